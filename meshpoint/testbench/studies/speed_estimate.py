"""Figure 6.12 and table 6.1: estimation of the layshaft's speed over two shifts."""

from __future__ import annotations

import numpy as np

from meshpoint.controller.settings import ESTIMATOR_NAMES
from meshpoint.testbench.studies.excitation import (
    BASELINE,
    THESIS_BASELINE_RPM,
    THESIS_FILTER,
    THESIS_SPEED_RPM,
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
from meshpoint.testbench.studies.simulated import RPM

NO_MATCH = (
    "no brake within the settings gives the production speed the thesis's error, so there is "
    "nothing to compare at equal excitation"
)


def _conclude(given: Given[Settings]) -> Finding:
    found = points(given)
    match, two = matched(found), shown(given, found)
    values = {
        "by_brake_nm": {
            f"{point.brake_nm:g}": {name: f.speed_rpm for name, f in point.figures.items()}
            for point in found
        },
        "table_6_1_rms_rpm": [
            {name: figures([[score]], name).speed_rpm for name in score} for score in two.scores
        ],
        "table_6_1_brake_nm": two.brake_nm,
    }
    if match is not None:
        values["matched_rms_rpm"] = {name: f.speed_rpm for name, f in match.figures.items()}
        values["matched_brake_nm"] = match.brake_nm
    charts = (*_over_time(two), _by_brake(found))
    return Finding(_statements(match), values, charts, (_table(two), curves(found)))


def _statements(match: Matched | None) -> tuple[Statement, ...]:
    thesis = (
        f"production {THESIS_BASELINE_RPM[0]} and {THESIS_BASELINE_RPM[1]} rpm RMS, the filter "
        f"{THESIS_SPEED_RPM[0]} and {THESIS_SPEED_RPM[1]} rpm: slightly better"
    )
    if match is None:
        return (Statement(thesis, "-", Verdict.NOT_COMPARABLE, NO_MATCH),)
    ours = {name: f.speed_rpm for name, f in match.figures.items()}
    better = ours[THESIS_FILTER] < ours[BASELINE]
    size = sum(THESIS_SPEED_RPM) / len(THESIS_SPEED_RPM)
    first = Statement(
        thesis,
        f"with a brake of {match.brake_nm:.0f} Nm the production speed reads "
        f"{ours[BASELINE]:.2f} rpm (so chosen), the thesis's filter {ours[THESIS_FILTER]:.2f} rpm",
        Verdict.AGREES if better else Verdict.DIFFERS,
        "compared at the excitation at which the production speed's error is the thesis's; the "
        "verdict is on the order alone",
    )
    second = Statement(
        f"the filter's error is {size:.2f} rpm",
        f"{ours[THESIS_FILTER]:.2f} rpm, {ours[THESIS_FILTER] / size:.2f} times the thesis's",
        Verdict.NOT_COMPARABLE,
        "simulated figures are not rig figures: our reference encoder has no error of its own, a "
        "real rig has more than the virtual one knows of, and Q and R were tuned anew",
    )
    return (first, second, *_others(ours))


def _others(ours: dict[str, float]) -> tuple[Statement, ...]:
    names = [name for name in ours if name not in (BASELINE, THESIS_FILTER)]
    return tuple(
        Statement(
            f"(not in the thesis) estimator {name}",
            f"{ours[name]:.2f} rpm, {ours[name] / ours[THESIS_FILTER]:.2f} times the thesis's "
            "filter in the same runs",
            Verdict.NOT_COMPARABLE,
            "the product's own; the thesis has none",
        )
        for name in names
    )


def _over_time(two: Shown) -> tuple[Chart, ...]:
    charts = []
    for i, trace in enumerate(two.traces):
        speeds: list[Line] = []
        errors: list[Line] = []
        for name in ESTIMATOR_NAMES:
            samples = trace.of(name)
            if not samples:
                continue
            start_us = trace.samples[0].time_us
            time_ms = np.array([(sample.time_us - start_us) / 1e3 for sample in samples])
            true = np.array([sample.omega_rad_s for sample in samples]) / RPM
            error = np.array([sample.omega_error_rad_s for sample in samples]) / RPM
            if not speeds:
                speeds.append(Line("reference encoder", time_ms, true))
            speeds.append(Line(label(name), time_ms, true + error, Style.DASHED))
            errors.append(Line(label(name), time_ms, error))
        charts.append(
            Chart(
                f"shift_{i + 1}",
                f"Estimated layshaft speed, shift {i + 1}, brake {two.brake_nm:g} Nm",
                "ms since the main box came free",
                (Panel("rpm", tuple(speeds)), Panel("error, rpm", tuple(errors))),
            )
        )
    return tuple(charts)


def _by_brake(found: list[Point]) -> Chart:
    brakes = [point.brake_nm for point in found]
    lines = tuple(
        Line(label(name), brakes, [point.figures[name].speed_rpm for point in found], Style.JOINED)
        for name in found[0].figures
    )
    levels = {
        "thesis, production": sum(THESIS_BASELINE_RPM) / 2.0,
        "thesis, its filter": sum(THESIS_SPEED_RPM) / 2.0,
    }
    panel = Panel("speed, rpm RMS", lines, levels, log_y=True)
    return Chart("by_brake", "Error against excitation", "brake, Nm", (panel,), log_x=True)


def _table(two: Shown) -> Table:
    rows: list[tuple[str | float | None, ...]] = []
    for i, score in enumerate(two.scores):
        for name in score:
            thesis = {
                BASELINE: THESIS_BASELINE_RPM[i],
                THESIS_FILTER: THESIS_SPEED_RPM[i],
            }.get(name)
            rows.append(
                (f"gear shift {i + 1}", label(name), figures([[score]], name).speed_rpm, thesis)
            )
    columns = ("", "signal", "ours, RMS rpm", "thesis, RMS rpm")
    return Table(
        "table_6_1", f"Table 6.1, with a brake of {two.brake_nm:g} Nm", columns, tuple(rows)
    )


STUDY = Study(
    "speed_estimate",
    "Estimation of the layshaft's speed",
    ("figure 6.12", "table 6.1"),
    Settings,
    _conclude,
    runs,
)
