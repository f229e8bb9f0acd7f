"""The bound of a message's response: known examples, and no simulated response above it."""

from __future__ import annotations

import random
from collections.abc import Sequence
from functools import cache

import pytest

from meshpoint.bus.simulated.contract_traffic import contract_traffic, wire_frame
from meshpoint.bus.simulated.core import CanBus, QueueOrder
from meshpoint.bus.simulated.events import Delivered
from meshpoint.bus.simulated.frame_bits import BitTiming, WireFrame, frame_bits, longest
from meshpoint.bus.simulated.response_time import Traffic, load, worst_response_ns
from meshpoint.dbc.schema import SCHEMA

pytestmark = pytest.mark.check
TIMING = BitTiming()
MS = 1_000_000
SPECS = {spec.name: spec for spec in SCHEMA.messages}


def test_the_example_that_refuted_the_older_analysis() -> None:
    """Davis et al. 2007, table 1: three messages of 1 ms (125 bits at 125 kbit/s), periods 2.5, 3.5
    and 3.5 ms. The second instance of C is the worst, 3.5 ms; the first says 3.0."""
    messages = [
        Traffic("A", 1, "a", 1 * MS, 2_500_000),
        Traffic("B", 2, "b", 1 * MS, 3_500_000),
        Traffic("C", 3, "c", 1 * MS, 3_500_000),
    ]
    worst = worst_response_ns(messages, QueueOrder.PRIORITY, bit_ns=8_000)
    assert worst == {"A": 2 * MS, "B": 3 * MS, "C": 3_500_000}
    assert load(messages) == pytest.approx(0.9714, abs=1e-4)


@pytest.mark.parametrize("order", QueueOrder)
def test_a_bus_that_is_asked_for_more_than_it_carries_has_no_bound(order: QueueOrder) -> None:
    messages = [Traffic("A", 1, "a", 6 * MS, 10 * MS), Traffic("B", 2, "b", 6 * MS, 10 * MS)]
    worst = worst_response_ns(messages, order, bit_ns=1)
    assert worst["B"] is None


def test_a_queue_in_order_waits_for_all_of_its_own() -> None:
    """Three at once on one node: whichever comes last waits for the other two, and for a frame of
    another node that had just begun."""
    messages = [
        *(Traffic(name, key, "one", 10, 1000) for key, name in enumerate("ABC")),
        Traffic("D", 9, "other", 25, 1000),
    ]
    worst = worst_response_ns(messages, QueueOrder.FIFO, bit_ns=1)
    assert worst == {"A": 55, "B": 55, "C": 55, "D": 55}


def stuffed(frame: WireFrame, draw: random.Random) -> WireFrame:
    """A payload that comes near the longest: a stuff bit after every four."""
    bits: list[int] = [draw.getrandbits(1)] * 5
    while len(bits) < 8 * len(frame.data):
        bits += [1 - bits[-1]] * 4
    text = "".join(map(str, bits))
    data = bytes(int(text[k : k + 8], 2) for k in range(0, 8 * len(frame.data), 8))
    return frame._replace(data=data)


def measured(
    messages: Sequence[Traffic], order: QueueOrder, draw: random.Random, together: bool
) -> dict[str, int]:
    """The longest responses in a second of the bus; phases drawn, or all at once. Jitter is drawn
    and counts, as in the bound, from when a frame was due."""
    nodes = sorted({message.node for message in messages})
    bus = CanBus(len(nodes), order=order, queue_length=1000)
    sends = []
    for message in messages:
        frame = wire_frame(SPECS[message.name])
        phase_ns = 0 if together else draw.randrange(message.period_ns)
        for due_ns in range(phase_ns, 1000 * MS, message.period_ns):
            late_ns = draw.randrange(message.jitter_ns + 1)
            sent = (
                stuffed(frame, draw)
                if together
                else frame._replace(data=draw.randbytes(len(frame.data)))
            )
            sends.append((due_ns + late_ns, nodes.index(message.node), message.name, due_ns, sent))
    sends.sort(key=lambda send: (send[0], send[1], send[4].can_id))
    due: dict[int, list[int]] = {}
    worst = dict.fromkeys((message.name for message in messages), 0)
    names = {spec.can_id: spec.name for spec in SCHEMA.messages}

    def note(until_ns: int) -> None:
        for event in bus.run_to(until_ns):
            assert isinstance(event, Delivered)
            name = names[event.frame.can_id]
            response_ns = event.time_ns + 6_000 - due[event.frame.can_id].pop(0)
            worst[name] = max(worst[name], response_ns)

    for time_ns, node, _, due_ns, frame in sends:
        note(time_ns)
        due.setdefault(frame.can_id, []).append(due_ns)
        assert bus.send(node, frame, time_ns)
    note(10_000 * MS)
    return worst


@cache
def bounds_of(order: QueueOrder) -> dict[str, int | None]:
    return worst_response_ns(contract_traffic(), order, TIMING.nominal_ns)


@pytest.mark.parametrize("order", QueueOrder)
@pytest.mark.parametrize("seed", range(4))
def test_no_message_of_ours_takes_longer_than_its_bound(order: QueueOrder, seed: int) -> None:
    draw = random.Random(seed)
    messages = contract_traffic()
    bounds = bounds_of(order)
    worst = measured(messages, order, draw, together=seed == 0)
    late = {n: (ns, bounds[n]) for n, ns in worst.items() if ns > (bounds[n] or 0)}
    assert not late


def test_the_bound_is_not_much_above_what_happens() -> None:
    """All at once, frames near their longest, no jitter and no extra steps: within a tenth for the
    messages that a shift needs."""
    messages = [
        Traffic(m.name, m.key, m.node, m.longest_ns, m.period_ns) for m in contract_traffic()
    ]
    bounds = worst_response_ns(messages, QueueOrder.PRIORITY, TIMING.nominal_ns)
    worst = measured(messages, QueueOrder.PRIORITY, random.Random(1), together=True)
    lowest_blocking_ns = max(m.longest_ns for m in messages)
    for name in ("ValveCommand", "EdgesLayshaftRise", "EdgesMainRise", "SleevesMain"):
        bound_ns = bounds[name]
        assert bound_ns is not None
        # Nothing lower was on the bus when all came at once.
        assert worst[name] >= 0.9 * (bound_ns - lowest_blocking_ns)


def test_the_longest_frame_of_each_message_bounds_its_random_ones() -> None:
    draw = random.Random(5)
    for spec in SCHEMA.messages:
        frame = wire_frame(spec)
        limit_ns = longest(frame).duration_ns(TIMING)
        for _ in range(50):
            sent = frame._replace(data=draw.randbytes(spec.length))
            assert frame_bits(sent).duration_ns(TIMING) <= limit_ns
