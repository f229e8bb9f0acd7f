"""The simulated bus for the virtual-time driver: exact lengths, other nodes' traffic.

Same use as `VirtualBus`, which has average lengths and no other traffic.
"""

from __future__ import annotations

import math
from collections import deque
from functools import lru_cache
from typing import Any, Final

from meshpoint.bus.simulated.contract_traffic import RIG_QUEUES, contract_traffic, wire_frame
from meshpoint.bus.simulated.core import CanBus, QueueOrder
from meshpoint.bus.simulated.events import Delivered
from meshpoint.bus.simulated.filler import NODES, FillerTraffic, draw_filler
from meshpoint.bus.simulated.frame_bits import (
    INTERMISSION_BITS,
    BitTiming,
    WireFrame,
    frame_bits,
)
from meshpoint.bus.simulated.response_time import Traffic, load, worst_response_ns
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.schema import SCHEMA

TIMING: Final = BitTiming()
CORES: Final = 3
"""Controller, rig and bench come first; the nodes behind them are others."""
NAMES: Final = {spec.can_id: spec.name for spec in SCHEMA.messages}


@lru_cache(maxsize=1)
def own_load() -> float:
    """The share of the bus that our own cyclic messages take with half of their stuff bits."""
    traffic = {message.name: message for message in contract_traffic(TIMING)}
    share = 0.0
    for spec in SCHEMA.messages:
        if spec.is_cyclic:
            plain = wire_frame(spec)._replace(data=b"\x55" * spec.length)
            plain_ns = frame_bits(plain).duration_ns(TIMING) + INTERMISSION_BITS * TIMING.nominal_ns
            message = traffic[spec.name]
            share += (message.longest_ns + 3 * plain_ns) / 4 / message.period_ns
    return share


class LoadedBus:
    """A bus with a load of `load_share`, of which our own nodes make their part."""

    def __init__(self, load_share: float, seed: int, order: QueueOrder) -> None:
        self._wanted = load_share
        self._order = order
        self._fillers = draw_filler(seed, load_share - own_load(), TIMING)
        self._filler = FillerTraffic(self._fillers, seed) if self._fillers else None
        self._bus = CanBus(CORES + NODES, TIMING, order=order)
        self._through: deque[tuple[int, Frame]] = deque()
        self._now_us = 0
        self._worst_ns: dict[str, int] = {}

    @property
    def busy_us(self) -> int:
        """Time with a frame on the bus."""
        return self._bus.busy_ns // 1000

    @property
    def next_us(self) -> float:
        """When to `take`."""
        if self._through:
            return self._now_us
        next_ns = self._bus.next_ns
        if self._filler is not None:
            next_ns = min(next_ns, self._filler.next_ns)
        return next_ns if math.isinf(next_ns) else -(-int(next_ns) // 1000)

    def send(self, sender: int, frames: list[Frame], now_us: int) -> None:
        """A node hands over frames at `now_us`; what its full queue refuses is counted."""
        for can_id, data, is_fd, is_extended in frames:
            frame = WireFrame(can_id, data, is_fd, is_extended, bitrate_switch=is_fd)
            self._bus.send(sender, frame, now_us * 1000)

    def take(self) -> tuple[int, Frame] | None:
        """Sender and frame of one that is through by now; None where only others have moved."""
        if not self._through:
            self._now_us = int(self.next_us)
            self._run_to(self._now_us * 1000)
        return self._through.popleft() if self._through else None

    def _run_to(self, now_ns: int) -> None:
        filler = self._filler
        while filler is not None and filler.next_ns <= now_ns:
            due_ns = filler.next_ns
            node, frame = filler.take()
            self._bus.send(CORES + node, frame, due_ns)
        for event in self._bus.run_to(now_ns):
            if isinstance(event, Delivered):
                self._note(event)
                can_id, data, is_fd, is_extended, *_ = event.frame
                through = Frame(can_id, data, is_fd, is_extended)
                self._through.append((event.senders[0], through))

    def _note(self, event: Delivered) -> None:
        name = NAMES.get(event.frame.can_id)
        if name is not None:
            intermission_ns = INTERMISSION_BITS * TIMING.nominal_ns
            response_ns = event.time_ns + intermission_ns - event.queued_ns
            self._worst_ns[name] = max(self._worst_ns.get(name, 0), response_ns)

    @property
    def traffic(self) -> list[Traffic]:
        """Our messages and the others', as the analysis sees them."""
        ours = contract_traffic(TIMING, RIG_QUEUES)
        return ours + [filler.traffic(TIMING) for filler in self._fillers]

    def figures(self) -> dict[str, Any]:
        """What was asked for and what came: worst responses of our messages beside their bounds,
        in milliseconds, None where the worst case of all traffic is more than the bus can carry."""
        traffic = self.traffic
        bounds = worst_response_ns(traffic, self._order, TIMING.nominal_ns)
        return {
            "load_wanted": self._wanted,
            "load_worst_case": round(load(traffic), 4),
            "queue_order": self._order.value,
            "other_messages": len(self._fillers),
            "refused": sum(self._bus.refused(node) for node in range(CORES + NODES)),
            "worst_response_ms": {
                name: {"measured": worst_ns / 1e6, "bound": _ms(bounds[name])}
                for name, worst_ns in sorted(self._worst_ns.items())
            },
        }


def _ms(time_ns: int | None) -> float | None:
    return None if time_ns is None else time_ns / 1e6
