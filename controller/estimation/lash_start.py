"""Where and how fast the main shaft is when a gear has come out, and how fast the vehicle."""

from __future__ import annotations

import math
from collections import deque
from typing import Final

import numpy as np

from meshpoint.controller.estimation.lash import LashStart, VehicleTrajectory
from meshpoint.controller.estimation.loaded_driveline import BehindState
from meshpoint.kernels.records import Vector
from meshpoint.units import US

FIT_US: Final = 300_000.0
"""The vehicle's trajectory is that about which the shaft has swung in gear for so long."""
LEAST_FIT_US: Final = 150_000.0
"""Over less than this its speed is the shaft's as the gear comes out."""
SWING_S: Final = 0.2
"""Memory of that swing."""
SWINGS_RAD: Final = np.geomspace(1e-3, 0.5, 12)
"""Standard deviations that it may have."""
CHANGE_S: Final = 0.33
"""While torque is taken away, the vehicle's acceleration changes within this by as much as hills
may make of it."""
EDGE_RAD: Final = 2.5e-3
"""Standard deviation of an edge: teeth may not be learned yet."""
BROAD: Final = 10.0
"""Speeds may be this many times as far off as swings leave them."""
KEPT_US: Final = 400_000.0
"""What a window in neutral has shown of the vehicle holds so long."""
HILL_SHARE: Final = 0.1
"""Standard deviation of the vehicle's acceleration so kept is at least this share of what hills may
make of it."""
FIRST_EDGES: Final = 12
"""A line through this many edges in neutral gives angle and speed at its start."""


class StartWatch:
    """Watches the edges up to a gear's coming out, and the first ones after it."""

    def __init__(self) -> None:
        self._in_gear: deque[tuple[float, float]] = deque()
        """The newest edge of each batch: time (us) and angle (rad)."""
        self._since_us = 0.0
        self._behind: BehindState | None = None
        self._vehicle: VehicleTrajectory | None = None
        self.waiting: Vector = np.empty((2, 0))
        """Edges since the gear came out, until they were enough."""

    def lose(self) -> None:
        """Edges were lost: nothing from before holds."""
        self._in_gear.clear()
        self._vehicle = None

    def take_in_gear(self, edges: Vector) -> None:
        """New edges (2, n) with a gear in mesh."""
        seen = self._in_gear
        seen.append((float(edges[0, -1]), float(edges[1, -1])))
        while seen[-1][0] - seen[0][0] > FIT_US:
            seen.popleft()

    def take_vehicle(self, vehicle: VehicleTrajectory) -> None:
        """A window in neutral has shown how the vehicle goes."""
        self._vehicle = vehicle

    def released(self, since_us: float, behind: BehindState | None = None) -> None:
        """A gear came out no later than this; behind: as in `LashStart`."""
        self._since_us, self._behind = since_us, behind
        self.waiting = np.empty((2, 0))

    def take_out(self, edges: Vector, vehicle_sds: tuple[float, float]) -> LashStart | None:
        """New edges since then; the start once they are enough. vehicle_sds: what is not known of
        the vehicle's speed (rad/s) and acceleration (rad/s2)."""
        after = edges[:, edges[0] > self._since_us]
        self.waiting = np.concatenate((self.waiting, after), axis=1)
        if self.waiting.shape[1] < FIRST_EDGES:
            return None
        waits = (self.waiting[0] - self._since_us) * US
        speed, angle = np.polyfit(waits, self.waiting[1], 1).tolist()
        before = np.array(self._in_gear).T.reshape(2, -1)
        before = before[:, before[0] <= self._since_us]
        kept, self._vehicle = self._vehicle, None
        self._in_gear.clear()
        start = LashStart(self._since_us, angle, speed, speed, behind=self._behind)
        if kept is not None and self._since_us - kept.time_us < KEPT_US:
            return _kept(start, kept, vehicle_sds)
        if before.shape[1] < 2 or before[0, -1] - before[0, 0] < LEAST_FIT_US:
            return start
        waits = (before[0] - self._since_us) * US
        (speed, hill), covariance = vehicle_trajectory(waits, before[1], vehicle_sds)
        return _with_vehicle(start, speed, hill, covariance)


def _kept(start: LashStart, vehicle: VehicleTrajectory, sds: tuple[float, float]) -> LashStart:
    """The start with the vehicle as a window in neutral has shown it."""
    if not (np.isfinite(vehicle[1:3]).all() and np.isfinite(vehicle.covariance).all()):
        return start
    vehicle = vehicle.at(start.time_us)
    covariance = vehicle.covariance + np.diag((sds[0], HILL_SHARE * sds[1])) ** 2
    return _with_vehicle(start, vehicle.speed_rad_s, vehicle.hill_rad_s2, covariance)


def _with_vehicle(
    start: LashStart, speed_rad_s: float, hill_rad_s2: float, covariance: Vector
) -> LashStart:
    root = np.asarray(np.linalg.cholesky(covariance), np.float64)
    return start._replace(vehicle_rad_s=speed_rad_s, hill_rad_s2=hill_rad_s2, vehicle_root=root)


def vehicle_trajectory(
    waits_s: Vector, angles_rad: Vector, sds: tuple[float, float]
) -> tuple[tuple[float, float], Vector]:
    """Speed (rad/s) and acceleration (rad/s2) of the vehicle at the time 0 of the waits, and their
    covariance, from the shaft's angles in gear.

    The vehicle's trajectory is one of the third degree, the shaft's swing about it a Gaussian
    process (Rasmussen and Williams 2006, 2.7: parametric basis functions; Matern's kernel of 3/2).
    How strong the swing is is not known: strengths are weighed by their likelihood."""
    speed_sd, hill_sd = sds
    apart = math.sqrt(3.0) * np.abs(waits_s[:, np.newaxis] - waits_s) / SWING_S
    swing, edge = (1.0 + apart) * np.exp(-apart), EDGE_RAD**2 * np.eye(waits_s.size)
    basis = np.stack([waits_s**k / math.factorial(k) for k in range(4)], axis=1)
    prior_sd = np.array((BROAD, BROAD * speed_sd, hill_sd, hill_sd / CHANGE_S))
    line = np.polyfit(waits_s, angles_rad, 1)
    off = angles_rad - np.polyval(line, waits_s)
    logs, means, spreads = np.empty(SWINGS_RAD.size), [], []
    for k, swing_rad in enumerate(SWINGS_RAD):
        noise = swing_rad**2 * swing + edge
        whole = np.linalg.cholesky(noise + (basis * prior_sd**2) @ basis.T)
        logs[k] = -0.5 * np.sum(np.linalg.solve(whole, off) ** 2) - np.sum(np.log(np.diag(whole)))
        weighed = np.linalg.solve(noise, basis)
        spread = np.linalg.inv(basis.T @ weighed + np.diag(prior_sd**-2.0))
        means.append((spread @ weighed.T @ off)[1:3])
        spreads.append(spread[1:3, 1:3])
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    mean = weights @ np.array(means)
    covariance = np.diag((speed_sd**2, 0.0))
    for weight, own, spread in zip(weights, means, spreads, strict=True):
        covariance += weight * (spread + np.outer(own - mean, own - mean))
    return (float(line[0] + mean[0]), float(mean[1])), covariance
