"""The page of a log that our controller has not made: what its sensors tell over its time, and
what our controller would have decided of each request."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import Any, Final

from meshpoint.gearbox import GearboxSheet
from meshpoint.replays.envelope import Envelope
from meshpoint.replays.sensor_replay import SensorReplay
from meshpoint.report.html import (
    NUMBER_CLASS,
    Cell,
    Page,
    definitions,
    table,
    table_row,
)
from meshpoint.report.layout import (
    BLUE,
    GREEN,
    GREY,
    INK,
    ORANGE,
    PAPER,
    PURPLE,
    Figure,
    axis_lines,
)
from meshpoint.report.run import number_cell
from meshpoint.report.write import report_provenance, write_page

SCRIPTS: Final = ("report/report.js",)
HEIGHT_PX: Final = 620
MOST_MARKS: Final = 300
"""Requests drawn as lines; of more, lines alone would be seen."""
GEARS: Final = ("gear by sleeves", "gear by ratio")
STYLES: Final = {
    "layshaft": BLUE,
    "main": ORANGE,
    "input, as said": GREEN,
    "propeller, as said": PURPLE,
    GEARS[0]: INK,
    GEARS[1]: GREY,
}
DECIDED: Final[list[Cell]] = [
    ("asked, s", NUMBER_CLASS), ("gears", ""), ("decided", ""), ("reference", ""),
    ("fires, ms", NUMBER_CLASS), ("expects phase, deg", NUMBER_CLASS), ("contact", "text"),
]  # fmt: skip
SEEN: Final[list[Cell]] = [
    ("gears", ""), ("left, s", NUMBER_CLASS), ("there, s", NUMBER_CLASS),
    ("no gear, ms", NUMBER_CLASS),
]  # fmt: skip
SUBTITLE: Final = (
    "A bus that another controller moved. Ours was fed its sensor frames and moved nothing: it "
    "estimated, it learned, and it was asked for what it would have done at each request. How a "
    "shift ended is the other controller's doing, and nowhere reported as ours."
)
OVER_TIME: Final = "<h2>Over the log's time</h2><div id='log'></div>"


class SensorTraces:
    """What is drawn over the log's time, however long that is."""

    def __init__(self) -> None:
        self.envelopes: dict[str, Envelope] = {}

    def take(self, name: str, at_s: float, value: float) -> None:
        """A value of now; names as in `STYLES`."""
        self.envelopes.setdefault(name, Envelope()).take(at_s, value)

    def figure(self, asked_s: list[float]) -> Figure:
        """Speeds above, gears below, a line at each request."""
        traces = [
            {"type": "scatter", "mode": "lines", "name": name, "x": times, "y": values,
             "yaxis": "y2" if name in GEARS else "y", "connectgaps": False,
             "line": {"color": color, "width": 1.5, "dash": "dot" if name == GEARS[1] else "solid"}}
            for name, color in STYLES.items()
            if name in self.envelopes
            for times, values in [self.envelopes[name].points()]
        ]  # fmt: skip
        marks = [
            {"type": "line", "x0": at_s, "x1": at_s, "yref": "paper", "y0": 0, "y1": 1,
             "line": {"color": GREY, "width": 1, "dash": "dot"}}
            for at_s in asked_s[:MOST_MARKS]
        ]  # fmt: skip
        return {"data": traces, "layout": _layout(marks)}


def _layout(marks: list[Figure]) -> Figure:
    return {
        "height": HEIGHT_PX,
        "margin": {"l": 72, "r": 10, "t": 30, "b": 90},
        **PAPER,
        "hovermode": "x unified",
        "xaxis": {"title": {"text": "time since the first frame, s"}, "anchor": "y2",
                  **axis_lines()},
        "yaxis": {"title": {"text": "speed, rpm"}, "domain": [0.36, 1.0], **axis_lines()},
        "yaxis2": {"title": {"text": "gear"}, "domain": [0.0, 0.3], "dtick": 2, **axis_lines()},
        "legend": {"orientation": "h", "x": 0.5, "xanchor": "center", "y": -0.16, "yanchor": "top"},
        "shapes": marks,
    }  # fmt: skip


class SensorPage:
    """Title, what was asked and by which data sheet; `lines`: what was used and what was not."""

    def __init__(self, log: str, strategy: str, sheet: GearboxSheet, lines: list[str]) -> None:
        self._log = log
        self._strategy = strategy
        self._sheet = sheet
        self._lines = lines

    def write(
        self,
        path: Path,
        replay: SensorReplay,
        traces: SensorTraces,
        events: list[dict[str, Any]],
    ) -> None:
        """Writes the page. CommandError where it cannot be written."""
        decided = replay.decided()
        drawn = traces.figure([row["asked_s"] for row in decided])
        title = f"meshpoint replay: {self._log}, sensors alone"
        seen, by = replay.seen
        shifts = [
            [(f"{s.from_gear} → {s.to_gear}", ""), *_numbers(s.left_s, s.there_s, s.open_ms)]
            for s in seen
        ]
        body = [
            f"<h1>{escape(title)}</h1>",
            f"<p>{escape(SUBTITLE)}</p>",
            OVER_TIME if drawn["data"] else "<p>No speed and no gear to draw.</p>",
            f"<h2>What {escape(self._strategy)} would have done</h2>",
            _table(DECIDED, [_decided_cells(row) for row in decided], "No request in the log."),
            f"<h2>Shifts that the log shows, by {escape(by)}</h2>",
            _table(SEEN, shifts, "None."),
            "<h2>What was used, and what cannot be said</h2>",
            _list(self._lines),
            "<h2>What the controller said</h2>",
            _list([f"{event['s']:.3f} s: {event['event']}" for event in events]),
            "<h2>Provenance</h2>",
            definitions(report_provenance(self._sheet, log=self._log)),
        ]
        data = {"shifts": [], "overview": {"log": drawn} if drawn["data"] else {}}
        write_page(path, lambda plotly: Page(title, body, data, plotly, SCRIPTS).text())


def _table(head: list[Cell], rows: list[list[Cell]], none: str) -> str:
    if not rows:
        return f"<p>{escape(none)}</p>"
    made = [f"<tr>{table_row(row)}</tr>\n" for row in rows]
    return f'<div class="scroll">{table(head, made)}</div>'


def _list(lines: list[str]) -> str:
    items = "".join(f"<li>{escape(line.strip())}</li>\n" for line in lines)
    return f'<div class="scroll"><ul>\n{items}</ul></div>' if items else "<p>Nothing.</p>"


def _numbers(*values: float | None) -> list[Cell]:
    return [number_cell(value, 2) for value in values]


def _decided_cells(row: dict[str, Any]) -> list[Cell]:
    status = row["status"] if row["fault"] == "none" else f"{row['status']}: {row['fault']}"
    return [
        *_numbers(row["asked_s"]),
        (f"{row['from']} → {row['to']}", ""),
        (status, ""),
        (row["reference"], ""),
        *_numbers(row["fired_ms"], row["predicted_phase_deg"]),
        (f"not reported: {row['contact_why']}", "text"),
    ]
