"""How long a sleeve takes from its valve's activation to its gear's teeth, stroke by stroke.

Under a constant force the way grows with the square of the time since the valve has opened:

    sqrt(x / x_c) = (t - t_v) / (t_c - t_v)

so a line through the roots of the measured ways gives the contact t_c, whatever stops the sleeve
there. Delays are reported at the log's mean supply pressure.
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

FROM, TO = 0.06, 0.9
"""Shares of the way to the teeth that are used: before, noise rules; after, the teeth."""
PRESSURE_EXPONENT: Final = 0.5
"""The travel goes with the supply pressure to the power of less this: near enough in one log."""
LEAST_SAMPLES: Final = 8
MOST_REST: Final = 0.05
"""RMS of the roots about the line; a sleeve that was held up on its way is no sample."""
LEAST_CORRELATION, MOST_CORRELATION = 0.3, 0.8
"""A sleeve's strokes go together, by seals, grease and warmth that change slowly."""


class Contact(NamedTuple):
    """One stroke."""

    gear: MainGear
    delay_s: float
    """From activation to contact."""
    supply_pa: float


def contact_of(stroke: Stroke, sheet: GearboxSheet) -> Contact | None:
    """None where the sleeve did not go there in one move."""
    to_contact = sheet.sleeve.to_contact_m
    seconds = (stroke.time_us - stroke.fired_us) * US
    share = stroke.way_m / to_contact
    there = np.flatnonzero(share >= TO)
    if not there.size:
        return None
    end = int(there[0])
    below = np.flatnonzero(share[:end] < FROM)
    begin = int(below[-1]) + 1 if below.size else 0
    if end - begin < LEAST_SAMPLES:
        return None
    root, at = np.sqrt(np.maximum(share[begin:end], 0.0)), seconds[begin:end]
    # Noise of x is constant, so that of its root is 1 / (2 root): large roots weigh more.
    slope, offset = np.polyfit(at, root, 1, w=root)
    if slope <= 0.0 or float(np.std(root - slope * at - offset)) > MOST_REST:
        return None
    valve_s, delay_s = -offset / slope, (1.0 - offset) / slope
    if abs(delay_s - sheet.sleeve.delay_s) > FAR_S or valve_s < 0.0:
        return None
    return Contact(stroke.gear, float(delay_s), stroke.supply_pa)


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
