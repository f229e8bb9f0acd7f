"""Where and how fast the main shaft is when a gear has come out, and how fast the vehicle."""

from __future__ import annotations

from typing import Final

import numpy as np

from meshpoint.controller.estimate.lash import LashStart, VehicleTrajectory
from meshpoint.controller.estimate.loaded_driveline import BehindState
from meshpoint.kernels.records import Vector
from meshpoint.units import US

KEPT_US: Final = 400_000.0
"""What a window in neutral has shown of the vehicle holds so long."""
HILL_SHARE: Final = 0.1
"""Standard deviation of the vehicle's acceleration so kept is at least this share of what hills may
make of it."""
FIRST_EDGES: Final = 12
"""A line through this many edges in neutral gives angle and speed at its start."""


class StartWatch:
    """Waits for the first edges after a gear's coming out."""

    def __init__(self) -> None:
        self._since_us = 0.0
        self._behind: BehindState | None = None
        self._vehicle: VehicleTrajectory | None = None
        self.waiting: Vector = np.empty((2, 0))
        """Edges since the gear came out, until they were enough."""

    def lose(self) -> None:
        """Edges were lost: nothing from before holds."""
        self._vehicle = None

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
        kept, self._vehicle = self._vehicle, None
        start = LashStart(self._since_us, angle, speed, speed, behind=self._behind)
        if kept is not None and self._since_us - kept.time_us < KEPT_US:
            return _kept(start, kept, vehicle_sds)
        return start


def _kept(start: LashStart, vehicle: VehicleTrajectory, sds: tuple[float, float]) -> LashStart:
    """The start with the vehicle as a window in neutral has shown it."""
    if not (np.isfinite(vehicle[1:3]).all() and np.isfinite(vehicle.covariance).all()):
        return start
    vehicle = vehicle.at(start.time_us)
    covariance = vehicle.covariance + np.diag((sds[0], HILL_SHARE * sds[1])) ** 2
    root = np.asarray(np.linalg.cholesky(covariance), np.float64)
    return start._replace(
        vehicle_rad_s=vehicle.speed_rad_s, hill_rad_s2=vehicle.hill_rad_s2, vehicle_root=root
    )
