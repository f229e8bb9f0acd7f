"""Judged shifts by columns: a quarter of a kilobyte a shift, a quarter of what objects take.

`ShiftColumns` grows as runs come to their end; `Shifts` is a choice of them in some order. A number
that is not there is NaN, and None again in a `JudgedShift`.
"""

from __future__ import annotations

import dataclasses
import types
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any, Final, NamedTuple, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray

from meshpoint.campaigns.record import GAP, JudgedShift
from meshpoint.gearbox.gears import DRIVE_GEARS
from meshpoint.kernels.records import Integers
from meshpoint.results.shift_figures import REFUSED

if TYPE_CHECKING:
    import pyarrow as pa

Column = NDArray[Any]
PENDING: Final = 1024
"""This many records wait as objects until they become columns."""
AT_ONCE: Final = 16_384
"""This many rows at a time are made, written or read."""
WIDTHS: Final[dict[type, type[np.generic]]] = {
    int: np.int64, float: np.float64, bool: np.bool_, str: np.int32,
}  # fmt: skip
"""A word is a number in the list of words."""
PLACES: Final = np.array(
    [0, *(10 * gear.range_ + gear.main for _, gear in sorted(DRIVE_GEARS.items()))]
)
"""By number of a drive gear, what its main box and its range stand in."""


class Field(NamedTuple):
    """One column."""

    name: str
    kind: type
    is_optional: bool

    @property
    def width(self) -> type[np.generic]:
        """What it is kept as."""
        return WIDTHS[self.kind]


def _fields() -> dict[str, Field]:
    hints = get_type_hints(JudgedShift)
    found = {}
    for name in (field.name for field in dataclasses.fields(JudgedShift)):
        is_optional = isinstance(hints[name], types.UnionType)
        kind = get_args(hints[name])[0] if is_optional else hints[name]
        found[name] = Field(name, kind, is_optional)
    return found


FIELDS: Final = _fields()


class ShiftColumns:
    """Judged shifts in the order in which they came."""

    def __init__(self) -> None:
        self._columns = {name: np.empty(0, field.width) for name, field in FIELDS.items()}
        """Longer than what is in them, and exchanged for longer ones where they are full."""
        self._filled = 0
        self._pending: list[JudgedShift] = []
        self._codes: dict[str | None, int] = {}
        self._words: list[str | None] = []

    def __len__(self) -> int:
        return self._filled + len(self._pending)

    def extend(self, records: Iterable[JudgedShift]) -> None:
        """Some more."""
        self._pending.extend(records)
        if len(self._pending) >= PENDING:
            self._flush()

    def extend_by(self, rows: Any, text: dict[str, list[str | None]]) -> None:
        """Some more: whole columns by name; those of text are numbers in the list of `text`."""
        self._flush()
        end = self._reserve(len(rows["seed"]))
        for name, field in FIELDS.items():
            values = rows[name]
            if field.kind is str:
                meaning = np.array([self._code(word) for word in text[name]], dtype=np.int32)
                values = meaning[values]
            self._columns[name][self._filled : end] = values
        self._filled = end

    def column(self, name: str) -> Column:
        """All values of one column."""
        self._flush()
        return self._columns[name][: self._filled]

    @property
    def words(self) -> list[str | None]:
        """What the numbers in columns of text mean."""
        self._flush()
        return self._words

    def code(self, word: str | None) -> int:
        """The number of a word; -1 where none is it."""
        self._flush()
        return self._codes.get(word, -1)

    def all(self) -> Shifts:
        """All of them."""
        return Shifts(self, np.arange(len(self)))

    def _flush(self) -> None:
        records, self._pending = self._pending, []
        end = self._reserve(len(records))
        for name, field in FIELDS.items():
            values: list[Any] = [getattr(record, name) for record in records]
            if field.kind is str:
                values = [self._code(word) for word in values]
            self._columns[name][self._filled : end] = values  # None: NaN
        self._filled = end

    def _reserve(self, more: int) -> int:
        """Makes room for this many more rows; where they end."""
        end, room = self._filled + more, self._columns["seed"].size
        if end > room:
            room = max(end, room + room // 4, PENDING)
            for name, column in self._columns.items():
                longer = np.empty(room, column.dtype)
                longer[: self._filled] = column[: self._filled]
                self._columns[name] = longer
        return end

    def _code(self, word: str | None) -> int:
        code = self._codes.setdefault(word, len(self._words))
        if code == len(self._words):
            self._words.append(word)
        return code


class Shifts:
    """Some judged shifts in some order."""

    def __init__(self, columns: ShiftColumns, rows: Integers) -> None:
        """`rows`: their numbers in `columns`."""
        self._columns, self._rows = columns, rows

    @classmethod
    def of(cls, records: Iterable[JudgedShift]) -> Shifts:
        """These records."""
        columns = ShiftColumns()
        columns.extend(records)
        return columns.all()

    def __len__(self) -> int:
        return int(self._rows.size)

    def __iter__(self) -> Iterator[JudgedShift]:
        """As records, each made when it is asked for."""
        for part in self.parts(PENDING):
            for values in zip(*(part.values(name) for name in FIELDS), strict=True):
                yield JudgedShift(**dict(zip(FIELDS, values, strict=True)))

    def column(self, name: str) -> Column:
        """Values of one column: numbers, NaN where there is none; words as their `codes`."""
        return self._columns.column(name)[self._rows]

    def known(self, name: str) -> Column:
        """Of one column of numbers, those that are there."""
        values = self.column(name)
        return values[~np.isnan(values)]

    def values(self, name: str) -> list[Any]:
        """One column as a record has it."""
        field, column = FIELDS[name], self.column(name)
        if field.kind is str:
            words = self.words
            return [words[code] for code in column.tolist()]
        if field.is_optional:
            return [None if value != value else value for value in column.tolist()]
        found: list[Any] = column.tolist()
        return found

    def is_(self, name: str, word: str | None) -> NDArray[np.bool_]:
        """Where a column of text has this word."""
        found: NDArray[np.bool_] = self.column(name) == self._columns.code(word)
        return found

    @property
    def is_gap(self) -> NDArray[np.bool_]:
        """Whether the first contact was in a gap."""
        return self.is_("contact", GAP)

    @property
    def engaged(self) -> NDArray[np.bool_]:
        """Whether the gear is in."""
        return self.is_("result", "engaged")

    @property
    def refused(self) -> NDArray[np.bool_]:
        """Whether the controller has not begun it."""
        return self.is_("result", REFUSED)

    @property
    def meet_teeth(self) -> NDArray[np.bool_]:
        """Whether dog teeth have to meet: all but changes of the splitter alone."""
        places: NDArray[np.bool_] = (
            PLACES[self.column("from_gear")] != PLACES[self.column("to_gear")]
        )
        return places

    @property
    def words(self) -> list[str | None]:
        """What the numbers in columns of text mean."""
        return self._columns.words

    def words_of(self, name: str) -> list[str | None]:
        """Each word that a column of text has, once."""
        return [self.words[code] for code in np.unique(self.column(name))]

    def where(self, chosen: NDArray[np.bool_]) -> Shifts:
        """Those, in the same order."""
        return Shifts(self._columns, self._rows[chosen])

    def by(self, strategy: str) -> Shifts:
        """Those of one strategy."""
        return self.where(self.is_("strategy", strategy))

    def stretch(self, start: int, end: int) -> Shifts:
        """Those from one place on up to another."""
        return Shifts(self._columns, self._rows[start:end])

    def parts(self, at_once: int = AT_ONCE) -> Iterator[Shifts]:
        """This many at a time that they take little memory."""
        for start in range(0, len(self), at_once):
            yield self.stretch(start, start + at_once)

    def to_arrow(self, schema: pa.Schema) -> pa.Table:
        """As a table of this schema; words in order of the alphabet, so that the order in which
        shifts came does not show."""
        import pyarrow as pa

        return pa.Table.from_arrays([self._arrow(field) for field in schema], schema=schema)

    def _arrow(self, field: pa.Field) -> pa.Array:
        import pyarrow as pa

        column, own = self.column(field.name), FIELDS[field.name]
        if own.kind is not str:
            return pa.array(column, field.type, mask=np.isnan(column) if own.is_optional else None)
        all_words = self.words
        words = sorted(word for code in np.unique(column) if (word := all_words[code]) is not None)
        place = {word: k for k, word in enumerate(words)}
        places = np.array([place.get(word, -1) for word in all_words] or [-1], dtype=np.int32)
        codes = pa.array(places[column], mask=places[column] < 0)
        return pa.DictionaryArray.from_arrays(codes, pa.array(words, pa.string()))
