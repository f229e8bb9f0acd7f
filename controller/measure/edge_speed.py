"""The speed of a shaft straight from one edge frame: teeth over the time they took.

It uses no filter, no model and no tooth numbers, so errors of the estimators do not affect it. The
sequence checks with it whether two shafts turn together. The guard measures speeds by itself
(`guard/own_speed`).
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from meshpoint.controller.measure.chain_kernels import STAMPS, newest_teeth, pack_stamps
from meshpoint.controller.measure.wheel_edges import EdgeFrame
from meshpoint.dbc.sensor_time import HALF, WRAP
from meshpoint.kernels.records import Integers

DEAD_US: Final = 20_000
"""If the newest edge of a frame is older than this, and older than three teeth took before, the
sensor has failed. Read, bus and tick included, this is detected within 50 ms."""
SPEED_STALE_US: Final = 25_000
"""The same limit when no frame arrives, for the newest edge of the last frame: two frames may be
lost without losing the speed."""
TEETH_LATE: Final = 3
SPEED_HELD_US: Final = 45_000
"""While frames hold a tooth too many or too few, the last speed stays valid for this long."""
LOW: Final = 0xFFFF
_new: Final = tuple.__new__  # a NamedTuple without its constructor's argument handling


class Speed(NamedTuple):
    """A mean speed, and the middle of the interval it was measured over (sensor clock, us)."""

    time_us: int
    omega_rad_s: float


class Turned(NamedTuple):
    """Number of teeth passed until the newest edge, and the time (us) of that edge."""

    time_us: int
    teeth: int


class EdgeSpeed:
    """One shaft's wheel by its rising edges."""

    def __init__(self, teeth: int) -> None:
        self._pitch_rad = 2.0 * math.pi / teeth
        self._speed: Speed | None = None
        self._measured_us = 0
        self._is_dead = False
        self._interval_us = 0
        self._index = 0
        self._low: Integers = np.zeros(STAMPS, np.int64)
        self._newest_us: int | None = None
        self._teeth = 0

    def take(self, frame: EdgeFrame, now_us: int) -> None:
        """One frame, read shortly before `now_us` of the sensor clock."""
        if frame.sensor_fault or frame.stopped or frame.long_interval or frame.valid_stamps < 2:
            self._speed = None
            return
        read_us = now_us + ((frame.read_time_us - now_us + HALF) % WRAP) - HALF
        stamps = frame.timestamp_low_us
        newest_us = read_us - ((read_us - stamps[0]) & LOW)
        fresh = (frame.newest_index - self._index) & LOW
        if fresh == 0 and self._newest_us is not None:
            newest_us = self._newest_us  # no new edge, however young its 16 bits make it look
        self._teeth += fresh
        self._index = frame.newest_index
        self._newest_us = newest_us
        self._is_dead = read_us - newest_us > max(DEAD_US, TEETH_LATE * self._interval_us)
        pack_stamps(self._low.data, 0, *stamps)
        span_us, teeth = newest_teeth(self._low, frame.valid_stamps)
        if teeth:
            self._interval_us = span_us // teeth
            omega = teeth * self._pitch_rad / (span_us * 1e-6)
            self._speed = _new(Speed, (newest_us - span_us // 2, omega))
            self._measured_us = newest_us

    @property
    def turned(self) -> Turned | None:
        """Running count of teeth; None before the first edge."""
        return None if self._newest_us is None else Turned(self._newest_us, self._teeth)

    def at(self, now_us: int) -> Speed | None:
        """The newest speed; None if there is none, or if edges have stopped coming."""
        newest_us = self._newest_us
        if self._speed is None or newest_us is None or self._is_dead:
            return None
        limit_us = max(SPEED_STALE_US, TEETH_LATE * self._interval_us)
        is_turning = now_us - newest_us <= limit_us
        is_measured = now_us - self._measured_us <= max(SPEED_HELD_US, limit_us)
        return self._speed if is_turning and is_measured else None
