"""Where and how fast the main shaft is when a gear has come out, and how fast the vehicle."""

from __future__ import annotations

from collections import deque
from typing import Final

import numpy as np

from meshpoint.controller.estimation.lash_cloud import LashStart
from meshpoint.controller.records import Vector
from meshpoint.units import US

MEAN_US: Final = 250_000.0
"""The vehicle's speed is the shaft's mean over the last so long in gear: over some swings."""
LEAST_MEAN_US: Final = 50_000.0
"""Over less than this it is the shaft's speed as the gear comes out."""
KEPT_US: Final = 400_000.0
"""What a window in neutral has told of the vehicle holds so long."""
FIRST_EDGES: Final = 12
"""A line through so many edges in neutral gives angle and speed at its start."""


class StartWatch:
    """Watches the edges up to a gear's coming out, and the first ones after it."""

    def __init__(self) -> None:
        self._in_gear: deque[tuple[float, float]] = deque()
        """The newest edge of each batch: time (us) and angle (rad)."""
        self._since_us = 0.0
        self._vehicle: tuple[float, float] | None = None
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
        while seen[-1][0] - seen[0][0] > MEAN_US:
            seen.popleft()

    def take_vehicle(self, time_us: float, speed_rad_s: float) -> None:
        """A window in neutral has told the vehicle's speed, at the main shaft."""
        self._vehicle = (time_us, speed_rad_s)

    def released(self, since_us: float) -> None:
        """A gear came out no later than this."""
        self._since_us = since_us
        self.waiting = np.empty((2, 0))

    def take_out(self, edges: Vector) -> LashStart | None:
        """New edges since then; the start once they are enough."""
        after = edges[:, edges[0] > self._since_us]
        self.waiting = np.concatenate((self.waiting, after), axis=1)
        if self.waiting.shape[1] < FIRST_EDGES:
            return None
        waits = (self.waiting[0] - self._since_us) * US
        speed, angle = np.polyfit(waits, self.waiting[1], 1).tolist()
        vehicle = self._vehicle_rad_s(speed)
        self._in_gear.clear()
        self._vehicle = None
        return LashStart(self._since_us, angle, speed, vehicle)

    def _vehicle_rad_s(self, speed_rad_s: float) -> float:
        if self._vehicle is not None and self._since_us - self._vehicle[0] < KEPT_US:
            return self._vehicle[1]
        seen = self._in_gear
        if len(seen) < 2 or seen[-1][0] - seen[0][0] < LEAST_MEAN_US:
            return speed_rad_s
        (first_us, first), (last_us, last) = seen[0], seen[-1]
        return (last - first) / ((last_us - first_us) * US)
