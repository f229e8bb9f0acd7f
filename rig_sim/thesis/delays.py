"""Sleeve delays of the preset `thesis`: drawn from the data sheet alone."""

from __future__ import annotations

import numpy as np

from meshpoint.gearbox.sheet import GearboxSheet


class Delays:
    """Delay from a sleeve valve's activation to contact: normal, cut by drawing again."""

    def __init__(self, rng: np.random.Generator, sheet: GearboxSheet) -> None:
        self._rng = rng
        self._actuator = sheet.sleeve

    def draw_s(self) -> float:
        """The next delay, s."""
        actuator = self._actuator
        if actuator.delay_sd_s == 0.0 or actuator.delay_limit_s == 0.0:
            return actuator.delay_s
        while True:
            deviation_s = float(self._rng.normal(0.0, actuator.delay_sd_s))
            if abs(deviation_s) <= actuator.delay_limit_s:
                return actuator.delay_s + deviation_s
