"""The virtual-time driver: the same cores as live, on one event heap, without sleeping.

Steps wait on a heap ordered by time, then node; the bus has one frame on its way at a time, and a
frame that is through comes before a step at the same microsecond. So a run is a function of its
seed.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable

from meshpoint.bench.loaded_bus import LoadedBus
from meshpoint.bench.shared_bus import SharedBus
from meshpoint.bench.virtual_bus import VirtualBus
from meshpoint.bus.core import Core
from meshpoint.dbc.frame import Frame


class VirtualTime:
    """Runs cores against each other over a virtual bus.

    `phases_us` are the first step times of the nodes: real nodes do not tick together.
    `on_frame(time_us, frame)` sees every frame as it leaves the bus, in bus order.
    `rejected` are the acceptance filters: identifiers that a node's CAN controller drops.
    `bus` is the bus between them, a `VirtualBus` where none is given.
    """

    def __init__(
        self,
        cores: list[Core],
        phases_us: list[int],
        on_frame: Callable[[int, Frame], None] | None = None,
        on_event: Callable[[int, int, str], None] | None = None,
        rejected: list[frozenset[int]] | None = None,
        bus: VirtualBus | LoadedBus | SharedBus | None = None,
    ) -> None:
        self._cores = cores
        self._rejected = rejected or [frozenset()] * len(cores)
        self._bus = VirtualBus() if bus is None else bus
        self._on_frame = on_frame
        self._on_event = on_event
        self._heap: list[tuple[int, int]] = []
        self._routes: dict[tuple[int, int], list[tuple[int, Core]]] = {}
        self._due: list[int] = list(phases_us)
        self._phases_us = list(phases_us)
        self.now_us = 0
        for node, phase_us in enumerate(phases_us):
            self._push(phase_us, node)

    @property
    def bus(self) -> VirtualBus | LoadedBus | SharedBus:
        """The bus, for its load."""
        return self._bus

    def _push(self, time_us: int, node: int) -> None:
        heapq.heappush(self._heap, (time_us, node))

    def run(self, until: Callable[[], bool], limit_us: int) -> bool:
        """Runs until `until()` says so, looked at after every step, or until `limit_us`.

        Returns whether `until` was met."""
        heap, bus = self._heap, self._bus
        while True:
            # A frame that is through comes before a step at the same microsecond.
            while bus.next_us <= heap[0][0]:
                if bus.next_us > limit_us:
                    return False
                self.now_us = int(bus.next_us)
                through = bus.take()
                if through is not None:
                    self._deliver(*through)
            if heap[0][0] > limit_us:
                return False
            self.now_us, node = heapq.heappop(heap)
            if self._due[node] == self.now_us:
                self._step(node)
                if until():
                    return True

    def _deliver(self, sender: int, frame: Frame) -> None:
        now_us, due_us = self.now_us, self._due
        if self._on_frame is not None:
            self._on_frame(now_us, frame)
        route = self._routes.get((sender, frame.can_id))
        if route is None:
            route = self._routes[sender, frame.can_id] = self._route(sender, frame.can_id)
        for node, core in route:
            core.receive(frame)
            if now_us < self._phases_us[node]:
                continue  # it has not been switched on yet
            if due_us[node] > now_us and core.next_step_us <= now_us:
                due_us[node] = now_us
                self._push(now_us, node)

    def _route(self, sender: int, can_id: int) -> list[tuple[int, Core]]:
        """The nodes that receive this identifier from this sender."""
        return [
            (node, core)
            for node, core in enumerate(self._cores)
            if node != sender and can_id not in self._rejected[node]
        ]

    def _step(self, node: int) -> None:
        core = self._cores[node]
        step = core.step(self.now_us)
        if self._on_event is not None:
            for line in step.events:
                self._on_event(self.now_us, node, line)
        self._bus.send(node, step.frames, self.now_us)
        self._due[node] = max(core.next_step_us, self.now_us + 1)
        self._push(self._due[node], node)
