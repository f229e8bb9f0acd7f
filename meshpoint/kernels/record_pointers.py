"""Records for compiled kernels: pointers that the compiler knows the layout of.

Loads numba: `meshpoint.kernels.jit` has the same two for plain Python.
"""

# numba is typed only in part.
# mypy: disable-error-code="no-untyped-call,untyped-decorator"

from __future__ import annotations

from typing import Any

from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from meshpoint.kernels.records import WORD_BYTES


@intrinsic
def record_on(_context: Any, memory: Any, layout: Any) -> Any:
    """The record that lies at the beginning of this flat memory, by reference."""
    if not (isinstance(memory, types.Array) and memory.layout == "C"):
        return None
    record = layout.dtype

    def point(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        array = context.make_array(signature.args[0])(context, builder, given[0])
        return builder.bitcast(array.data, context.get_value_type(record))

    return record(memory, layout), point


@intrinsic
def new_record(_context: Any, layout: Any) -> Any:
    """A record of zeros, which lasts as long as the call of the kernel."""
    record = layout.dtype

    def make(context: Any, builder: Any, _signature: Any, _given: Any) -> Any:
        place = cgutils.alloca_once(builder, context.get_data_type(record))
        place.align = WORD_BYTES
        cgutils.memset(builder, place, context.get_constant(types.intp, record.size), 0)
        return builder.bitcast(place, context.get_value_type(record))

    return record(layout), make
