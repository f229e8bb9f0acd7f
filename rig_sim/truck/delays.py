"""Delays of the sleeves: by a law with pressure, temperature and noise, or by the cylinder model.

    t = t_v + (t_mean - t_v) (p_nom / p_supply)^n k_T + noise + t_s (1 - exp(-rest / tau_s))

t_v: the valve's delay; t_mean: the sheet's delay plus this gear's own deviation; k_T = 1 + k (80
degC - T). The noise is normal, truncated by drawing again, as in preset `thesis` (6.2: 45 +- 5 ms);
a gear's strokes may go together, x_n = c x_n-1 + sqrt(1 - c^2) z. A sleeve that has rested sticks.
The brake valve's delay scatters from stroke to stroke, a normal cut at 2.5 standard deviations.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from meshpoint.gearbox.gears import SLEEVE_OF_MAIN, MainGear, Sleeve
from meshpoint.gearbox.sheet import GearboxSheet
from meshpoint.rig_sim.parts.cylinder import CYLINDER_STEP_S, EVERY, Cylinder, travel
from meshpoint.rig_sim.truck.as_built import AsBuilt
from meshpoint.rig_sim.truck.strokes import SampledStroke
from meshpoint.units import MS, SECOND_US

LEAST_DELAY_SHARE: Final = 0.3
VALVE_STREAM: Final = 0x7A1
VALVE_LIMIT_SDS: Final = 2.5
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
        self._correlation = built["sleeve.correlation"]
        self._last_s: dict[MainGear, float] = {}
        """Noise of each gear's last stroke."""
        self._moved_us: dict[Sleeve, float] = {}
        """When each sleeve began its last stroke."""
        self._valve_rng = np.random.Generator(np.random.PCG64([built.teeth_seed, VALVE_STREAM]))
        self.extra_s = 0.0
        """Added to every delay; set by the fault `valve_slow`."""

    def draw_s(self) -> float:
        """A delay at nominal pressure, for the splitter and range sleeves."""
        return self._sheet.sleeve.delay_s + self._noise_s() + self.extra_s

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

    def draw_gear_s(
        self, gear: MainGear, supply_gauge_pa: float, time_us: float = math.inf
    ) -> float:
        """From activation, at `time_us`, to contact with this gear, or from it to neutral, s."""
        actuator = self._sheet.sleeve
        drawn_s = self.mean_gear_s(gear, supply_gauge_pa) + self.stiction_s(gear, time_us)
        drawn_s += self._gear_noise_s(gear) + self.extra_s
        self._moved_us[SLEEVE_OF_MAIN[gear].sleeve] = time_us
        return max(drawn_s, actuator.valve_delay_s + LEAST_DELAY_SHARE * actuator.delay_s)

    def expected_s(
        self, gear: MainGear, supply_gauge_pa: float, time_us: float
    ) -> tuple[float, float]:
        """Mean and standard deviation of what `draw_gear_s` would draw, with all that is known of
        the strokes before, s."""
        mean_s = self.mean_gear_s(gear, supply_gauge_pa) + self.stiction_s(gear, time_us)
        share = self._correlation
        sd_s = self.sd_s if share == 0.0 else self.sd_s * math.sqrt(1.0 - share * share)
        return mean_s + share * self._last_s.get(gear, 0.0), sd_s

    def stiction_s(self, gear: MainGear, time_us: float) -> float:
        """What the sleeve's rest up to this instant adds, s."""
        most_s = self._built["sleeve.stiction_ms"] * MS
        moved_us = self._moved_us.get(SLEEVE_OF_MAIN[gear].sleeve)
        if most_s == 0.0 or moved_us is None:
            return most_s
        rest_s = max(time_us - moved_us, 0.0) / SECOND_US
        return -most_s * math.expm1(-rest_s / self._built["sleeve.stiction_s"])

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

    def _gear_noise_s(self, gear: MainGear) -> float:
        """Noise that goes together with that of the gear's last stroke, within the same limit."""
        share, last_s = self._correlation, self._last_s.get(gear)
        if share == 0.0:
            return self._noise_s()
        while True:
            deviation_s = self._noise_s()
            if last_s is not None:
                deviation_s = share * last_s + math.sqrt(1.0 - share * share) * deviation_s
            if abs(deviation_s) <= self._limit_s:
                self._last_s[gear] = deviation_s
                return deviation_s

    def _noise_s(self) -> float:
        if self.sd_s == 0.0 or self._limit_s == 0.0:
            return 0.0
        while True:
            deviation_s = float(self._rng.normal(0.0, self.sd_s))
            if math.fabs(deviation_s) <= self._limit_s:
                return deviation_s
