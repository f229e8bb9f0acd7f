"""A server for viewers on this machine, in Foxglove's WebSocket protocol.

It announces channels and sends each viewer the messages of those that it has asked for. It takes
no commands. The protocol is that of https://github.com/foxglove/ws-protocol (docs/spec.md), whose
newer name is `foxglove.sdk.v1`: viewers of either name are served.

A web page may open a socket to any address of this machine, and its browser says in `Origin` where
the page is from. Only pages from this machine are served, and those of origins that the user has
allowed. What is no browser sends no `Origin`.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import re
import socket
import struct
import threading
from collections import deque
from collections.abc import Callable, Collection
from http import HTTPStatus
from typing import TYPE_CHECKING, Any, Final, NamedTuple

if TYPE_CHECKING:
    from websockets.asyncio.server import ServerConnection
    from websockets.http11 import Request, Response

LOCALHOST: Final = "127.0.0.1"
SUBPROTOCOLS: Final = ("foxglove.sdk.v1", "foxglove.websocket.v1")
OWN_PAGE: Final = re.compile(r"https?://(localhost|127\.0\.0\.1|\[::1\])(:\d{1,5})?")
"""A page of this machine. "null" is none: a page of anywhere can have it."""
MESSAGE: Final = struct.Struct("<BIQ")
"""Before a message: what it is, the viewer's number for the channel, ns."""
MESSAGE_DATA: Final = 0x01
MOST_WAITING_BYTES: Final = 4 * 1024 * 1024
"""A viewer that reads more slowly than the bus talks misses what goes beyond it."""
MOST_VIEWERS: Final = 16
"""At once: each may have that much waiting."""
LONGEST_REQUEST_BYTES: Final = 256 * 1024
MOST_ASKED: Final = 1_000
"""More than there are channels, and than the time of a send allows."""
HANDSHAKE_S: Final = 5.0
"""Who does not ask for anything in this time is not waited for."""
END_S: Final = 1.0
"""Viewers have so long to say goodbye."""
QUIET: Final = logging.Logger("viewers", logging.CRITICAL + 1)
"""The library would write a traceback for whatever anybody sends to the port."""


class Channel(NamedTuple):
    """What viewers may ask for."""

    topic: str
    schema_name: str
    schema: dict[str, Any]
    """A JSON schema of its messages."""


class _Viewer:
    """One connection, and its numbers for the channels that it has asked for."""

    def __init__(self, connection: ServerConnection) -> None:
        self.connection = connection
        self.channels: dict[int, int] = {}

    def take(self, request: dict[str, Any]) -> None:
        """What it asks for; KeyError, TypeError or ValueError where it is not to be understood.
        What newer viewers may ask for beside it is passed over."""
        if request["op"] == "subscribe":
            for each in request["subscriptions"]:
                self.channels[int(each["id"])] = int(each["channelId"])
            if len(self.channels) > MOST_ASKED:
                raise ValueError("subscriptions")
        elif request["op"] == "unsubscribe":
            for number in request["subscriptionIds"]:
                self.channels.pop(int(number), None)


class ViewerServer:
    """Serves from a thread of its own, from `start` to `stop`. OSError where the port is taken."""

    def __init__(
        self, port: int, origins: Collection[str], on_refused: Callable[[str], None]
    ) -> None:
        """origins: of pages that may read the bus. on_refused: is called with the origin of each
        other page that wanted to, in the server's thread."""
        self._port, self._origins, self._on_refused = port, frozenset(origins), on_refused
        self._channels: list[Channel] = []
        self._viewers: set[_Viewer] = set()
        self._waiting: deque[tuple[int, int, bytes]] = deque()
        self._wakes = False
        self._loop = asyncio.new_event_loop()
        self._end = asyncio.Event()
        self._thread = threading.Thread(target=self._run, name="viewers", daemon=True)

    def start(self) -> None:
        """Listens from now on."""
        self._socket = socket.create_server((LOCALHOST, self._port))
        self._thread.start()

    def stop(self) -> None:
        """Ends all connections, whether or not those at their other ends answer."""
        self._loop.call_soon_threadsafe(self._end.set)
        self._thread.join(4 * END_S)

    def open(self, channel: Channel) -> int:
        """Announces a channel; its number."""
        self._channels.append(channel)
        number = len(self._channels)
        self._loop.call_soon_threadsafe(self._announce, number)
        return number

    @property
    def is_watched(self) -> bool:
        """Whether there is any viewer."""
        return bool(self._viewers)

    def send(self, channel: int, time_ns: int, message: bytes) -> None:
        """A message of a channel, to whoever has asked for it."""
        self._waiting.append((channel, time_ns, message))
        if not self._wakes:
            self._wakes = True
            self._loop.call_soon_threadsafe(self._send_waiting)

    def _run(self) -> None:
        # What goes wrong with a connection is its own matter; tracebacks for it say nothing.
        self._loop.set_exception_handler(lambda *_: None)
        with asyncio.Runner(loop_factory=lambda: self._loop) as runner:
            runner.run(self._serve())

    async def _serve(self) -> None:
        from websockets.asyncio.server import serve

        server = await serve(
            self._take_viewer,
            sock=self._socket,
            subprotocols=SUBPROTOCOLS,  # type: ignore[arg-type]  # a NewType of str
            process_request=self._refusal,
            compression=None,
            open_timeout=HANDSHAKE_S,
            close_timeout=END_S,
            max_size=LONGEST_REQUEST_BYTES,
            logger=QUIET,
        )
        await self._end.wait()
        server.close()
        with contextlib.suppress(TimeoutError):  # those that are half open end with the loop
            await asyncio.wait_for(server.wait_closed(), 2 * END_S)

    def _refusal(self, connection: ServerConnection, request: Request) -> Response | None:
        """The answer to a page that may not read the bus, and to a viewer too many."""
        for origin in request.headers.get_all("Origin"):
            if origin not in self._origins and not OWN_PAGE.fullmatch(origin):
                self._on_refused(origin)
                return connection.respond(HTTPStatus.FORBIDDEN, "pages of this origin: --origin\n")
        if len(self._viewers) >= MOST_VIEWERS:
            allowed = f"{MOST_VIEWERS} viewers are connected, which is the most\n"
            return connection.respond(HTTPStatus.SERVICE_UNAVAILABLE, allowed)
        return None

    async def _take_viewer(self, connection: ServerConnection) -> None:
        from websockets.exceptions import ConnectionClosed

        viewer = _Viewer(connection)
        try:
            await connection.send(json.dumps({
                "op": "serverInfo", "name": "meshpoint", "capabilities": [],
                "supportedEncodings": ["json"], "metadata": {},
            }))  # fmt: skip
            await connection.send(self._advertised(range(1, len(self._channels) + 1)))
            self._viewers.add(viewer)
            async for text in connection:
                if isinstance(text, str):
                    viewer.take(json.loads(text))
        except ConnectionClosed:
            pass
        except (KeyError, TypeError, ValueError, RecursionError):
            await connection.close(1008, "a request that is not to be understood")
        finally:
            self._viewers.discard(viewer)

    def _advertised(self, numbers: Collection[int]) -> str:
        channels = [
            {
                "id": number, "topic": channel.topic, "encoding": "json",
                "schemaName": channel.schema_name, "schemaEncoding": "jsonschema",
                "schema": json.dumps(channel.schema),
            }
            for number in numbers
            for channel in [self._channels[number - 1]]
        ]  # fmt: skip
        return json.dumps({"op": "advertise", "channels": channels})

    def _announce(self, number: int) -> None:
        text = self._advertised([number])
        for viewer in self._viewers:
            self._write(viewer, text)

    def _send_waiting(self) -> None:
        self._wakes = False
        while self._waiting:
            channel, time_ns, message = self._waiting.popleft()
            for viewer in self._viewers:
                for number, wanted in viewer.channels.items():
                    if wanted == channel:
                        head = MESSAGE.pack(MESSAGE_DATA, number, time_ns)
                        self._write(viewer, head + message)

    def _write(self, viewer: _Viewer, message: str | bytes) -> None:
        """Sends without waiting."""
        from websockets.asyncio.server import broadcast

        if viewer.connection.transport.get_write_buffer_size() < MOST_WAITING_BYTES:
            broadcast([viewer.connection], message)
