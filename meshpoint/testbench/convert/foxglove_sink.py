"""Time series as an MCAP file for Foxglove, Lichtblick and PlotJuggler; events are `foxglove.Log`.

Needs the extra `meshpoint[mcap]`.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from meshpoint.testbench.convert.foxglove_rows import nanoseconds, schema_of, values_of
from meshpoint.testbench.convert.series import Sample
from meshpoint.testbench.convert.sink import Event, Sink
from meshpoint.testbench.extra import needed

if TYPE_CHECKING:
    from foxglove import Channel, Context

EXTRA: Final = "mcap"


@contextmanager
def mcap_file(path: Path) -> Iterator[Sink]:
    """An MCAP file, which is complete once this is left."""
    foxglove = needed("foxglove", EXTRA)
    context = foxglove.Context()
    with foxglove.open_mcap(path, allow_overwrite=True, context=context):
        yield FoxgloveSink(context)


class FoxgloveSink:
    """Channels of a context, each opened with its first row."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._channels: dict[str, Channel] = {}
        self._events: Any = None

    def sample(self, sample: Sample) -> None:
        """A row of a topic."""
        channel = self._channels.get(sample.topic) or self._open(sample.topic)
        channel.log(values_of(sample), log_time=nanoseconds(sample.time_s))

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

    def _open(self, topic: str) -> Channel:
        from foxglove import Channel

        self._channels[topic] = Channel(f"/{topic}", schema=schema_of(topic), context=self._context)
        return self._channels[topic]
