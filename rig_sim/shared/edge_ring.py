"""Edge arrays as the sensor side keeps and sends them, and the scale of the reference encoder."""

from __future__ import annotations

import struct
from typing import Final, NamedTuple

from meshpoint.kernels.structures import RecordArray
from meshpoint.rig_sim.shared.angle_kernels import read_ring
from meshpoint.rig_sim.shared.capture_records import CHANNELS, STAMPS, Captured, Reading
from meshpoint.rig_sim.shared.sensor_clock import SensorClock

HEAD_VALUES: Final = 4

ENCODER_SAMPLES_S: Final = (0.0, 0.002, 0.004, 0.006, 0.008)

ENCODER_STEPS_PER_TURN: Final = 1 << 24

ENCODER_MODULUS: Final = 1 << 32

_unpack: Final = struct.Struct(f"={CHANNELS * HEAD_VALUES}q{CHANNELS * STAMPS}H").unpack_from
"""All numbers of a `kernels.Reading` at once, faster than field by field."""

_STAMPS_FROM: Final = CHANNELS * HEAD_VALUES

_ROWS: Final = [
    (HEAD_VALUES * i, slice(_STAMPS_FROM + STAMPS * i, _STAMPS_FROM + STAMPS * (i + 1)))
    for i in range(CHANNELS)
]

_new: Final = tuple.__new__  # a NamedTuple without its constructor's argument handling


class EdgeRead(NamedTuple):
    """One channel's read: newest index, how many stamps hold, flags, 27 stamps newest first."""

    newest_index: int
    valid_stamps: int
    long_interval: bool
    stopped: bool
    stamps: tuple[int, ...]


class RingReader:
    """Puts the newest edges of all channels into reads; its memory is used again each time."""

    def __init__(self) -> None:
        self._reading = RecordArray(Reading())

    def read(
        self, now_us: int, on_us: float, clock: SensorClock, captured: RecordArray[Captured]
    ) -> list[EdgeRead]:
        """The read of all channels now (`kernels.read_ring`)."""
        reading = self._reading
        read_ring(float(now_us), on_us, clock.memory.array, captured.array, reading.array)
        values = _unpack(reading.record.raw())
        return [
            _new(
                EdgeRead,
                (values[i], values[i + 1], values[i + 2] == 1, values[i + 3] == 1, values[row]),
            )
            for i, row in _ROWS
        ]
