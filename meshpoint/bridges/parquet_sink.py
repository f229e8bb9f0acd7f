"""Time series as a Parquet table: a column for each signal, a row for each sample of a topic.

Columns of other topics are null in a row; events are rows with `event` and `who` alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.parquet as pq

from meshpoint.bridges.series import TOPICS, Sample
from meshpoint.bridges.sink import Event, Sink

GROUP_ROWS: Final = 50_000
"""Rows that are held before they are written."""


def _schema() -> pa.Schema:
    fixed = [
        pa.field("time_s", pa.float64(), nullable=False),
        pa.field("topic", pa.dictionary(pa.int16(), pa.string())),
        pa.field("who", pa.string()),
        pa.field("event", pa.string()),
    ]
    signals = [
        pa.field(
            f"{topic}.{signal.name}",
            pa.float64(),
            metadata={
                "unit": signal.unit,
                "comment": signal.comment,
                "names": _names(signal.names),
            },
        )
        for topic, of in TOPICS.items()
        for signal in of.signals
    ]
    return pa.schema(fixed + signals)


def _names(names: Mapping[int, str]) -> str:
    return ", ".join(f"{number} {name}" for number, name in names.items())


@contextmanager
def parquet_file(path: Path) -> Iterator[Sink]:
    """A Parquet file, which is complete once this is left."""
    with pq.ParquetWriter(path, _schema(), compression="zstd") as writer:
        sink = ParquetSink(writer)
        yield sink
        sink.flush()


class ParquetSink:
    """Rows in groups."""

    def __init__(self, writer: pq.ParquetWriter) -> None:
        self._writer = writer
        self._rows: list[dict[str, Any]] = []

    def sample(self, sample: Sample) -> None:
        """A row of a topic."""
        values = {f"{sample.topic}.{name}": of for name, of in sample.values.items()}
        self._add({"time_s": sample.time_s, "topic": sample.topic, **values})

    def event(self, event: Event) -> None:
        """A row of its own."""
        self._add({"time_s": event.time_s, "who": event.who, "event": event.words})

    def _add(self, row: dict[str, Any]) -> None:
        self._rows.append(row)
        if len(self._rows) >= GROUP_ROWS:
            self.flush()

    def flush(self) -> None:
        """Writes what is held."""
        if self._rows:
            self._writer.write_table(pa.Table.from_pylist(self._rows, schema=self._writer.schema))
            self._rows.clear()
