"""How long a sleeve takes from its valve's activation to its gear's teeth, stroke by stroke.

Whatever the sleeve does on its way, over the last part of it the way grows nearly with the square
of the time: a parabola through the samples from 30 to 90 % of the way gives the contact, whatever
stops the sleeve there. It is exact under a constant force; of a chamber that fills, where the way
grows with the cube of the time, it is off by 0.05 ms. Delays are reported at the log's mean supply
pressure.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from meshpoint.controller.sleeve.contact_chance import FAR_S
from meshpoint.gearbox import GearboxSheet, MainGear
from meshpoint.gearbox.gears import MAIN_GEARS
from meshpoint.testbench.identify.log_reader import Stroke
from meshpoint.units import US

FROM, TO = 0.3, 0.9
"""Shares of the way to the teeth that are used: before, a detent rules; after, the teeth."""
PRESSURE_EXPONENT: Final = 0.5
"""The travel goes with the supply pressure to the power of less this: near enough in one log."""
LEAST_SAMPLES: Final = 4
MOST_REST: Final = 0.02
"""RMS of the shares about the parabola: twice the sensor's noise. A sleeve that was held up on its
way is no sample."""
LEAST_CORRELATION, MOST_CORRELATION = 0.3, 0.8
"""A sleeve's strokes go together, by seals, grease and warmth that change slowly."""


class Contact(NamedTuple):
    """One stroke."""

    gear: MainGear
    delay_s: float
    """From activation to contact."""
    supply_pa: float


def contact_of(stroke: Stroke, sheet: GearboxSheet) -> Contact | None:
    """None where the sleeve did not go there from neutral in one move, after it was fired."""
    seconds = (stroke.time_us - stroke.fired_us) * US
    share = stroke.way_m / sheet.sleeve.to_contact_m
    there = np.flatnonzero(share >= TO)
    end = int(there[0]) if there.size else 0
    below = np.flatnonzero(share[:end] < FROM)
    begin = int(below[-1]) + 1 if below.size else end
    if end - begin < LEAST_SAMPLES or seconds[begin] < 0.0:
        return None
    near, since = share[begin:end], seconds[begin:end] - seconds[end - 1]
    bend, slope, newest = np.polyfit(since, near, 2)
    rest = float(np.sqrt(np.mean((near - np.polyval((bend, slope, newest), since)) ** 2)))
    root = slope**2 + 4.0 * bend * (1.0 - newest)
    if slope <= 0.0 or root < 0.0 or rest > MOST_REST:
        return None
    delay_s = float(seconds[end - 1] + 2.0 * (1.0 - newest) / (slope + math.sqrt(root)))
    if abs(delay_s - sheet.sleeve.delay_s) > FAR_S:
        return None
    return Contact(stroke.gear, delay_s, stroke.supply_pa)


@dataclass(frozen=True)
class SleeveFit:
    """Delays of the strokes by gear, at one supply pressure."""

    delays_s: dict[MainGear, np.ndarray]
    supply_pa: float
    """Absolute; the delays are reported at this pressure."""
    used: int
    seen: int

    @property
    def freedom(self) -> int:
        """Degrees of freedom of the spread within gears."""
        return sum(delays.size - 1 for delays in self.delays_s.values())

    @property
    def effective_freedom(self) -> float:
        """The same for strokes that go together."""
        square = self.correlation**2
        return max(1.0, self.freedom * (1.0 - square) / (1.0 + square))

    @property
    def spread_s(self) -> float:
        """Standard deviation within gears. Strokes that go together scatter less about their own
        mean than about the true one: that is made good for."""
        if self.freedom < 1:
            return math.nan
        squares = sum(float(np.sum((d - d.mean()) ** 2)) for d in self.delays_s.values())
        expected = sum(_squares_expected(d.size, self.correlation) for d in self.delays_s.values())
        return math.sqrt(squares / expected)

    @property
    def correlation(self) -> float:
        """Of a stroke's deviation with that of the gear's stroke before; a log of few strokes
        cannot show that there is none."""
        pairs = [(d - d.mean()) for d in self.delays_s.values() if d.size > 2]
        squares = sum(float(np.sum(one**2)) for one in pairs)
        strokes = sum(one.size for one in pairs)
        if squares == 0.0:
            return LEAST_CORRELATION
        found = sum(float(np.sum(one[1:] * one[:-1])) for one in pairs) / squares
        # Deviations from a mean of n are correlated by -1 / n of themselves.
        own = float(found + len(pairs) / strokes)
        return min(max(own, LEAST_CORRELATION), MOST_CORRELATION)


def _squares_expected(count: int, correlation: float) -> float:
    """Expected sum of squares about their mean, of this many values of variance 1."""
    lags = np.arange(1, count)
    return float(count - 1 - 2.0 * np.sum((1.0 - lags / count) * correlation**lags))


def at_supply(delay_s: float, seen_pa: float, reported_pa: float, sheet: GearboxSheet) -> float:
    """A delay that was seen at one absolute supply pressure, as it would be at another: the valve's
    part stays, the piston's goes with a power of the gauge pressure."""
    valve_s, atmosphere_pa = sheet.sleeve.valve_delay_s, sheet.air.atmosphere_pa
    share = (seen_pa - atmosphere_pa) / (reported_pa - atmosphere_pa)
    return float(valve_s + (delay_s - valve_s) * share**PRESSURE_EXPONENT)


def at_sheet(delay_s: float, seen_pa: float, sheet: GearboxSheet) -> float:
    """The same at the data sheet's supply pressure."""
    return at_supply(delay_s, seen_pa, sheet.air.supply_gauge_pa + sheet.air.atmosphere_pa, sheet)


def sleeve_fit(strokes: Iterable[Stroke], sheet: GearboxSheet) -> SleeveFit | None:
    """None without a usable stroke."""
    seen = list(strokes)
    contacts = [one for one in (contact_of(stroke, sheet) for stroke in seen) if one is not None]
    if not contacts:
        return None
    supply = float(np.mean([one.supply_pa for one in contacts]))
    delays: dict[MainGear, np.ndarray] = {}
    for gear in MAIN_GEARS:
        own = [
            at_supply(one.delay_s, one.supply_pa, supply, sheet)
            for one in contacts
            if one.gear is gear
        ]
        if own:
            delays[gear] = np.array(own)
    return SleeveFit(delays, supply, len(contacts), len(seen))
