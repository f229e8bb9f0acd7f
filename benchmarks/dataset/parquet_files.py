"""The set's tables as Parquet: the same rows give the same bytes, with the same version of pyarrow.

Nothing in such a file says when it was written.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.parquet as pq

from benchmarks.dataset.parts import SERIES, TEXT, TRUTH, ShiftParts

LEVEL: Final = 15
"""Of zstd."""


def write_parquet(folder: Path, shifts: Sequence[ShiftParts]) -> None:
    """All tables of a set, each in the order of the shifts."""
    for part in ("known", "later", "truth"):
        for name in TRUTH if part == "truth" else SERIES:
            tables = [getattr(shift, part)[name] for shift in shifts]
            _write(folder / part / f"{name}.parquet", pa.concat_tables(tables).unify_dictionaries())
    _write(folder / "shifts.parquet", _rows([each.shift for each in shifts]))
    _write(folder / "truth" / "contacts.parquet", _rows([each.contact for each in shifts]))
    _write(folder / "truth" / "conditions.parquet", _rows([each.conditions for each in shifts]))


def _rows(rows: Sequence[dict[str, Any]]) -> pa.Table:
    return pa.Table.from_pylist(list(rows))


def _write(path: Path, table: pa.Table) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    table = table.combine_chunks()
    texts = [
        field.name for field in table.schema if field.type == TEXT or pa.types.is_string(field.type)
    ]
    encodings = {
        field.name: "DELTA_BINARY_PACKED"
        if pa.types.is_integer(field.type)
        else "BYTE_STREAM_SPLIT"
        for field in table.schema
        if pa.types.is_integer(field.type) or pa.types.is_floating(field.type)
    }
    pq.write_table(
        table,
        path,
        compression="zstd",
        compression_level=LEVEL,
        use_dictionary=texts,
        column_encoding=encodings,
    )
