"""Section 6.3.2: what a prediction over the sleeve's delay is worth where the splitter changes too.

The splitter's step says with what share of its inertia the input shaft turns with the layshaft
(4.11 to 4.13). A shift that changes it predicts with another inertia afterwards; and a splitter
that changes within the sleeve's delay, or between whose steps the sleeve stands, turns the layshaft
otherwise than predicted.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from benchmarks.studies.record import (
    Chart,
    Finding,
    Given,
    Line,
    Panel,
    Statement,
    Study,
    Table,
    ThesisVerdict,
)
from benchmarks.studies.simulated import simulate_shift
from benchmarks.studies.thesis_predictions import predict_hold
from meshpoint.controller.models.thesis import layshaft_model
from meshpoint.gearbox import GearboxSheet, Split
from meshpoint.gearbox.gears import MAIN_GEARS
from meshpoint.gearbox.tables import count
from meshpoint.kernels.records import Vector
from meshpoint.units import MS_US, US

SAMPLE_US: Final = 1_000
NO_INERTIA_KGM2: Final = 1e-9
BELIEVED: Final = Split.HIGH
OUT: Final = "out"
COLUMNS: Final = (
    "the splitter is", "inertia, kgm2", "most in the whole shift, % of pitch",
    "most while a gear would be engaged, % of pitch",
)  # fmt: skip


@dataclass(frozen=True)
class Settings:
    """The time after the release in which a gear would be engaged."""

    engaging_ms: int = count("engaging_ms", 10, 1000)


def _turning(sheet: GearboxSheet) -> dict[str, tuple[GearboxSheet, Split]]:
    """What turns with the layshaft, by where the splitter's sleeve is. Out of both steps it is the
    layshaft alone."""
    alone = replace(sheet.shafts, input_inertia_kgm2=NO_INERTIA_KGM2)
    steps = {split.name.lower(): (sheet, split) for split in Split}
    return steps | {OUT: (replace(sheet, shafts=alone), BELIEVED)}


def _errors_pct(given: Given[Settings], turning: GearboxSheet, split: Split) -> tuple[Vector, ...]:
    """Times at which the sleeve's delay is over (ms), and by how much the prediction was wrong that
    takes the splitter to be in the high step: the layshaft's angle, in per cent of a pitch."""
    sheet, model = given.sheet, layshaft_model(given.sheet, BELIEVED)
    shift = simulate_shift(turning, given.common.shift, SAMPLE_US, split)
    switches = np.array((shift.switch_us, shift.switch_u))
    delay_us = round(sheet.sleeve.delay_s / US)
    ahead = delay_us // SAMPLE_US
    states = [shift.state(i) for i in range(shift.time_us.size - ahead)]
    then = [predict_hold(each, each.time_us + delay_us, switches, model) for each in states]
    theta = np.array([each.theta_rad for each in then])
    error = 100.0 * (theta - shift.theta_rad[ahead:]) / sheet.dog.pitch_rad
    return shift.time_ms[ahead:], error, shift.switch_us


def _conclude(given: Given[Settings]) -> Finding:
    sheet, lines, rows = given.sheet, [], []
    most = {}
    for name, (turning, split) in _turning(sheet).items():
        time_ms, error, switch_us = _errors_pct(given, turning, split)
        since_ms = time_ms - switch_us[1] / MS_US - 1e3 * sheet.sleeve.delay_s
        engaging = (since_ms >= 0.0) & (since_ms < given.own.engaging_ms)
        whole, then = float(np.abs(error).max()), float(np.abs(error[engaging]).max())
        rows.append((name, turning.inertia_kgm2(split), whole, then))
        lines.append(Line(name, time_ms, error))
        most[name] = whole, then
    share = max(sheet.main_mesh(gear).ratio for gear in MAIN_GEARS)
    half_gap_pct = 50.0 * sheet.dog.backlash_share
    at_the_gear = {name: tuple(share * each for each in both) for name, both in most.items()}
    braked, engaged = at_the_gear["low"]
    statement = Statement(
        "should the splitter also change gear the prediction varies slightly",
        f"between the steps by {engaged:.0f} % of a pitch while a gear would be engaged and by "
        f"{braked:.0f} % as the brake acts, of the gear that turns fastest; half a gap is "
        f"{half_gap_pct:.0f} %. With the sleeve out of both by {at_the_gear[OUT][1]:.0f} %; with "
        f"the step's own inertia by {most[BELIEVED.name.lower()][0]:.0e} %",
        ThesisVerdict.AGREES if engaged < half_gap_pct else ThesisVerdict.DIFFERS,
        "slightly is taken as less than half a gap: the thesis gives no figure. Which step is in "
        "has to be known when the sleeve is fired, and stay in until it meets its gear",
    )
    values = {"half_gap_pct": half_gap_pct, "fastest_gear": share} | {
        f"{name}_{when}_pct": value
        for name, both in most.items()
        for when, value in zip(("most", "engaging"), both, strict=True)
    }
    chart = Chart(
        "splitter",
        "Predicted with the high step's inertia, over the sleeve's delay",
        "ms since the box came free",
        (Panel("error of the layshaft's angle, % of pitch", tuple(lines)),),
    )
    table = Table("inertias", "What turns with the layshaft", COLUMNS, tuple(rows))
    return Finding((statement,), values, (chart,), (table,))


STUDY = Study(
    "splitter", "Prediction where the splitter changes too", ("section 6.3.2",), Settings, _conclude
)
