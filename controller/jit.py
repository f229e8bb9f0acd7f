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
