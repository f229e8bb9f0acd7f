"""`convert --live`: who on this machine may see the bus, and that nobody can hold it up."""

from __future__ import annotations

import json
import signal
import socket
import struct
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import can
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

sys.path.insert(0, str(Path(__file__).parent))

from live_command import LiveCommand, live

from meshpoint.bus.frames import message_of
from meshpoint.dbc.link import Transmitter
from meshpoint.dbc.messages import GearboxSensors
from meshpoint.dbc.node import Node

SUPPLY_PA = 8.5e5
HEAD = struct.Struct("<BIQ")
DAMAGED = Transmitter(Node.GEARBOX_IO).encode(GearboxSensors())._replace(data=b"\x01" * 16)


class View:
    """A bus, and what serves it to viewers."""

    def __init__(self, command: LiveCommand, port: int, channel: str) -> None:
        self.command, self.port = command, port
        self.bus = can.Bus(interface="meshpoint", channel=channel, fd=True)
        self._io = Transmitter(Node.GEARBOX_IO)
        self._sent = 0

    def connect(self, protocol: str, **options: Any) -> ClientConnection:
        return connect(f"ws://127.0.0.1:{self.port}", subprotocols=[protocol], **options)

    def send(self) -> None:
        """Another read of the sensors."""
        self._sent += 1
        read = GearboxSensors(sample_time_us=10_000 * self._sent, supply_pressure_pa=SUPPLY_PA)
        self.bus.send(message_of(self._io.encode(read)))
        time.sleep(0.01)

    def raw(self, said: bytes) -> socket.socket:
        """Somebody who speaks no WebSocket."""
        other = socket.create_connection(("127.0.0.1", self.port))
        other.sendall(said)
        return other


@pytest.fixture(scope="module")
def view() -> Iterator[View]:
    with (
        tempfile.TemporaryDirectory(prefix="mpb-") as folder,
        socket.socket() as free,
    ):
        free.bind(("127.0.0.1", 0))
        port, channel = free.getsockname()[1], f"unix:{folder}/bus.sock"
        free.close()
        arguments = ("--live", str(port), "-c", channel, "--origin", "https://viewer.example")
        with live(Path(folder), "convert", *arguments) as command:
            command.until_said(f"ws://127.0.0.1:{port}")
            made = View(command, port, channel)
            yield made
            made.bus.shutdown()


def first_message(view: View, viewer: ClientConnection) -> bytes:
    """What a viewer is sent of the sensors once it has asked for them, as its number 7."""
    while True:
        view.send()
        try:
            said = viewer.recv(timeout=0.01)
        except TimeoutError:
            continue
        if isinstance(said, bytes):
            return said
        for channel in json.loads(said).get("channels", []):
            if channel["topic"] == "/GearboxSensors":
                assert (channel["encoding"], channel["schemaEncoding"]) == ("json", "jsonschema")
                assert "supply_pressure_pa" in json.loads(channel["schema"])["properties"]
                wanted = [{"id": 7, "channelId": channel["id"]}]
                viewer.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))


@pytest.mark.parametrize("protocol", ["foxglove.sdk.v1", "foxglove.websocket.v1"])
def test_viewers_old_and_new_are_sent_what_they_ask_for(view: View, protocol: str) -> None:
    with view.connect(protocol) as viewer:
        assert viewer.subprotocol == protocol
        assert json.loads(viewer.recv())["op"] == "serverInfo"
        message = first_message(view, viewer)
        kind, number, time_ns = HEAD.unpack_from(message)
        assert (kind, number) == (1, 7)
        assert time_ns * 1e-9 == pytest.approx(time.time(), abs=60.0)
        assert json.loads(message[HEAD.size :])["supply_pressure_pa"] == SUPPLY_PA


@pytest.mark.parametrize(
    "origin", ["https://evil.example", "null", "http://localhost.evil.example"]
)
def test_a_web_page_from_elsewhere_cannot_read_the_bus(view: View, origin: str) -> None:
    for _ in range(3):
        with pytest.raises(InvalidStatus) as refused:
            view.connect("foxglove.sdk.v1", origin=origin)
        assert refused.value.response.status_code == 403
    view.command.until_said(f"a web page of {origin} was refused")
    assert view.command.said.count(f"a web page of {origin} was refused") == 1


@pytest.mark.parametrize(
    "origin", ["http://localhost:8080", "http://127.0.0.1", "https://viewer.example"]
)
def test_a_page_of_this_machine_or_one_that_is_allowed_can(view: View, origin: str) -> None:
    with view.connect("foxglove.sdk.v1", origin=origin) as viewer:
        assert json.loads(viewer.recv())["op"] == "serverInfo"


def test_more_viewers_than_the_most_are_refused_until_one_goes(view: View) -> None:
    with ExitStack() as connected:
        viewers: list[ClientConnection] = []
        with pytest.raises(InvalidStatus) as refused:
            while len(viewers) < 1_000:
                viewer = connected.enter_context(view.connect("foxglove.sdk.v1"))
                assert json.loads(viewer.recv())["op"] == "serverInfo"
                viewers.append(viewer)
        assert (len(viewers), refused.value.response.status_code) == (16, 503)
        first_message(view, viewers[-1])
    while True:  # the server hears of it a little later
        try:
            with view.connect("foxglove.sdk.v1") as viewer:
                assert json.loads(viewer.recv())["op"] == "serverInfo"
                return
        except InvalidStatus:
            time.sleep(0.05)


def test_what_is_no_request_is_answered_without_a_line(view: View) -> None:
    said = view.command.said
    for _ in range(20):
        with view.raw(b"\x00\xff nonsense\r\n\r\n") as other:
            other.settimeout(60)
            while other.recv(1024):
                pass
        for request in ("[]", "{", '{"op": "subscribe", "subscriptions": 3}'):
            with view.connect("foxglove.sdk.v1") as viewer, pytest.raises(ConnectionClosed):
                viewer.send(request)
                while True:
                    viewer.recv(timeout=60)
    assert view.command.said == said


def test_ctrl_c_ends_it_whoever_is_connected(view: View) -> None:
    """One has sent half a request, one nothing, one is a viewer that reads nothing any more. What
    was wrong on the bus was counted, and is said once."""
    said = view.command.said
    for _ in range(20):
        view.bus.send(can.Message(arbitration_id=0x123, is_extended_id=False, data=b"\x01"))
        view.bus.send(message_of(DAMAGED))
    with (
        view.raw(b"GET / HTTP/1.1\r\nHost: x\r\nUpgra"),
        view.raw(b""),
        view.connect("foxglove.sdk.v1") as viewer,
    ):
        first_message(view, viewer)  # so what was sent before it has come as well
        assert view.command.said == said
        view.command.signal(signal.SIGINT)
        assert view.command.end() == 0
    assert "20 frames of 1 identifier that no message here has are left out" in view.command.said
    assert "20 frames of a wrong length, CRC or value are left out" in view.command.said
    assert "Traceback" not in view.command.said
