"""How long a message may take from its queue to its receivers, at worst.

For nodes that send their waiting frames by priority: Davis, Burns, Bril, Lukkien, "Controller Area
Network (CAN) schedulability analysis: Refuted, revisited and revised" (Real-Time Systems 35, 2007).
For nodes that send them in the order given, as a SocketCAN interface does: the same busy period for
the node's queue as a whole at its lowest priority, and messages of other nodes come late by what
they may have waited behind lower ones of their own (after Davis, Kollmann, Pollex, Slomka,
"Controller Area Network (CAN) schedulability analysis with FIFO queues", ECRTS 2011).

Frames have a length and a least interval each, so nothing here knows of bits. Times in integer
nanoseconds. No errors on the bus: each would cost its error frame and the frame again.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from meshpoint.bus.simulated.core import QueueOrder

HORIZON_NS: Final = 10_000_000_000
"""A busy period that is longer has no end that is of use."""
NO_EXTRA_NS: Final = 1 << 60
ROUNDS: Final = 100
"""Of the search for how long frames wait behind others of their own node."""


@dataclass(frozen=True)
class Traffic:
    """One message as the analysis sees it."""

    name: str
    key: int
    """Its arbitration bits; the lowest is sent first."""
    node: str
    longest_ns: int
    """Its longest frame with the intermission."""
    period_ns: int
    """The least time from one to the next."""
    jitter_ns: int = 0
    """How much later than its period says it may be queued."""
    extra_ns: int | None = None
    """The least time between frames that come besides; None: there are none."""

    def most_in(self, window_ns: int) -> int:
        """How many may be queued in a window of this length, its end not included."""
        count = _ceil(window_ns + self.jitter_ns, self.period_ns)
        return count if self.extra_ns is None else count + _ceil(window_ns, self.extra_ns)

    def earliest_ns(self, instance: int) -> int:
        """When, counted from the first, its frame number `instance` (from 0) is due at the
        earliest."""
        due = [number * self.period_ns for number in range(instance + 1)]
        if self.extra_ns is not None:
            due += [number * self.extra_ns for number in range(instance + 1)]
        return sorted(due)[instance]

    def next_arrival_ns(self, after_ns: int) -> int:
        """The next moment at which one more may have been queued, if all came as early as they
        may."""
        count = (after_ns + self.jitter_ns) // self.period_ns + 1
        regular_ns = count * self.period_ns - self.jitter_ns
        if self.extra_ns is None:
            return regular_ns
        return min(regular_ns, (after_ns // self.extra_ns + 1) * self.extra_ns)


def load(messages: Sequence[Traffic]) -> float:
    """Share of the bus that they take if every frame is its longest."""
    return sum(
        message.longest_ns * (1.0 / message.period_ns + 1.0 / (message.extra_ns or math.inf))
        for message in messages
    )


def worst_response_ns(
    messages: Sequence[Traffic], order: QueueOrder, bit_ns: int
) -> dict[str, int | None]:
    """For each message the longest time from its queue to the end of its intermission (ns),
    jitter included; None where there is no bound, as on a bus with a load above 1."""
    if order is QueueOrder.PRIORITY:
        return {message.name: _by_priority(message, messages, bit_ns) for message in messages}
    return _in_order(messages, bit_ns)


def _ceil(value: int, step: int) -> int:
    return -(-value // step)


def _blocking_ns(key: int, messages: Sequence[Traffic]) -> int:
    """The longest lower frame, which may have just begun."""
    return max((other.longest_ns for other in messages if other.key > key), default=0)


def _by_priority(message: Traffic, messages: Sequence[Traffic], bit_ns: int) -> int | None:
    higher = [other for other in messages if other.key < message.key]
    if load([*higher, message]) > 1.0:
        return None
    blocking_ns = _blocking_ns(message.key, messages)
    busy_ns = message.longest_ns
    while True:
        grown_ns = blocking_ns + sum(
            other.most_in(busy_ns) * other.longest_ns for other in (*higher, message)
        )
        if grown_ns == busy_ns:
            break
        if grown_ns > HORIZON_NS:
            return None
        busy_ns = grown_ns
    worst_ns, demand = 0, _Demand(higher, [0] * len(higher), bit_ns)
    for instance in range(message.most_in(busy_ns)):
        before_ns = blocking_ns + instance * message.longest_ns
        start_ns = _start_ns(before_ns, demand)
        if start_ns is None:
            return None
        due_ns = message.earliest_ns(instance) - message.jitter_ns
        worst_ns = max(worst_ns, start_ns + message.longest_ns - due_ns)
    return worst_ns


class _Demand:
    """The bus time that some messages may take in a window; arrays, because it is asked for often.

    `late_ns`: how much later than their jitter each may come."""

    def __init__(self, messages: Sequence[Traffic], late_ns: Sequence[int], bit_ns: int) -> None:
        values = [
            (m.longest_ns, m.period_ns, m.extra_ns or NO_EXTRA_NS, late + bit_ns)
            for m, late in zip(messages, late_ns, strict=True)
        ]
        table = np.array(values, dtype=np.int64).reshape(-1, 4)
        self._longest, self._period, self._extra, self._late = table.T
        self._jitter = np.array([m.jitter_ns for m in messages], dtype=np.int64)
        self._has_extra = self._extra < NO_EXTRA_NS

    def ns(self, window_ns: int) -> int:
        """All of them together."""
        window = window_ns + self._late
        regular = -(-(window + self._jitter) // self._period)
        extra = -(-window // self._extra) * self._has_extra
        return int(((regular + extra) * self._longest).sum())


def _start_ns(before_ns: int, higher: _Demand, from_ns: int = 0) -> int | None:
    """When a frame starts that `before_ns` of bus time comes before at any rate, besides what wins
    against it; `from_ns`: it is known not to start earlier."""
    start_ns = max(before_ns, from_ns)
    while True:
        grown_ns = before_ns + higher.ns(start_ns)
        if grown_ns <= start_ns:
            return start_ns
        if grown_ns > HORIZON_NS:
            return None
        start_ns = grown_ns


def _in_order(messages: Sequence[Traffic], bit_ns: int) -> dict[str, int | None]:
    """All nodes with queues in order. How long a frame waits in its queue depends on the others'
    waiting, so this begins with none and goes on until nothing grows."""
    nodes: dict[str, list[Traffic]] = {}
    for message in messages:
        nodes.setdefault(message.node, []).append(message)
    late_ns = dict.fromkeys((message.name for message in messages), 0)
    for _ in range(ROUNDS):
        worst: dict[str, int | None] = {}
        for group in nodes.values():
            delay_ns = _queue_delay_ns(group, messages, late_ns, bit_ns)
            for message in group:
                worst[message.name] = None if delay_ns is None else message.jitter_ns + delay_ns
        grown_ns = {}
        for message in messages:
            response_ns = worst[message.name]
            if response_ns is None:
                return dict.fromkeys(late_ns)
            alone = len(nodes[message.node]) == 1
            queued_ns = response_ns - message.jitter_ns - message.longest_ns
            grown_ns[message.name] = 0 if alone else queued_ns
        if grown_ns == late_ns:
            return worst
        late_ns = grown_ns
    return dict.fromkeys(late_ns)


def _queue_delay_ns(
    group: Sequence[Traffic], messages: Sequence[Traffic], late_ns: dict[str, int], bit_ns: int
) -> int | None:
    """The longest time from the arrival of a frame in a node's queue until it is through.

    The bus is busy from time 0 with the queue's own work and with frames that win against its
    lowest; a frame that comes at a time waits for all the work that came until then. Only the
    moments at which work comes can be the worst."""
    lowest = max(message.key for message in group)
    others = [message for message in messages if message not in group]
    higher = [other for other in others if other.key < lowest]
    if load([*group, *higher]) > 1.0:
        return None
    demand = _Demand(higher, [late_ns[other.name] for other in higher], bit_ns)
    blocking_ns = _blocking_ns(lowest, others)
    shortest_ns = min(message.longest_ns for message in group)
    at_ns = worst_ns = begun_ns = 0
    while at_ns <= HORIZON_NS:
        # One nanosecond more: what comes at this very moment may stand before the frame.
        work_ns = sum(message.most_in(at_ns + 1) * message.longest_ns for message in group)
        start_ns = _start_ns(blocking_ns + work_ns - shortest_ns, demand, begun_ns)
        if start_ns is None:
            return None
        begun_ns = start_ns
        through_ns = start_ns + shortest_ns
        worst_ns = max(worst_ns, through_ns - at_ns)
        at_ns = min(message.next_arrival_ns(at_ns) for message in group)
        if at_ns >= through_ns:
            return worst_ns
    return None
