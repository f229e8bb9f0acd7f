"""socketcand as an interface of ours: CAN over TCP, served by a small server of this file.

The protocol is that of github.com/linux-can/socketcand in its raw mode: `< hi >`, `< open can0 >`,
`< ok >`, `< rawmode >`, `< ok >`; then `< send 0CFF9003 8 29 10 ... >` and `< frame 0CFF9003 1.5
2910... >`. It has classic frames alone, so it is for `--profile classic`.
"""

from __future__ import annotations

import argparse
import socket
import threading
from collections.abc import Iterator

import can
import pytest

from meshpoint.bus.classic.cores import ClassicControllerCore, ClassicRigCore
from meshpoint.bus.core import Core
from meshpoint.bus.frames import frame_of, message_of
from meshpoint.bus.options import BusOpenError, add_bus_arguments, open_bus_from
from meshpoint.controller.core.core import ControllerCore
from meshpoint.controller.settings.header import new_header
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.core import RigCore
from meshpoint.rig_sim.settings import Preset, RigSettings
from tests.patience import Patience

SHEET = load_sheet("truck12")
TICK_US = 10_000


class Server:
    """One bus, `can0`: what a client sends, every other client gets."""

    def __init__(self) -> None:
        self._socket = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._socket.getsockname()[1]
        self._clients: list[socket.socket] = []
        self._lock = threading.Lock()
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self) -> None:
        """Ends it, and every client's connection."""
        self._socket.close()
        with self._lock:
            for client in self._clients:
                client.close()

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self._socket.accept()
            except OSError:
                return
            threading.Thread(target=self._serve, args=(client,), daemon=True).start()

    def _serve(self, client: socket.socket) -> None:
        client.sendall(b"< hi >")
        rest = ""
        while True:
            try:
                got = client.recv(4096)
            except OSError:
                return
            if not got:
                return
            *whole, rest = (rest + got.decode("ascii")).split(">")
            for command in whole:
                self._obey(client, command.strip(" <").split())

    def _obey(self, client: socket.socket, words: list[str]) -> None:
        if words[0] == "open":
            client.sendall(b"< ok >" if words[1] == "can0" else b"< error could not open bus >")
        elif words[0] == "rawmode":
            with self._lock:
                self._clients.append(client)
            client.sendall(b"< ok >")
        elif words[0] == "send":
            _, can_id, length, *data = words
            assert len(data) == int(length, 16) <= 8, "a classic bus"
            payload = "".join(f"{int(byte, 16):02X}" for byte in data)
            with self._lock:
                for other in self._clients:
                    if other is not client:
                        other.sendall(f"< frame {can_id} 1.000000 {payload} >".encode())


@pytest.fixture
def server() -> Iterator[Server]:
    running = Server()
    yield running
    running.close()


def opened(server: Server, channel: str = "can0") -> can.BusABC:
    parser = argparse.ArgumentParser()
    add_bus_arguments(parser)
    kwargs = ["--bus-kwargs", "host=127.0.0.1", f"port={server.port}"]
    return open_bus_from(parser.parse_args(["-i", "socketcand", "-c", channel, *kwargs]))


def passed(core: Core, bus: can.BusABC, to: Core, at: can.BusABC, now_us: int) -> list[str]:
    """One step of a node: what it has to send goes over the server to the other one; what it
    reports is returned."""
    frames, events = core.step(now_us)
    for frame in frames:
        bus.send(message_of(frame))
    patience = Patience()
    for frame in frames:
        while (message := at.recv(0.1)) is None:
            patience.check("the other side has all of it")
        assert frame_of(message) == frame
        to.receive(frame)
    return events


def test_controller_and_rig_come_to_the_gear_over_it(server: Server) -> None:
    """The controller sees shafts, sleeves and air of a rig behind the server: it is in gear."""
    inner = ControllerCore(new_header("1", SHEET, ControllerSettings()))
    controller = ClassicControllerCore(inner, SHEET)
    rig = ClassicRigCore(RigCore(SHEET, RigSettings(preset=Preset.THESIS, seed=1)), SHEET)
    reported: list[str] = []
    with opened(server) as ours, opened(server) as theirs:
        for tick in range(40):
            now_us = tick * TICK_US
            passed(rig, theirs, controller, ours, now_us)
            reported += passed(controller, ours, rig, theirs, now_us)
            if "starting -> in_gear" in reported:
                return
    raise AssertionError(reported)


def test_a_bus_that_the_server_does_not_have_is_refused_in_one_line(server: Server) -> None:
    with pytest.raises(BusOpenError, match="socketcand, channel can7") as refused:
        opened(server, "can7")
    assert "\n" not in str(refused.value)
