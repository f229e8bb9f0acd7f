"""The controller under another J1939 address: identifiers, checksums, claims, and both ways."""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from meshpoint.bus.core import Step
from meshpoint.bus.diagnosis.address import Name
from meshpoint.bus.diagnosis.core import DiagnosedCore
from meshpoint.bus.frames import frame_of, message_of
from meshpoint.bus.options import add_bus_arguments, open_bus_from
from meshpoint.bus.source_address import TAKEN, exchanged, source_address
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.j1939 import checked_request, group_of, is_intact
from meshpoint.dbc.link import Receiver, Transmitter
from meshpoint.dbc.messages import TSC1, TscOverrideMode, ValveAction, ValveCommand
from meshpoint.dbc.node import Node

OURS = 0x21
ADDRESSES = st.integers(0, 253).filter(lambda one: one not in TAKEN)
IDS = st.integers(0, (1 << 29) - 1)


def parsed(*arguments: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    add_bus_arguments(parser)
    return parser.parse_args(["-i", "virtual", "-c", "source_address", *arguments])


@pytest.fixture
def wire() -> Iterator[can.BusABC]:
    """What is on the bus, as it is."""
    with can.Bus(interface="virtual", channel="source_address") as bus:
        yield bus


@pytest.fixture
def node(wire: can.BusABC) -> Iterator[can.BusABC]:
    """The bus as a node of ours sees it."""
    with open_bus_from(parsed("--address", hex(OURS))) as bus:
        yield bus


@given(IDS, ADDRESSES)
def test_the_addresses_change_places_and_back_and_nothing_else_does(
    can_id: int, address: int
) -> None:
    moved = exchanged(can_id, address)
    assert exchanged(moved, address) == can_id
    assert group_of(moved) == group_of(can_id)
    assert moved >> 26 == can_id >> 26


def test_what_is_sent_and_what_is_heard(wire: can.BusABC, node: can.BusABC) -> None:
    sent = Transmitter(Node.TRANSMISSION_CONTROL).encode(
        ValveCommand(brake_action=ValveAction.ON_NOW)
    )
    node.send(message_of(sent))
    heard = wire.recv(1.0)
    assert heard is not None
    assert heard.arbitration_id == sent.can_id & ~0xFF | OURS
    wire.send(heard)
    back = node.recv(1.0)
    assert back is not None
    reported = Receiver(Node.GEARBOX_IO).receive(frame_of(back)).message
    assert reported == ValveCommand(brake_action=ValveAction.ON_NOW)


@pytest.mark.parametrize(("on_the_bus", "heard"), [
    (0x0C0121F9, 0x0C0103F9),  # TC1 for us
    (0x0C0103F9, 0x0C0121F9),  # TC1 for another node, which has address 3
    (0x0C01FFF9, 0x0C01FFF9),  # TC1 for all
    (0x18EEFF21, 0x18EEFF03),  # a claim of our address
    (0x18EEFF03, 0x18EEFF21),  # and one of another's
    (0x18FF2180, 0x18FF2180),  # no destination in there
])  # fmt: skip
def test_whom_a_frame_is_for_and_from(
    wire: can.BusABC, node: can.BusABC, on_the_bus: int, heard: int
) -> None:
    wire.send(can.Message(arbitration_id=on_the_bus, data=bytes(8)))
    message = node.recv(1.0)
    assert message is not None
    assert message.arbitration_id == heard


@pytest.mark.parametrize("broken", [False, True])
def test_the_checksum_of_an_engine_request_is_that_of_its_identifier(
    wire: can.BusABC, node: can.BusABC, broken: bool
) -> None:
    request = TSC1(override_control_mode=TscOverrideMode.SPEED_CONTROL, requested_speed_rad_s=120.0)
    frame = checked_request(Transmitter(Node.TRANSMISSION_CONTROL).encode(request), 5)
    if broken:
        frame = frame._replace(data=bytes([frame.data[0], 0x55]) + frame.data[2:])
        assert not is_intact(frame)
    node.send(message_of(frame))
    message = wire.recv(1.0)
    assert message is not None
    assert message.arbitration_id == 0x0C000021
    assert is_intact(frame_of(message)) is not broken


def test_a_standard_identifier_is_left_alone(wire: can.BusABC, node: can.BusABC) -> None:
    wire.send(can.Message(arbitration_id=0x321, is_extended_id=False, data=b"x"))
    message = node.recv(1.0)
    assert message is not None
    assert message.arbitration_id == 0x321


@pytest.mark.parametrize("text", ["254", "255", "-1", "x", "0", "0x80", "249"])
def test_an_address_that_cannot_be_ours_is_refused(text: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError, match=r"allowed: 0\.\.253"):
        source_address(text)


def test_addresses_are_taken_in_both_ways_of_writing() -> None:
    assert source_address("33") == source_address("0x21") == 33


class Silent:
    """A controller that says nothing."""

    next_step_us = 0

    def receive(self, frame: Frame) -> None:
        """Nothing."""

    def step(self, now_us: int) -> Step:
        """A frame under the controller's address."""
        return Step([Frame(0x0CFF1003, bytes(8))], [])

    def shutdown(self, now_us: int) -> Step:
        """The same."""
        return self.step(now_us)


def test_the_claim_is_of_the_bus_own_address_and_lost_to_a_smaller_name(
    wire: can.BusABC, node: can.BusABC
) -> None:
    core = DiagnosedCore(Silent(), "1", reported_as=OURS)

    def step(now_us: int) -> list[str]:
        while (message := node.recv(0.0)) is not None:
            core.receive(frame_of(message))
        step = core.step(now_us)
        for frame in step.frames:
            node.send(message_of(frame))
        return step.events

    def said() -> list[int]:
        found = []
        while (message := wire.recv(0.0)) is not None:
            found.append(message.arbitration_id)
        return found

    step(0)
    first = said()
    assert first[0] == 0x18EEFF21
    assert 0x0CFF1021 in first
    assert {can_id & 0xFF for can_id in first} == {OURS}
    smaller = Name(identity=0).number.to_bytes(8, "little")
    wire.send(can.Message(arbitration_id=0x18EEFF03, data=smaller))
    step(10_000)
    assert said() == [0x0CFF1021], "address 3 belongs to whom it may"
    wire.send(can.Message(arbitration_id=0x18EEFF21, data=smaller))
    (line,) = step(20_000)
    assert "address 33 belongs to another node" in line
    assert said() == [0x18EEFFFE]
    step(30_000)
    assert said() == []
