"""numba's compiler for the kernels, or none: with NUMBA_DISABLE_JIT=1 numba is not even loaded.

`compiled` and `bare` make an entry point, kept in numba's file cache; `inlined` a piece of one,
copied to where it is called. numba looks only at the file of a cached function, so a change in a
piece in another file would go unseen: the cache's folder therefore bears a digest of all kernels.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, TypeVar, cast

Kernel = TypeVar("Kernel", bound=Callable[..., Any])

DISABLED: Final = os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0")
FOLDER: Final = Path(__file__).parent


def _digest() -> str:
    """Of every file that has kernels, records or figures for them: all that know one of the two."""
    hashed = hashlib.sha256(Path(__file__).read_bytes())
    for path in sorted(FOLDER.rglob("*.py")):
        source = path.read_bytes()
        if b"meshpoint.controller.jit" in source or b"meshpoint.controller.records" in source:
            hashed.update(source)
    return hashed.hexdigest()[:12]


BARE: Final[dict[str, Any]] = {"error_model": "numpy", "_nrt": False}
"""Without numba's runtime, whose atomic counting of references takes longer than a small piece of
work: for kernels that neither make nor keep an array."""


def compiled(function: Kernel) -> Kernel:
    """The function compiled, with numba's file cache; as it is where compiling is switched off."""
    return _entry(function, {"error_model": "numpy"})


def bare(function: Kernel) -> Kernel:
    """A kernel that only works on the arrays it is given; compiled and cached as `compiled`."""
    return _entry(function, BARE)


def inlined(function: Kernel) -> Kernel:
    """A piece of a kernel that makes no array of its own, copied to where it is called: a call
    hands over each array as seven words."""
    if DISABLED:
        return function
    from numba import njit

    return cast(Kernel, njit(forceinline=True, **BARE)(function))


def _entry(function: Kernel, options: dict[str, Any]) -> Kernel:
    if DISABLED:
        return function
    # Loading it is a third of the start-up, so only where it is needed.
    from numba import config as numba_config
    from numba import njit

    config: Any = numba_config
    before = config.CACHE_DIR
    config.CACHE_DIR = before or str(FOLDER / "__pycache__" / f"kernels-{_DIGEST}")
    try:
        return cast(Kernel, njit(cache=True, **options)(function))
    except RuntimeError:
        # Nowhere to keep what was compiled, as in a read-only container: each start compiles.
        return cast(Kernel, njit(**options)(function))
    finally:
        config.CACHE_DIR = before


_DIGEST: Final = "" if DISABLED else _digest()
