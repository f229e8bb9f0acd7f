"""Edge arrays as the sensor side keeps and sends them, and the scale of the reference encoder."""

from __future__ import annotations

import struct
from typing import Final, NamedTuple

import numpy as np

from meshpoint.rig_sim.shared.angle_kernels import Floats, Integers, Stamps, read_ring
from meshpoint.rig_sim.shared.sensor_clock import SensorClock

RING: Final = 64

STAMPS: Final = 27

HEAD: Final = 4

ENCODER_SAMPLES_S: Final = (0.0, 0.002, 0.004, 0.006, 0.008)

ENCODER_STEPS_PER_TURN: Final = 1 << 24

ENCODER_MODULUS: Final = 1 << 32

_new: Final = tuple.__new__  # a NamedTuple without its constructor's argument handling


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
