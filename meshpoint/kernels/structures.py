"""Records of the compiled kernels: one piece of memory, its fields by name on both sides.

A record is declared once, as a class, the unit in the field's name:

    class Tank(Record):
        pressure_pa: float
        inflows_kg_s: Annotated[Row[float], 3]

Fields are `float`, `int` (64 bits, or `Annotated[int, ctypes.c_uint16]`), other records, or rows
of these. Python reads and writes `tank.pressure_pa` in the memory itself: the record is a ctypes
structure, as a field takes 0.05 us there and 2 us in a `np.record`. Kernels get
`RecordArray(tank).array`, a NumPy array of one such record, and say `tank = tanks[0]`, then
`tank.pressure_pa` as well. With NUMBA_DISABLE_JIT=1 `tanks[0]` is the structure itself.

Keep records, not rows or NumPy views of them, in objects that are copied: a copied record finds its
copied memory, a row would get one of its own.
"""

from __future__ import annotations

import copy
import ctypes
import inspect
from collections.abc import Iterator, Sequence
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    Final,
    Generic,
    Protocol,
    Self,
    TypeVar,
    cast,
    get_args,
    get_origin,
    overload,
)

import numpy as np
import numpy.typing as npt

from meshpoint.kernels.jit import DISABLED

Value = TypeVar("Value")
Floats = npt.NDArray[np.float64]

SCALARS: Final[dict[Any, Any]] = {float: ctypes.c_double, int: ctypes.c_int64}


class Row(Protocol[Value]):
    """This many values or records one after the other; a slice of values is a list of them."""

    @overload
    def __getitem__(self, index: int) -> Value: ...
    @overload
    def __getitem__(self, index: slice) -> list[Value]: ...
    @overload
    def __setitem__(self, index: int, value: Value) -> None: ...
    @overload
    def __setitem__(self, index: slice, value: Sequence[Value]) -> None: ...
    def __len__(self) -> int:
        """How many."""

    def __iter__(self) -> Iterator[Value]:
        """One after the other."""


def _stored(hint: Any) -> Any:
    """The ctypes type of a field's declaration."""
    if get_origin(hint) is Annotated:
        what, extra = get_args(hint)
        return _stored(get_args(what)[0]) * extra if isinstance(extra, int) else extra
    return SCALARS.get(hint, hint)


class _Declared(type(ctypes.Structure)):  # type: ignore[misc]
    """Makes the fields of what a class declares. Without a dict in the instance a misspelt field is
    an error, not a new attribute."""

    def __new__(cls, name: str, bases: tuple[type, ...], names: dict[str, Any]) -> Any:
        return super().__new__(cls, name, bases, {"__slots__": (), **names})

    def __init__(cls, *given: Any) -> None:
        # Not in __new__: from Python 3.13 on a structure takes fields once it is initialised.
        super().__init__(*given)
        hints = inspect.get_annotations(cls, eval_str=True)
        cls._fields_ = [(field, _stored(hint)) for field, hint in hints.items()]


if TYPE_CHECKING:
    Structure = object  # which knows no fields but those declared
else:
    Structure = ctypes.Structure


class Record(Structure, metaclass=_Declared):
    """Base of all records. A copy by `copy.deepcopy` keeps what lies in one memory together."""

    def __init__(self, *values: Any, **fields: Any) -> None:
        super().__init__(*values, **fields)

    def raw(self) -> memoryview:
        """The memory itself, byte by byte."""
        return memoryview(cast(Any, self)).cast("B")

    def copy(self) -> Self:
        """One in a memory of its own."""
        return cast(Self, cast(Any, type(self)).from_buffer_copy(self))

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        root: Any = self
        while root._b_base_ is not None:
            root = root._b_base_
        copied = memo.get(id(root))
        if copied is None:
            copied = memo[id(root)] = type(root).from_buffer_copy(root)
        offset = ctypes.addressof(cast(Any, self)) - ctypes.addressof(root)
        return cast(Self, _part_of(copied, offset, type(self)))


class Vector(Record):
    """A record of numbers to be integrated: all fields are floats."""

    @property
    def vector(self) -> Floats:
        """The same memory as one row of numbers."""
        size = ctypes.sizeof(cast(Any, self)) // np.dtype(np.float64).itemsize
        return np.ndarray(size, np.float64, buffer=cast(Any, self))


Kept = TypeVar("Kept", bound=Record)


class RecordArray(Generic[Kept]):
    """A record and the array through which kernels see it. A copy of both still is one memory."""

    def __init__(self, record: Kept) -> None:
        self.record = record
        self.array: Sequence[Kept] = (record,)
        if not DISABLED:
            view = np.ndarray(1, dtype_of(type(record)), buffer=cast(Any, record))
            self.array = cast(Sequence[Kept], view)

    def __deepcopy__(self, memo: dict[int, Any]) -> RecordArray[Kept]:
        return RecordArray(copy.deepcopy(self.record, memo))


_dtypes: Final[dict[type[Record], np.dtype[Any]]] = {}


def dtype_of(kind: type[Record]) -> np.dtype[Any]:
    """The record as NumPy and the compiler know it: always the same object, which numba's look-up
    of argument types goes by."""
    if kind not in _dtypes:
        stored = cast(Any, kind)
        names = [name for name, _ in stored._fields_]
        formats = [_format(field) for _, field in stored._fields_]
        offsets = [getattr(kind, name).offset for name in names]
        size = ctypes.sizeof(stored)
        if issubclass(kind, Vector):
            names.append("vector")
            formats.append(np.dtype((np.float64, (size // 8,))))
            offsets.append(0)
        _dtypes[kind] = np.dtype(
            {"names": names, "formats": formats, "offsets": offsets, "itemsize": size},
            align=True,
        )
    return _dtypes[kind]


def _part_of(record: Any, offset: int, kind: type[Record]) -> Any:
    """The record of this kind that begins this many bytes after the beginning of another. It is got
    field by field, as one made from a buffer would not know what it is a part of."""
    while offset or type(record) is not kind:
        for name, field in record._fields_:
            start, size = getattr(type(record), name).offset, ctypes.sizeof(field)
            if start <= offset < start + size:
                record, offset = getattr(record, name), offset - start
                break
        if isinstance(record, ctypes.Array):
            size = ctypes.sizeof(record._type_)
            record, offset = record[offset // size], offset % size
    return record


def _format(field: Any) -> np.dtype[Any]:
    if issubclass(field, ctypes.Array):
        return np.dtype((_format(field._type_), (field._length_,)))
    return dtype_of(field) if issubclass(field, Record) else np.dtype(field)
