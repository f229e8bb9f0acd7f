"""Traffic of other nodes, drawn from a seed: what shares a truck's bus with ours.

Cyclic frames of other identifiers, classic ones of eight bytes and FD ones, at priorities from the
engine's to the body's, as many as are needed for the load that is asked for. Contents are random.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from meshpoint.bus.simulated.frame_bits import (
    INTERMISSION_BITS,
    BitTiming,
    WireFrame,
    arbitration_key,
    frame_bits,
    longest,
)
from meshpoint.bus.simulated.response_time import Traffic
from meshpoint.dbc.schema import SCHEMA

NODES: Final = 6
PERIODS_MS: Final = (10, 20, 20, 50, 50, 100, 100, 100, 250, 1000)
PRIORITIES: Final = (3, 4, 5, 6, 6, 6, 7)
LENGTHS: Final = (8, 16, 32, 64)
ADDRESSES: Final = range(0x10, 0x80)
"""Source addresses of other nodes: none of ours."""
JITTER_SHARE: Final = 0.1
"""Of its period, how much later than due a frame may come."""
SAMPLES: Final = 8
LEAST_LOAD: Final = 1e-4


@dataclass(frozen=True)
class Filler:
    """One cyclic message of another node."""

    node: int
    """0 to NODES - 1."""
    frame: WireFrame
    """Its first one; the others differ in their data."""
    period_ns: int
    phase_ns: int
    mean_ns: int
    """Mean length with the intermission."""

    @property
    def jitter_ns(self) -> int:
        """How late it may come."""
        return int(self.period_ns * JITTER_SHARE)

    def traffic(self, timing: BitTiming) -> Traffic:
        """As the response-time analysis sees it."""
        bits_ns = longest(self.frame).duration_ns(timing)
        return Traffic(
            f"other 0x{self.frame.can_id:08X}",
            arbitration_key(self.frame),
            f"other node {self.node}",
            bits_ns + INTERMISSION_BITS * timing.nominal_ns,
            self.period_ns,
            self.jitter_ns,
        )


def _generator(seed: int, stream: int) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64([seed, 0xB05, stream]))


def draw_filler(seed: int, load: float, timing: BitTiming) -> list[Filler]:
    """Messages that take this share of the bus together, to within a hundredth of it."""
    draw = _generator(seed, 0)
    taken = {spec.can_id for spec in SCHEMA.messages}
    found: list[Filler] = []
    left = load
    while left > LEAST_LOAD:
        frame = _draw_frame(draw, taken)
        mean_ns = _mean_ns(frame, draw, timing)
        period_ns = PERIODS_MS[draw.integers(len(PERIODS_MS))] * 1_000_000
        # The last one comes as often as is needed to hit the load.
        period_ns = max(period_ns, round(mean_ns / left))
        node, phase_ns = int(draw.integers(NODES)), int(draw.integers(period_ns))
        found.append(Filler(node, frame, period_ns, phase_ns, mean_ns))
        left -= mean_ns / period_ns
    return found


def _draw_frame(draw: np.random.Generator, taken: set[int]) -> WireFrame:
    """A frame with an identifier that nobody has yet."""
    while True:
        is_broadcast = draw.random() < 0.5
        group = 0xFF80 + int(draw.integers(0x80)) if is_broadcast else int(draw.integers(0xF000))
        priority = PRIORITIES[draw.integers(len(PRIORITIES))]
        can_id = priority << 26 | group << 8 | ADDRESSES[draw.integers(len(ADDRESSES))]
        if can_id not in taken:
            break
    taken.add(can_id)
    is_fd = draw.random() < 0.4
    length = LENGTHS[draw.integers(len(LENGTHS))] if is_fd else 8
    return WireFrame(can_id, draw.bytes(length), is_fd, bitrate_switch=is_fd)


def _mean_ns(frame: WireFrame, draw: np.random.Generator, timing: BitTiming) -> int:
    length = len(frame.data)
    lengths = [
        frame_bits(frame._replace(data=draw.bytes(length))).duration_ns(timing)
        for _ in range(SAMPLES)
    ]
    return sum(lengths) // SAMPLES + INTERMISSION_BITS * timing.nominal_ns


class FillerTraffic:
    """When which filler frame is handed to its node's queue; the same for the same seed."""

    def __init__(self, fillers: list[Filler], seed: int) -> None:
        self._draw = _generator(seed, 1)
        self._fillers = fillers
        self._counts = [0] * len(fillers)
        self._due_ns = [self._draw_due_ns(index) for index in range(len(fillers))]

    def _draw_due_ns(self, index: int) -> int:
        filler = self._fillers[index]
        due_ns = filler.phase_ns + self._counts[index] * filler.period_ns
        return due_ns + int(self._draw.integers(filler.jitter_ns + 1))

    @property
    def next_ns(self) -> int:
        """When the next one is due."""
        return min(self._due_ns)

    def take(self) -> tuple[int, WireFrame]:
        """The next one: its node and the frame."""
        index = self._due_ns.index(min(self._due_ns))
        filler = self._fillers[index]
        self._counts[index] += 1
        self._due_ns[index] = self._draw_due_ns(index)
        data = self._draw.bytes(len(filler.frame.data))
        return filler.node, filler.frame._replace(data=data)
