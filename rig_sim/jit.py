"""How the truck's parts are compiled: small functions in their own files, one cached entry point.

numba's file cache looks only at the file of the cached function, so a change in a part would go
unseen. `part` therefore compiles without a cache and is inlined where it is called; `entry` caches,
with a digest of all sources of this package in the cache's key. With NUMBA_DISABLE_JIT=1 both leave
plain Python.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, TypeVar, cast

Kernel = TypeVar("Kernel", bound=Callable[..., Any])


DISABLED: Final = os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0")
"""Then numba is not even loaded, which is half of the start-up."""


OPTIONS: Final[dict[str, Any]] = {"error_model": "numpy", "_nrt": False}
"""Without numba's runtime, which counts references to arrays: kernels neither make nor keep one,
and the counting, atomic as it is, took half of their time."""


def _digest() -> int:
    hashed = hashlib.sha256()
    for path in sorted(Path(__file__).parent.rglob("*.py")):
        hashed.update(path.read_bytes())
    return int.from_bytes(hashed.digest()[:7])


SOURCES: Final = _digest()
"""A number that changes with any source of this package: entry points keep it in their closure."""


def part(function: Kernel) -> Kernel:
    """A piece of physics, compiled into the entry points that call it."""
    if DISABLED:
        return function
    import numba

    return cast(Kernel, numba.njit(**OPTIONS)(function))


def inlined(function: Kernel) -> Kernel:
    """A part that is copied to where it is called. A call hands over each array as seven words, so
    for a small part with many arrays it would cost more than the work."""
    if DISABLED:
        return function
    import numba

    return cast(Kernel, numba.njit(forceinline=True, **OPTIONS)(function))


def entry(function: Kernel) -> Kernel:
    """A cached entry point; the function must read `SOURCES` through its closure."""
    if DISABLED:
        return function
    import numba

    try:
        return cast(Kernel, numba.njit(cache=True, **OPTIONS)(function))
    except RuntimeError:
        # Nowhere to keep what was compiled, as in a read-only container: each start compiles.
        return cast(Kernel, numba.njit(**OPTIONS)(function))
