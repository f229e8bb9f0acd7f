"""A CAN bus in virtual time: one frame at a time, lowest identifier first, each its real length.

Durations are those of a 500 kbit/s arbitration and 2 Mbit/s data phase with average bit stuffing,
so a burst of eight edge frames takes 2.6 ms here as on the wire.
"""

from __future__ import annotations

import math
from collections import deque
from functools import cache
from typing import Final

from meshpoint.dbc.frame import Frame

NOMINAL_BIT_US: Final = 2.0
DATA_BIT_US: Final = 0.5
STUFFING: Final = 1.1
"""Average share of stuff bits; the worst case is 1.25."""
FD_HEADER_BITS: Final = 32 + 3
"""Start, 29-bit identifier with its SRR and IDE, and up to the bit rate switch (ISO 11898-1)."""
FD_TAIL_BITS: Final = 12
"""CRC delimiter, acknowledge, end of frame and intermission at the nominal rate."""
FD_DATA_OVERHEAD_BITS: Final = 5 + 4 + 26
"""ESI and length, stuff count, CRC-21 with its fixed stuff bits."""
CLASSIC_OVERHEAD_BITS: Final = 54 + 12
"""Everything of a classic extended frame that is not data."""


IDLE: Final = math.inf


@cache
def duration_us(length: int, is_fd: bool) -> int:
    """How long a frame occupies the bus."""
    if not is_fd:
        return round((CLASSIC_OVERHEAD_BITS + 8 * length) * STUFFING * NOMINAL_BIT_US)
    nominal = (FD_HEADER_BITS * STUFFING + FD_TAIL_BITS) * NOMINAL_BIT_US
    data = (FD_DATA_OVERHEAD_BITS + 8 * length * STUFFING) * DATA_BIT_US
    return round(nominal + data)


Waiting = tuple[int, int, int, Frame]
"""A frame in a node's queue: its key, of which the lowest wins the bus, how long it occupies the
bus in us, its sender, the frame. A plain tuple: two thousand are made each second of bus time."""


class VirtualBus:
    """Each node's frames waiting for the bus, and the one on it.

    A node's own frames leave in the order given, as from a SocketCAN interface's queue; between
    nodes the lowest identifier wins. `next_us` is when the frame on the bus is through, infinite
    while the bus is idle."""

    def __init__(self) -> None:
        self._queues: dict[int, deque[Waiting]] = {}
        self._on_bus: Waiting | None = None
        self._free_us = 0
        self.next_us: float = IDLE
        self.busy_us = 0

    def send(self, sender: int, frames: list[Frame], now_us: int) -> None:
        """A node hands over frames at `now_us`; they leave it in this order."""
        if not frames:
            return
        queue = self._queues.get(sender)
        if queue is None:
            queue = self._queues[sender] = deque()
        for frame in frames:
            can_id, data, is_fd, is_extended = frame
            # Standard identifiers win over extended ones that begin alike.
            key = 2 * can_id + 1 if is_extended else can_id << 19
            queue.append((key, duration_us(len(data), is_fd), sender, frame))
        if self._on_bus is None:
            self._start(max(now_us, self._free_us))

    def _start(self, at_us: int) -> None:
        """Arbitration between the first waiting frames of all nodes, if there are any."""
        first: deque[Waiting] | None = None
        for queue in self._queues.values():
            if queue and (first is None or queue[0][0] < first[0][0]):
                first = queue
        if first is None:
            self._on_bus, self.next_us = None, IDLE
            return
        self._on_bus = waiting = first.popleft()
        self.busy_us += waiting[1]
        self._free_us = self.next_us = at_us + waiting[1]

    @property
    def on_bus(self) -> tuple[int, Frame]:
        """Sender and frame that is on the bus. Call where `next_us` is finite."""
        if self._on_bus is None:
            raise RuntimeError("take from an idle bus")
        return self._on_bus[2:]

    def take(self) -> tuple[int, Frame]:
        """Sender and frame that is through now; the next one starts. Call at `next_us`."""
        through = self.on_bus
        self._start(self._free_us)
        return through
