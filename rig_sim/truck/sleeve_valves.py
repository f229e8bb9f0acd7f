"""The 3/2 valves of the sleeves with dog teeth, and their cylinders, from stroke to stroke.

A valve's spool follows its coil late, on and off by delays of their own:

    t = t_v + d + x_n + t_s (1 - exp(-rest / tau_s)),   x_n = c x_n-1 + sqrt(1 - c^2) z

t_v the sheet's, d this valve's own, z a normal cut at the limit, t_s what its seals stick after a
long rest; off, chance has no memory and nothing sticks. What a valve feeds and vents with is found
from its gear's delay: the conductance with which a single stroke from neutral, at the sheet's
supply, 80 degC and without a rest before, takes the sheet's delay and the deviation drawn for that
gear.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

import numpy as np

from meshpoint.gearbox.gears import SIDE_OF, DogGear, Sleeve, SplitGear
from meshpoint.gearbox.sheet import GearboxSheet
from meshpoint.rig_sim.parts.cylinder import Cylinder
from meshpoint.rig_sim.shared.engagement import DOG_OF_VALVE, GEAR_AT, VALVE_OF_DOG
from meshpoint.rig_sim.shared.valve_drivers import Valve
from meshpoint.rig_sim.truck.as_built import AsBuilt
from meshpoint.rig_sim.truck.axial_motion import stroke_s
from meshpoint.rig_sim.truck.delays import TruckDelays
from meshpoint.units import MM, MS, SECOND_US

VALVE_STREAM: Final = 0x51E
WARM_C: Final = 80.0
LEAST_M3_SPA, MOST_M3_SPA = 2e-10, 1e-7
"""Between these a valve is looked for: with more the chambers would be too fast for the steps."""
HALVINGS: Final = 26
_DELAY_LIKE: Final[dict[DogGear, str]] = {
    **{gear: gear.name.lower() for gear in SIDE_OF if not isinstance(gear, SplitGear)},
    SplitGear.LOW_SPLIT: "third",
    SplitGear.HIGH_SPLIT: "crawl",
}
"""Whose drawn deviation a stroke has. Those of the splitter are drawn with those of the other ends
of a main sleeve: a gearbox of a seed stays what it was."""


class SleeveValves:
    """Delays of the four valves, and the cylinders between them."""

    def __init__(self, delays: TruckDelays, sheet: GearboxSheet, built: AsBuilt) -> None:
        self._delays = delays
        self._sheet = sheet
        self._built = built
        self._correlation = built["sleeve.correlation"]
        self._last_s: dict[Valve, float] = {}
        own = np.random.Generator(np.random.PCG64([built.teeth_seed, VALVE_STREAM]))
        self._own_s = {
            (valve, on): float(own.uniform(-1.0, 1.0)) * built[f"sleeve.valve_{name}_ms"] * MS
            for valve, gear in DOG_OF_VALVE.items()
            if gear in sheet.dog_gears
            for on, name in ((True, "on"), (False, "off"))
        }
        self._moved_us: dict[Valve, float] = {}
        """When each valve was last switched."""
        names = dict.fromkeys(SIDE_OF[gear].sleeve for gear in sorted(sheet.dog_gears, key=_order))
        self.cylinders = {name: self._cylinder(name) for name in names}
        """Of each sleeve with dog teeth, in neutral, in oil of 80 degC; to be copied."""

    def change_conditions(self, built: AsBuilt) -> None:
        """Another oil temperature."""
        self._built = built

    def mean_s(self, valve: Valve, on: bool) -> float:
        """From the coil to the spool, without chance."""
        return max(self._sheet.sleeve.valve_delay_s + self._own_s[valve, on], 0.0)

    def draw_s(self, valve: Valve, on: bool, time_us: float) -> float:
        """The same of this stroke, after the valve's rest up to this instant."""
        chance_s = self._delays.noise_s()
        if on and self._correlation:
            chance_s = self._remembered_s(valve, chance_s)
        sticks_s = self._sticks_s(valve, time_us) if on else 0.0
        self._moved_us[valve] = time_us
        return max(self.mean_s(valve, on) + sticks_s + chance_s, 0.0)

    def expected_s(self, valve: Valve, time_us: float) -> tuple[float, float]:
        """Mean and standard deviation of what `draw_s` would draw on, knowing its strokes."""
        share = self._correlation
        mean_s = self.mean_s(valve, True) + self._sticks_s(valve, time_us)
        sd_s = self._delays.sd_s * math.sqrt(1.0 - share * share)
        return mean_s + share * self._last_s.get(valve, 0.0), sd_s

    def _cylinder(self, name: Sleeve) -> Cylinder:
        """As built, its valves as wide as their gears' delays need."""
        built, actuator, air = self._built, self._sheet.sleeve, self._sheet.air
        c = Cylinder()
        c.area_m2 = built["sleeve.area_cm2"] * 1e-4
        c.dead_m3 = built["sleeve.dead_volume_cm3"] * 1e-6
        c.mass_kg = built["sleeve.mass_kg"]
        c.stroke_m = c.high_m = actuator.stroke_m
        c.low_m = -actuator.stroke_m
        c.neutral_n, c.end_n = built["sleeve.neutral_detent_n"], built["sleeve.end_detent_n"]
        c.detent_m = min(built["sleeve.detent_mm"] * MM, 0.8 * actuator.to_contact_m)
        c.atmosphere_pa = air.atmosphere_pa
        c.supply_pa = air.supply_gauge_pa + air.atmosphere_pa
        self._set_friction(c, 1.0)
        travels_s = [self._travel_s(name, side) for side in (1, -1)]
        vent = built["sleeve.vent_factor"]

        def both(conductance: float) -> None:
            c.a_fill_m3_spa = c.b_fill_m3_spa = conductance
            c.a_vent_m3_spa = c.b_vent_m3_spa = vent * conductance

        def feeds_a(conductance: float) -> None:
            c.a_fill_m3_spa = conductance

        def feeds_b(conductance: float) -> None:
            c.b_fill_m3_spa = conductance

        contact_m = actuator.to_contact_m
        _solve(both, lambda: stroke_s(c, contact_m), sum(travels_s) / 2.0)
        _solve(feeds_a, lambda: stroke_s(c, contact_m), travels_s[0])
        _solve(feeds_b, lambda: stroke_s(c, -contact_m), travels_s[1])
        return c

    def stroke_s(self, gear: DogGear, supply_pa: float) -> float:
        """From the spool to contact, by a single stroke from neutral at this absolute pressure of
        the tank; infinite where the sleeve never gets there."""
        where = SIDE_OF[gear]
        cylinder = self.cylinders[where.sleeve].copy()
        cylinder.supply_pa = supply_pa
        self.set_friction(cylinder)
        return stroke_s(cylinder, where.direction * self._sheet.sleeve.to_contact_m)

    def set_friction(self, c: Cylinder) -> None:
        """Friction and damping in the oil as it is."""
        built = self._built
        colder_k = WARM_C - built["oil.temperature_c"]
        self._set_friction(c, max(1.0 + built["sleeve.thicker_per_k"] * colder_k, 0.0))

    def _set_friction(self, c: Cylinder, thicker: float) -> None:
        built = self._built
        thicker *= 1.0 + c.added_friction
        c.sliding_n = thicker * built["sleeve.friction_n"]
        c.damping_nsm = thicker * built["sleeve.damping_nsm"]
        c.static_n = built["sleeve.static_factor"] * c.sliding_n

    def _sticks_s(self, valve: Valve, time_us: float) -> float:
        """What the valve's rest up to this instant adds."""
        most_s = self._built["sleeve.stiction_ms"] * MS
        moved_us = self._moved_us.get(valve)
        if most_s == 0.0 or moved_us is None:
            return most_s
        rest_s = max(time_us - moved_us, 0.0) / SECOND_US
        return -most_s * math.expm1(-rest_s / self._built["sleeve.stiction_s"])

    def _travel_s(self, name: Sleeve, side: int) -> float:
        """From the spool to contact, as drawn for a gear."""
        gear, sleeve = GEAR_AT[name, side], self._sheet.sleeve
        whole_s = sleeve.delay_s + self._built[f"sleeve.{_DELAY_LIKE[gear]}_delay_ms"] * MS
        return whole_s - self.mean_s(VALVE_OF_DOG[gear], True)

    def _remembered_s(self, valve: Valve, chance_s: float) -> float:
        share, last_s = self._correlation, self._last_s.get(valve)
        while last_s is not None:
            drawn_s = share * last_s + math.sqrt(1.0 - share * share) * chance_s
            if abs(drawn_s) <= self._delays.limit_s:
                chance_s = drawn_s
                break
            chance_s = self._delays.noise_s()
        self._last_s[valve] = chance_s
        return chance_s


def _order(gear: DogGear) -> int:
    return SIDE_OF[gear].sleeve


def _solve(set_to: Callable[[float], None], found_s: Callable[[], float], target_s: float) -> None:
    """Sets the conductance with which a stroke takes this long; a wider valve is faster."""
    low, high = math.log(LEAST_M3_SPA), math.log(MOST_M3_SPA)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        set_to(math.exp(middle))
        if found_s() > target_s:
            low = middle
        else:
            high = middle
    set_to(math.exp(high))
