"""Delays of the sleeves: by a law with pressure, temperature and noise, or by the cylinder model.

    t = t_v + (t_mean - t_v) (p_nom / p_supply)^n k_T + noise

t_v: the valve's delay; t_mean: the sheet's delay plus this gear's own deviation; k_T = 1 + k (80
degC - T). The noise is normal, truncated by drawing again, as in preset `thesis` (6.2: 45 +- 5 ms).
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from meshpoint.gearbox.gears import MainGear
from meshpoint.gearbox.sheet import GearboxSheet
from meshpoint.rig_sim.parts.cylinder import CYLINDER_STEP_S, EVERY, Cylinder, travel
from meshpoint.rig_sim.truck.as_built import AsBuilt
from meshpoint.rig_sim.truck.strokes import SampledStroke
from meshpoint.units import MS, SECOND_US

LEAST_DELAY_SHARE: Final = 0.3
WARM_C: Final = 80.0
LEAST_GAUGE_PA: Final = 1e4


class CylinderTravel(NamedTuple):
    """A stroke of the cylinder model with the speed and force it has at contact."""

    stroke: SampledStroke
    speed_m_s: float
    force_n: float


class TruckDelays:
    """Draws the delays of all sleeves, in the order in which they are asked for."""

    def __init__(self, rng: np.random.Generator, sheet: GearboxSheet, built: AsBuilt) -> None:
        self._rng = rng
        self._sheet = sheet
        self._built = built
        self.sd_s = built["sleeve.noise_sd_ms"] * MS
        self._limit_s = built["sleeve.noise_limit_ms"] * MS
        self.has_cylinder = built["sleeve.model"] >= 0.5
        self.extra_s = 0.0
        """Added to every delay; set by the fault `valve_slow`."""

    def draw_s(self) -> float:
        """A delay at nominal pressure, for the splitter and range sleeves."""
        return self._sheet.sleeve.delay_s + self._noise_s() + self.extra_s

    def draw_gear_s(self, gear: MainGear, supply_gauge_pa: float) -> float:
        """From activation to contact with this gear, or from it to neutral, s."""
        actuator = self._sheet.sleeve
        drawn_s = self.mean_gear_s(gear, supply_gauge_pa) + self._noise_s() + self.extra_s
        return max(drawn_s, actuator.valve_delay_s + LEAST_DELAY_SHARE * actuator.delay_s)

    def mean_gear_s(self, gear: MainGear, supply_gauge_pa: float) -> float:
        """The same without noise, s."""
        actuator, built = self._sheet.sleeve, self._built
        mean_s = actuator.delay_s + built[f"sleeve.{gear.name.lower()}_delay_ms"] * MS
        colder_k = WARM_C - built["oil.temperature_c"]
        slower = 1.0 + built["sleeve.slower_per_k"] * colder_k
        pressure = self._sheet.air.supply_gauge_pa / max(supply_gauge_pa, LEAST_GAUGE_PA)
        travel_s = (mean_s - actuator.valve_delay_s) * slower
        travel_s *= pressure ** built["sleeve.pressure_exponent"]
        return float(actuator.valve_delay_s + travel_s)

    def force_n(self, supply_gauge_pa: float) -> float:
        """Force (N) on a sleeve at this supply pressure (Pa, gauge)."""
        share = max(supply_gauge_pa, 0.0) / self._sheet.air.supply_gauge_pa
        force_n: float = self._built["sleeve.force_n"] * share
        return force_n

    def air_share(self) -> float:
        """Share of the tank's air that a stroke takes."""
        return self._built["air.sleeve_cylinder_l"] / self._built["air.tank_l"]

    def cylinder(self, time_us: float, supply_gauge_pa: float) -> CylinderTravel:
        """A stroke by the cylinder's equations, for a valve activated now; the noise is in the
        valve's delay."""
        actuator, built = self._sheet.sleeve, self._built
        colder_k = WARM_C - built["oil.temperature_c"]
        friction_n = built["sleeve.friction_n"] * (1.0 + built["sleeve.slower_per_k"] * colder_k)
        cylinder = Cylinder(
            built["sleeve.area_cm2"] * 1e-4,
            built["sleeve.dead_volume_cm3"] * 1e-6,
            built["sleeve.conductance_m3_spa"],
            built["sleeve.mass_kg"],
            friction_n,
            built["sleeve.damping_nsm"],
            actuator.stroke_m,
        )
        atmosphere_pa = self._sheet.air.atmosphere_pa
        found = travel(
            cylinder, supply_gauge_pa + atmosphere_pa, atmosphere_pa, actuator.to_contact_m
        )
        delay_s = max(actuator.valve_delay_s + self._noise_s() + self.extra_s, 0.0)
        start_us = time_us + delay_s * SECOND_US
        stroke = SampledStroke(
            start_us,
            start_us + found.time_s * SECOND_US,
            actuator.to_contact_m,
            EVERY * CYLINDER_STEP_S * SECOND_US,
            found.samples_m,
        )
        return CylinderTravel(stroke, found.speed_m_s, found.force_n)

    def _noise_s(self) -> float:
        if self.sd_s == 0.0 or self._limit_s == 0.0:
            return 0.0
        while True:
            deviation_s = float(self._rng.normal(0.0, self.sd_s))
            if math.fabs(deviation_s) <= self._limit_s:
                return deviation_s
