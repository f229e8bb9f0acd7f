"""Records of the compiled kernels: state, parameters and filters by name, over flat memory.

A class says what a record holds, each field with its unit in its name; `layout_of` makes the NumPy
dtype of it. A record is handed to a kernel as the flat float64 array it stands on, because numba
takes 0.02 us for one more of these and 1.1 us for a record; the kernel's first line names it again:

    state = record_on(x, STATE)
    state.pressure_pa += ...

`Over` names a stretch of fields once more as one array, for linear algebra and copies. With
NUMBA_DISABLE_JIT=1 the same lines work on a `numpy.record`. A series of several quantities is no
record but a plain array, one row a quantity.
"""

from __future__ import annotations

from typing import Any, Final, Protocol, TypeVar, cast, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Integers = NDArray[np.int64]
Layout = np.dtype[np.record]
Item = TypeVar("Item", covariant=True)

WORD_BYTES: Final = 8
"""Bytes of a number, float or integer: a record is a whole number of them."""


class Records(Protocol[Item]):
    """An array of records."""

    def __getitem__(self, at: int | tuple[int, ...]) -> Item:
        """One of them, by reference."""


class Over:
    """Says that a field lies over others, from the named one on."""

    def __init__(self, first: str) -> None:
        self.first = first


def layout_of(record: Any) -> Layout:
    """The dtype of a record's class: float, int, another record's class, or `Annotated` by the
    sizes of an array of these; with `Over` a second name for what another field holds. A size may
    be a record's class: as many numbers as that has. A class may be generic in those of its records
    (`Filter[State, Model]`)."""
    names: list[str] = []
    formats: list[Any] = []
    offsets: list[int] = []
    size = 0
    of = get_origin(record) or record
    given = dict(zip(getattr(of, "__parameters__", ()), get_args(record), strict=True))
    for name, hint in get_type_hints(of, include_extras=True).items():
        kind, shape, over = _parted(hint, given)
        field = np.dtype((kind, shape)) if shape else np.dtype(kind)
        names.append(name)
        formats.append(field)
        offsets.append(size if over is None else offsets[names.index(over.first)])
        size += field.itemsize if over is None else 0
    fields = {"names": names, "formats": formats, "offsets": offsets, "itemsize": size}
    named: Any = np.dtype(fields, align=True)  # type: ignore[call-overload]
    layout: Any = np.dtype((np.record, named))
    return cast(Layout, layout)


def words_of(record: Any) -> int:
    """How many numbers a record holds."""
    return layout_of(record).itemsize // WORD_BYTES


def _parted(hint: Any, given: dict[Any, Any]) -> tuple[Any, tuple[int, ...], Over | None]:
    """A field's element, its sizes, and what it lies over; given: the records that stand for a
    generic class's parameters."""

    def meant(part: Any) -> Any:
        inner = getattr(part, "__parameters__", ())
        return part[tuple(given[one] for one in inner)] if inner else given.get(part, part)

    of, *rest = get_args(hint) if getattr(hint, "__metadata__", None) else (hint,)
    of, over = meant(of), next((part for part in rest if isinstance(part, Over)), None)
    sizes = [meant(part) for part in rest if not isinstance(part, Over)]
    shape = tuple(part if isinstance(part, int) else words_of(part) for part in sizes)
    if of in (Vector, Integers):
        return np.float64 if of == Vector else np.int64, shape, over
    if of in (float, int):
        return np.float64 if of is float else np.int64, shape, over
    return layout_of(get_args(of)[0] if get_origin(of) is Records else of), shape, over


def filled(layout: Layout, **values: float) -> Vector:
    """The flat memory of a record of floats alone: every field, in order. KeyError otherwise."""
    if tuple(values) != layout.names:
        raise KeyError(f"the fields are {layout.names}, not {tuple(values)}")
    return np.array([*values.values()], dtype=np.float64)


class RecordMemory:
    """A record and the flat memory it stands on. Copied (a campaign copies whole controllers) as
    the memory alone: copies of views would be arrays of their own."""

    def __init__(self, layout: Layout) -> None:
        self._layout = layout
        self.flat: Vector = np.zeros(layout.itemsize // WORD_BYTES)
        self._record = self.flat.view(layout)
        self._name_parts()

    def part(self, name: str) -> NDArray[Any]:
        """A field as a view: of one element where it is a single number."""
        view: NDArray[Any] = self._record[name]
        return view if view.ndim == 1 else view[0]

    def put(self, **fields: Any) -> None:
        """Sets these fields."""
        for name, value in fields.items():
            self.part(name)[...] = value

    def _name_parts(self) -> None:
        """Makes the views that are asked for often; called again for a copy."""

    def __deepcopy__(self, _memo: dict[int, Any]) -> Any:
        other = type(self).__new__(type(self))
        RecordMemory.__init__(other, self._layout)
        other.flat[:] = self.flat
        return other
