"""Charts and tables into files: PNG by matplotlib, CSV beside it."""

from __future__ import annotations

import csv
import math
import textwrap
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmarks.studies.record import (
    RECORD_DIGITS,
    Chart,
    Finding,
    Line,
    Panel,
    Style,
    Table,
)
from meshpoint.base.errors import CommandError
from meshpoint.report.layout import BLUE, GREEN, GREY, INK, ORANGE, PURPLE
from meshpoint.results.output import folder_for

SERIES_COLOURS: Final = (BLUE, ORANGE, GREEN, PURPLE, INK, "#e69f00", "#56b4e9", GREY)
WIDTH_IN, PANEL_IN, DPI = 9.0, 3.1, 100
MOST_DECADES, WRAP = 4, 18


def write_files(finding: Finding, folder: Path) -> list[str]:
    """Writes all charts and tables of a study; returns the names of the files."""
    folder_for(folder)
    names = []
    both = [chart.name for chart in finding.charts] + [table.name for table in finding.tables]
    if len(set(both)) < len(both):
        raise ValueError(f"charts and tables share a name, and so a file: {both}")
    for chart in finding.charts:
        _draw(chart, folder / f"{chart.name}.png")
        _write_csv(folder / f"{chart.name}.csv", ("panel", "line", "x", "y"), chart_rows(chart))
        names += [f"{chart.name}.png", f"{chart.name}.csv"]
    for table in finding.tables:
        _write_csv(folder / f"{table.name}.csv", table.columns, table_rows(table))
        names.append(f"{table.name}.csv")
    return names


def chart_rows(chart: Chart) -> list[list[str]]:
    """Every point of a chart: panel, line, x, y."""
    return [
        [panel.y_title, line.name, _text(x), _text(y)]
        for panel in chart.panels
        for line in panel.lines
        for x, y in zip(line.x, line.y, strict=True)
    ]


def colours(chart: Chart) -> dict[str, str]:
    """A colour for each name: a line has the same in all panels."""
    names = dict.fromkeys(line.name for panel in chart.panels for line in panel.lines)
    return {name: SERIES_COLOURS[i % len(SERIES_COLOURS)] for i, name in enumerate(names)}


def log_ticks(low: float, high: float) -> list[float]:
    """Round figures over a logarithmic axis: 1, 2, 5 a decade; over many decades powers of ten."""
    first, last = math.floor(math.log10(low)), math.ceil(math.log10(high))
    steps = (1.0, 2.0, 5.0) if last - first <= MOST_DECADES else (1.0,)
    values = [step * 10.0**power for power in range(first, last + 1) for step in steps]
    return [float(f"{value:.1g}") for value in values if 0.8 * low <= value <= 1.25 * high]


def extent(values: Iterable[Any]) -> tuple[float, float] | None:
    """Least and most of all finite values above zero; None where there is none."""
    parts = [np.asarray(each, dtype=np.float64).ravel() for each in values]
    every = np.concatenate([part[np.isfinite(part) & (part > 0.0)] for part in parts])
    return (float(every.min()), float(every.max())) if every.size else None


def panel_extent(panel: Panel) -> tuple[float, float] | None:
    """What a logarithmic y axis has to show."""
    return extent([*(line.y for line in panel.lines), list(panel.levels.values())])


def chart_extent(chart: Chart) -> tuple[float, float] | None:
    """What a logarithmic x axis has to show."""
    return extent(line.x for panel in chart.panels for line in panel.lines)


def wrapped(name: str, break_: str) -> str:
    """A choice's name on several short lines."""
    return break_.join(textwrap.wrap(name, WRAP))


def table_rows(table: Table) -> list[list[str]]:
    """A table's rows as the CSV has them."""
    return [[_text(value) for value in row] for row in table.rows]


def _text(value: Any) -> str:
    if value is None:
        return ""
    return f"{value:.{RECORD_DIGITS}g}" if isinstance(value, (float, np.floating)) else str(value)


def _write_csv(path: Path, head: tuple[str, ...], rows: list[list[str]]) -> None:
    try:
        with path.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(head)
            writer.writerows(rows)
    except OSError as error:
        raise CommandError(f"{path}: cannot be written: {error.strerror or error}") from error


def _draw(chart: Chart, path: Path) -> None:
    from matplotlib.figure import Figure

    panels = len(chart.panels)
    figure = Figure(figsize=(WIDTH_IN, 0.8 + PANEL_IN * panels), layout="constrained")
    axes = figure.subplots(panels, 1, sharex=True, squeeze=False)[:, 0]
    for axis, panel in zip(axes, chart.panels, strict=True):
        _draw_panel(axis, panel, colours(chart))
    if chart.log_x:
        axes[-1].set_xscale("log")
        _log_ticks(axes[-1].xaxis, chart_extent(chart))
    if chart.x_names:
        names = [wrapped(name, "\n") for name in chart.x_names]
        axes[-1].set_xticks(range(1, len(names) + 1), names)
    axes[-1].set_xlabel(chart.x_title)
    figure.suptitle(f"{chart.title} (simulated)")
    try:
        figure.savefig(path, dpi=DPI, metadata={"Software": None})
    except OSError as error:
        raise CommandError(f"{path}: cannot be written: {error.strerror or error}") from error


def _log_ticks(axis: Any, ends: tuple[float, float] | None) -> None:
    if ends is not None:
        ticks = log_ticks(*ends)
        axis.set_ticks(ticks, [f"{tick:g}" for tick in ticks])
        axis.set_ticks([], minor=True)


def _draw_panel(axis: Any, panel: Panel, colour_of: dict[str, str]) -> None:
    bars = [line for line in panel.lines if line.style is Style.BARS]
    for line in panel.lines:
        if line.style is Style.BARS:
            _draw_bars(axis, line, colour_of[line.name], bars.index(line), len(bars))
        else:
            _draw_line(axis, line, colour_of[line.name])
    for name, level in panel.levels.items():
        axis.axhline(level, color=GREY, lw=0.9, ls="-.")
        axis.annotate(
            name, (1.0, level), xycoords=("axes fraction", "data"), ha="right", va="bottom",
            fontsize="x-small", color=GREY,
        )  # fmt: skip
    for name, moment in panel.moments.items():
        axis.axvline(moment, color=GREY, lw=0.9, ls=":")
        axis.annotate(
            name, (moment, 1.0), xycoords=("data", "axes fraction"), fontsize="x-small", color=GREY
        )
    if panel.log_y:
        axis.set_yscale("log")
        _log_ticks(axis.yaxis, panel_extent(panel))
    if panel.y_range is not None:
        axis.set_ylim(*panel.y_range)
    axis.set_ylabel(panel.y_title)
    axis.grid(alpha=0.3)
    axis.legend(loc="best", fontsize="x-small")


def _draw_bars(axis: Any, line: Line, colour: str, place: int, count: int) -> None:
    """Bars of several lines of a panel stand side by side."""
    x = np.asarray(line.x, dtype=np.float64)
    width = (0.9 * float(np.min(np.diff(x))) if x.size > 1 else 1.0) / count
    beside = (place - 0.5 * (count - 1)) * width
    axis.bar(x + beside, line.y, width=width, color=colour, alpha=0.6, label=line.name)


def _draw_line(axis: Any, line: Line, colour: str) -> None:
    styles: dict[Style, dict[str, Any]] = {
        Style.LINE: {"ls": "-"},
        Style.DASHED: {"ls": "--"},
        Style.POINTS: {"ls": "none", "marker": ".", "ms": 4},
        Style.JOINED: {"ls": "-", "marker": "o", "ms": 3},
    }
    axis.plot(line.x, line.y, color=colour, lw=1.3, label=line.name, **styles[line.style])
