"""How a main shaft moves ahead on a driveline that swings: `swing_kernels` with its memory."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from meshpoint.controller.models.lash_trajectory import LashTrajectory
from meshpoint.controller.models.swing_kernels import (
    RATE,
    SWING_MODEL,
    swing_ahead,
    swing_outlook,
    swing_trajectories,
)
from meshpoint.kernels.records import RecordMemory, Vector
from meshpoint.units import US

OUTLOOK_US: Final = 10_000.0
"""What will be known is worked out at steps of this, in which some edges come."""


def ticks_over(step_us: float, count: int) -> int:
    """Ticks of `OUTLOOK_US` that this many steps of time lie between."""
    return 2 + int(step_us * max(1, count - 1) // OUTLOOK_US)


def between_ticks(found: Vector, step_us: float, count: int) -> Vector:
    """Values at equal steps of time from those at ticks of `OUTLOOK_US`; the last one holds on."""
    times_us = OUTLOOK_US * np.arange(found.size)
    return np.asarray(np.interp(step_us * np.arange(count), times_us, found))


class SwingRates(NamedTuple):
    """How the driveline swings; as in `swing_kernels.SwingModel`."""

    natural_rad_s: float
    decay_per_s: float
    noise_rad2_s3: float


class SwingMotion(RecordMemory):
    """A `swing_kernels.SwingModel`. It is not changed once it is made."""

    def __init__(self, white_rad2_s3: float, walk_rad2_s5: float, rates: SwingRates) -> None:
        super().__init__(SWING_MODEL)
        self.flat[:] = [white_rad2_s3, walk_rad2_s5, *rates]


class Swing(NamedTuple):
    """State and covariance of a main shaft that swings, and the model that they move by."""

    x: Vector
    p: Vector
    model: SwingMotion
    edge_rad2_s: float = 1e-6
    """Variance of an edge's angle times the time from edge to edge."""

    @property
    def speed_rad_s(self) -> float:
        """The part of the shaft's speed with which it swings."""
        return self.x.item(RATE)

    def ahead(self, wait_s: float) -> tuple[float, float]:
        """Angle and speed after a time."""
        found = np.empty((1, 2, 1))
        swing_trajectories(self.x, self.model.flat, np.array([wait_s]), 0.0, found)
        return found.item(0), found.item(1)

    def spread_ahead(self, wait_s: float) -> tuple[Vector, Vector]:
        """State and covariance after a time."""
        x, p = self.x.copy(), self.p.copy()
        swing_ahead(x, p, wait_s, self.model.flat)
        return x, p

    def theta_sd_ahead(self, wait_s: float) -> float:
        """Standard deviation of the angle after a time."""
        variance = self.spread_ahead(wait_s)[1].item(0, 0)
        return math.sqrt(variance) if variance > 0.0 else 0.0

    def outlook(self, horizon_s: float, tick_s: float, count: int) -> Vector:
        """Variances (rad2) of the angle predicted `horizon_s` ahead, now and after each further
        tick of edges."""
        found = np.empty(count)
        edges = np.array([horizon_s, tick_s, self.edge_rad2_s])
        swing_outlook(self.x, self.p, self.model.flat, edges, found)
        return found

    def trajectories(self, waits_s: Vector, step_s: float, found: Vector) -> None:
        """Angle and speed at equal steps of time, the first after each of `waits_s` (m,), to found
        (m, 2, n)."""
        swing_trajectories(self.x, self.model.flat, waits_s, step_s, found)


class ShaftState(NamedTuple):
    """Angle and speed at a time, with standard deviations."""

    time_us: float
    theta_rad: float
    omega_rad_s: float
    theta_sd_rad: float
    omega_sd_rad_s: float
    acceleration_rad_s2: float = 0.0
    """Without its swing. Zero where it is not estimated: speed held (4.16)."""
    swing: Swing | LashTrajectory | None = None
    """How it swings, where the estimator knows that."""

    def theta_at(self, time_us: float) -> float:
        """The angle at another time: the swing goes on; without one, acceleration held."""
        dt = (time_us - self.time_us) * US
        if self.swing is not None:
            return self.swing.ahead(dt)[0]
        return self.theta_rad + dt * (self.omega_rad_s + 0.5 * dt * self.acceleration_rad_s2)

    def omega_at(self, time_us: float) -> float:
        """The speed at another time: the swing goes on; without one, acceleration held."""
        dt = (time_us - self.time_us) * US
        if self.swing is not None:
            return self.swing.ahead(dt)[1]
        return self.omega_rad_s + dt * self.acceleration_rad_s2

    def steady_omega_at(self, time_us: float) -> float:
        """The speed at another time of a shaft that does not swing: that of the vehicle."""
        dt = (time_us - self.time_us) * US
        omega = self.omega_rad_s + dt * self.acceleration_rad_s2
        return omega if self.swing is None else omega - self.swing.speed_rad_s

    def theta_sd_at(self, time_us: float) -> float:
        """Standard deviation of the angle at another time."""
        dt = (time_us - self.time_us) * US
        if self.swing is not None:
            return self.swing.theta_sd_ahead(dt)
        return math.hypot(self.theta_sd_rad, self.omega_sd_rad_s * dt)

    def variances(self, first_us: float, step_us: float, count: int) -> Vector:
        """Variances (rad2) of the angle at equal steps of time, each as predicted by what will be
        known as long before it as now is before the first."""
        horizon_s = max(0.0, (first_us - self.time_us) * US)
        if self.swing is None:
            return np.full(count, self.theta_sd_at(first_us) ** 2)
        found = self.swing.outlook(horizon_s, OUTLOOK_US * US, ticks_over(step_us, count))
        return between_ticks(found, step_us, count)

    def trajectories(self, firsts_us: Sequence[float], step_us: float, count: int) -> Vector:
        """Angle and speed (m, 2, count) at equal steps of time, from each of m times on."""
        found, waits_us = np.empty((len(firsts_us), 2, count)), np.array(firsts_us) - self.time_us
        if self.swing is not None:
            self.swing.trajectories(waits_us * US, step_us * US, found)
            return found
        dt = (waits_us[:, np.newaxis] + step_us * np.arange(count)) * US
        speed, half = self.omega_rad_s, 0.5 * dt * self.acceleration_rad_s2
        found[:, 1] = speed + dt * self.acceleration_rad_s2
        found[:, 0] = self.theta_rad + dt * (speed + half)
        return found
