"""What is to be learned of a sleeve, and what the data sheet says of it before anything is.

The valves' conductance is no key of the sheet: it is the one that gives the sheet's delay from
neutral to contact, so the prior of it hangs together with that of friction, damping, dead volume,
vents and detent: whatever these are, the delay is known to the sheet's tolerance.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from meshpoint.controller.records import Vector
from meshpoint.controller.sleeve.cylinder import (
    FOREVER,
    NOTHING_SEEN,
    TO_LEVEL,
    WAY_WORDS,
    move,
)
from meshpoint.gearbox import GearboxSheet

ON, OFF, FEED = 0, 2, 4
"""Each of two: of the valve that pushes towards +x, and of the other."""
FRICTION, DAMPING, DEAD, VENT, DETENT, OFFSET, GAIN, LEFT = range(6, 14)
PARAMETERS: Final = 14
"""Two on delays and two off delays (s), two logarithms of how fast a chamber fills, those of
friction, damping, dead volume and vent share; the detent's force (kN); the position sensor's offset
(mm) and the logarithm of its gain; and of one movement alone, the logarithm of the pressures left
in the chambers as it begins over those that the law expects."""
DETENT_UNIT_N: Final = 1e3
OFFSET_UNIT_M: Final = 1e-3
OFFSET_SD: Final = 0.12
"""Offset of a position sensor, mm: at most 0.3."""
GAIN_SD: Final = 0.007
"""At most 1.5 %."""
LEFT_SD: Final = 0.08
OWN_FEED_SD: Final = 0.10
"""By how much two valves of a sleeve differ in their conductance."""
LEAST_CONDUCTANCE: Final = 1e-10
MOST_CONDUCTANCE: Final = 1e-6
LONGEST_S: Final = 0.5
"""No sleeve takes longer to its gear."""
_SUPPLY: Final = 5
_FEED: Final = 6
_FRICTION: Final = 8
_STOP: Final = 12
_DEAD: Final = 10


class Prior(NamedTuple):
    """Mean and covariance of what is to be learned (PARAMETERS,), and of switches after that."""

    mean: Vector
    covariance: Vector


class SleeveLaw:
    """Of one gearbox's sheet: from what is learned of a sleeve to its law."""

    def __init__(self, sheet: GearboxSheet) -> None:
        sleeve, air = sheet.sleeve, sheet.air
        self.face_m = sleeve.to_contact_m
        self.stroke_m = sleeve.stroke_m
        self.atmosphere_pa = air.atmosphere_pa
        self._flat = np.array(
            [
                sleeve.bore_m2,
                sleeve.mass_kg,
                sleeve.stroke_m,
                sleeve.detent_m,
                air.atmosphere_pa,
                air.atmosphere_pa + air.supply_gauge_pa,
                1.0,
                1.0,
                max(sleeve.friction_n, 1.0),
                max(sleeve.damping_nsm, 1.0),
                sleeve.dead_m3,
                sleeve.vent_share,
                sleeve.stroke_m,
                0.0,
            ]
        )
        self._sheet_chamber_m3 = self._chamber_m3(self._flat)
        self._travel_s = sleeve.delay_s - sleeve.valve_delay_s
        self._detent_n = sleeve.detent_n
        self._nominal = self._solved()
        self.sheet_pa = air.supply_gauge_pa

    def flat(self, learned: Vector, supply_gauge_pa: float, stop_m: float) -> Vector:
        """The law's record (`cylinder.Law`) at a supply pressure; a tooth may stop it short."""
        law = self._flat.copy()
        law[_STOP] = min(law[_STOP], stop_m)
        law[_SUPPLY] = self.atmosphere_pa + supply_gauge_pa
        law[_FRICTION : _FRICTION + 4] *= np.exp(learned[FRICTION : VENT + 1])
        # A stroke's time goes with the rate at which a chamber fills: a larger chamber has a valve
        # that lets through as much more.
        larger = self._chamber_m3(law) / self._sheet_chamber_m3
        law[_FEED : _FEED + 2] = self._nominal * larger * np.exp(learned[FEED : FEED + 2])
        law[-1] = max(learned[DETENT], 0.0) * DETENT_UNIT_N
        return law

    def _chamber_m3(self, law: Vector) -> float:
        """Volume of a chamber with the sleeve in neutral."""
        return float(law[_DEAD] + law[0] * self.stroke_m)

    def at_rest(self, x_m: float) -> Vector:
        """The state of a sleeve that rests with both chambers vented."""
        air = self.atmosphere_pa
        return np.array([x_m, 0.0, air, air, 0.0, 0.0])

    def prior(self, sheet: GearboxSheet) -> Prior:
        """What the sheet says, with its tolerances."""
        sleeve = sheet.sleeve
        mean = np.zeros(PARAMETERS)
        mean[ON:FEED] = sleeve.valve_delay_s
        mean[DETENT] = self._detent_n / DETENT_UNIT_N
        sd = np.zeros(PARAMETERS)
        sd[ON:FEED] = sleeve.valve_delay_tolerance_s
        sd[FRICTION : VENT + 1] = (
            sleeve.friction_tolerance,
            sleeve.damping_tolerance,
            sleeve.dead_tolerance,
            sleeve.vent_tolerance,
        )
        sd[DETENT] = sleeve.detent_tolerance_n / DETENT_UNIT_N
        sd[OFFSET], sd[GAIN], sd[LEFT] = OFFSET_SD, GAIN_SD, LEFT_SD
        slope = self._slope(mean)
        own = max(sleeve.delay_limit_s - sleeve.valve_delay_tolerance_s, 1e-4) / 2.0
        # Of the conductances, one part each has of its own, one they have in common, and one that
        # makes good for what friction and the rest do to the delay.
        spread = np.diag(sd)
        common = np.zeros((PARAMETERS, 1))
        common[FEED : FEED + 2, 0] = own / abs(slope[FEED])
        spread[FEED, FEED] = spread[FEED + 1, FEED + 1] = OWN_FEED_SD
        for k in range(FRICTION, DETENT + 1):
            spread[FEED : FEED + 2, k] = -slope[k] / slope[FEED] * sd[k]
        spread = np.hstack([spread, common])
        return Prior(mean, spread @ spread.T)

    def _slope(self, mean: Vector) -> Vector:
        """By how much the travel of a stroke from neutral grows (s) with each parameter."""
        slope = np.zeros(PARAMETERS)
        for k in range(FEED, DETENT + 1):
            probe = np.zeros(PARAMETERS)
            probe[k] = 0.05
            if k == FEED:
                probe[FEED + 1] = 0.05
            more = self._travel(self.flat(mean + probe, self._sheet_gauge, FOREVER))
            less = self._travel(self.flat(mean - probe, self._sheet_gauge, FOREVER))
            slope[k] = (more - less) / 0.1
        return slope

    @property
    def _sheet_gauge(self) -> float:
        return float(self._flat[_SUPPLY] - self.atmosphere_pa)

    def _travel(self, law: Vector) -> float:
        x, way = self.at_rest(0.0), np.zeros(WAY_WORDS)
        on = np.array([[0.0, 0.0, 1.0]])
        move(law, x, on, 1, self.face_m, 1.0, LONGEST_S, TO_LEVEL, FOREVER, NOTHING_SEEN, way)
        return float(way[0]) if way[0] >= 0.0 else LONGEST_S

    def _solved(self) -> float:
        """The conductance that gives the sheet's delay."""
        law = self._flat.copy()
        law[-1] = self._detent_n
        low, high = math.log(LEAST_CONDUCTANCE), math.log(MOST_CONDUCTANCE)
        for _ in range(40):
            middle = 0.5 * (low + high)
            law[_FEED : _FEED + 2] = math.exp(middle)
            slow = self._travel(law) > self._travel_s
            low, high = (middle, high) if slow else (low, middle)
        return math.exp(0.5 * (low + high))
