"""The simulated bus: arbitration, queues, errors and their counters, bus-off and the way back."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from itertools import pairwise

import pytest

from meshpoint.bus.simulated.confinement import ErrorCounters, ErrorState
from meshpoint.bus.simulated.core import CanBus, QueueOrder
from meshpoint.bus.simulated.events import (
    Attempt,
    BusEvent,
    Delivered,
    Destroyed,
    ErrorKind,
    Fault,
    Purged,
    StateChanged,
)
from meshpoint.bus.simulated.frame_bits import BitTiming, WireFrame, frame_bits

BIT_NS = 2000
RUN_NS = 11 * BIT_NS


def classic(can_id: int, data: bytes = b"\x55" * 8) -> WireFrame:
    return WireFrame(can_id, data, is_fd=False, bitrate_switch=False)


def length_ns(frame: WireFrame) -> int:
    return frame_bits(frame).duration_ns(BitTiming())


def drain(bus: CanBus, limit_ns: int = 10**12) -> list[BusEvent]:
    """Runs from event to event, as a driver does."""
    events: list[BusEvent] = []
    while bus.next_ns <= limit_ns:
        events += bus.run_to(int(bus.next_ns))
    return events


def delivered(events: list[BusEvent]) -> list[Delivered]:
    return [event for event in events if isinstance(event, Delivered)]


def states(events: list[BusEvent], node: int) -> list[ErrorState]:
    found = [e.state for e in events if isinstance(e, StateChanged) and e.node == node]
    return [state for k, state in enumerate(found) if k == 0 or state is not found[k - 1]]


def times(count: int, of: int | None = None, **fault: object) -> Callable[[Attempt], Fault | None]:
    """The first `count` attempts (of a node) go wrong."""
    left = [count]

    def disturb(attempt: Attempt) -> Fault | None:
        if not left[0] or (of is not None and of not in attempt.senders):
            return None
        left[0] -= 1
        return Fault(**fault)  # type: ignore[arg-type]

    return disturb


def test_a_frame_takes_its_bits_and_the_next_one_waits_for_the_intermission() -> None:
    bus = CanBus(2)
    first, second = classic(0x100), WireFrame(0x200, bytes(64))
    assert bus.send(0, first, 5_000)
    assert bus.send(0, second, 5_000)
    one, two = delivered(drain(bus))
    assert one.time_ns == 5_000 + length_ns(first)
    assert two.time_ns == one.time_ns + 3 * BIT_NS + length_ns(second)
    assert bus.busy_ns == length_ns(first) + length_ns(second) + 6 * BIT_NS


def test_the_lowest_identifier_wins_whoever_asks_first() -> None:
    bus = CanBus(4)
    bus.send(3, classic(0x7), 0)  # alone on the idle bus by a nanosecond
    for node, can_id in enumerate((0x300, 0x100, 0x200)):
        bus.send(node, classic(can_id), 1)
    got = [event.frame.can_id for event in delivered(drain(bus))]
    assert got == [0x7, 0x100, 0x200, 0x300]


def test_frames_of_one_moment_compete_in_whatever_order_they_are_handed_over() -> None:
    for order in ((0, 1), (1, 0)):
        bus = CanBus(2)
        for node in order:
            bus.send(node, classic(0x100 + node), 1_000)
        assert [e.frame.can_id for e in delivered(drain(bus))] == [0x100, 0x101]


def test_a_node_sends_in_order_or_by_priority_as_it_is_built() -> None:
    for order, first in ((QueueOrder.FIFO, 0x300), (QueueOrder.PRIORITY, 0x100)):
        bus = CanBus(2, order=order)
        for can_id in (0x300, 0x100, 0x200):
            bus.send(0, classic(can_id), 0)
        got = [event.frame.can_id for event in delivered(drain(bus))]
        assert got[0] == first
        assert sorted(got) == [0x100, 0x200, 0x300]


def test_a_full_queue_refuses_and_counts() -> None:
    bus = CanBus(2, queue_length=3)
    assert [bus.send(0, classic(1), 0) for _ in range(5)] == [True, True, True, False, False]
    assert bus.refused(0) == 2
    assert len(delivered(drain(bus))) == 3


def test_two_senders_of_the_same_bits_are_one_frame_and_of_others_a_collision() -> None:
    bus = CanBus(2, restarts=False)
    for node in (0, 1):
        bus.send(node, classic(0x100), 0)
    (same,) = delivered(drain(bus))
    assert same.senders == (0, 1)
    bus.send(0, classic(0x100, b"a"), 10**9)
    bus.send(1, classic(0x100, b"b"), 10**9)
    events = drain(bus)
    collisions = [e for e in events if isinstance(e, Destroyed)]
    assert {e.kind for e in collisions} == {ErrorKind.COLLISION}
    # Each attempt costs both 8: error-passive after 16, bus-off after 32.
    assert len(collisions) == 32
    assert states(events, 0) == states(events, 1)
    assert states(events, 0)[-2:] == [ErrorState.PASSIVE, ErrorState.BUS_OFF]
    assert not delivered(events)


def test_a_destroyed_frame_is_sent_again() -> None:
    bus = CanBus(3, disturb=times(2))
    bus.send(0, classic(0x100), 0)
    events = drain(bus)
    assert [type(e) for e in events] == [Destroyed, Destroyed, Delivered]
    flags_and_rest = (6 + 8 + 3) * BIT_NS
    first, second, through = events
    assert first.time_ns == length_ns(classic(0x100)) // 2 + 6 * BIT_NS
    assert second.time_ns - first.time_ns == first.time_ns - 6 * BIT_NS + flags_and_rest
    assert through.time_ns == second.time_ns + 11 * BIT_NS + length_ns(classic(0x100))
    assert bus.counters(0) == (15, 0)  # twice 8, less one for the frame that went through
    assert bus.counters(1) == (0, 1)  # twice 1, less one


def test_who_sees_an_error_first_pays_for_it() -> None:
    bus = CanBus(3, disturb=times(1, seen_by=1))
    bus.send(0, classic(0x100), 0)
    broken, _ = drain(bus)
    assert isinstance(broken, Destroyed)
    assert broken.seen_by == 1
    assert broken.time_ns == length_ns(classic(0x100)) // 2 + 12 * BIT_NS
    assert bus.counters(1) == (0, 8)
    assert bus.counters(2) == (0, 0)


def test_a_passive_receiver_misses_a_frame_that_all_others_get() -> None:
    bus = CanBus(3, disturb=times(16, seen_by=1))
    for number in range(40):
        bus.send(0, classic(0x100 + number), 0)
    events = drain(bus)
    assert ErrorState.PASSIVE in states(events, 1)
    missed = [event for event in delivered(events) if event.missed_by is not None]
    assert len(delivered(events)) == 40
    assert {event.missed_by for event in missed} == {1}
    # 9 an error: passive after 15, and the sixteenth is its own alone.
    assert len(missed) == 1


def test_a_node_that_is_alone_gets_passive_and_never_bus_off() -> None:
    bus = CanBus(1)
    bus.send(0, classic(0x100), 0)
    events = bus.run_to(100_000_000)
    assert {event.kind for event in events if isinstance(event, Destroyed)} == {ErrorKind.ACK}
    assert bus.counters(0) == (128, 0)
    assert bus.state(0) is ErrorState.PASSIVE
    bus.add_node(100_000_000)
    assert len(delivered(bus.run_to(101_000_000))) == 1
    assert bus.state(0) is ErrorState.ACTIVE


def test_a_passive_node_waits_eight_bits_after_its_own_frame() -> None:
    bus = CanBus(2, disturb=times(16, kind=ErrorKind.BIT))
    bus.send(0, classic(0x100), 0)
    bus.send(0, classic(0x100), 0)
    one, two = delivered(drain(bus))
    assert bus.state(0) is ErrorState.ACTIVE  # 128 - 2
    assert two.time_ns - one.time_ns == length_ns(classic(0x100)) + 3 * BIT_NS
    again = CanBus(2, disturb=times(20, kind=ErrorKind.BIT))
    again.send(0, classic(0x100), 0)
    again.send(0, classic(0x100), 0)
    one, two = delivered(drain(again))
    assert again.state(0) is ErrorState.PASSIVE
    assert two.time_ns - one.time_ns == length_ns(classic(0x100)) + (3 + 8) * BIT_NS


def test_a_passive_senders_fd_frame_says_so() -> None:
    bus = CanBus(2, disturb=times(20, kind=ErrorKind.BIT))
    bus.send(0, WireFrame(0x100, bytes(64)), 0)
    (through,) = delivered(drain(bus))
    assert through.frame.error_state


def test_bus_off_after_32_errors_purges_the_queue_and_ends_after_128_runs() -> None:
    bus = CanBus(3, disturb=times(32, of=0))
    for _ in range(5):
        bus.send(0, classic(0x100), 0)
    events = bus.run_to(50_000_000)
    off = next(e for e in events if isinstance(e, StateChanged) and e.state is ErrorState.BUS_OFF)
    back = next(e for e in events if isinstance(e, StateChanged) and e.time_ns > off.time_ns)
    assert [e for e in events if isinstance(e, Purged)] == [Purged(off.time_ns, 0, 5)]
    assert off.transmit_errors == 256
    assert back.state is ErrorState.ACTIVE
    assert back.time_ns - off.time_ns == 128 * RUN_NS
    assert bus.counters(0) == (0, 0)
    assert not delivered(events)


def test_a_busy_bus_delays_recovery_to_a_run_a_frame() -> None:
    """Each frame ends with eleven recessive bits; there are no others where frames never stop."""
    bus = CanBus(3)
    frame = classic(0x200)
    for number in range(127):
        assert bus.send(1, frame._replace(data=bytes([number] * 8)), 0)
    bus.run_to(1)
    bus.force_bus_off(0, 1)
    events = bus.run_to(10**9)
    off, back = [e for e in events if isinstance(e, StateChanged)]
    assert back.state is ErrorState.ACTIVE
    frames = delivered(events)
    assert len(frames) == 127
    # 127 frames and the run that was missing: the bus was never idle before.
    assert back.time_ns == frames[-1].time_ns - 8 * BIT_NS + 2 * RUN_NS
    assert off.time_ns == 1


@pytest.mark.parametrize("keeps", [False, True])
def test_stale_frames_after_bus_off_go_out_only_where_that_is_asked_for(keeps: bool) -> None:
    bus = CanBus(2, keeps_queue=keeps)
    bus.send(0, classic(0x100), 0)
    bus.run_to(1)
    bus.send(0, classic(0x101), 1)
    bus.force_bus_off(0, 1)
    assert not bus.send(0, classic(0x102), 1)
    ids = [event.frame.can_id for event in delivered(bus.run_to(10**9))]
    assert ids == ([0x100, 0x101] if keeps else [0x100])


def test_without_restart_a_node_stays_off_until_it_is_reported() -> None:
    bus = CanBus(2, restarts=False)
    bus.force_bus_off(0, 0)
    bus.run_to(10**9)
    assert bus.state(0) is ErrorState.BUS_OFF
    bus.restart(0, 10**9)
    bus.run_to(10**9 + 128 * RUN_NS - 1)
    assert bus.state(0) is ErrorState.BUS_OFF
    bus.run_to(10**9 + 128 * RUN_NS)
    assert bus.state(0) is ErrorState.ACTIVE


def test_the_counters_follow_the_standard() -> None:
    counters = ErrorCounters()
    for _ in range(12):
        counters.transmit_error()
    assert (counters.transmit, counters.is_warning) == (96, True)
    for _ in range(4):
        counters.transmit_error()
    assert counters.state is ErrorState.PASSIVE
    counters.sent()
    assert (counters.transmit, counters.state) == (127, ErrorState.ACTIVE)
    for _ in range(200):
        counters.receive_error(first=False)
    assert counters.state is ErrorState.PASSIVE
    counters.received()
    assert (counters.receive, counters.state) == (119, ErrorState.ACTIVE)
    counters.go_bus_off()
    counters.sent()
    assert counters.state is ErrorState.BUS_OFF
    counters.recover()
    assert (counters.transmit, counters.receive, counters.state) == (0, 0, ErrorState.ACTIVE)


@pytest.mark.parametrize("seed", range(6))
def test_any_traffic_keeps_the_rules_of_the_bus(seed: int) -> None:
    """Drawn senders, frames, times and faults: one frame at a time, never a lower priority while
    a higher one was ready, every frame through, purged or waiting."""
    draw = random.Random(seed)

    def disturb(attempt: Attempt) -> Fault | None:
        if draw.random() > 0.05:
            return None
        receivers = [n for n in range(5) if n not in attempt.senders]
        return Fault(ErrorKind.CRC, draw.random(), draw.choice([None, *receivers]))

    bus = CanBus(5, disturb=disturb, order=draw.choice(list(QueueOrder)))
    sent, events, now_ns = 0, [], 0
    for number in range(600):
        now_ns += draw.randrange(400_000)
        events += bus.run_to(now_ns)
        frame = WireFrame(draw.getrandbits(20) << 8 | number % 5, draw.randbytes(8))
        sent += bus.send(number % 5, frame, now_ns)
        if draw.random() < 0.01:
            bus.force_bus_off(draw.randrange(5), now_ns)
    events += drain(bus)
    gone = sum(event.frames for event in events if isinstance(event, Purged))
    through = delivered(events)
    assert len(through) + gone >= sent > 500
    assert sent - gone <= len(through) <= sent
    ends = [e.time_ns for e in events]
    assert ends == sorted(ends)
    for before, after in pairwise(through):
        assert after.time_ns - before.time_ns >= length_ns(after.frame) + 3 * BIT_NS
    assert math.isinf(bus.next_ns)
