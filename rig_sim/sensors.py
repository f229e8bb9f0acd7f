"""The Hall sensors: exact edge times of the four wheels, and what a 10 ms read of them holds.

Thesis 2.5 and 4.5: the signal sin(n theta) gives a rising edge where the wheel angle is a whole
number of pitches and a falling one a duty later; the capture timer counts microseconds.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import Final, NamedTuple

import numpy as np

from gearbox.sheet import Wheels
from rig_sim.kernels import TAU, capture_edges, motion_at, read_ring, settled
from rig_sim.plant import US, Segment
from rig_sim.shafts import Angle

RING: Final = 64
STAMPS: Final = 27
ENCODER_SAMPLES_S: Final = (0.0, 0.002, 0.004, 0.006, 0.008)
ENCODER_STEPS_PER_TURN: Final = 1 << 24
ENCODER_MODULUS: Final = 1 << 32


class Shaft(IntEnum):
    """The shafts in the order of the wire contract."""

    INPUT = 0
    LAYSHAFT = 1
    MAIN = 2
    PROPELLER = 3


class EdgeRead(NamedTuple):
    """One channel's read: newest index, how many stamps hold, flags, 27 stamps newest first."""

    newest_index: int
    valid_stamps: int
    long_interval: bool
    stopped: bool
    stamps: tuple[int, ...]


class EdgeCapture:
    """Eight capture channels: rising and falling edges of four wheels."""

    def __init__(self, wheels: Wheels, angles: tuple[Angle, ...]) -> None:
        order = (wheels.input_, wheels.layshaft, wheels.main, wheels.propeller)
        channels = 2 * len(order)
        self._teeth = np.array([wheel.teeth for wheel in order], dtype=np.int64)
        self._offsets = np.array([offset for wheel in order for offset in (0.0, wheel.duty_share)])
        self._seen = np.zeros((channels, 2), dtype=np.int64)
        self._ring = np.zeros((channels, RING), dtype=np.int64)
        self._stamps = np.zeros((channels, STAMPS), dtype=np.int64)
        self._heads = np.zeros((channels, 4), dtype=np.int64)
        for channel in range(channels):
            turns, rest = angles[channel // 2]
            teeth = order[channel // 2].teeth
            tooth = math.floor(rest * teeth / TAU - self._offsets[channel])
            self._seen[channel, 0] = turns * teeth + tooth

    def add(self, segment: Segment) -> None:
        """Find all edges of a segment."""
        capture_edges(
            (segment.layshaft, segment.layshaft, segment.main, segment.main),
            segment.start_us,
            segment.duration_s,
            segment.shares,
            segment.before,
            segment.after,
            self._teeth,
            self._offsets,
            self._seen,
            self._ring,
        )

    def read(self, now_us: int, clock_start_us: int) -> list[EdgeRead]:
        """The read of all channels now, in the order of the wire contract."""
        read_ring(now_us, clock_start_us, self._seen, self._ring, self._stamps, self._heads)
        return [
            EdgeRead(index, valid, long == 1, stopped == 1, tuple(stamps))
            for (index, valid, long, stopped), stamps in zip(
                self._heads.tolist(), self._stamps.tolist(), strict=True
            )
        ]


class Encoder:
    """The reference encoder: layshaft angle and speed at five instants before a read, exact."""

    def __init__(self) -> None:
        self._segments: list[Segment] = []

    def add(self, segment: Segment) -> None:
        """Remember a segment until the next read."""
        self._segments.append(segment)

    def read(self, now_us: int) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Angles (rad, modulo 256 turns, in encoder steps) and speeds (rad/s), newest first.

        Instants before the first segment, at power-up, are continued backwards from it.
        """
        angles, speeds = [], []
        for back_s in ENCODER_SAMPLES_S:
            angle, speed = self._at(now_us - back_s / US)
            steps = angle[0] * ENCODER_STEPS_PER_TURN + round(
                angle[1] / TAU * ENCODER_STEPS_PER_TURN
            )
            angles.append(steps % ENCODER_MODULUS * (TAU / ENCODER_STEPS_PER_TURN))
            speeds.append(speed)
        del self._segments[:-1]
        return tuple(angles), tuple(speeds)

    def _at(self, time_us: float) -> tuple[Angle, float]:
        index = len(self._segments) - 1
        while index > 0 and time_us < self._segments[index].start_us:
            index -= 1
        segment = self._segments[index]
        turns, rest = segment.before[Shaft.LAYSHAFT]
        turned, speed = motion_at(segment.layshaft, (time_us - segment.start_us) * US)
        return settled(turns, rest + turned), speed
