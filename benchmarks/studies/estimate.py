"""Figures 6.12 and 6.13, tables 6.1 and 6.2: estimation of the layshaft's speed and angle over two
shifts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.studies.excitation import (
    BASELINE,
    THESIS_ANGLE_DEG,
    THESIS_BASELINE_RPM,
    THESIS_ESTIMATOR,
    THESIS_SPEED_RPM,
    BrakePoint,
    Figures,
    Matched,
    Settings,
    Shown,
    curves,
    figures,
    label,
    matched,
    points,
    runs,
    shown,
)
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
from meshpoint.controller.settings.settings import ESTIMATOR_NAMES
from meshpoint.kernels.records import Vector
from meshpoint.results.estimation import Sample
from meshpoint.units import DEG, RPM

NO_MATCH = (
    "no brake within the settings gives the production speed the thesis's error, so there is "
    "nothing to compare at equal excitation"
)


@dataclass(frozen=True)
class Estimated:
    """The quantity of the layshaft that is estimated."""

    name: str
    unit: str
    table: str
    """The thesis's table of it, as `6.1`."""
    of: Callable[[Figures], float]
    """Its RMS error."""
    true: Callable[[list[Sample]], Vector]
    """As the reference encoder says it, in the unit."""
    error: Callable[[list[Sample]], Vector]
    axis: str
    """Of its panel over time."""
    thesis: dict[str, tuple[float, float]]
    """RMS errors of the thesis's two shifts, by signal."""
    levels: dict[str, float]
    """What of them is drawn beside ours, by its label."""


def _conclude(
    what: Estimated,
    given: Given[Settings],
    statements: Callable[[Matched | None], tuple[Statement, ...]],
) -> Finding:
    """The finding of the study of a quantity."""
    found = points(given)
    match, two = matched(found), shown(given, found)
    table, suffix = what.table.replace(".", "_"), what.unit
    values: dict[str, Any] = {
        "by_brake_nm": {
            f"{point.brake_nm:g}": {name: what.of(f) for name, f in point.figures.items()}
            for point in found
        },
        f"table_{table}_rms_{suffix}": [
            {name: what.of(figures([[score]], name)) for name in score} for score in two.scores
        ],
        f"table_{table}_brake_nm": two.brake_nm,
    }
    if match is not None:
        values[f"matched_rms_{suffix}"] = {name: what.of(f) for name, f in match.figures.items()}
        values["matched_brake_nm"] = match.brake_nm
    charts = (*_over_time(what, two), _by_brake(what, found))
    return Finding(statements(match), values, charts, (_table(what, two), curves(found)))


def _over_time(what: Estimated, two: Shown) -> tuple[Chart, ...]:
    """A chart a shift: the quantity and its error, each estimator's beside the encoder's."""
    charts = []
    for i, trace in enumerate(two.traces):
        lines: list[Line] = []
        errors: list[Line] = []
        for name in ESTIMATOR_NAMES:
            samples = trace.of(name)
            if not samples:
                continue
            start_us = trace.samples[0].time_us
            time_ms = np.array([(sample.time_us - start_us) / 1e3 for sample in samples])
            true, error = what.true(samples), what.error(samples)
            if not lines:
                lines.append(Line("reference encoder", time_ms, true))
            lines.append(Line(label(name), time_ms, true + error, Style.DASHED))
            errors.append(Line(label(name), time_ms, error))
        charts.append(
            Chart(
                f"shift_{i + 1}",
                f"Estimated layshaft {what.name}, shift {i + 1}, brake {two.brake_nm:g} Nm",
                "ms since the main box came free",
                (Panel(what.axis, tuple(lines)), Panel(f"error, {what.unit}", tuple(errors))),
            )
        )
    return tuple(charts)


def _by_brake(what: Estimated, found: list[BrakePoint]) -> Chart:
    brakes = [point.brake_nm for point in found]
    lines = tuple(
        Line(label(name), brakes, [what.of(point.figures[name]) for point in found], Style.JOINED)
        for name in found[0].figures
    )
    panel = Panel(f"{what.name}, {what.unit} RMS", lines, what.levels, log_y=True)
    return Chart("by_brake", "Error against excitation", "brake, Nm", (panel,), log_x=True)


def _table(what: Estimated, two: Shown) -> Table:
    rows: list[tuple[str | float | None, ...]] = []
    for i, score in enumerate(two.scores):
        for name in score:
            thesis = what.thesis.get(name)
            ours = what.of(figures([[score]], name))
            rows.append((f"gear shift {i + 1}", label(name), ours, thesis[i] if thesis else None))
    columns = ("", "signal", f"ours, RMS {what.unit}", f"thesis, RMS {what.unit}")
    title = f"Table {what.table}, with a brake of {two.brake_nm:g} Nm"
    return Table(f"table_{what.table.replace('.', '_')}", title, columns, tuple(rows))


def _true_rpm(samples: list[Sample]) -> Vector:
    return np.array([sample.omega_rad_s for sample in samples]) / RPM


def _error_rpm(samples: list[Sample]) -> Vector:
    return np.array([sample.omega_error_rad_s for sample in samples]) / RPM


SPEED = Estimated(
    name="speed",
    unit="rpm",
    table="6.1",
    of=lambda figures: figures.speed_rpm,
    true=_true_rpm,
    error=_error_rpm,
    axis="rpm",
    thesis={BASELINE: THESIS_BASELINE_RPM, THESIS_ESTIMATOR: THESIS_SPEED_RPM},
    levels={
        "thesis, production": sum(THESIS_BASELINE_RPM) / 2.0,
        "thesis, its filter": sum(THESIS_SPEED_RPM) / 2.0,
    },
)


def _of_speed(match: Matched | None) -> tuple[Statement, ...]:
    thesis = (
        f"production {THESIS_BASELINE_RPM[0]} and {THESIS_BASELINE_RPM[1]} rpm RMS, the filter "
        f"{THESIS_SPEED_RPM[0]} and {THESIS_SPEED_RPM[1]} rpm: slightly better"
    )
    if match is None:
        return (Statement(thesis, "-", ThesisVerdict.NOT_COMPARABLE, NO_MATCH),)
    ours = {name: f.speed_rpm for name, f in match.figures.items()}
    better = ours[THESIS_ESTIMATOR] < ours[BASELINE]
    size = sum(THESIS_SPEED_RPM) / len(THESIS_SPEED_RPM)
    first = Statement(
        thesis,
        f"with a brake of {match.brake_nm:.0f} Nm the production speed reads "
        f"{ours[BASELINE]:.2f} rpm (so chosen), the thesis's filter "
        f"{ours[THESIS_ESTIMATOR]:.2f} rpm",
        ThesisVerdict.AGREES if better else ThesisVerdict.DIFFERS,
        "compared at the excitation at which the production speed's error is the thesis's; the "
        "verdict is on the order alone",
    )
    second = Statement(
        f"the filter's error is {size:.2f} rpm",
        f"{ours[THESIS_ESTIMATOR]:.2f} rpm, {ours[THESIS_ESTIMATOR] / size:.2f} times the thesis's",
        ThesisVerdict.NOT_COMPARABLE,
        "simulated figures are not rig figures: our reference encoder has no error of its own, a "
        "real rig has more than the virtual one knows of, and Q and R were tuned anew",
    )
    return (first, second, *_others(ours))


def _others(ours: dict[str, float]) -> tuple[Statement, ...]:
    names = [name for name in ours if name not in (BASELINE, THESIS_ESTIMATOR)]
    return tuple(
        Statement(
            f"(not in the thesis) estimator {name}",
            f"{ours[name]:.2f} rpm, {ours[name] / ours[THESIS_ESTIMATOR]:.2f} times the thesis's "
            "filter in the same runs",
            ThesisVerdict.NOT_COMPARABLE,
            "the product's own; the thesis has none",
        )
        for name in names
    )


SPEED_STUDY = Study(
    "speed_estimate",
    "Estimation of the layshaft's speed",
    ("figure 6.12", "table 6.1"),
    Settings,
    lambda given: _conclude(SPEED, given, _of_speed),
    runs,
)


def _true_deg(samples: list[Sample]) -> Vector:
    """From the first sample on; the encoder counts turns modulo 256."""
    true: Vector = np.unwrap([sample.theta_rad for sample in samples], period=512.0 * np.pi) / DEG
    passed: Vector = true - true[0]
    return passed


def _error_deg(samples: list[Sample]) -> Vector:
    return np.array([sample.theta_error_rad for sample in samples]) / DEG


ANGLE = Estimated(
    name="angle",
    unit="deg",
    table="6.2",
    of=lambda figures: figures.angle_deg,
    true=_true_deg,
    error=_error_deg,
    axis="deg since the main box came free",
    thesis={THESIS_ESTIMATOR: THESIS_ANGLE_DEG},
    levels={"thesis, its filter": sum(THESIS_ANGLE_DEG) / 2.0},
)


def _of_angle(match: Matched | None) -> tuple[Statement, ...]:
    size = sum(THESIS_ANGLE_DEG) / len(THESIS_ANGLE_DEG)
    thesis = f"the filter's angle follows the encoder closely: {size:.2f} deg RMS"
    if match is None:
        return (Statement(thesis, "-", ThesisVerdict.NOT_COMPARABLE, NO_MATCH),)
    ours = {name: f.angle_deg for name, f in match.figures.items()}
    first = Statement(
        thesis,
        f"{ours[THESIS_ESTIMATOR]:.3f} deg at the thesis's excitation, "
        f"{ours[THESIS_ESTIMATOR] / size:.2f} times the thesis's",
        ThesisVerdict.AGREES if ours[THESIS_ESTIMATOR] <= size else ThesisVerdict.DIFFERS,
        "closely is taken as no worse than the thesis's own; that ours is smaller says nothing of "
        "a real rig: simulated figures are not rig figures, and our reference encoder has no error "
        "of its own",
    )
    rest = tuple(
        Statement(
            f"(not in the thesis) estimator {label(name)}",
            f"{ours[name]:.3f} deg, {ours[name] / ours[THESIS_ESTIMATOR]:.2f} times the thesis's "
            "filter in the same runs",
            ThesisVerdict.NOT_COMPARABLE,
            "the production controller has no angle; this is the last edge carried on at its speed"
            if name == BASELINE
            else "the product's own; the thesis has none",
        )
        for name in ours
        if name != THESIS_ESTIMATOR
    )
    return (first, *rest)


ANGLE_STUDY = Study(
    "angle_estimate",
    "Estimation of the layshaft's angle",
    ("figure 6.13", "table 6.2"),
    Settings,
    lambda given: _conclude(ANGLE, given, _of_angle),
    runs,
)
