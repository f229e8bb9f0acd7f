"""Estimation of the layshaft's angle or speed over two shifts: shared by tables 6.1 and 6.2."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.studies.excitation import (
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
    shown,
)
from benchmarks.studies.record import (
    Chart,
    Finding,
    Given,
    Line,
    Panel,
    Statement,
    Style,
    Table,
)
from meshpoint.controller.motion.linear_kernels import Vector
from meshpoint.controller.settings import ESTIMATOR_NAMES
from meshpoint.testbench.results.estimation import Sample

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


def conclude(
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
