"""Time series as an ASAM MDF 4 file: a channel group for each topic, and one for the events.

Needs the extra `meshpoint[mf4]`.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import numpy as np

from meshpoint.base.extra import needed
from meshpoint.base.version import product_version
from meshpoint.bridges.series import TOPICS, Sample
from meshpoint.bridges.sink import Event, Sink

EXTRA: Final = "mf4"
GROUP_ROWS: Final = 50_000
"""Rows of a topic that are held before they are handed on."""
EVENT_BYTES: Final = 200
HISTORY: Final = (
    "<FHcomment><TX>converted</TX><tool_id>meshpoint convert</tool_id>"
    f"<tool_vendor>meshpoint</tool_vendor><tool_version>{product_version()}</tool_version></FHcomment>"
)
LEAST_DATE_S: Final = 1e8
"""A log whose first time is less counts from its own start."""


@contextmanager
def mf4_file(path: Path) -> Iterator[Sink]:
    """An MF4 file, which is written when this is left."""
    asammdf = needed("asammdf", EXTRA)
    with asammdf.MDF(version="4.10") as mdf:
        sink = Mf4Sink(asammdf, mdf)
        yield sink
        sink.flush()
        mdf.file_history.append(undated_history(asammdf, HISTORY))
        mdf.save(path, overwrite=True, compression=2, add_history_block=False)


def undated_history(asammdf: Any, comment: str) -> Any:
    """The entry of a file's history that the format wants, without the time of writing: the same
    content gives the same bytes. comment: XML of the format, what wrote it."""
    history = asammdf.blocks.v4_blocks.FileHistory()
    history.comment = comment
    history.abs_time = history.tz_offset = history.daylight_save_time = history.time_flags = 0
    return history


class Mf4Sink:
    """Groups of channels, each begun with its first rows."""

    def __init__(self, asammdf: Any, mdf: Any) -> None:
        self._asammdf, self._mdf = asammdf, mdf
        self._groups: dict[str, int] = {}
        self._held: dict[str, tuple[array[float], list[array[float]]]] = {}
        self._events: list[Event] = []
        self._begun_s: float | None = None

    def sample(self, sample: Sample) -> None:
        """A row of a topic; what is not known is no number."""
        signals, begun_s = TOPICS[sample.topic].signals, self._begin(sample.time_s)
        if sample.topic not in self._held:
            self._held[sample.topic] = array("d"), [array("d") for _ in signals]
        times, columns = self._held[sample.topic]
        times.append(sample.time_s - begun_s)
        for signal, column in zip(signals, columns, strict=True):
            value = sample.values.get(signal.name)
            column.append(math.nan if value is None else value)
        if len(times) >= GROUP_ROWS:
            self._write(sample.topic)

    def event(self, event: Event) -> None:
        """A text of the channel `Events`."""
        self._events.append(event._replace(time_s=event.time_s - self._begin(event.time_s)))

    def _begin(self, time_s: float) -> float:
        """The time of the first row: MDF has it in its header, and all times since then. A log that
        counts from its own start has no date."""
        if self._begun_s is None:
            self._begun_s = 0.0 if time_s < LEAST_DATE_S else time_s
            self._mdf.header.start_time = datetime.fromtimestamp(self._begun_s, UTC)
        return self._begun_s

    def flush(self) -> None:
        """Hands on what is held."""
        for topic in list(self._held):
            self._write(topic)
        if self._events:
            words = [f"{each.who}: {each.words}".encode()[:EVENT_BYTES] for each in self._events]
            texts = self._asammdf.Signal(
                samples=np.array(words),
                timestamps=np.array([each.time_s for each in self._events]),
                name="Events",
                encoding="utf-8",
            )
            self._mdf.append([texts], comment="what happened, in words")
            self._events.clear()

    def _write(self, topic: str) -> None:
        times, columns = self._held.pop(topic)
        of, at_s = TOPICS[topic], np.array(times)
        if topic in self._groups:
            values = [np.array(column) for column in columns]
            self._mdf.extend(self._groups[topic], [(each, None) for each in (at_s, *values)])
            return
        signals = [
            self._asammdf.Signal(
                samples=np.array(column),
                timestamps=at_s,
                name=f"{topic}.{signal.name}",
                unit=signal.unit,
                comment=signal.comment,
                conversion=_conversion(signal.names),
            )
            for signal, column in zip(of.signals, columns, strict=True)
        ]
        self._groups[topic] = self._mdf.append(signals, acq_name=topic, comment=of.comment)


def _conversion(names: Mapping[int, str]) -> dict[str, Any] | None:
    """Values to texts."""
    if not names:
        return None
    found: dict[str, Any] = {}
    for k, (number, name) in enumerate(names.items()):
        found |= {f"val_{k}": number, f"text_{k}": name}
    return found
