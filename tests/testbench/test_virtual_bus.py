"""The bus in virtual time: one frame at a time, the lowest identifier first, each its length."""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from meshpoint.bench.virtual_bus import VirtualBus, duration_us
from meshpoint.bench.virtual_time import VirtualTime
from meshpoint.bus.core import Step
from meshpoint.dbc.frame import Frame


def test_a_64_byte_fd_frame_takes_its_time_on_the_wire() -> None:
    """500 kbit/s and 2 Mbit/s: ISO 11898-1 gives some 0.35 to 0.45 ms with bit stuffing."""
    assert 350 <= duration_us(64, True) <= 450


def test_a_classic_extended_frame_takes_its_time_on_the_wire() -> None:
    """131 bits with 8 bytes before stuffing, 160 at worst, 2 us each."""
    assert 2 * 128 <= duration_us(8, False) <= 2 * 160


@settings(deadline=None)
@given(length=st.integers(0, 63), is_fd=st.booleans())
def test_a_longer_frame_takes_no_less(length: int, is_fd: bool) -> None:
    assert duration_us(length + 1, is_fd) >= duration_us(length, is_fd) > 0


def drain(bus: VirtualBus) -> list[tuple[int, Frame]]:
    got = []
    while math.isfinite(bus.next_us):
        through_us = int(bus.next_us)
        _, frame = bus.take()
        got.append((through_us, frame))
    return got


FRAMES = st.lists(
    st.builds(
        Frame,
        st.integers(0, (1 << 29) - 1),
        st.sampled_from([bytes(n) for n in (0, 8, 24, 64)]),
        st.just(True),
        st.just(True),
    ),
    min_size=1,
    max_size=20,
)


@settings(deadline=None)
@given(frames=FRAMES, now_us=st.integers(0, 10**9))
def test_waiting_frames_win_by_identifier_and_follow_each_other(
    frames: list[Frame], now_us: int
) -> None:
    """The first takes the idle bus; the others are in order; the bus is never shared or idle."""
    bus = VirtualBus()
    bus.send(0, frames[:1], now_us)
    for sender, frame in enumerate(frames[1:], 1):
        bus.send(sender, [frame], now_us)
    got = drain(bus)
    assert got[0][1] == frames[0]
    assert [f for _, f in got[1:]] == sorted(frames[1:], key=lambda f: f.can_id)
    at_us = now_us
    for time_us, frame in got:
        at_us += duration_us(len(frame.data), frame.is_fd)
        assert time_us == at_us
    assert bus.busy_us == at_us - now_us


def test_frames_of_one_identifier_stay_in_the_order_given() -> None:
    bus = VirtualBus()
    frames = [Frame(0x100, bytes([k])) for k in range(10)]
    bus.send(0, frames, 0)
    assert [frame for _, frame in drain(bus)] == frames


def test_a_frame_on_the_bus_is_not_interrupted() -> None:
    bus = VirtualBus()
    low, high = Frame(0x1FFF_0000, bytes(64)), Frame(0x1, bytes(8))
    bus.send(0, [low], 0)
    bus.send(1, [high], 10)
    assert [frame for _, frame in drain(bus)] == [low, high]


def test_a_standard_identifier_wins_over_an_extended_one_that_begins_alike() -> None:
    """11 bits 0x123 against 29 bits whose first 11 are 0x123: the IDE bit decides."""
    bus = VirtualBus()
    extended = Frame(0x123 << 18, b"", is_extended=True)
    standard = Frame(0x123, b"", is_extended=False)
    for sender, frame in enumerate((Frame(0, b""), extended, standard)):
        bus.send(sender, [frame], 0)
    assert [frame for _, frame in drain(bus)][1:] == [standard, extended]


class Talker:
    """Sends one frame every 10 ms and notes when it was stepped and what it heard."""

    def __init__(self, can_id: int, at_once: bool = False) -> None:
        self._frame = Frame(can_id, bytes(64))
        self._at_once = at_once
        self._due_us = 0
        self._waiting = False
        self.steps: list[int] = []
        self.heard: list[int] = []

    @property
    def next_step_us(self) -> int:
        return 0 if self._waiting else self._due_us

    def receive(self, frame: Frame) -> None:
        self.heard.append(frame.can_id)
        self._waiting = self._at_once

    def step(self, now_us: int) -> Step:
        self.steps.append(now_us)
        self._waiting = False
        due = now_us >= self._due_us
        if due:
            self._due_us = now_us + 10_000
        return Step([self._frame] if due else [], [])

    def shutdown(self, now_us: int) -> Step:
        return Step([], [])


def test_nodes_are_stepped_when_due_and_never_hear_themselves() -> None:
    a, b, c = Talker(0x10), Talker(0x20), Talker(0x30)
    seen: list[tuple[int, int]] = []
    driver = VirtualTime(
        [a, b, c],
        [0, 300, 5_000],
        lambda t, frame: seen.append((t, frame.can_id)),
        rejected=[frozenset(), frozenset({0x30}), frozenset()],
    )
    assert not driver.run(lambda: False, 100_000)
    assert a.steps == list(range(0, 100_001, 10_000))
    assert b.steps == list(range(300, 100_001, 10_000))
    assert set(a.heard) == {0x20, 0x30}
    assert set(b.heard) == {0x10}
    times = [t for t, _ in seen]
    assert all(
        later - earlier >= duration_us(64, True) for earlier, later in itertools.pairwise(times)
    )


def test_a_node_that_wants_to_act_on_a_frame_is_stepped_as_it_arrives() -> None:
    talker, prompt = Talker(0x10), Talker(0x20, at_once=True)
    driver = VirtualTime([talker, prompt], [0, 4_000])
    driver.run(lambda: False, 35_000)
    arrivals = [t + duration_us(64, True) for t in talker.steps]
    assert set(arrivals[1:3]) <= set(prompt.steps)


@pytest.mark.parametrize("count", [1, 4])
def test_a_run_ends_when_it_is_told_to(count: int) -> None:
    talker = Talker(0x10)
    driver = VirtualTime([talker], [0])
    assert driver.run(lambda: len(talker.steps) == count, 10**6)
    assert driver.now_us == (count - 1) * 10_000


def test_a_node_is_switched_on_at_its_phase_whatever_it_hears_before() -> None:
    """Real nodes do not tick together: a frame does not start one that wants to step at once."""

    class Node:
        """Sends a frame every 10 ms; due at once before its first step, as both our nodes are."""

        def __init__(self) -> None:
            self.stepped_us: list[int] = []

        @property
        def next_step_us(self) -> int:
            return self.stepped_us[-1] + 10_000 if self.stepped_us else 0

        def receive(self, frame: Frame) -> None:
            pass

        def step(self, now_us: int) -> Step:
            self.stepped_us.append(now_us)
            return Step([Frame(0x123, bytes(8), True, True)], [])

        def shutdown(self, now_us: int) -> Step:
            return Step([], [])

    nodes = [Node(), Node()]
    VirtualTime([*nodes], [805, 7_091]).run(lambda: False, 30_000)
    assert nodes[0].stepped_us == [805, 10_805, 20_805]
    assert nodes[1].stepped_us == [7_091, 17_091, 27_091]
