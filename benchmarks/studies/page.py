"""`studies.html`: all studies on one page that opens anywhere, without a network."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any, Final

from benchmarks.studies.draw import chart_extent, colours, log_ticks, panel_extent, wrapped
from benchmarks.studies.record import (
    Chart,
    Line,
    Panel,
    Style,
    Table,
    ThesisVerdict,
    figures,
)
from benchmarks.studies.runner import StudyRecord
from meshpoint.base.errors import CommandError
from meshpoint.report.html import (
    NUMBER_CLASS,
    Cell,
    Page,
    definitions,
    table,
    table_row,
)
from meshpoint.report.layout import GREY, GRID, PAPER

SCRIPT: Final = Path(__file__).with_name("page.js")
PANEL_PX, FRAME_PX, GAP = 270, 110, 0.06
VERDICTS: Final = {
    ThesisVerdict.AGREES: ("agrees", "gap"),
    ThesisVerdict.DIFFERS: ("differs", "tooth"),
    ThesisVerdict.BY_CONSTRUCTION: ("by construction", ""),
    ThesisVerdict.NOT_COMPARABLE: ("not comparable", ""),
}
INTRODUCTION: Final = """Every figure and table of the 2019 Linköping thesis (Modeling and control
of engaging gears in gearboxes without synchromesh towards specific angles between gear and coupling
sleeve), ours beside its statement. Everything of ours is simulated; where the thesis measured on a
rig, the truck preset of the virtual rig stands for it. A verdict says what came out, and why. By
construction: it agrees, but rig, data sheet or study was given what it then reads out, so it could
only have shown a mistake of ours."""
MODES: Final = {
    Style.LINE: "lines",
    Style.DASHED: "lines",
    Style.POINTS: "markers",
    Style.JOINED: "lines+markers",
}


def write_page(path: Path, records: Sequence[StudyRecord], provenance: dict[str, str]) -> None:
    """Writes the page. CommandError where it cannot be written."""
    from plotly.offline import get_plotlyjs

    body = [
        "<h1>The thesis reproduced</h1>",
        f"<p>{escape(INTRODUCTION)}</p>",
        _overview(records),
    ]
    drawn = {}
    for record in records:
        body.append(_section(record))
        for chart in record.finding.charts:
            drawn[f"{record.study}-{chart.name}"] = plotly_figure(chart)
    body += ["<h2>Provenance</h2>", definitions(provenance)]
    page = Page("The thesis reproduced", body, {"figures": drawn}, get_plotlyjs(), [SCRIPT])
    try:
        path.write_text(page.text(), encoding="utf-8", newline="\n")
    except OSError as error:
        raise CommandError(f"{path}: cannot be written: {error.strerror or error}") from error


def _overview(records: Sequence[StudyRecord]) -> str:
    head: list[Cell] = [("study", ""), ("of the thesis", ""), ("", ""), ("verdict", "")]
    rows = []
    for record in records:
        link = f'<td><a href="#{record.study}">{escape(record.study)}</a></td>'
        cells = table_row(
            [
                (", ".join(record.of) or "beyond it", ""),
                (record.title, ""),
                _verdict(record.finding.verdict),
            ]
        )
        rows.append(f"<tr>{link}{cells}</tr>\n")
    return table(head, rows)


def _verdict(verdict: ThesisVerdict) -> Cell:
    return VERDICTS[verdict]


def _section(record: StudyRecord) -> str:
    finding = record.finding
    of = ", ".join(record.of)
    parts = [
        f'<h2 id="{record.study}">{escape(record.title)}{escape(f" ({of})" if of else "")}</h2>',
        "<p>Data sheet {}, profile {}.</p>".format(*(escape(name) for name in record.gearbox)),
        _statements(record),
    ]
    parts += [f'<div id="{record.study}-{chart.name}"></div>' for chart in finding.charts]
    parts += [f"<h3>{escape(each.title)}</h3>{_table(each)}" for each in finding.tables]
    links = ", ".join(f'<a href="{escape(name)}">{escape(name)}</a>' for name in record.files)
    parts.append(f"<p>Files: {links}</p>")
    return "\n".join(parts)


def _statements(record: StudyRecord) -> str:
    rows = []
    for each in record.finding.statements:
        said, ours, why = ((text, "text") for text in (each.thesis, each.ours, each.reason))
        rows.append(f"<tr>{table_row([said, ours, _verdict(each.verdict), why])}</tr>\n")
    head: list[Cell] = [("thesis or claim", ""), ("ours", ""), ("verdict", ""), ("why", "")]
    return table(head, rows)


def _table(each: Table) -> str:
    def cell(value: str | float | int | None) -> Cell:
        if value is None:
            return "–", NUMBER_CLASS
        if isinstance(value, str):
            return value, ""
        return f"{value:.4g}" if isinstance(value, float) else str(value), NUMBER_CLASS

    rows = [f"<tr>{table_row([cell(value) for value in row])}</tr>\n" for row in each.rows]
    numbers = [not isinstance(value, str) for value in each.rows[0]] if each.rows else []
    head = [
        (name.replace("_", " "), NUMBER_CLASS if is_number else "")
        for name, is_number in zip(each.columns, numbers, strict=False)
    ]
    return table(head, rows)


def plotly_figure(chart: Chart) -> dict[str, Any]:
    """A chart as Plotly describes one: plain dictionaries."""
    panels = len(chart.panels)
    colour_of = colours(chart)
    share = (1.0 - GAP * (panels - 1)) / panels
    layout: dict[str, Any] = {
        "title": {"text": f"{chart.title} (simulated)", "font": {"size": 14}},
        "height": FRAME_PX + PANEL_PX * panels,
        "margin": {"l": 80, "r": 10, "t": 44, "b": 48},
        **PAPER,
        "hovermode": "closest",
        "xaxis": _x_axis(chart),
        "shapes": [],
        "annotations": [],
    }
    data: list[dict[str, Any]] = []
    for i, panel in enumerate(chart.panels):
        top = 1.0 - i * (share + GAP)
        layout[_numbered("yaxis", i)] = _y_axis(panel, top - share, top)
        layout[_numbered("legend", i)] = {"y": round(top, 6), "yanchor": "top"}
        data += [_trace(line, colour_of[line.name], i) for line in panel.lines]
        _mark(layout, panel, i, chart.log_x)
    return {"data": data, "layout": layout}


AXIS: Final = {"gridcolor": GRID, "linecolor": GREY, "zeroline": False, "ticks": "outside"}


def _numbered(what: str, panel: int) -> str:
    return what if panel == 0 else f"{what}{panel + 1}"


def _x_axis(chart: Chart) -> dict[str, Any]:
    axis: dict[str, Any] = {
        "title": {"text": chart.x_title},
        "anchor": _numbered("y", len(chart.panels) - 1),
        "type": "log" if chart.log_x else "linear",
        **AXIS,
    }
    if chart.log_x:
        axis |= _log_ticks(chart_extent(chart))
    if chart.x_names:
        axis["tickvals"] = list(range(1, len(chart.x_names) + 1))
        axis["ticktext"] = [wrapped(name, "<br>") for name in chart.x_names]
    return axis


def _log_ticks(ends: tuple[float, float] | None) -> dict[str, Any]:
    ticks = log_ticks(*ends) if ends is not None else []
    return {"tickvals": ticks, "ticktext": [f"{tick:g}" for tick in ticks]}


def _y_axis(panel: Panel, bottom: float, top: float) -> dict[str, Any]:
    axis: dict[str, Any] = {
        "title": {"text": panel.y_title, "standoff": 8},
        "domain": [round(max(bottom, 0.0), 6), round(top, 6)],
        "type": "log" if panel.log_y else "linear",
        **AXIS,
    }
    if panel.y_range is not None:
        low, high = panel.y_range
        axis["range"] = [math.log10(low), math.log10(high)] if panel.log_y else [low, high]
    if panel.log_y:
        axis |= _log_ticks(panel_extent(panel))
    return axis


def _trace(line: Line, colour: str, panel: int) -> dict[str, Any]:
    trace: dict[str, Any] = {
        "name": line.name,
        "x": _points(line.x),
        "y": _points(line.y),
        "yaxis": _numbered("y", panel),
        "legend": _numbered("legend", panel),
        "showlegend": True,
    }
    if line.style is Style.BARS:
        return trace | {"type": "bar", "marker": {"color": colour, "opacity": 0.6}}
    style = {
        "color": colour,
        "width": 1.6,
        "dash": "dash" if line.style is Style.DASHED else "solid",
    }
    marker = {"color": colour, "size": 4}
    return trace | {"type": "scatter", "mode": MODES[line.style], "line": style, "marker": marker}


def _points(values: Any) -> list[float | None]:
    """NaN, which JSON has not, becomes a break in the line."""
    return [
        value if math.isfinite(value) else None for value in figures([float(v) for v in values])
    ]


def _mark(layout: dict[str, Any], panel: Panel, number: int, log_x: bool) -> None:
    axis = _numbered("y", number)
    for name, level in panel.levels.items():
        layout["shapes"].append(
            {"type": "line", "xref": "paper", "x0": 0, "x1": 1, "yref": axis, "y0": level,
             "y1": level, "line": {"color": GREY, "width": 1, "dash": "dashdot"}}
        )  # fmt: skip
        at = math.log10(level) if panel.log_y else level
        layout["annotations"].append(_note(name, "paper", 1.0, axis, at, "right"))
    for name, moment in panel.moments.items():
        layout["shapes"].append(
            {"type": "line", "xref": "x", "x0": moment, "x1": moment, "yref": f"{axis} domain",
             "y0": 0, "y1": 1, "line": {"color": GREY, "width": 1, "dash": "dot"}}
        )  # fmt: skip
        at = math.log10(moment) if log_x else moment
        layout["annotations"].append(_note(name, "x", at, f"{axis} domain", 1.0, "left"))


def _note(text: str, x_ref: str, x: float, y_ref: str, y: float, anchor: str) -> dict[str, Any]:
    return {
        "text": text, "xref": x_ref, "x": x, "yref": y_ref, "y": y, "xanchor": anchor,
        "yanchor": "bottom", "showarrow": False, "font": {"size": 10, "color": GREY},
    }  # fmt: skip
