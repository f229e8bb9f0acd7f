"""A shift as an ASAM MDF 4 file, for viewers: all that was known, came later and was true.

A channel group for each series; an edge's or sleeve's series is one for each shaft or sleeve. Time
is in seconds since the request. Whatever in the format says when or where a file was written is
fixed: the start time and the file's history stand at 1970-01-01.
"""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import asammdf
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from asammdf import MDF, Signal

from benchmarks.dataset.parts import SERIES, TIME_OF, TRUTH, ShiftParts
from meshpoint.bridges.mf4_sink import undated_history
from meshpoint.units import US

UNITS: Final = {
    "_us": "us", "_bar": "bar", "_mm": "mm", "_rpm": "rpm", "_deg": "deg", "_percent": "%",
    "_km_h": "km/h", "_c": "degC", "_j": "J",
}  # fmt: skip
"""By the end of a column's name."""
APART: Final = {"edges": ("shaft", "edge"), "sleeves": ("sleeve",)}
"""Columns that part a table into groups."""
HISTORY: Final = (
    "<FHcomment><TX>created</TX><tool_id>benchmarks.dataset</tool_id>"
    "<tool_vendor>meshpoint</tool_vendor><tool_version>1</tool_version></FHcomment>"
)


def write_mf4(path: Path, shift: ShiftParts) -> None:
    """One shift's file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with MDF(version="4.10") as mdf:
        mdf.header.start_time = datetime.fromtimestamp(0.0, UTC)
        for name, table in _groups(shift):
            signals = _signals(name, table)
            if signals:
                mdf.append(signals, acq_name=name, comment=name)
        mdf.file_history.append(undated_history(asammdf, HISTORY))
        mdf.save(path, overwrite=True, compression=2, add_history_block=False)


def _groups(shift: ShiftParts) -> Iterator[tuple[str, pa.Table]]:
    """Every series with rows, under the name of its group."""
    for name in SERIES:
        table = pa.concat_tables([shift.known[name], shift.later[name]]).unify_dictionaries()
        yield from _parted(name, table)
    for name in TRUTH:
        yield f"true_{name}", shift.truth[name]


def _parted(name: str, table: pa.Table) -> Iterator[tuple[str, pa.Table]]:
    by = APART.get(name)
    if by is None:
        yield name, table
        return
    keys = [" ".join(row.values()) for row in table.select(by).to_pylist()]
    for key in sorted(set(keys)):
        yield f"{name} {key}", table.filter(pa.array([each == key for each in keys])).drop(list(by))


def _signals(name: str, table: pa.Table) -> list[Signal]:
    """Its columns as channels; none of a table without rows."""
    if not table.num_rows:
        return []
    time = TIME_OF.get(name, "time_us")
    table = table.take(pc.sort_indices(table, sort_keys=[(time, "ascending")]))
    at_s = table[time].to_numpy().astype(np.float64) * US
    return [
        Signal(
            samples=_values(table[column]),
            timestamps=at_s,
            name=f"{name}.{column}".replace(" ", "."),
            unit=next((unit for end, unit in UNITS.items() if column.endswith(end)), ""),
            encoding="utf-8",
        )
        for column in table.column_names
        if column not in ("shift", time)
    ]


def _values(column: pa.ChunkedArray) -> Any:
    """Texts as bytes, flags as 0 and 1, a number that is not there as no number."""
    if pa.types.is_dictionary(column.type):
        return np.array([value.encode() for value in column.to_pylist()])
    if pa.types.is_boolean(column.type):
        return np.array(column.to_pylist(), dtype=np.uint8)
    if column.null_count:
        return np.array([np.nan if value is None else value for value in column.to_pylist()], float)
    return column.to_numpy()
