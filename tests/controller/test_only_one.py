"""Two controllers on one bus: the newcomer leaves, one at work that finds another falls silent."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from meshpoint.bus.core import Step
from meshpoint.bus.optional import classic_signs
from meshpoint.controller.run.node import BESIDE, LISTEN_US, NEWCOMER, OnlyController
from meshpoint.dbc.classic.codecs import ClassicSender
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.link import Transmitter
from meshpoint.dbc.messages import (
    TC1,
    ControllerEstimates,
    ControllerStatus,
    ValveCommand,
    ValveStatus,
)
from meshpoint.dbc.node import Node

TICK_US = 10_000
OFF = Frame(0x18FF0003, b"valves off")


class Controller:
    """A controller's core that sends what one sends each step, and no more."""

    def __init__(self, clock_us: int) -> None:
        """clock_us: what its own clock is ahead of the bus's."""
        self.next_step_us = 0
        self._clock_us = clock_us
        self.steps = 0
        self.heard: list[Frame] = []
        self._transmitter = Transmitter(Node.TRANSMISSION_CONTROL)

    def receive(self, frame: Frame) -> None:
        self.heard.append(frame)

    def step(self, now_us: int) -> Step:
        self.next_step_us = now_us + TICK_US
        self.steps += 1
        status = ControllerStatus(step_number=self.steps, step_time_us=now_us + self._clock_us)
        return Step([self._transmitter.encode(each) for each in (ValveCommand(), status)], [])

    def shutdown(self, _now_us: int) -> Step:
        return Step([OFF], ["valves off"])


class Node_:
    """One node of the bus, stepped every 10 ms from when it is switched on."""

    def __init__(self, on_us: int, clock_us: int = 0, *, is_proven: bool = False) -> None:
        self.on_us = on_us
        self.ended = False
        self.inside = Controller(clock_us)
        self.only = OnlyController(self.inside, self._end, is_proven=is_proven)
        self.sent: list[Frame] = []

    def _end(self) -> None:
        self.ended = True

    def step(self, now_us: int) -> list[Frame]:
        if now_us < self.on_us or now_us < self.only.next_step_us:
            return []
        frames = self.only.step(now_us).frames
        self.sent += frames
        return frames


def run(
    nodes: list[Node_], until_us: int, other: Callable[[int], list[Frame]] = lambda _: []
) -> None:
    """All of them on a bus that returns to each what it has sent, as several interfaces do."""
    for now_us in range(0, until_us, TICK_US):
        frames = [frame for node in nodes for frame in node.step(now_us)] + other(now_us)
        for node in nodes:
            if now_us >= node.on_us:
                for frame in frames:
                    node.only.receive_own(frame)


def test_alone_it_works_on_whatever_the_interface_returns_of_its_own_frames() -> None:
    one = Node_(0)
    run([one], 10_000_000)
    assert (one.only.conflict, one.ended) == ("", False)
    assert one.inside.steps == pytest.approx((10_000_000 - LISTEN_US) / TICK_US, abs=2)


def test_a_newcomer_leaves_without_having_sent_anything_and_the_one_at_work_goes_on() -> None:
    old, new = Node_(0), Node_(2_000_000, clock_us=500_000)
    run([old, new], 4_000_000)
    assert (new.only.conflict, new.ended, new.sent) == (NEWCOMER, True, [])
    assert new.only.shutdown(4_000_000) == Step([], [])
    assert (old.only.conflict, old.ended) == ("", False)
    assert old.inside.steps > 300


def test_two_that_begin_together_both_switch_their_valves_off_and_fall_silent() -> None:
    """Each has listened while the other did: neither can know which of them is to stay."""
    one, other = Node_(0), Node_(0, clock_us=3_000)
    run([one, other], 2_000_000)
    for node in (one, other):
        assert (node.only.conflict, node.ended) == (BESIDE, True)
        assert node.sent[-1] == OFF
        assert node.sent.count(OFF) == 1
        assert node.inside.steps < 8, "within 100 ms"
        assert node.only.step(3_000_000) == node.only.shutdown(3_000_000) == Step([], [])


def test_on_a_classic_bus_it_is_known_by_its_valve_orders() -> None:
    one, sender = Node_(0), ClassicSender("ValveOrders")
    one.only = OnlyController(one.inside, one._end, classic_signs())
    orders = sender.message_type()
    run([one], 1_500_000, lambda now_us: [sender.frame(orders)] if now_us > 1_000_000 else [])
    assert one.only.conflict == BESIDE


def test_one_whose_commands_are_proven_is_not_silenced_by_frames_that_prove_nothing() -> None:
    old, new = Node_(0, is_proven=True), Node_(1_000_000, is_proven=True)
    forger = Transmitter(Node.TRANSMISSION_CONTROL)

    def forged(now_us: int) -> list[Frame]:
        late = now_us > 500_000
        return [forger.encode(ControllerStatus(step_time_us=9))] if late else []

    run([old, new], 2_000_000, forged)
    assert old.only.conflict == ""
    assert new.only.conflict == NEWCOMER


def test_a_frame_now_and_then_is_an_accident() -> None:
    one, stray = Node_(0), Transmitter(Node.TRANSMISSION_CONTROL)

    def now_and_then(now_us: int) -> list[Frame]:
        return [stray.encode(ControllerStatus(step_time_us=7))] if now_us % 60_000 == 0 else []

    run([one], 3_000_000, now_and_then)
    assert one.only.conflict == ""


def _broken(frame: Frame) -> Frame:
    return frame._replace(data=frame.data[:-1] + bytes([frame.data[-1] ^ 0x55]))


@pytest.mark.parametrize(
    "frame",
    [
        Transmitter(Node.BENCH).encode(TC1(requested_gear=8)),
        Transmitter(Node.GEARBOX_IO).encode(ValveStatus()),
        Transmitter(Node.TRANSMISSION_CONTROL).encode(ControllerEstimates()),
        _broken(Transmitter(Node.TRANSMISSION_CONTROL).encode(ControllerStatus(step_time_us=5))),
    ],
    ids=["a request", "the gearbox", "no sign of a controller", "a damaged frame"],
)
def test_neither_the_rig_s_nodes_nor_damaged_frames_are_a_second_controller(frame: Frame) -> None:
    one = Node_(0)
    run([one], 2_000_000, lambda _: [frame])
    assert one.only.conflict == ""


def test_what_was_on_the_bus_before_it_began_is_not_of_its_time() -> None:
    one, request = Node_(0), Transmitter(Node.BENCH).encode(TC1(requested_gear=8))
    one.step(0)
    one.only.receive(request)
    assert one.inside.heard == []
    for now_us in range(0, LISTEN_US + 1, TICK_US):
        one.step(now_us)
    one.only.receive(request)
    assert one.inside.heard == [request]
    assert one.inside.steps == 1
