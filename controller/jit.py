"""numba's compiler for the kernels, or none: with NUMBA_DISABLE_JIT=1 numba is not even loaded.

`compiled` and `bare` make an entry point, kept on disk (`meshpoint.kernel_cache`); `inlined` a
piece of one, copied to where it is called.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, TypeVar, cast

Kernel = TypeVar("Kernel", bound=Callable[..., Any])

DISABLED: Final = os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0")
FOLDER: Final = Path(__file__).parent


BARE: Final[dict[str, Any]] = {"error_model": "numpy", "_nrt": False}
"""Without numba's runtime, whose atomic counting of references takes longer than a small piece of
work: for kernels that neither make nor keep an array."""


def compiled(function: Kernel) -> Kernel:
    """The function compiled and kept on disk; as it is where compiling is switched off."""
    return _entry(function, {"error_model": "numpy"})


def bare(function: Kernel) -> Kernel:
    """A kernel that only works on the arrays it is given; compiled and kept as `compiled`."""
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
    from numba import njit

    from meshpoint.kernel_cache import keep_compiled

    kernel = njit(**options)(function)
    keep_compiled(kernel, FOLDER)
    return cast(Kernel, kernel)
