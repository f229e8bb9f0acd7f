"""A sleeve's law: what the data sheet says of it, how it is learned, and what is kept of it.

The valves' conductance is no key of the sheet: it is the one that gives the sheet's delay from
neutral to contact, so the prior of it hangs together with that of friction, damping, dead volume,
vents and detent: whatever these are, the delay is known to the sheet's tolerance.

The samples of a movement go through an iterated extended Kalman filter over the whole movement.
Unknown are the figures of the law (`PARAMETERS`), and how late each switch's spool is beyond its
valve's learned delay. Both have a prior; the law gives the places in between.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import fields
from functools import cache
from typing import Final, NamedTuple

import numpy as np

from meshpoint.controller.settings.learned import SleeveLawRecord
from meshpoint.controller.sleeve.cylinder import (
    DETENT,
    DETENT_UNIT_N,
    FEED,
    FOREVER,
    FRICTION,
    GAIN,
    IN_GEAR,
    LAW,
    LEFT,
    OFF,
    OFFSET,
    ON,
    PARAMETERS,
    TO_LEVEL,
    VENT,
    WAY,
    WAY_WORDS,
    carry,
)
from meshpoint.gearbox import GearboxSheet
from meshpoint.kernels.records import Vector

OFFSET_UNIT_M: Final = 1e-3
OFFSET_SD: Final = 0.12
"""Offset of a position sensor, mm: at most 0.3."""
GAIN_SD: Final = 0.007
"""At most 1.5 %."""
LEFT_SD: Final = 0.08
OWN_FEED_SD: Final = 0.10
"""By how much two valves of a sleeve differ in their conductance."""
NEAR_STOP_M: Final = 1e-3
IN_GEAR_SHARE: Final = 0.5
"""Force of the detents in gear over that of the one in neutral: the sheet has the latter alone."""
LEAST_CONDUCTANCE: Final = 1e-10
MOST_CONDUCTANCE: Final = 1e-6
SLOPE_STEP: Final = 0.05
LONGEST_S: Final = 0.5
"""No sleeve takes longer to its gear."""

SAMPLE_SD_M: Final = 8e-5
"""Of a sample from the law: its noise, and what a law leaves out."""
INDEPENDENT: Final = 40
"""More samples than these weigh no more: what the law leaves out lasts longer than a sample."""
LARGEST_STEP_SDS: Final = 4.0
"""The law bends too much for a longer step."""
HALVINGS: Final = 4
Figures = Callable[[Vector], Vector]
"""From unknowns, one row each, to a figure of each row, or a row of figures."""

KEPT = [k for k in range(PARAMETERS) if k != LEFT]
"""What outlasts a movement."""
LOGS, UNITS = np.zeros(PARAMETERS, dtype=bool), np.ones(PARAMETERS)
"""Of which the logarithm is learned, and what one of the others is in SI."""
LOGS[FEED : VENT + 1] = LOGS[GAIN] = True
UNITS[[DETENT, IN_GEAR]], UNITS[OFFSET] = DETENT_UNIT_N, OFFSET_UNIT_M
NAMES: Final = [field.name for field in fields(SleeveLawRecord)][1:-1]
"""Of the figures in a record, in the order of the parameters."""
LEAST_VARIANCE = 1e-14


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
        self.in_gear_m = sleeve.stroke_m - NEAR_STOP_M
        """A sleeve this far from neutral is in its gear."""
        self.late_s = sleeve.delay_limit_s
        """A valve shuts by no more than this later than it mostly does."""
        self.atmosphere_pa = air.atmosphere_pa
        self.sheet_pa = air.supply_gauge_pa
        """Gauge."""
        self.sheet: Vector = np.array(
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
                sleeve.detent_n,
                IN_GEAR_SHARE * sleeve.detent_n,
            ]
        )
        """The record `cylinder.Law`."""
        self._solve(sleeve.delay_s - sleeve.valve_delay_s)

    def at_rest(self, x_m: float) -> Vector:
        """The state of a sleeve that rests with both chambers vented."""
        air = self.atmosphere_pa
        return np.array([x_m, 0.0, air, air, 0.0, 0.0])

    def prior(self, sheet: GearboxSheet) -> Prior:
        """What the sheet says, with its tolerances."""
        sleeve = sheet.sleeve
        mean = np.zeros(PARAMETERS)
        mean[ON:FEED] = sleeve.valve_delay_s
        mean[DETENT] = sleeve.detent_n / DETENT_UNIT_N
        mean[IN_GEAR] = IN_GEAR_SHARE * mean[DETENT]
        sd = np.zeros(PARAMETERS)
        sd[ON:FEED] = sleeve.valve_delay_tolerance_s
        sd[FRICTION : VENT + 1] = (
            sleeve.friction_tolerance,
            sleeve.damping_tolerance,
            sleeve.dead_tolerance,
            sleeve.vent_tolerance,
        )
        sd[DETENT] = sd[IN_GEAR] = sleeve.detent_tolerance_n / DETENT_UNIT_N
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
        slope, steps = np.zeros(PARAMETERS), np.zeros((PARAMETERS, PARAMETERS))
        moved = range(FEED, DETENT + 1)
        for k in moved:
            steps[k, k] = SLOPE_STEP
        steps[FEED, FEED + 1] = SLOPE_STEP
        longer_s = self._travels_s(mean + steps[moved]) - self._travels_s(mean - steps[moved])
        slope[moved] = longer_s / (2.0 * SLOPE_STEP)
        return slope

    def _travels_s(self, learned: Vector) -> Vector:
        """From the valve's spool to contact, from neutral, by each row of what is learned."""
        rows = np.hstack([learned, np.zeros((len(learned), 1))])
        rows[:, ON] = 0.0
        seen, states = np.zeros((len(rows), 0)), np.tile(self.at_rest(0.0), (len(rows), 1))
        ways, fired = np.zeros((len(rows), WAY_WORDS)), np.array([[0.0, 0.0, 1.0]])
        carry(
            self.sheet, self.atmosphere_pa + self.sheet_pa, FOREVER, True, fired,
            rows, self.face_m, 1.0, LONGEST_S, TO_LEVEL, FOREVER, seen, states, ways,
        )  # fmt: skip
        crossed_s = ways.view(WAY)["crossed_s"][:, 0]
        return np.where(crossed_s < 0.0, LONGEST_S, crossed_s)

    def _solve(self, travel_s: float) -> None:
        """The conductance that gives the sheet's delay."""
        feed = self.sheet.view(LAW)["feed"][0]
        learned = np.zeros((1, PARAMETERS))
        learned[0, DETENT] = self.sheet.view(LAW)["detent_n"][0] / DETENT_UNIT_N
        low, high = math.log(LEAST_CONDUCTANCE), math.log(MOST_CONDUCTANCE)
        for _ in range(40):
            middle = 0.5 * (low + high)
            feed[:] = math.exp(middle)
            slow = self._travels_s(learned)[0] > travel_s
            low, high = (middle, high) if slow else (low, middle)
        feed[:] = math.exp(0.5 * (low + high))


class Fitted(NamedTuple):
    """Unknowns (PARAMETERS + switches,) with covariance, and what is left of the samples (m)."""

    mean: Vector
    covariance: Vector
    left_m: Vector


@cache
def probes(count: int) -> Vector:
    """Steps for the slopes: of delays (s), logarithms, detents (kN), offset (mm)."""
    steps = np.full(count, 0.02)
    steps[:FEED] = 2e-4
    steps[DETENT] = steps[IN_GEAR] = 0.01
    steps[OFFSET] = 0.05
    steps[PARAMETERS:] = 2e-4
    return steps


def slopes(of: Figures, at: Vector, base: float | Vector, moved_by: Sequence[int]) -> Vector:
    """How each figure that `of` gives, here `base`, changes with each unknown: one column each.
    moved_by: those that it changes with at all."""
    steps = probes(len(at))
    tried = np.empty((len(moved_by), len(at)))
    tried[:] = at
    tried[range(len(moved_by)), moved_by] += steps[moved_by]
    rows = np.zeros((len(at), *np.shape(base)))
    rows[moved_by] = ((of(tried) - base).T / steps[moved_by]).T
    return rows.T


def fit(places: Figures, seen_m: Vector, prior: Prior, begin: Vector, iterations: int) -> Fitted:
    """The most likely unknowns, from `begin` on. places: the readings (m) that unknowns give."""
    noise = SAMPLE_SD_M**2 * max(1.0, len(seen_m) / INDEPENDENT)
    mean, covariance = prior
    inverse = np.linalg.inv(covariance)

    def cost(z: Vector, left: Vector) -> float:
        return float(left @ left) / noise + float((z - mean) @ inverse @ (z - mean))

    z, left = begin, seen_m - places(begin[np.newaxis])[0]
    now = cost(z, left)
    posterior: Vector = covariance
    for _ in range(iterations):
        slope = slopes(places, z, seen_m - left, range(len(z)))
        information = inverse + slope.T @ slope / noise
        posterior = np.asarray(np.linalg.inv(information), dtype=np.float64)
        step = posterior @ (slope.T @ left / noise - inverse @ (z - mean))
        step /= max(
            1.0, float(np.max(np.abs(step) / np.sqrt(np.diag(covariance)))) / LARGEST_STEP_SDS
        )
        for _ in range(HALVINGS):
            tried = z + step
            rest = seen_m - places(tried[np.newaxis])[0]
            then = cost(tried, rest)
            if then < now:
                z, left, now = tried, rest, then
                break
            step = 0.5 * step
        else:
            break
    return Fitted(z, posterior, left)


def law_record(known: Prior, movements: int) -> SleeveLawRecord:
    """What a calibration file keeps."""
    kept = np.where(LOGS, np.exp(known.mean), known.mean * UNITS)[KEPT].tolist()
    covariance = known.covariance[np.ix_(KEPT, KEPT)]
    root = np.linalg.cholesky(covariance + LEAST_VARIANCE * np.eye(len(KEPT)))
    figures = [*(tuple(kept[k : k + 2]) for k in (ON, OFF, FEED)), *kept[FRICTION:]]
    lower = tuple(root[np.tril_indices(len(KEPT))].tolist())
    named = dict(zip(NAMES, figures, strict=True))
    return SleeveLawRecord(movements=movements, **named, root=lower)


def known_from(record: SleeveLawRecord) -> Prior:
    """The inverse."""
    mean, covariance = np.zeros(PARAMETERS), np.zeros((PARAMETERS, PARAMETERS))
    kept = np.hstack([getattr(record, name) for name in NAMES])
    logs = LOGS[KEPT]
    mean[KEPT] = kept / UNITS[KEPT]
    mean[np.array(KEPT)[logs]] = np.log(kept[logs])
    root = np.zeros((len(KEPT), len(KEPT)))
    root[np.tril_indices(len(KEPT))] = record.root
    covariance[np.ix_(KEPT, KEPT)] = root @ root.T + LEAST_VARIANCE * np.eye(len(KEPT))
    covariance[LEFT, LEFT] = LEFT_SD**2
    return Prior(mean, covariance)
