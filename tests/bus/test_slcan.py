"""slcan as an interface of ours: a fake adapter behind a pseudo-terminal."""

from __future__ import annotations

import argparse
import os
import sys
import tty

import pytest

from meshpoint.bus.frames import frame_of
from meshpoint.bus.options import add_bus_arguments, open_bus_from
from meshpoint.dbc.link import Receiver, Transmitter
from meshpoint.dbc.messages import GearboxSensors, ValveCommand
from meshpoint.dbc.node import Node

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="no pseudo-terminals")


class FakeAdapter:
    """What a firmware sees of the serial line, and what it says."""

    def __init__(self) -> None:
        self._master, slave = os.openpty()
        tty.setraw(slave)
        self.path = os.ttyname(slave)
        self._slave = slave

    def heard(self, lines: int) -> list[bytes]:
        got = b""
        while got.count(b"\r") < lines:
            got += os.read(self._master, 4096)
        return got.split(b"\r")[:-1]

    def say(self, line: str) -> None:
        os.write(self._master, line.encode() + b"\r")

    def close(self) -> None:
        os.close(self._slave)
        os.close(self._master)


@pytest.mark.parametrize("shadow", [False, True])
def test_our_frames_go_both_ways_and_a_shadow_opens_it_listen_only(shadow: bool) -> None:
    adapter = FakeAdapter()
    parser = argparse.ArgumentParser()
    add_bus_arguments(parser)
    words = ["-i", "slcan", "-c", adapter.path, "--bus-kwargs", "sleep_after_open=0"]
    namespace = parser.parse_args(words)
    namespace.shadow = shadow
    sensors = GearboxSensors(sample_time_us=4711, supply_pressure_pa=9.5e5)
    sent = Transmitter(Node.GEARBOX_IO).encode(sensors)
    command = Transmitter(Node.TRANSMISSION_CONTROL).encode(ValveCommand())
    try:
        with open_bus_from(namespace) as bus:
            assert adapter.heard(1) == [b"L" if shadow else b"O"]
            adapter.say(f"B{sent.can_id:08X}A{sent.data.hex().upper()}")  # A: 16 bytes
            message = bus.recv(10.0)
            assert message is not None
            got = Receiver(Node.TRANSMISSION_CONTROL).receive(frame_of(message)).message
            assert isinstance(got, GearboxSensors)
            assert got.sample_time_us == 4711
            bus.send(
                message.__class__(
                    arbitration_id=command.can_id,
                    data=command.data,
                    is_fd=True,
                    bitrate_switch=True,
                )
            )
            (line,) = adapter.heard(1)
            assert line.startswith(b"B0CFF4003E"), "48 bytes are length code E"
            assert line[10:] == command.data.hex().upper().encode()
    finally:
        adapter.close()
