"""numba's compiler for the kernels, or none: with NUMBA_DISABLE_JIT=1 numba is not even loaded."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any, Final, TypeVar, cast

Kernel = TypeVar("Kernel", bound=Callable[..., Any])

DISABLED: Final = os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0")


def compiled(function: Kernel) -> Kernel:
    """The function compiled, with numba's file cache; as it is where compiling is switched off."""
    if DISABLED:
        return function
    # Loading it is a third of the start-up, so only where it is needed.
    from numba import njit

    try:
        return cast(Kernel, njit(cache=True)(function))
    except RuntimeError:
        # Nowhere to keep what was compiled, as in a read-only container: each start compiles.
        return cast(Kernel, njit(function))


BARE: Final[dict[str, Any]] = {"error_model": "numpy", "_nrt": False}
"""Without counting references to arrays, for kernels that neither make nor keep one."""


def bare(function: Kernel) -> Kernel:
    """A kernel that only works on the arrays it is given; compiled and cached as `compiled`."""
    if DISABLED:
        return function
    from numba import njit

    try:
        return cast(Kernel, njit(cache=True, **BARE)(function))
    except RuntimeError:
        return cast(Kernel, njit(**BARE)(function))


def inlined(function: Kernel) -> Kernel:
    """A piece of bare kernels of the same file (numba's cache sees no other file), copied to where
    it is called: handing over its arrays would cost more than its work."""
    if DISABLED:
        return function
    from numba import njit

    return cast(Kernel, njit(forceinline=True, **BARE)(function))
