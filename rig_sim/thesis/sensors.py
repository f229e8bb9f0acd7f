"""The Hall sensors: exact edge times of the wheels, and what a 10 ms read of them holds.

Thesis 2.5 and 4.5: the signal sin(n theta) gives a rising edge where the wheel angle is a whole
number of pitches and a falling one a duty later; the capture timer counts microseconds.
"""

from __future__ import annotations

import math
from enum import IntEnum

from meshpoint.gearbox.wheels import SHAFT_OF_WHEEL, Wheels
from meshpoint.kernels.structures import RecordArray
from meshpoint.rig_sim.settings import SettingsError
from meshpoint.rig_sim.shared.angle_kernels import TAU, settled
from meshpoint.rig_sim.shared.angles import Angle
from meshpoint.rig_sim.shared.edge_ring import (
    ENCODER_MODULUS,
    ENCODER_SAMPLES_S,
    ENCODER_STEPS_PER_TURN,
    EdgeRead,
    RingReader,
)
from meshpoint.rig_sim.shared.sensor_clock import SensorClock
from meshpoint.rig_sim.thesis.closed_form import Piece, SensorWheels, capture_edges, motion_at
from meshpoint.rig_sim.thesis.plant import MotionSegment
from meshpoint.units import US


class Shaft(IntEnum):
    """The shafts in the order of the wire contract."""

    INPUT = 0
    LAYSHAFT = 1
    MAIN = 2
    PROPELLER = 3


class EdgeCapture:
    """The capture channels: rising and falling edges of the wheels."""

    def __init__(self, wheels: Wheels, angles: tuple[Angle, ...]) -> None:
        order = list(wheels.rows.values())
        if any(wheel.missing for wheel in order):
            raise SettingsError("preset thesis: wheels.*.missing, allowed are whole wheels only")
        offsets = [offset for wheel in order for offset in (0.0, wheel.duty_share)]
        self._wheels = RecordArray(
            SensorWheels(teeth=tuple(w.teeth for w in order), offsets=tuple(offsets))
        )
        self._captured = RecordArray(self._wheels.record.captured)
        self._piece = RecordArray(Piece())
        self._reader = RingReader()
        for edge, channel in enumerate(self._captured.record.channels):
            turns, rest = angles[SHAFT_OF_WHEEL[edge // 2]]
            teeth = order[edge // 2].teeth
            tooth = math.floor(rest * teeth / TAU - offsets[edge])
            channel.tooth = turns * teeth + tooth

    def add(self, segment: MotionSegment) -> None:
        """Find all edges of a segment."""
        piece = self._piece.record
        piece.start_us, piece.duration_s = segment.start_us, segment.duration_s
        piece.layshaft, piece.main = segment.layshaft.record, segment.main.record
        shafts = list(zip(segment.shares, segment.before, segment.after, strict=True))
        for wheel, shaft in zip(piece.wheels, SHAFT_OF_WHEEL, strict=True):
            wheel.share, before, after = shafts[shaft]
            wheel.turns, wheel.rest_rad = before
            wheel.end_turns, wheel.end_rest_rad = after
        capture_edges(self._piece.array, self._wheels.array)

    def read(self, now_us: int, clock: SensorClock) -> list[EdgeRead]:
        """The read of all channels now, in the order of the wire contract."""
        return self._reader.read(now_us, 0.0, clock, self._captured)


class Encoder:
    """The reference encoder: layshaft angle and speed at five instants before a read, exact."""

    def __init__(self) -> None:
        self._segments: list[MotionSegment] = []

    def add(self, segment: MotionSegment) -> None:
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
        turned, speed = motion_at(segment.layshaft.array[0], (time_us - segment.start_us) * US)
        return settled(turns, rest + turned), speed
