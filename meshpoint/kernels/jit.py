"""numba's compiler for the kernels, or none: with NUMBA_DISABLE_JIT=1 numba is not even loaded.

    compiled    an entry point, kept on disk (`meshpoint.kernels.cache`)
    bare        one that neither makes nor keeps an array
    piece       compiled into the entry points that call it
    inlined     a piece that is copied to where it is called

`record_on` and `new_record` give a kernel a record of `meshpoint.kernels.records`: by a pointer,
while `view` and `zeros` are compiled anew for each layout.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any, Final, TypeVar, cast

from meshpoint.kernels.records import WORD_BYTES, Layout, Vector

Kernel = TypeVar("Kernel", bound=Callable[..., Any])

DISABLED: Final = os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0")
"""Loading numba is a third of the start-up."""

BARE: Final[dict[str, Any]] = {"error_model": "numpy", "_nrt": False}
"""Without numba's runtime, which counts references to arrays: the counting, atomic as it is, takes
longer than a small piece of work."""


def compiled(function: Kernel) -> Kernel:
    """The function compiled and kept on disk; as it is where compiling is switched off."""
    return _entry(function, {"error_model": "numpy"})


def bare(function: Kernel) -> Kernel:
    """A kernel that only works on the arrays it is given; compiled and kept as `compiled`."""
    return _entry(function, BARE)


def piece(function: Kernel) -> Kernel:
    """A piece of a kernel that makes no array of its own."""
    return _piece(function, BARE)


def inlined(function: Kernel) -> Kernel:
    """A piece that is copied to where it is called: a call hands over each array as seven words,
    which costs a small piece with many arrays more than its work."""
    return _piece(function, {"forceinline": True, **BARE})


def _piece(function: Kernel, options: dict[str, Any]) -> Kernel:
    if DISABLED:
        return function
    from meshpoint.kernels.pieces import piece_of_kernels

    return cast(Kernel, piece_of_kernels(function, **options))


def _entry(function: Kernel, options: dict[str, Any]) -> Kernel:
    if DISABLED:
        return function
    from numba import njit

    from meshpoint.kernels.cache import keep_compiled

    kernel = njit(**options)(function)
    keep_compiled(kernel)
    return cast(Kernel, kernel)


def _record_on(memory: Vector, layout: Layout) -> Any:
    """The record that lies at the beginning of this memory, by reference; a matrix without gaps
    is memory as well. A ValueError where there are gaps."""
    import numpy as np

    return np.ndarray(1, layout, memory)[0]


def _new_record(layout: Layout) -> Any:
    """A record of zeros, which lasts as long as the call of the kernel."""
    import numpy as np

    return np.zeros(layout.itemsize // WORD_BYTES).view(layout)[0]


record_on: Any
new_record: Any
if DISABLED:
    record_on, new_record = _record_on, _new_record
else:
    from meshpoint.kernels import record_pointers

    record_on, new_record = record_pointers.record_on, record_pointers.new_record
