"""`meshpoint controller` on a bus on which another controller is at work."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest

from meshpoint.base.exits import Exit
from meshpoint.bus.frames import message_of
from meshpoint.bus.local.plugin import MeshpointBus
from meshpoint.cli.main import main
from meshpoint.dbc.link import Transmitter
from meshpoint.dbc.messages import ControllerStatus
from meshpoint.dbc.node import Node


@pytest.fixture(autouse=True)
def another(channel: str) -> Iterator[None]:
    """Another controller reports its steps on the test's bus."""
    ending, other = threading.Event(), Transmitter(Node.TRANSMISSION_CONTROL)

    def report() -> None:
        with MeshpointBus(channel) as bus:
            ready.set()
            while not ending.wait(0.01):
                bus.send(message_of(other.encode(ControllerStatus())))

    ready = threading.Event()
    at_work = threading.Thread(target=report)
    at_work.start()
    ready.wait()
    yield
    ending.set()
    at_work.join()


def test_the_newcomer_says_why_it_leaves_and_ends_with_1(
    channel: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["controller", "--quiet", "-i", "meshpoint", "-c", channel]) == Exit.FAILED
    said = capsys.readouterr().err.splitlines()[-1]
    assert said.startswith("meshpoint controller: another controller is at work on this bus")
    assert "--shadow" in said
