"""Time series as an MCAP file for Foxglove, Lichtblick and PlotJuggler; events are `foxglove.Log`.

Needs the extra `meshpoint[mcap]`.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Final

from meshpoint.base.extra import needed
from meshpoint.bridges.foxglove_rows import nanoseconds, schema_of, values_of
from meshpoint.bridges.series import Sample
from meshpoint.bridges.sink import Event, Sink

if TYPE_CHECKING:
    from foxglove import Channel, Context

EXTRA: Final = "mcap"


@contextmanager
def mcap_file(path: Path) -> Iterator[Sink]:
    """An MCAP file, which is complete once this is left."""
    foxglove = needed("foxglove", EXTRA)
    context = foxglove.Context()
    with path.open("wb") as file:
        kept = _Kept(file)
        with foxglove.open_mcap(kept, context=context):
            yield FoxgloveSink(context, kept.check)
        file.flush()
        kept.check()


class _Kept:
    """A file whose first error is kept for `check`: to its writer it seems to take all, as foxglove
    says each row that finds no room on standard error, and raises nothing."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._at = self._end = 0
        self._error: OSError | None = None

    def check(self) -> None:
        """OSError where anything could not be written."""
        if self._error is not None:
            raise self._error

    def write(self, data: bytes) -> int:
        """Takes all, or seems to."""
        self._try(lambda: self._file.write(data))
        self._at += len(data)
        self._end = max(self._end, self._at)
        return len(data)

    def flush(self) -> None:
        """As of any file."""
        self._try(self._file.flush)

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """As of any file, of one with all that was written too."""
        self._at = offset + (0, self._at, self._end)[whence]
        self._try(lambda: self._file.seek(self._at))
        return self._at

    def _try(self, act: Callable[[], object]) -> None:
        if self._error is None:
            try:
                act()
            except OSError as error:
                self._error = error


class FoxgloveSink:
    """Channels of a context, each opened with its first row."""

    def __init__(self, context: Context, check: Callable[[], None]) -> None:
        """check: raises OSError where a row could not be written; it is called after each."""
        self._context, self._check = context, check
        self._channels: dict[str, Channel] = {}
        self._events: Any = None

    def sample(self, sample: Sample) -> None:
        """A row of a topic."""
        channel = self._channels.get(sample.topic) or self._open(sample.topic)
        channel.log(values_of(sample), log_time=nanoseconds(sample.time_s))
        self._check()

    def event(self, event: Event) -> None:
        """A line of the log panel."""
        from foxglove.channels import LogChannel
        from foxglove.messages import Log, LogLevel, Timestamp

        if self._events is None:
            self._events = LogChannel("/events", context=self._context)
        at_ns = nanoseconds(event.time_s)
        stamp = Timestamp(sec=at_ns // 10**9, nsec=at_ns % 10**9)
        line = Log(timestamp=stamp, level=LogLevel.Info, name=event.who, message=event.words)
        self._events.log(line, log_time=at_ns)
        self._check()

    def _open(self, topic: str) -> Channel:
        from foxglove import Channel

        self._channels[topic] = Channel(f"/{topic}", schema=schema_of(topic), context=self._context)
        return self._channels[topic]
