"""Figure 6.13 and table 6.2: estimation of the layshaft's angle over two shifts."""

from __future__ import annotations

import numpy as np

from meshpoint.controller.settings import ESTIMATOR_NAMES
from meshpoint.testbench.studies.excitation import (
    BASELINE,
    THESIS_ANGLE_DEG,
    THESIS_FILTER,
    Matched,
    Point,
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
from meshpoint.testbench.studies.record import (
    Chart,
    Finding,
    Given,
    Line,
    Panel,
    Statement,
    Study,
    Style,
    Table,
    Verdict,
)
from meshpoint.testbench.studies.simulated import DEG
from meshpoint.testbench.studies.speed_estimate import NO_MATCH


def _conclude(given: Given[Settings]) -> Finding:
    found = points(given)
    match, two = matched(found), shown(given, found)
    values = {
        "by_brake_nm": {
            f"{point.brake_nm:g}": {name: f.angle_deg for name, f in point.figures.items()}
            for point in found
        },
        "table_6_2_rms_deg": [
            {name: figures([[score]], name).angle_deg for name in score} for score in two.scores
        ],
        "table_6_2_brake_nm": two.brake_nm,
    }
    if match is not None:
        values["matched_rms_deg"] = {name: f.angle_deg for name, f in match.figures.items()}
        values["matched_brake_nm"] = match.brake_nm
    charts = (*_over_time(two), _by_brake(found))
    return Finding(_statements(match), values, charts, (_table(two), curves(found)))


def _statements(match: Matched | None) -> tuple[Statement, ...]:
    size = sum(THESIS_ANGLE_DEG) / len(THESIS_ANGLE_DEG)
    thesis = f"the filter's angle follows the encoder closely: {size:.2f} deg RMS"
    if match is None:
        return (Statement(thesis, "-", Verdict.NOT_COMPARABLE, NO_MATCH),)
    ours = {name: f.angle_deg for name, f in match.figures.items()}
    first = Statement(
        thesis,
        f"{ours[THESIS_FILTER]:.3f} deg at the thesis's excitation, "
        f"{ours[THESIS_FILTER] / size:.2f} times the thesis's",
        Verdict.AGREES if ours[THESIS_FILTER] <= size else Verdict.DIFFERS,
        "closely is taken as no worse than the thesis's own; that ours is smaller says nothing of "
        "a real rig: simulated figures are not rig figures, and our reference encoder has no error "
        "of its own",
    )
    rest = tuple(
        Statement(
            f"(not in the thesis) estimator {label(name)}",
            f"{ours[name]:.3f} deg, {ours[name] / ours[THESIS_FILTER]:.2f} times the thesis's "
            "filter in the same runs",
            Verdict.NOT_COMPARABLE,
            "the production controller has no angle; this is the last edge carried on at its speed"
            if name == BASELINE
            else "the product's own; the thesis has none",
        )
        for name in ours
        if name != THESIS_FILTER
    )
    return (first, *rest)


def _over_time(two: Shown) -> tuple[Chart, ...]:
    charts = []
    for i, trace in enumerate(two.traces):
        angle: list[Line] = []
        errors: list[Line] = []
        for name in ESTIMATOR_NAMES:
            samples = trace.of(name)
            if not samples:
                continue
            start_us = trace.samples[0].time_us
            time_ms = np.array([(sample.time_us - start_us) / 1e3 for sample in samples])
            # the encoder counts turns modulo 256
            true = np.unwrap([sample.theta_rad for sample in samples], period=512.0 * np.pi) / DEG
            error = np.array([sample.theta_error_rad for sample in samples]) / DEG
            if not angle:
                angle.append(Line("reference encoder", time_ms, true - true[0]))
            angle.append(Line(label(name), time_ms, true - true[0] + error, Style.DASHED))
            errors.append(Line(label(name), time_ms, error))
        charts.append(
            Chart(
                f"shift_{i + 1}",
                f"Estimated layshaft angle, shift {i + 1}, brake {two.brake_nm:g} Nm",
                "ms since the main box came free",
                (
                    Panel("deg since the main box came free", tuple(angle)),
                    Panel("error, deg", tuple(errors)),
                ),
            )
        )
    return tuple(charts)


def _by_brake(found: list[Point]) -> Chart:
    brakes = [point.brake_nm for point in found]
    lines = tuple(
        Line(label(name), brakes, [point.figures[name].angle_deg for point in found], Style.JOINED)
        for name in found[0].figures
    )
    levels = {"thesis, its filter": sum(THESIS_ANGLE_DEG) / 2.0}
    panel = Panel("angle, deg RMS", lines, levels, log_y=True)
    return Chart("by_brake", "Error against excitation", "brake, Nm", (panel,), log_x=True)


def _table(two: Shown) -> Table:
    rows = tuple(
        (
            f"gear shift {i + 1}",
            label(name),
            figures([[score]], name).angle_deg,
            THESIS_ANGLE_DEG[i] if name == THESIS_FILTER else None,
        )
        for i, score in enumerate(two.scores)
        for name in score
    )
    columns = ("", "signal", "ours, RMS deg", "thesis, RMS deg")
    return Table("table_6_2", f"Table 6.2, with a brake of {two.brake_nm:g} Nm", columns, rows)


STUDY = Study(
    "angle_estimate",
    "Estimation of the layshaft's angle",
    ("figure 6.13", "table 6.2"),
    Settings,
    _conclude,
    runs,
)
