"""Constant-speed estimation: for the main shaft (thesis 4.16), and for any shaft to which the
layshaft's model does not apply at the time."""

from __future__ import annotations

import math

import numpy as np

from meshpoint.controller.measure.wheel_edges import EdgeBatch
from meshpoint.controller.models.swing import ShaftState
from meshpoint.controller.models.thesis import CRUISE_FILTER, cruise_filter
from meshpoint.controller.settings.settings import CruiseFilterTuning
from meshpoint.kernels.records import RecordMemory
from meshpoint.units import US

SPEED_WINDOW_US = 10_000
"""The production speed's window: one read of the arrays (thesis 2.5)."""
ESTIMATE_STALE_US = 60_000
"""An angle extrapolated for longer than this may be off by more than a tooth gap allows."""


class WindowSpeed:
    """The production speed: teeth in the last 10 ms over the time they took, held until the next.

    The window runs from the newest edge at least 10 ms old to the newest edge of all."""

    def __init__(self) -> None:
        self._times: list[float] = []
        self._angles: list[float] = []
        self.omega_rad_s: float | None = None

    def edges(self, batch: EdgeBatch) -> None:
        """Takes new edges, in order of time, and computes the speed again if there are any."""
        if not batch.time_us.size:
            return
        self._times += batch.time_us.tolist()
        self._angles += batch.theta_rad.tolist()
        start = self._times[-1] - SPEED_WINDOW_US
        keep = next((i for i, t in enumerate(self._times) if t > start), len(self._times) - 1)
        keep = max(0, keep - 1)
        del self._times[:keep], self._angles[:keep]
        if len(self._times) > 1:
            turned = self._angles[-1] - self._angles[0]
            self.omega_rad_s = turned / ((self._times[-1] - self._times[0]) * US)

    def restart(self) -> None:
        """Forgets all edges."""
        self._times, self._angles, self.omega_rad_s = [], [], None

    @property
    def newest(self) -> tuple[float, float] | None:
        """Time and angle of the newest edge."""
        return (self._times[-1], self._angles[-1]) if self._times else None


class _CruiseMemory(RecordMemory):
    """State and parameters of the filter."""

    def _name_parts(self) -> None:
        self.time_us, self.x, self.p = self.part("time_us"), self.part("x"), self.part("p")


class CruiseTracker:
    """Angle and speed of a shaft whose speed changes little, by a Kalman filter on its edges."""

    def __init__(self, tuning: CruiseFilterTuning, pitch_rad: float) -> None:
        self._tuning = tuning
        self._pitch_rad = pitch_rad
        self._filter = _CruiseMemory(CRUISE_FILTER)
        self._filter.part("acceleration_rad_s2")[0] = tuning.acceleration_rad_s2
        self._filter.part("edge_time_s")[0] = tuning.edge_time_us * US
        self._seed = WindowSpeed()
        self._running = False

    def lose_speed(self) -> None:
        """Starts anew with the edges to come; teeth keep their numbers."""
        self.restart()

    def restart(self) -> None:
        """Starts anew from the edges to come; after a jump in speed or lost teeth."""
        self._running = False
        self._seed.restart()

    def edges(self, batch: EdgeBatch) -> None:
        """Takes new edges in order of time."""
        if not batch.time_us.size:
            return
        if not self._running:
            self._start(batch)
            return
        cruise_filter(self._filter.flat, batch.time_us, batch.theta_rad)

    def _start(self, batch: EdgeBatch) -> None:
        self._seed.edges(batch)
        newest = self._seed.newest
        if self._seed.omega_rad_s is None or newest is None:
            return
        memory = self._filter
        memory.time_us[0] = newest[0]
        memory.x[:] = newest[1], self._seed.omega_rad_s
        speed_sd = 0.05 * abs(self._seed.omega_rad_s) + 1.0
        memory.p[:] = np.diag([(0.1 * self._pitch_rad) ** 2, speed_sd**2])
        self._running = True

    def at(self, time_us: float) -> ShaftState | None:
        """The state at a time, speed held; None before enough edges, or without any for 60 ms."""
        memory = self._filter
        newest_us = memory.time_us.item()
        if not self._running or abs(time_us - newest_us) > ESTIMATE_STALE_US:
            return None
        dt = (time_us - newest_us) * US
        theta, omega = memory.x.tolist()
        (p00, p01), (_, p11) = memory.p.tolist()
        q = self._tuning.acceleration_rad_s2 * dt
        theta_var = p00 + dt * (2.0 * p01 + dt * p11) + 0.25 * (q * dt) ** 2
        return ShaftState(
            time_us,
            theta + omega * dt,
            omega,
            math.sqrt(max(0.0, theta_var)),
            math.sqrt(max(0.0, p11 + q * q)),
        )
