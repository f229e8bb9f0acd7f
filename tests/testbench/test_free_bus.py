"""A rig joins no bus on which a gearbox is at work."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import can
import pytest

from meshpoint.base.errors import CommandError
from meshpoint.base.exits import Exit
from meshpoint.bus.frames import message_of
from meshpoint.bus.local.plugin import MeshpointBus
from meshpoint.cli.main import main
from meshpoint.dbc.link import Transmitter
from meshpoint.dbc.messages import ControllerStatus, ValveStatus
from meshpoint.dbc.node import Node
from meshpoint.run.free_bus import check_no_nodes, check_no_rig


@contextmanager
def sender(channel: str, message: Callable[[], can.Message]) -> Iterator[None]:
    """Somebody who sends such a frame all the time."""
    ready, ending = threading.Event(), threading.Event()

    def send() -> None:
        with MeshpointBus(channel) as bus:
            ready.set()
            while not ending.wait(0.01):
                bus.send(message())

    at_work = threading.Thread(target=send)
    at_work.start()
    ready.wait()
    try:
        yield
    finally:
        ending.set()
        at_work.join()


def frames_of(node: Node, message: object) -> Callable[[], can.Message]:
    transmitter = Transmitter(node)
    return lambda: message_of(transmitter.encode(message))


def test_a_second_rig_says_why_it_does_not_start(
    channel: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with sender(channel, frames_of(Node.GEARBOX_IO, ValveStatus())):
        assert main(["rig", "-i", "meshpoint", "-c", channel]) == Exit.BAD_INPUT
    assert "a gearbox is at work on meshpoint channel" in capsys.readouterr().err


def test_a_controller_alone_keeps_no_rig_away(channel: str) -> None:
    with (
        sender(channel, frames_of(Node.TRANSMISSION_CONTROL, ControllerStatus())),
        MeshpointBus(channel) as bus,
    ):
        check_no_rig(bus)
        with pytest.raises(CommandError, match="other nodes are at work"):
            check_no_nodes(bus)


def test_other_peoples_traffic_neither_keeps_a_rig_away_nor_makes_it_wait(channel: str) -> None:
    count = itertools.count()

    def foreign() -> can.Message:
        return can.Message(arbitration_id=0x123, is_extended_id=False, data=[next(count) & 0xFF])

    with sender(channel, foreign), MeshpointBus(channel) as bus:
        check_no_nodes(bus)
