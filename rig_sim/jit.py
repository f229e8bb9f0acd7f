"""How the rig's numeric parts are compiled: small functions in their own files, few entry points.

`part` and `inlined` make a piece, compiled into the entry points that call it; `entry` makes an
entry point, kept on disk (`meshpoint.kernel_cache`). With NUMBA_DISABLE_JIT=1 all leave plain
Python.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any, Final, TypeVar, cast

Kernel = TypeVar("Kernel", bound=Callable[..., Any])


DISABLED: Final = os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0")
"""Then numba is not even loaded, which is half of the start-up."""


OPTIONS: Final[dict[str, Any]] = {"error_model": "numpy", "_nrt": False}
"""Without numba's runtime, which counts references to arrays: kernels neither make nor keep one,
and the counting, atomic as it is, took half of their time."""


def part(function: Kernel) -> Kernel:
    """A piece of physics, compiled into the entry points that call it."""
    if DISABLED:
        return function
    from meshpoint.kernel_pieces import piece_of_kernels

    return cast(Kernel, piece_of_kernels(function, **OPTIONS))


def inlined(function: Kernel) -> Kernel:
    """A part that is copied to where it is called. A call hands over each array as seven words, so
    for a small part with many arrays it would cost more than the work."""
    if DISABLED:
        return function
    from meshpoint.kernel_pieces import piece_of_kernels

    return cast(Kernel, piece_of_kernels(function, forceinline=True, **OPTIONS))


def entry(function: Kernel, options: dict[str, Any] | None = None) -> Kernel:
    """An entry point, kept on disk (`meshpoint.kernel_cache`); the options are numba's."""
    if DISABLED:
        return function
    import numba

    from meshpoint.kernel_cache import keep_compiled

    kernel = numba.njit(**(OPTIONS if options is None else options))(function)
    keep_compiled(kernel)
    return cast(Kernel, kernel)
