"""The virtual-time driver: the same cores as live, on one event heap, without sleeping.

Events are ordered by time, then priority (a frame that is through comes before a step at the same
microsecond), then sequence; so a run is a function of its seed.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable
from enum import IntEnum

from bus.core import Core
from dbc.frame import Frame
from testbench.virtual_bus import VirtualBus


class Priority(IntEnum):
    """Order of events at the same microsecond."""

    DELIVERY = 0
    STEP = 1


class VirtualTime:
    """Runs cores against each other over a virtual bus.

    `phases_us` are the first step times of the nodes: real nodes do not tick together.
    `on_frame(time_us, frame)` sees every frame as it leaves the bus, in bus order.
    `rejected` are the acceptance filters: identifiers that a node's CAN controller drops.
    """

    def __init__(
        self,
        cores: list[Core],
        phases_us: list[int],
        on_frame: Callable[[int, Frame], None] | None = None,
        on_event: Callable[[int, int, str], None] | None = None,
        rejected: list[frozenset[int]] | None = None,
    ) -> None:
        self._cores = cores
        self._rejected = rejected or [frozenset()] * len(cores)
        self._bus = VirtualBus()
        self._on_frame = on_frame
        self._on_event = on_event
        self._heap: list[tuple[int, Priority, int, int]] = []
        self._sequence = 0
        self._due: list[int] = list(phases_us)
        self.now_us = 0
        for node, phase_us in enumerate(phases_us):
            self._push(phase_us, Priority.STEP, node)

    @property
    def bus(self) -> VirtualBus:
        """The bus, for its load."""
        return self._bus

    def _push(self, time_us: int, priority: Priority, node: int) -> None:
        self._sequence += 1
        heapq.heappush(self._heap, (time_us, priority, self._sequence, node))

    def run(self, until: Callable[[], bool], limit_us: int) -> bool:
        """Runs until `until()` says so, looked at after every step, or until `limit_us`.

        Returns whether `until` was met."""
        while self._heap and self._heap[0][0] <= limit_us:
            self.now_us, priority, _, node = heapq.heappop(self._heap)
            if priority is Priority.DELIVERY:
                self._deliver()
            elif self._due[node] == self.now_us:
                self._step(node)
                if until():
                    return True
        return False

    def _deliver(self) -> None:
        delivery = self._bus.take()
        if self._on_frame is not None:
            self._on_frame(delivery.time_us, delivery.frame)
        can_id = delivery.frame.can_id
        for node, core in enumerate(self._cores):
            if node == delivery.sender or can_id in self._rejected[node]:
                continue
            core.receive(delivery.frame)
            if core.next_step_us <= self.now_us and self._due[node] > self.now_us:
                self._due[node] = self.now_us
                self._push(self.now_us, Priority.STEP, node)
        if self._bus.next_us is not None:
            self._push(self._bus.next_us, Priority.DELIVERY, 0)

    def _step(self, node: int) -> None:
        core = self._cores[node]
        step = core.step(self.now_us)
        if self._on_event is not None:
            for line in step.events:
                self._on_event(self.now_us, node, line)
        idle = self._bus.next_us is None
        self._bus.send(node, step.frames, self.now_us)
        if idle and self._bus.next_us is not None:
            self._push(self._bus.next_us, Priority.DELIVERY, 0)
        self._due[node] = max(core.next_step_us, self.now_us + 1)
        self._push(self._due[node], Priority.STEP, node)
