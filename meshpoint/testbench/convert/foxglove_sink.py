"""Time series for Foxglove and Lichtblick: in an MCAP file, or live on a socket of this machine.

A topic is a channel of JSON objects with a JSON schema; events are `foxglove.Log`. Needs the extra
`meshpoint[mcap]`.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from meshpoint.testbench.convert.series import TOPICS, Sample, Signal
from meshpoint.testbench.convert.sink import Event, Sink
from meshpoint.testbench.errors import CommandError
from meshpoint.testbench.extra import needed

if TYPE_CHECKING:
    from foxglove import Channel, Context

EXTRA: Final = "mcap"
LOCALHOST: Final = "127.0.0.1"
NAMED: Final = "_name"
"""Ends the name of a choice's text, beside its number."""


@contextmanager
def mcap_file(path: Path) -> Iterator[Sink]:
    """An MCAP file, which is complete once this is left."""
    foxglove = needed("foxglove", EXTRA)
    context = foxglove.Context()
    with foxglove.open_mcap(path, allow_overwrite=True, context=context):
        yield FoxgloveSink(context)


@contextmanager
def live_view(port: int) -> Iterator[FoxgloveSink]:
    """A WebSocket of this machine alone, to which viewers connect."""
    foxglove = needed("foxglove", EXTRA)
    context = foxglove.Context()
    try:
        server = foxglove.start_server(name="meshpoint", host=LOCALHOST, port=port, context=context)
    except (OSError, RuntimeError) as error:
        raise CommandError(f"--live {port}: no server can be opened there: {error}") from error
    try:
        yield FoxgloveSink(context)
    finally:
        server.stop()


class FoxgloveSink:
    """Channels of a context, each opened with its first row."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._channels: dict[str, Channel] = {}
        self._choices: dict[str, list[Signal]] = {}
        self._events: Any = None

    def sample(self, sample: Sample) -> None:
        """A row of a topic."""
        channel = self._channels.get(sample.topic) or self._open(sample.topic)
        values: dict[str, Any] = dict(sample.values)
        for signal in self._choices[sample.topic]:
            number = sample.values.get(signal.name)
            values[signal.name + NAMED] = signal.names.get(int(number or 0), "")
        channel.log(values, log_time=_nanoseconds(sample.time_s))

    def event(self, event: Event) -> None:
        """A line of the log panel."""
        from foxglove.channels import LogChannel
        from foxglove.messages import Log, LogLevel, Timestamp

        if self._events is None:
            self._events = LogChannel("/events", context=self._context)
        at_ns = _nanoseconds(event.time_s)
        stamp = Timestamp(sec=at_ns // 10**9, nsec=at_ns % 10**9)
        line = Log(timestamp=stamp, level=LogLevel.Info, name=event.who, message=event.words)
        self._events.log(line, log_time=at_ns)

    def _open(self, topic: str) -> Channel:
        from foxglove import Channel

        of = TOPICS[topic]
        self._choices[topic] = [signal for signal in of.signals if signal.names]
        properties = {signal.name: _property(signal, "number") for signal in of.signals}
        for signal in self._choices[topic]:
            properties[signal.name + NAMED] = _property(signal, "string")
        schema = {
            "title": topic, "description": of.comment, "type": "object", "properties": properties,
        }  # fmt: skip
        self._channels[topic] = Channel(f"/{topic}", schema=schema, context=self._context)
        return self._channels[topic]


def _property(signal: Signal, kind: str) -> dict[str, str]:
    unit = f" [{signal.unit}]" if signal.unit else ""
    return {"type": kind, "description": f"{signal.comment}{unit}"}


def _nanoseconds(time_s: float) -> int:
    return round(time_s * 1e9)
