"""Time series of a live bus for the viewers on this machine: each row as it comes."""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from typing import Any, Final

from meshpoint.base.errors import CommandError
from meshpoint.base.extra import needed
from meshpoint.bridges.foxglove_rows import nanoseconds, schema_of, values_of
from meshpoint.bridges.foxglove_sink import EXTRA
from meshpoint.bridges.series import Sample
from meshpoint.bridges.sink import Event
from meshpoint.bridges.viewer_server import Channel, ViewerServer
from meshpoint.results.output import complain

INFO: Final = 2
"""A level of foxglove.Log."""
LOG_SCHEMA: Final = {
    "title": "foxglove.Log",
    "description": "A log message",
    "type": "object",
    "properties": {
        "timestamp": {
            "type": "object",
            "title": "time",
            "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}},
        },
        "level": {"type": "integer", "description": "2 is INFO"},
        "message": {"type": "string"},
        "name": {"type": "string", "description": "Who says it"},
        "file": {"type": "string"},
        "line": {"type": "integer"},
    },
}
ORIGIN: Final = re.compile(r"https?://[a-z0-9.-]{1,253}(:\d{1,5})?", re.ASCII)
MOST_SAID: Final = 5
LONGEST_SHOWN: Final = 100


@contextmanager
def live_view(port: int, origins: Collection[str]) -> Iterator[LiveSink]:
    """A WebSocket of this machine alone, to which viewers connect, web pages of this machine and
    those of `origins`."""
    for origin in origins:
        if not ORIGIN.fullmatch(origin):
            raise CommandError(
                f"--origin {origin}: allowed is where a page is from, as https://app.foxglove.dev, "
                "with no path behind it"
            )
    needed("websockets", EXTRA)
    refused = RefusedPages()
    server = ViewerServer(port, origins, refused.take)
    try:
        server.start()
    except OSError as error:
        raise CommandError(f"--live {port}: no server can be opened there: {error}") from error
    try:
        yield LiveSink(server)
    finally:
        server.stop()
        refused.end()


class RefusedPages:
    """Says which web pages were refused, the first of them by name."""

    def __init__(self) -> None:
        self._origins: set[str] = set()
        self._others = 0

    def take(self, origin: str) -> None:
        """A page of this origin wanted to read the bus."""
        shown = origin[:LONGEST_SHOWN]
        if shown in self._origins or len(self._origins) >= MOST_SAID:
            self._others += 1
            return
        self._origins.add(shown)
        way = f" (--origin {shown} lets it read the bus)" if ORIGIN.fullmatch(origin) else ""
        complain(f"meshpoint convert: a web page of {shown} was refused{way}")

    def end(self) -> None:
        """How often it happened besides."""
        if self._others:
            complain(f"meshpoint convert: web pages were refused {self._others:,} times more")


class LiveSink:
    """A channel for each topic, announced with its first row."""

    def __init__(self, server: ViewerServer) -> None:
        self._server = server
        self._channels: dict[str, int] = {}

    def sample(self, sample: Sample) -> None:
        """A row of a topic."""
        channel = self._channels.get(sample.topic)
        if channel is None:
            of = Channel(f"/{sample.topic}", sample.topic, schema_of(sample.topic))
            channel = self._channels[sample.topic] = self._server.open(of)
        self._send(channel, sample.time_s, values_of(sample))

    def event(self, event: Event) -> None:
        """A line of the log panel."""
        channel = self._channels.get("events")
        if channel is None:
            of = Channel("/events", "foxglove.Log", LOG_SCHEMA)
            channel = self._channels["events"] = self._server.open(of)
        sec, nsec = divmod(nanoseconds(event.time_s), 10**9)
        line = {
            "timestamp": {"sec": sec, "nsec": nsec}, "level": INFO, "message": event.words,
            "name": event.who, "file": "", "line": 0,
        }  # fmt: skip
        self._send(channel, event.time_s, line)

    def _send(self, channel: int, time_s: float, values: dict[str, Any]) -> None:
        if self._server.is_watched:
            message = json.dumps(values, allow_nan=False).encode()
            self._server.send(channel, nanoseconds(time_s), message)
