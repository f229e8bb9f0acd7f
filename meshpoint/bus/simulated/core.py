"""The bus as a core without clock: frames in, what happened out, time in integer nanoseconds.

    send(node, frame, now_ns)   into the node's queue; False where that is full or the node bus-off
    run_to(now_ns)              what has happened by then
    next_ns                     when to ask again

Nodes whose frames wait when the bus becomes free compete by identifier. Who starts at a moment is
settled by the first call with a later one, so the order of calls within a nanosecond is of no
account. Not modelled: overload frames, differences of the nodes' clocks, delays of the line.
"""

from __future__ import annotations

import math
from bisect import insort
from enum import Enum
from operator import attrgetter
from typing import Final, NamedTuple

from meshpoint.bus.simulated.confinement import ErrorCounters, ErrorState
from meshpoint.bus.simulated.events import (
    Attempt,
    BusEvent,
    Delivered,
    Destroyed,
    Disturb,
    ErrorKind,
    Fault,
    Purged,
    StateChanged,
)
from meshpoint.bus.simulated.frame_bits import (
    INTERMISSION_BITS,
    BitTiming,
    WireFrame,
    arbitration_key,
    check_frame,
    common_bits,
    frame_bits,
)

NEVER: Final = math.inf
SUSPEND_BITS: Final = 8
"""An error-passive node waits this much longer after its own frame."""
FLAG_BITS: Final = 6
LATE_FLAG_BITS: Final = 12
"""The flag of the node that saw the error first, and those of the others after it."""
DELIMITER_BITS: Final = 8
AFTER_ACK_BITS: Final = 8
"""Acknowledge delimiter and end of frame: recessive, as the intermission is."""
FREE_BITS: Final = 11
RECOVERY_RUNS: Final = 128
"""A node that is bus-off is back after this many runs of eleven recessive bits."""
QUEUE_LENGTH: Final = 128


class QueueOrder(Enum):
    """Which of a node's waiting frames competes for the bus."""

    FIFO = "fifo"
    """The one that was handed over first, as from a SocketCAN interface."""
    PRIORITY = "priority"
    """The one with the lowest identifier, as from a controller with enough transmit buffers."""


class _Waiting(NamedTuple):
    key: int
    queued_ns: int
    frame: WireFrame


_key = attrgetter("key")


class _Node:
    """A node's queue, its error counters, and from when on it may send."""

    def __init__(self, queue_length: int, order: QueueOrder) -> None:
        self.queue: list[_Waiting] = []
        """The first one competes for the bus."""
        self.queue_length = queue_length
        self._order = order
        self.counters = ErrorCounters()
        self.shown = (ErrorState.ACTIVE, False)
        self.earliest_ns = 0
        self.runs_left: int | None = None
        """Runs of recessive bits to its recovery; None: not recovering."""
        self.counted_from_ns = 0
        self.refused = 0

    def put(self, waiting: _Waiting) -> None:
        if self._order is QueueOrder.FIFO:
            self.queue.append(waiting)
        else:  # frames of one identifier stay in the order given
            insort(self.queue, waiting, key=_key)


class _Outcome(NamedTuple):
    """What becomes of an attempt: how long its frame lasts, whole or until it is broken off (ns),
    why it is, and which receiver alone misses it."""

    lasts_ns: int
    fault: Fault | None = None
    missed_by: int | None = None


class _OnBus(NamedTuple):
    attempt: Attempt
    waiting: dict[int, _Waiting]
    outcome: _Outcome
    end_ns: int
    """End of frame, or of the error flags."""


def never_disturbed(_attempt: Attempt) -> Fault | None:
    """A bus without faults."""
    return None


class CanBus:
    """One bus of `nodes` nodes.

    restarts: whether a node that went bus-off begins its recovery by itself; else `restart` does.
    keeps_queue: whether its waiting frames survive bus-off, and go out stale.
    """

    def __init__(
        self,
        nodes: int = 0,
        timing: BitTiming | None = None,
        *,
        queue_length: int = QUEUE_LENGTH,
        order: QueueOrder = QueueOrder.FIFO,
        disturb: Disturb = never_disturbed,
        restarts: bool = True,
        keeps_queue: bool = False,
    ) -> None:
        self._timing = timing or BitTiming()
        self._queue_length = queue_length
        self._order = order
        self.disturb = disturb
        self._restarts = restarts
        self._keeps_queue = keeps_queue
        self._nodes: dict[int, _Node] = {}
        self._on_bus: _OnBus | None = None
        self._free_ns = 0
        self._recessive_ns = 0
        self._now_ns = 0
        self._events: list[BusEvent] = []
        self.busy_ns = 0
        """Time with a frame or an error frame on the bus, intermissions included."""
        for _ in range(nodes):
            self.add_node(0)

    def add_node(self, now_ns: int, queue_length: int | None = None) -> int:
        """Another node; its number."""
        number = max(self._nodes, default=-1) + 1
        node = _Node(queue_length or self._queue_length, self._order)
        node.earliest_ns = now_ns
        self._nodes[number] = node
        return number

    def remove_node(self, number: int) -> None:
        """The node is gone, with what it had not sent; a frame on the bus goes through."""
        del self._nodes[number]

    def state(self, node: int) -> ErrorState:
        """A node's error state."""
        return self._nodes[node].counters.state

    def counters(self, node: int) -> tuple[int, int]:
        """A node's transmit and receive error counters."""
        counters = self._nodes[node].counters
        return counters.transmit, counters.receive

    def waiting(self, node: int) -> int:
        """How many frames a node has in its queue."""
        return len(self._nodes[node].queue)

    def refused(self, node: int) -> int:
        """How many frames found a node's queue full or the node bus-off."""
        return self._nodes[node].refused

    def send(self, node: int, frame: WireFrame, now_ns: int) -> bool:
        """Puts a frame into the node's queue; whether it could.

        ValueError for a frame that no CAN bus could carry."""
        check_frame(frame)
        self._advance(now_ns)
        place = self._nodes[node]
        if place.counters.state is ErrorState.BUS_OFF or len(place.queue) >= place.queue_length:
            place.refused += 1
            return False
        place.put(_Waiting(arbitration_key(frame), now_ns, frame))
        return True

    def force_bus_off(self, node: int, now_ns: int) -> None:
        """As if the node had failed to send often enough."""
        self._advance(now_ns)
        self._nodes[node].counters.go_bus_off()
        self._show(now_ns)

    def restart(self, node: int, now_ns: int) -> None:
        """A node that is bus-off begins to count recessive bits."""
        self._advance(now_ns)
        self._restart(node, now_ns)

    def _restart(self, node: int, now_ns: int) -> None:
        place = self._nodes[node]
        if place.counters.state is ErrorState.BUS_OFF and place.runs_left is None:
            place.runs_left = RECOVERY_RUNS
            place.counted_from_ns = max(now_ns, self._recessive_ns)

    @property
    def next_ns(self) -> float:
        """When something happens or is settled next; infinite where nothing will."""
        if self._events:
            return self._now_ns
        if self._on_bus is not None:
            return self._on_bus.end_ns
        start_ns = self._start_ns()
        return min(start_ns + 1, self._recovery_ns())

    def run_to(self, now_ns: int) -> list[BusEvent]:
        """Everything that has happened by `now_ns`, in order of time. Time never goes back: all
        calls come in its order."""
        self._advance(now_ns)
        events, self._events = self._events, []
        return events

    def _advance(self, now_ns: int) -> None:
        while True:
            on_bus = self._on_bus
            if on_bus is not None:
                if on_bus.end_ns > now_ns:
                    break
                self._end(on_bus)
                continue
            start_ns, recovery_ns = self._start_ns(), self._recovery_ns()
            if recovery_ns <= min(start_ns, now_ns):
                self._recover(int(recovery_ns))
            elif start_ns < now_ns:
                self._start(int(start_ns))
            else:
                break
        self._now_ns = now_ns

    def _start_ns(self) -> float:
        """When the next frame starts, by what waits now."""
        starts = [
            max(node.earliest_ns, node.queue[0].queued_ns)
            for node in self._nodes.values()
            if node.queue and node.counters.state is not ErrorState.BUS_OFF
        ]
        return max(self._free_ns, min(starts)) if starts else NEVER

    def _start(self, at_ns: int) -> None:
        """Arbitration among all that wait by now; the winner's frame is on the bus."""
        ready = {}
        for number, node in self._nodes.items():
            if node.queue and node.counters.state is not ErrorState.BUS_OFF:
                head = node.queue[0]
                if max(node.earliest_ns, head.queued_ns) <= at_ns:
                    ready[number] = head
        best = min(head.key for head in ready.values())
        winners = {number: head for number, head in ready.items() if head.key == best}
        frame = next(iter(winners.values())).frame
        if frame.is_fd:
            passive = any(self.state(number) is ErrorState.PASSIVE for number in winners)
            frame = frame._replace(error_state=frame.error_state or passive)
        attempt = Attempt(at_ns, tuple(winners), frame)
        outcome = self._outcome_of(attempt, [head.frame for head in winners.values()])
        self._count_recessive(at_ns)
        end_ns = at_ns + outcome.lasts_ns
        if outcome.fault is not None:
            flags = FLAG_BITS if outcome.fault.seen_by is None else LATE_FLAG_BITS
            end_ns += flags * self._timing.nominal_ns
        self._on_bus = _OnBus(attempt, winners, outcome, end_ns)

    def _outcome_of(self, attempt: Attempt, sent: list[WireFrame]) -> _Outcome:
        nominal_ns = self._timing.nominal_ns
        whole_ns = frame_bits(attempt.frame).duration_ns(self._timing)
        others = [frame for frame in sent[1:] if frame != sent[0]]
        if others:
            bits = min(common_bits(sent[0], other) for other in others)
            until_ns = min(whole_ns, (bits + 1) * nominal_ns)
            return _Outcome(until_ns, Fault(ErrorKind.COLLISION))
        fault = self.disturb(attempt)
        seen_by = None if fault is None else fault.seen_by
        if fault is not None and (seen_by is None or self.state(seen_by) is ErrorState.ACTIVE):
            share = min(max(fault.share, 0.0), 1.0)
            return _Outcome(max(round(share * whole_ns), nominal_ns), fault)
        if not self._is_acknowledged(attempt.senders):
            return _Outcome(whole_ns - AFTER_ACK_BITS * nominal_ns, Fault(ErrorKind.ACK))
        # The flag of a receiver that is error-passive is recessive: the others get the frame.
        return _Outcome(whole_ns, missed_by=seen_by)

    def _is_acknowledged(self, senders: tuple[int, ...]) -> bool:
        return len(senders) > 1 or any(
            number not in senders and node.counters.state is not ErrorState.BUS_OFF
            for number, node in self._nodes.items()
        )

    def _end(self, on_bus: _OnBus) -> None:
        """The frame is through, or its error flags are."""
        attempt, waiting, outcome, end_ns = on_bus
        nominal_ns = self._timing.nominal_ns
        senders, fault = attempt.senders, outcome.fault
        if fault is None:
            self._count_good(on_bus)
            self._recessive_ns = end_ns - AFTER_ACK_BITS * nominal_ns
            self._free_ns = end_ns + INTERMISSION_BITS * nominal_ns
            queued_ns = min(head.queued_ns for head in waiting.values())
            self._events.append(
                Delivered(end_ns, senders, attempt.frame, queued_ns, outcome.missed_by)
            )
        else:
            self._count_bad(senders, fault)
            self._recessive_ns = end_ns
            self._free_ns = end_ns + (DELIMITER_BITS + INTERMISSION_BITS) * nominal_ns
            counters = {number: self.counters(number) for number in self._nodes}
            self._events.append(
                Destroyed(end_ns, senders, attempt.frame, fault.kind, counters, fault.seen_by)
            )
        self.busy_ns += self._free_ns - attempt.start_ns
        self._on_bus = None
        for number in senders:
            node = self._nodes.get(number)
            if node is not None and node.counters.state is ErrorState.PASSIVE:
                node.earliest_ns = self._free_ns + SUSPEND_BITS * nominal_ns
        self._show(end_ns)

    def _count_good(self, on_bus: _OnBus) -> None:
        for number, node in self._nodes.items():
            sent = on_bus.waiting.get(number)
            if sent is not None:
                node.counters.sent()
                if sent in node.queue:
                    node.queue.remove(sent)
            elif number == on_bus.outcome.missed_by:
                node.counters.receive_error(first=False)
            elif node.counters.state is not ErrorState.BUS_OFF:
                node.counters.received()

    def _count_bad(self, senders: tuple[int, ...], fault: Fault) -> None:
        for number, node in self._nodes.items():
            counters = node.counters
            if number in senders:
                if fault.kind is ErrorKind.ACK:
                    counters.not_acknowledged()
                else:
                    counters.transmit_error()
            elif counters.state is not ErrorState.BUS_OFF:
                counters.receive_error(first=number == fault.seen_by)

    def _show(self, now_ns: int) -> None:
        """Says which nodes' states have changed; a queue ends with bus-off."""
        for number, node in self._nodes.items():
            counters = node.counters
            shown = (counters.state, counters.is_warning)
            if shown == node.shown:
                continue
            went_off = counters.state is ErrorState.BUS_OFF is not node.shown[0]
            node.shown = shown
            errors = (counters.transmit, counters.receive)
            self._events.append(StateChanged(now_ns, number, *shown, *errors))
            if went_off:
                if node.queue and not self._keeps_queue:
                    self._events.append(Purged(now_ns, number, len(node.queue)))
                    node.queue.clear()
                if self._restarts:
                    self._restart(number, now_ns)

    def _recovery_ns(self) -> float:
        """When the next node is back from bus-off, if no frame comes before."""
        run_ns = FREE_BITS * self._timing.nominal_ns
        return min(
            (
                max(self._recessive_ns, node.counted_from_ns) + node.runs_left * run_ns
                for node in self._nodes.values()
                if node.runs_left is not None
            ),
            default=NEVER,
        )

    def _count_recessive(self, until_ns: int) -> None:
        """The idle time that ends now, for those who wait to come back."""
        run_ns = FREE_BITS * self._timing.nominal_ns
        for node in self._nodes.values():
            if node.runs_left is not None:
                idle_ns = until_ns - max(self._recessive_ns, node.counted_from_ns)
                node.runs_left -= max(0, idle_ns // run_ns)

    def _recover(self, at_ns: int) -> None:
        run_ns = FREE_BITS * self._timing.nominal_ns
        for node in self._nodes.values():
            if node.runs_left is not None:
                since_ns = max(self._recessive_ns, node.counted_from_ns)
                if since_ns + node.runs_left * run_ns <= at_ns:
                    node.runs_left = None
                    node.counters.recover()
                    node.earliest_ns = at_ns
        self._show(at_ns)
