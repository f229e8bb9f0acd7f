"""How near the estimators come to the posterior Cramer-Rao bound, and how far ahead they see.

The excitation is that of the estimation trials (docs/estimation.md); the estimators are the
product's own. Simulated, by a model that leaves out what a real rig adds: the bound holds for it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

from benchmarks.studies.bound_runs import COMPARED_NAMES, ErrorSums, Shifts
from benchmarks.studies.bound_scene import Scene
from benchmarks.studies.record import (
    Chart,
    Finding,
    Given,
    Line,
    Panel,
    Statement,
    Study,
    Style,
    Table,
    ThesisVerdict,
)
from meshpoint.controller.settings.filters import ThesisFilterTuning
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.gearbox.tables import count, group, quantity
from meshpoint.units import DEG, RPM

CHUNK: Final = 10
"""Shifts a job."""
MODEL_CASES: Final = {"matched": False, "as_built": True}
OURS: Final = "crossing_learned"
SCALE_BOUNDS: Final = (0.5, 200.0)
"""Ends of the picture's scale, in bounds."""
FIGURE_COLUMNS: Final = (
    "angle_rms_deg",
    "speed_rms_rpm",
    "angle_over_bound",
    "speed_over_bound",
    "predict45_deg",
    "predict45_over_bound",
    "predict45_pct_of_pitch",
)


@dataclass(frozen=True)
class Settings:
    """How many shifts, what is learned before, and the figures to reach."""

    shifts: int = count("shifts", 1, 100_000)
    learn_s: float = quantity("learn_ms", 100.0, 60_000.0, 1e-3)
    earlier_shifts: int = count("earlier_shifts", 0, 1000)
    matched_at_most: float = quantity("matched_at_most", 0.1, 100.0)
    as_built_angle_at_most: float = quantity("as_built_angle_at_most", 0.1, 100.0)
    as_built_speed_at_most: float = quantity("as_built_speed_at_most", 0.1, 100.0)
    ahead_at_most: float = quantity("ahead_at_most", 0.1, 100.0)
    ahead_share_of_pitch: float = quantity("ahead_percent_of_pitch", 0.1, 100.0, 0.01)
    scene: Scene = group(Scene)
    thesis_filter: ThesisFilterTuning = group(ThesisFilterTuning)


def _runs(given: Given[Settings]) -> tuple[Shifts, ...]:
    return tuple(job for as_built in MODEL_CASES.values() for job in _of_case(given, as_built))


def _of_case(given: Given[Settings], as_built: bool) -> list[Shifts]:
    own = given.own
    settings = replace(ControllerSettings(), thesis_filter=own.thesis_filter)
    return [
        Shifts(
            own.scene,
            given.sheet,
            settings,
            as_built,
            given.common.seed,
            first,
            min(first + CHUNK, own.shifts),
            own.learn_s,
            own.earlier_shifts,
        )
        for first in range(0, own.shifts, CHUNK)
    ]


def _conclude(given: Given[Settings]) -> Finding:
    rows = {case: _rows(given, as_built) for case, as_built in MODEL_CASES.items()}
    pitch_deg = given.sheet.dog.pitch_rad / DEG
    tables = tuple(
        Table(
            case,
            f"{case.replace('_', ' ')}, {given.own.shifts} shifts; pitch {pitch_deg:g} deg",
            ("estimator", *FIGURE_COLUMNS),
            tuple(
                (row["estimator"], *(row[column] for column in FIGURE_COLUMNS))
                for row in rows[case]
            ),
        )
        for case in MODEL_CASES
    )
    return Finding(_statements(given.own, rows), rows, (_chart(rows),), tables)


def _rows(given: Given[Settings], as_built: bool) -> list[dict[str, Any]]:
    total = dict.fromkeys(COMPARED_NAMES, ErrorSums())
    for job in _of_case(given, as_built):
        for name, squares in given.results[job].items():
            total[name] = total[name].plus(squares)
    pitch_deg = given.sheet.dog.pitch_rad / DEG
    least = _figures(total["bound"])
    rows = []
    for name, squares in total.items():
        angle, speed, ahead = _figures(squares)
        values = (
            angle, speed, angle / least[0], speed / least[1], ahead, ahead / least[2],
            100.0 * ahead / pitch_deg,
        )  # fmt: skip
        rows.append({"estimator": name} | dict(zip(FIGURE_COLUMNS, values, strict=True)))
    return rows


def _figures(squares: ErrorSums) -> tuple[float, float, float]:
    """RMS of angle (deg), speed (rpm), and angle ahead (deg)."""
    return (
        math.sqrt(squares.theta / squares.samples) / DEG,
        math.sqrt(squares.omega / squares.samples) / RPM,
        math.sqrt(squares.ahead / max(1, squares.predictions)) / DEG,
    )


def _statements(own: Settings, rows: Mapping[str, list[dict[str, Any]]]) -> tuple[Statement, ...]:
    matched, built = (_row(rows[case], OURS) for case in MODEL_CASES)
    pitch = 100.0 * own.ahead_share_of_pitch
    wanted = (
        ("angle, parameters known", matched["angle_over_bound"], own.matched_at_most, "x bound"),
        ("speed, parameters known", matched["speed_over_bound"], own.matched_at_most, "x bound"),
        ("angle as built", built["angle_over_bound"], own.as_built_angle_at_most, "x bound"),
        ("speed as built", built["speed_over_bound"], own.as_built_speed_at_most, "x bound"),
        ("45 ms ahead", matched["predict45_over_bound"], own.ahead_at_most, "x bound"),
        ("45 ms ahead as built", built["predict45_pct_of_pitch"], pitch, "% of a pitch"),
    )
    return tuple(
        Statement(
            f"(not in the thesis) {what}: at most {most:g} {unit}",
            f"{value:.3f} {unit}",
            ThesisVerdict.AGREES if value <= most else ThesisVerdict.DIFFERS,
            "the bound is that of the simulated excitation, teeth and parameters known",
        )
        for what, value, most, unit in wanted
    )


def _row(rows: list[dict[str, Any]], name: str) -> dict[str, Any]:
    return next(row for row in rows if row["estimator"] == name)


def _chart(rows: Mapping[str, list[dict[str, Any]]]) -> Chart:
    places = list(range(1, len(COMPARED_NAMES) + 1))
    panels = tuple(
        Panel(
            f"{title}, over the bound",
            tuple(
                Line(case.replace("_", " "), places, [row[key] for row in rows[case]], Style.BARS)
                for case in MODEL_CASES
            ),
            {"bound": 1.0},
            y_range=SCALE_BOUNDS,
            log_y=True,
        )
        for key, title in (
            ("angle_over_bound", "angle RMS"),
            ("speed_over_bound", "speed RMS"),
            ("predict45_over_bound", "angle 45 ms ahead"),
        )
    )
    names = tuple(name.replace("_", " ") for name in COMPARED_NAMES)
    return Chart("ranking", "Estimators beside the bound", "", panels, x_names=names)


STUDY = Study(
    "bound", "Estimation and prediction beside the bound", ("beyond",), Settings, _conclude, _runs
)
