"""The python-can interface `silkit`: a node on a CAN network of SIL Kit that nobody coordinates."""

from __future__ import annotations

import logging
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from typing import Any

import can
import pytest
from patience import HANG_S, until

from meshpoint.bus.silkit.library import ESI, FDF, IDE, XLF, join
from meshpoint.bus.silkit.plugin import SilKitBus
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.messages import ControllerStatus, GearboxSensors, ValveCommand

pytestmark = pytest.mark.device

FD = {"is_fd": True, "bitrate_switch": True}


@pytest.fixture
def pair(registry: Any) -> Iterator[tuple[SilKitBus, SilKitBus]]:
    with SilKitBus(registry=registry.uri) as first, SilKitBus(registry=registry.uri) as second:
        both_hear(first, second)
        yield first, second


def both_hear(first: SilKitBus, second: SilKitBus) -> None:
    """A participant takes a moment to be known to the others."""
    for sender, hearer in ((first, second), (second, first)):

        def arrives(sender: SilKitBus = sender, hearer: SilKitBus = hearer) -> bool:
            sender.send(can.Message(arbitration_id=0x7FF, is_extended_id=False))
            return hearer.recv(0.1) is not None

        until(arrives, "a first frame")
    while first.recv(0.2) or second.recv(0.2):
        pass


def receive(bus: can.BusABC) -> can.Message:
    message = bus.recv(HANG_S)
    assert message is not None
    return message


@pytest.mark.parametrize(
    "message",
    [
        can.Message(arbitration_id=0x18FF1080, data=bytes(range(64)), **FD),
        can.Message(arbitration_id=0x18FF1080, data=b"1", error_state_indicator=True, is_fd=True),
        can.Message(arbitration_id=0x123, is_extended_id=False, data=b"abc"),
        can.Message(arbitration_id=0x7FF, is_extended_id=False, is_remote_frame=True, dlc=5),
    ],
    ids=["fd", "error state", "standard", "remote"],
)
def test_a_message_arrives_as_it_was_sent_and_not_at_its_sender(
    pair: tuple[SilKitBus, SilKitBus], message: can.Message
) -> None:
    began_s = time.time()
    pair[0].send(message)
    got = receive(pair[1])
    assert got.equals(message, timestamp_delta=None, check_channel=False, check_direction=False)
    assert began_s <= got.timestamp <= time.time()
    assert pair[0].recv(0.2) is None


def test_fd_data_are_padded_to_a_length_that_can_fd_has(pair: tuple[SilKitBus, SilKitBus]) -> None:
    pair[0].send(can.Message(arbitration_id=1, data=bytes(13), is_fd=True))
    assert len(receive(pair[1]).data) == 16


@pytest.mark.parametrize(
    "message",
    [
        can.Message(arbitration_id=1 << 29, check=False),
        can.Message(arbitration_id=1, data=bytes(9), check=False),
        can.Message(is_error_frame=True),
    ],
    ids=["identifier", "length", "error frame"],
)
def test_what_no_can_bus_could_carry_is_refused(
    pair: tuple[SilKitBus, SilKitBus], message: can.Message
) -> None:
    with pytest.raises(ValueError, match=r"identifier|9 bytes|error frame"):
        pair[0].send(message)


def test_what_others_send_that_is_no_can_frame_is_left_out_and_said_once(
    registry: Any, caplog: pytest.LogCaptureFixture
) -> None:
    with SilKitBus(registry=registry.uri) as bus:
        other = join("other", registry.uri)
        foreign = other.create_can_controller("can", "CAN1")
        foreign.start()

        def arrives() -> bool:
            foreign.send_frame(0x7F0, b"")
            return bus.recv(0.1) is not None

        until(arrives, "a first frame")
        foreign.send_frame(0x800, b"")
        foreign.send_frame(1, bytes(100), XLF)
        foreign.send_frame(2, b"ok", FDF + IDE + ESI)
        with caplog.at_level(logging.WARNING):
            while (message := receive(bus)).arbitration_id == 0x7F0:
                pass
        assert message.arbitration_id == 2
        assert [record.getMessage() for record in caplog.records] == [
            f"silkit: network CAN1, registry {registry.uri}: frame 0x800: identifier 0x800, "
            "allowed is 0 to 0x7FF; left out, as all of these"
        ]


def test_without_a_registry_there_is_no_bus_and_it_is_named(registry: Any) -> None:
    registry.end()
    said = set()
    for _ in range(2):  # a node that tries again says it once
        with pytest.raises(can.CanInitializationError) as refused:
            SilKitBus(registry=registry.uri)
        said.add(str(refused.value))
    assert len(said) == 1
    assert f"no registry at {registry.uri}" in said.pop()


@pytest.mark.parametrize("uri", ["nonsense", "silkit://127.0.0.1:99999"])
def test_a_registry_that_is_none_is_named(registry: Any, uri: str) -> None:
    with pytest.raises(can.CanInitializationError, match=uri):
        SilKitBus(registry=uri)


def test_a_name_that_is_taken_is_refused(registry: Any) -> None:
    with (
        SilKitBus(registry=registry.uri, participant="one"),
        pytest.raises(can.CanInitializationError, match="same name"),
    ):
        SilKitBus(registry=registry.uri, participant="one")


def test_a_registry_that_is_lost_ends_the_bus(
    pair: tuple[SilKitBus, SilKitBus], registry: Any
) -> None:
    registry.end()
    with pytest.raises(can.CanOperationError, match="lost the registry"):
        pair[0].recv(HANG_S)
    with pytest.raises(can.CanOperationError, match="lost the registry"):
        pair[1].send(can.Message(arbitration_id=1))


SENDING = """
import can, sys
from meshpoint.bus.silkit.plugin import SilKitBus
with SilKitBus(registry=sys.argv[1]) as bus:
    while True:
        bus.send(can.Message(data=bytes(8)))
"""
LEAVING = """
import sys
from meshpoint.bus.silkit.plugin import SilKitBus
for _ in range(10):
    with SilKitBus(registry=sys.argv[1]) as bus:
        while bus.recv(0.1) is None:
            pass
"""


def test_a_node_leaves_while_others_go_on_sending(registry: Any) -> None:
    sending, leaving = [
        subprocess.Popen([sys.executable, "-c", words, registry.uri], stdin=subprocess.DEVNULL)
        for words in (SENDING, LEAVING)
    ]
    try:
        until(lambda: leaving.poll() is not None, "a node that has left ten times")
        assert sending.poll() is None
    finally:
        for each in (sending, leaving):
            each.kill()
            each.wait()
    assert leaving.returncode == 0


def test_rig_and_controller_meet_there_and_the_controllers_last_frames_switch_all_valves_off(
    registry: Any,
) -> None:
    bus = ["-i", "silkit", "-c", "TRUCK", "--bus-kwargs", f"registry={registry.uri}"]
    nodes = []
    wanted = {CODECS[kind.__name__].spec.can_id for kind in (ControllerStatus, GearboxSensors)}
    valves = CODECS["ValveCommand"]
    with SilKitBus("TRUCK", registry=registry.uri) as listener:
        try:
            for words in (["rig"], ["controller", "--arm"]):
                command = [sys.executable, "-m", "meshpoint", *words, *bus, "--quiet"]
                nodes.append(subprocess.Popen(command, stdin=subprocess.DEVNULL))
            heard = set[int]()

            def all_heard() -> bool:
                assert all(node.poll() is None for node in nodes)
                message = listener.recv(0.1)
                heard.update(set() if message is None else {message.arbitration_id})
                return wanted <= heard

            until(all_heard, "both nodes", say=lambda: [hex(each) for each in heard])
            nodes[1].send_signal(signal.SIGTERM)
            assert nodes[1].wait(HANG_S) == 0
            ended_s, commands = time.time(), []
            while (message := receive(listener)).timestamp < ended_s:
                if message.arbitration_id == valves.spec.can_id:
                    commands.append(valves.decode(bytes(message.data)))
        finally:
            for node in nodes:
                node.kill()
                node.wait()
    assert commands[-1] == ValveCommand()
