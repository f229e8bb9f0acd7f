"""The Hall sensors: exact edge times of the four wheels, and what a 10 ms read of them holds.

Thesis 2.5 and 4.5: the signal sin(n theta) gives a rising edge where the wheel angle is a whole
number of pitches and a falling one a duty later; the capture timer counts microseconds.
"""

from __future__ import annotations

import math
import struct
from enum import IntEnum
from typing import Final, NamedTuple

import numpy as np

from gearbox.sheet import Wheels
from rig_sim.kernels import (
    TAU,
    Floats,
    Integers,
    Stamps,
    capture_edges,
    motion_at,
    read_ring,
    settled,
)
from rig_sim.plant import US, Segment
from rig_sim.sensor_clock import SensorClock
from rig_sim.shafts import Angle

RING: Final = 64
STAMPS: Final = 27
HEAD: Final = 4
ENCODER_SAMPLES_S: Final = (0.0, 0.002, 0.004, 0.006, 0.008)
ENCODER_STEPS_PER_TURN: Final = 1 << 24
ENCODER_MODULUS: Final = 1 << 32


_new: Final = tuple.__new__  # a NamedTuple without its constructor's argument handling


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


class RingReader:
    """Puts the newest edges of all channels into reads; its arrays are used again each time."""

    def __init__(self, channels: int) -> None:
        self._stamps: Stamps = np.zeros((channels, STAMPS), dtype=np.uint16)
        self._heads: Integers = np.zeros((channels, HEAD), dtype=np.int64)
        self._unpack_stamps = struct.Struct(f"={channels * STAMPS}H").unpack
        self._unpack_heads = struct.Struct(f"={channels * HEAD}q").unpack
        self._rows = [(HEAD * i, slice(STAMPS * i, STAMPS * (i + 1))) for i in range(channels)]

    def read(
        self, now_us: int, on_us: float, clock: SensorClock, counts: Integers, ring: Floats
    ) -> list[EdgeRead]:
        """The read of all channels now (`kernels.read_ring`)."""
        stamps_, heads_ = self._stamps, self._heads
        read_ring(float(now_us), on_us, clock.pieces, counts, ring, stamps_, heads_)
        stamps, heads = self._unpack_stamps(stamps_.data), self._unpack_heads(heads_.data)
        return [
            _new(
                EdgeRead,
                (heads[i], heads[i + 1], heads[i + 2] == 1, heads[i + 3] == 1, stamps[row]),
            )
            for i, row in self._rows
        ]


class EdgeCapture:
    """Eight capture channels: rising and falling edges of four wheels."""

    def __init__(self, wheels: Wheels, angles: tuple[Angle, ...]) -> None:
        order = (wheels.input_, wheels.layshaft, wheels.main, wheels.propeller)
        channels = 2 * len(order)
        self._teeth = np.array([wheel.teeth for wheel in order], dtype=np.int64)
        self._offsets = np.array([offset for wheel in order for offset in (0.0, wheel.duty_share)])
        self._seen = np.zeros((channels, 2), dtype=np.int64)
        self._ring = np.zeros((channels, RING))
        self._reader = RingReader(channels)
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

    def read(self, now_us: int, clock: SensorClock) -> list[EdgeRead]:
        """The read of all channels now, in the order of the wire contract."""
        return self._reader.read(now_us, 0.0, clock, self._seen[:, 1], self._ring)


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
