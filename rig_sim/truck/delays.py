"""Delays of the brake valve, of splitter and range, and of main sleeves that are a pure delay.

Those of sleeves are the sheet's (a main gear's with its own deviation) and a normal truncated by
drawing again, as in preset `thesis` (6.2: 45 +- 5 ms). The brake valve's scatters from stroke to
stroke, a normal cut at 2.5 standard deviations. Main sleeves as built: `sleeve_valves`.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from meshpoint.gearbox.gears import DogGear
from meshpoint.gearbox.sheet import GearboxSheet
from meshpoint.rig_sim.truck.as_built import AsBuilt
from meshpoint.units import MS

VALVE_STREAM: Final = 0x7A1
VALVE_LIMIT_SDS: Final = 2.5


class TruckDelays:
    """Draws the delays of all sleeves, in the order in which they are asked for."""

    def __init__(self, rng: np.random.Generator, sheet: GearboxSheet, built: AsBuilt) -> None:
        self._rng = rng
        self._sheet = sheet
        self._built = built
        self.sd_s = built["sleeve.noise_sd_ms"] * MS
        self.limit_s = built["sleeve.noise_limit_ms"] * MS
        self._valve_rng = np.random.Generator(np.random.PCG64([built.teeth_seed, VALVE_STREAM]))

    def draw_s(self) -> float:
        """A delay at nominal pressure, for the splitter and range sleeves."""
        return self._sheet.sleeve.delay_s + self.noise_s()

    def change_conditions(self, built: AsBuilt) -> None:
        """Another oil temperature."""
        self._built = built

    def brake_valve_s(self) -> float:
        """From a switch of the brake valve to the first change of pressure."""
        mean_s, sd_s = self._sheet.brake.valve_delay_s, self._built["air.valve_scatter_ms"] * MS
        if sd_s == 0.0:
            return mean_s
        deviation = float(self._valve_rng.standard_normal())
        while abs(deviation) > VALVE_LIMIT_SDS:
            deviation = float(self._valve_rng.standard_normal())
        return max(mean_s + sd_s * deviation, 0.0)

    def draw_gear_s(self, gear: DogGear) -> float:
        """From activation to contact with this gear, or from it to neutral, by a pure delay, s."""
        return self.mean_gear_s(gear) + self.noise_s()

    def mean_gear_s(self, gear: DogGear) -> float:
        """The same without noise, s."""
        return self._sheet.sleeve.delay_s + self._built[f"sleeve.{gear.name.lower()}_delay_ms"] * MS

    def air_share(self) -> float:
        """Share of the tank's air that a stroke takes."""
        return self._built["air.sleeve_cylinder_l"] / self._built["air.tank_l"]

    def noise_s(self) -> float:
        """Chance in one stroke or one switching of a valve, s."""
        if self.sd_s == 0.0 or self.limit_s == 0.0:
            return 0.0
        while True:
            deviation_s = float(self._rng.normal(0.0, self.sd_s))
            if math.fabs(deviation_s) <= self.limit_s:
                return deviation_s
