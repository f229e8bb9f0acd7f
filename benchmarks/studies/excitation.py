"""Estimation at the thesis's excitation: figures 6.12 and 6.13, tables 6.1 and 6.2.

The production speed lags: its error goes with the deceleration, so figures are comparable only at
equal excitation. The thesis gives none, but it gives the production speed's own error; so the brake
is made weaker until that is the thesis's, and the other estimators are read off there.

The truck rig stands for the real one, sensor errors included. Reference is its encoder, which has
no error of its own. Estimators see what the controller sees, and are asked at every encoder instant
before the edges that came after it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np

from benchmarks.studies.jobs import (
    AsBuilt,
    LoopJob,
    LoopResult,
    Scores,
    ShiftErrors,
    ShiftTrace,
)
from benchmarks.studies.record import Given, Table
from meshpoint.base.errors import CommandError
from meshpoint.controller.settings.settings import ESTIMATOR_NAMES, ControllerSettings
from meshpoint.gearbox.tables import count, quantity
from meshpoint.rig_sim.settings import Preset
from meshpoint.units import DEG, RPM

BASELINE: Final = "window"
THESIS_ESTIMATOR: Final = "thesis"
LABELS: Final = {BASELINE: "production (window)", THESIS_ESTIMATOR: "thesis's filter"}
THESIS_BASELINE_RPM: Final = (5.74, 5.95)
THESIS_SPEED_RPM: Final = (4.34, 4.30)
THESIS_ANGLE_DEG: Final = (0.5147, 0.5464)
SHIFTS_SHOWN: Final = 2
"""Gear shifts in the thesis's tables."""
PATIENCE_MS: Final = 10_000
"""A weak brake takes longer than the controller's default patience."""


@dataclass(frozen=True)
class Settings:
    """The brakes that are tried, on how many trucks, and which shifts count."""

    brake_low_nm: float = quantity("brake_low_nm", 5.0, 1000.0)
    brake_high_nm: float = quantity("brake_high_nm", 5.0, 1000.0)
    brakes: int = count("brakes", 2, 20)
    drag_nm: float = quantity("drag_nm", 0.0, 60.0)
    """Constant drag of the truck: as drawn it would by itself slow the layshaft more than the
    thesis's excitation."""
    trucks: int = count("trucks", 1, 50)
    learning_shifts: int = count("learning_shifts", 0, 1000)
    """Shifts before those that count: an estimator may learn."""
    shifts: int = count("shifts", 2, 1000)
    """Shifts that count, of each truck with each brake."""


class Figures(NamedTuple):
    """RMS by 5.10."""

    angle_deg: float
    speed_rpm: float


class BrakePoint(NamedTuple):
    """What all estimators came to with one brake."""

    brake_nm: float
    figures: dict[str, Figures]


def label(name: str) -> str:
    """An estimator as charts and tables name it."""
    return LABELS.get(name, name)


def brakes_nm(own: Settings) -> list[float]:
    """The brakes that are tried, evenly spaced in ratio."""
    spaced = np.geomspace(own.brake_low_nm, own.brake_high_nm, own.brakes)
    return [float(f"{value:.4g}") for value in spaced]


def runs(given: Given[Settings]) -> tuple[LoopJob, ...]:
    """Every brake on every truck."""
    return tuple(
        _run(given, brake_nm, truck)
        for brake_nm in brakes_nm(given.own)
        for truck in range(given.own.trucks)
    )


def _run(given: Given[Settings], brake_nm: float, truck: int) -> LoopJob:
    own, sheet = given.own, given.eased.sheet
    settings = ControllerSettings()
    patient = replace(settings.limits, synchronise_ms=PATIENCE_MS)
    as_built: AsBuilt = (("drag.constant_nm", own.drag_nm),)
    keep = own.learning_shifts + SHIFTS_SHOWN if truck == 0 else 0
    return LoopJob(
        replace(
            sheet,
            brake=replace(sheet.brake, max_torque_nm=brake_nm),
        ),
        replace(settings, limits=patient),
        Preset.TRUCK,
        given.common.seed + truck,
        own.learning_shifts + own.shifts,
        as_built=as_built,
        keep=keep,
        profile=given.profile,
    )


def points(given: Given[Settings]) -> list[BrakePoint]:
    """All brakes, over all trucks and the shifts that count."""
    found = []
    for brake_nm in brakes_nm(given.own):
        trucks = []
        for truck in range(given.own.trucks):
            result: LoopResult = given.results[_run(given, brake_nm, truck)]
            trucks.append(result.scores[given.own.learning_shifts :])
        found.append(
            BrakePoint(brake_nm, {name: figures(trucks, name) for name in ESTIMATOR_NAMES})
        )
    return found


def figures(trucks: list[list[Scores]], estimator: str) -> Figures:
    """RMS over the shifts of all trucks. CommandError where none was scored.

    The mean angle error of a truck is taken off: the encoder counts from tooth 0, and a wheel's
    mean tooth offset cannot be observed, nor does it matter for a phase that is learned."""
    samples, angle_rad2, speed_rad2_s2 = 0, 0.0, 0.0
    for scores in trucks:
        total = _total(scores, estimator)
        samples += total.samples
        speed_rad2_s2 += total.speed_rad2_s2
        angle_rad2 += total.angle_rad2 - total.angle_rad**2 / max(1, total.samples)
    if not samples:
        raise CommandError(f"estimator {estimator} was never scored: no shift went as far")
    return Figures(
        math.sqrt(max(0.0, angle_rad2) / samples) / DEG,
        math.sqrt(speed_rad2_s2 / samples) / RPM,
    )


def _total(scores: list[Scores], estimator: str) -> ShiftErrors:
    squares = [score[estimator] for score in scores if estimator in score]
    return ShiftErrors(
        sum(each.samples for each in squares),
        sum(each.angle_rad for each in squares),
        sum(each.angle_rad2 for each in squares),
        sum(each.speed_rad2_s2 for each in squares),
    )


class Matched(NamedTuple):
    """Where the production speed's error is the thesis's: interpolated between two brakes."""

    brake_nm: float
    figures: dict[str, Figures]


def matched(found: list[BrakePoint]) -> Matched | None:
    """At the mean of the thesis's two shifts; None where no two brakes enclose it."""
    wanted = sum(THESIS_BASELINE_RPM) / len(THESIS_BASELINE_RPM)
    for below, above in pairwise(found):
        low, high = below.figures[BASELINE].speed_rpm, above.figures[BASELINE].speed_rpm
        if low <= wanted <= high:
            share = (wanted - low) / (high - low)
            between = {
                name: Figures(*(a + share * (b - a) for a, b in zip(*pair, strict=True)))
                for name, pair in _pairs(below, above).items()
            }
            brake_nm = below.brake_nm + share * (above.brake_nm - below.brake_nm)
            return Matched(brake_nm, between)
    return None


def _pairs(below: BrakePoint, above: BrakePoint) -> dict[str, tuple[Figures, Figures]]:
    return {name: (below.figures[name], above.figures[name]) for name in below.figures}


class Shown(NamedTuple):
    """Two shifts of the first truck with the brake whose baseline is nearest to the thesis's."""

    brake_nm: float
    scores: list[Scores]
    traces: list[ShiftTrace]


def shown(given: Given[Settings], found: list[BrakePoint]) -> Shown:
    """The shifts that stand beside the thesis's."""
    wanted = sum(THESIS_BASELINE_RPM) / len(THESIS_BASELINE_RPM)
    nearest = min(found, key=lambda point: abs(point.figures[BASELINE].speed_rpm - wanted))
    result: LoopResult = given.results[_run(given, nearest.brake_nm, 0)]
    first = given.own.learning_shifts
    return Shown(
        nearest.brake_nm,
        result.scores[first : first + SHIFTS_SHOWN],
        result.traces[first : first + SHIFTS_SHOWN],
    )


def curves(found: list[BrakePoint]) -> Table:
    """RMS of all estimators by brake."""
    names = list(found[0].figures)
    columns = ["brake, Nm"]
    for name in names:
        columns += [f"{label(name)}: angle, deg", f"{label(name)}: speed, rpm"]
    rows = tuple(
        (point.brake_nm, *(value for name in names for value in point.figures[name]))
        for point in found
    )
    return Table("brakes", "RMS by brake torque, all trucks", tuple(columns), rows)
