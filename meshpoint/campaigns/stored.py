"""Tables of judged shifts as files: written by columns, words once, a sweep's points apart.

Words are dictionary columns. A row group holds shifts of one point of the sweep alone, so a reader
who filters by `sweep` and `sweep_value` reads that point and nothing else of the file.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from meshpoint.base.errors import CommandError, unwritten
from meshpoint.campaigns.columns import FIELDS, ShiftColumns, Shifts
from meshpoint.gearbox.reading import UnreadableError, open_regular

if TYPE_CHECKING:
    import pyarrow as pa

READ_AT_ONCE: Final = 4096
"""Rows. More take memory and no less time."""
KINDS: Final[dict[type, str]] = {int: "int64", float: "float64", bool: "bool", str: "string"}


def schema() -> pa.Schema:
    """Of every table of judged shifts."""
    import pyarrow as pa

    fields = []
    for field in FIELDS.values():
        kind = pa.type_for_alias(KINDS[field.kind])
        if field.kind is str:
            kind = pa.dictionary(pa.int32(), kind)
        fields.append(pa.field(field.name, kind, nullable=field.is_optional))
    return pa.schema(fields)


def write_shifts(path: Path, shifts: Shifts) -> None:
    """Written beside, then renamed: a file with this name is whole. CommandError where it cannot
    be."""
    import pyarrow.parquet as pq

    columns = schema()
    beside = path.with_suffix(".writing")
    try:
        with pq.ParquetWriter(beside, columns) as writer:
            for points in by_point(shifts):
                for part in points.parts():
                    writer.write_table(part.to_arrow(columns))
        beside.replace(path)
    except OSError as error:
        raise unwritten(path, error) from error


def by_point(shifts: Shifts) -> Iterator[Shifts]:
    """Stretches of one point of the sweep each, in their order."""
    if not len(shifts):
        return
    sweep, value = shifts.column("sweep"), shifts.column("sweep_value")
    changes = np.flatnonzero((np.diff(sweep) != 0) | (np.diff(value) != 0)) + 1
    ends = [0, *changes.tolist(), len(shifts)]
    for start, end in itertools.pairwise(ends):
        yield shifts.stretch(start, end)


def read_shifts(path: Path, into: ShiftColumns) -> None:
    """All shifts of a table, made by this version or by an older one that wrote words as text.
    CommandError where it is none."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns = schema()
    text = [field.name for field in FIELDS.values() if field.kind is str]
    try:
        with (
            open_regular(path) as source,
            pq.ParquetFile(source, read_dictionary=text, pre_buffer=False) as file,
        ):
            lacks = [name for name in FIELDS if name not in file.schema_arrow.names]
            if lacks:
                raise CommandError(f"{path}: not a part of a campaign: no column {lacks[0]}")
            for batch in file.iter_batches(READ_AT_ONCE, columns=list(FIELDS)):
                table = pa.Table.from_batches([batch]).select(list(FIELDS)).cast(columns)
                into.extend_by(*_columns_of(path, table))
    except UnreadableError as error:
        raise CommandError(str(error)) from error
    except (OSError, pa.ArrowException, ValueError, LookupError) as error:
        raise CommandError(f"{path}: not a part of a campaign: {error}") from error
    pa.default_memory_pool().release_unused()  # it would keep what reading took for more of it


def _columns_of(path: Path, table: pa.Table) -> tuple[dict[str, Any], dict[str, Any]]:
    """Columns as `ShiftColumns.extend_by` has them; a word that is not there is the list's last."""
    rows: dict[str, Any] = {}
    text: dict[str, Any] = {}
    for name, field in FIELDS.items():
        values = table.column(name).combine_chunks()
        words = values.dictionary.to_pylist() if field.kind is str else []
        if not field.is_optional and (values.null_count or None in words):
            raise CommandError(f"{path}: not a part of a campaign: a shift without {name}")
        if field.kind is str:
            text[name] = [*words, None]
            values = values.indices.fill_null(len(words))
        rows[name] = values.to_numpy(zero_copy_only=False)
    return rows, text


def read_columns(path: Path, names: tuple[str, ...]) -> list[list[Any]]:
    """Some columns of a table of judged shifts, which may be of another version of the product.
    CommandError where it lacks one."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with open_regular(path) as source:
            table = pq.read_table(source, columns=list(names))
        return [table.column(name).to_pylist() for name in names]
    except UnreadableError as error:
        raise CommandError(str(error)) from error
    except (OSError, KeyError, pa.ArrowException) as error:
        raise CommandError(f"{path}: not a table of a campaign: {error}") from error


def column_names(path: Path) -> frozenset[str]:
    """The columns of a table that `read_columns` has read. CommandError where it is gone since."""
    import pyarrow.parquet as pq

    try:
        with open_regular(path) as source:
            return frozenset(pq.read_schema(source).names)
    except UnreadableError as error:
        raise CommandError(str(error)) from error
