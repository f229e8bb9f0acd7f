"""What a replay adds to a report: the other strategy's decisions, beside what was recorded.

Drawn in one colour of their own. The log holds only the recorded contact; where the other tooth
would have landed is drawn as what it is, an interval that a model has worked out.
"""

from __future__ import annotations

from html import escape
from typing import Final

from meshpoint.report.collect import ReportShift
from meshpoint.report.counterfactual import Counterfactual
from meshpoint.report.html import NUMBER_CLASS, STACKED, Cell, table, table_row
from meshpoint.report.judged import Judged
from meshpoint.report.layout import (
    ORANGE,
    PHASE,
    PITCHES_EACH_WAY,
    PREDICTION,
    SLIP,
    VALVE,
    Figure,
    axis,
)
from meshpoint.report.run import Report, figure, number_cell
from meshpoint.report.trajectory import Decision

OTHER_BAND: Final = "rgba(213,94,0,.20)"
FAR: Final = 100.0 * PITCHES_EACH_WAY
"""Phase further away than this has no gap drawn."""
HEAD: Final = [
    ("shift", ""), ("gears", ""), ("recorded: fired, ms", NUMBER_CLASS), ("recorded contact", ""),
    ("acts", ""), ("decision", ""), ("brake off, ms", NUMBER_CLASS), ("fires, ms", NUMBER_CLASS),
    ("expects phase, % of pitch", NUMBER_CLASS), ("expects slip, rpm", NUMBER_CLASS),
    ("differs, ms", NUMBER_CLASS),
    ("would land, % of pitch, 95 %", NUMBER_CLASS), ("chance of a gap, %", NUMBER_CLASS),
    ("why no landing is reported", "text"),
]  # fmt: skip


def replayed_bars(shift: ReportShift) -> list[Figure]:
    """A bar where the other strategy commands a valve on; lowest first."""
    if shift.replayed is None:
        return []
    bars = []
    for name, spans in reversed(shift.replayed.driven.items()):
        label = f"{name.replace('_', ' ')}, replayed"
        x: list[float | None] = []
        for start_ms, end_ms in spans:
            x += [round(start_ms, 2), round(end_ms, 2), None]
        bars.append({
            "type": "scatter", "mode": "lines", "name": label, "x": x,
            "y": [None if at_ms is None else label for at_ms in x], "yaxis": axis(VALVE),
            "line": {"color": ORANGE, "width": 5}, "showlegend": False, "hoverinfo": "skip",
        })  # fmt: skip
    return bars


def replayed_predictions(shift: ReportShift) -> list[Figure]:
    """The phase at contact as the other strategy foresaw it, with its standard deviation."""
    judged = shift.replayed
    if judged is None:
        return []
    to_pct = 100.0 / shift.row.pitch_deg
    known = [d for d in judged.predictions if d.predicted_phase_deg is not None]
    x = [round(d.at_ms, 2) for d in known]
    middle = [to_pct * (d.predicted_phase_deg or 0.0) for d in known]
    sd = [to_pct * (d.predicted_phase_sd_deg or 0.0) for d in known]
    plain: Figure = {"mode": "lines", "line": {"width": 0, "color": OTHER_BAND}}
    quiet: Figure = {"hoverinfo": "skip", "showlegend": False}
    fill: Figure = {"fill": "tonexty", "fillcolor": OTHER_BAND}
    lines: list[tuple[str, list[float], Figure]] = [
        ("", [m - s for m, s in zip(middle, sd, strict=True)], plain | quiet),
        ("", [m + s for m, s in zip(middle, sd, strict=True)], plain | quiet | fill),
        ("replayed", middle, {"mode": "lines+markers", "line": {"color": ORANGE, "width": 2}}),
    ]
    return [
        {"type": "scatter", "name": name, "x": x, "y": [round(v, 2) for v in y],
         "yaxis": axis(PREDICTION), "legend": f"legend{PREDICTION + 1}", **style}
        for name, y, style in lines
    ]  # fmt: skip


def replayed_events(shift: ReportShift) -> tuple[list[Figure], list[Figure]]:
    """Vertical lines at its firing, its release, and where the decisions part; named below."""
    judged = shift.replayed
    if judged is None:
        return [], []
    last, parted = judged.last, judged.parted
    events = [
        ("decisions part", parted.at_ms if parted else None),
        ("would release", last.release_ms if last and parted else None),
        ("would fire", judged.fired_ms if parted else None),
    ]
    reported = [(name, at_ms) for name, at_ms in events if at_ms is not None]
    line = {"color": ORANGE, "width": 1.5, "dash": "dash"}
    shapes = [
        {"type": "line", "x0": round(at_ms, 2), "x1": round(at_ms, 2), "yref": "paper",
         "y0": 0, "y1": 1, "line": line}
        for _, at_ms in reported
    ]  # fmt: skip
    annotations = [
        {"x": round(at_ms, 2), "y": 0, "yref": "paper", "yanchor": "bottom", "text": name,
         "showarrow": False, "font": {"size": 11, "color": ORANGE}, "yshift": 14 * i,
         "xanchor": "left", "bgcolor": "rgba(255,255,255,.8)"}
        for i, (name, at_ms) in enumerate(reported)
    ]  # fmt: skip
    return shapes, annotations


def decisions_table(report: Report) -> str:
    """What the other strategy decides, shift by shift; nothing for a replay as recorded."""
    if report.asked is None:
        return ""
    rows = []
    for r, run in enumerate(report.runs):
        for s, shift in enumerate(run.shifts):
            link = f'<td data-name="shift"><a href="#shift-{r + 1}-{s + 1}">{s + 1}</a></td>'
            rows.append(f"<tr>{link}{table_row(_cells(shift), HEAD[1:])}</tr>\n")
    return (
        f"<h2>What {escape(report.asked)} decides on the same frames</h2>"
        f'<div class="scroll">{table(HEAD, rows, STACKED)}</div>'
        "<p>Each shift is judged from the state in which it was begun. The frames answer to the "
        "recorded commands: decisions made after a valve would have been driven otherwise are "
        "those of a controller that sees another trajectory than its own. Where its tooth would "
        "have landed is worked out from there by the learned brake and drag; outcomes are the "
        "log's alone.</p>"
    )


def _cells(shift: ReportShift) -> list[Cell]:
    row, judged = shift.row, shift.replayed
    gears: Cell = (f"{row.from_} → {row.to}", "")
    contact: Cell = (row.contact or "–", row.contact or "")
    if judged is None:
        none: list[Cell] = [("–", NUMBER_CLASS)] * 7
        why: Cell = ("the recorded controller could not be repeated up to here", "text")
        return [gears, ("–", NUMBER_CLASS), contact, ("–", ""), ("not judged", ""), *none, why]
    reported = judged.last if judged.fired_ms is not None else None
    return [
        gears,
        number_cell(judged.recorded.fired_ms if judged.recorded else None, 1),
        contact,
        (judged.strategy, ""),
        (judged.status if judged.fault == "none" else f"{judged.status}: {judged.fault}", ""),
        number_cell(judged.last.release_ms if judged.last else None, 1),
        number_cell(reported.fired_ms if reported else None, 1),
        (_phase(reported, row.pitch_deg), NUMBER_CLASS),
        number_cell(reported.predicted_slip_rpm if reported else None, 1, signed=True),
        number_cell(judged.parted.at_ms if judged.parted else None, 1),
        *_landing_cells(judged, row.pitch_deg),
    ]


def _landing_cells(judged: Judged, pitch_deg: float) -> list[Cell]:
    found = judged.counterfactual
    if found is None or not found.decidable:
        none: Cell = ("–", NUMBER_CLASS)
        return [none, none, (found.why if found else judged.contact_why, "text")]
    chance = 100.0 * (found.contact_probability or 0.0)
    return [
        (_landing(found, pitch_deg), NUMBER_CLASS),
        (figure(chance, 0), NUMBER_CLASS),
        ("", "text"),
    ]


def _landing(found: Counterfactual, pitch_deg: float) -> str:
    to_pct = 100.0 / pitch_deg
    half = to_pct * ((found.phase_high_deg or 0.0) - (found.phase_low_deg or 0.0)) / 2.0
    return f"{figure(to_pct * (found.phase_deg or 0.0), 1, True)} ± {half:.1f}"


def replayed_trajectory(shift: ReportShift) -> list[Figure]:
    """Slip and phase as they would have gone on, and the landing with its interval."""
    found = shift.replayed.counterfactual if shift.replayed else None
    if found is None or not found.trajectory:
        return []
    to_pct = 100.0 / shift.row.pitch_deg
    x = [round(at_ms, 2) for at_ms, _, _ in found.trajectory]
    lines = [(SLIP, x, [round(slip, 2) for _, slip, _ in found.trajectory])]
    near = [(ms, to_pct * phase) for ms, _, phase in found.trajectory if abs(to_pct * phase) < FAR]
    lines.append((PHASE, [round(ms, 2) for ms, _ in near], [round(value, 2) for _, value in near]))
    traces: list[Figure] = [
        {"type": "scatter", "mode": "lines", "name": "replayed, worked out", "x": times,
         "y": values, "yaxis": axis(panel), "legend": f"legend{panel + 1}",
         "line": {"color": ORANGE, "width": 2, "dash": "dash"}}
        for panel, times, values in lines
    ]  # fmt: skip
    if found.decidable:
        middle, high = to_pct * (found.phase_deg or 0.0), to_pct * (found.phase_high_deg or 0.0)
        traces += [
            {"type": "scatter", "mode": "markers", "name": "would land, 95 %",
             "x": [round(found.contact_ms or 0.0, 2)], "y": [round(middle, 2)],
             "error_y": {"type": "data", "array": [round(high - middle, 2)], "color": ORANGE},
             "marker": {"symbol": "diamond", "size": 9, "color": ORANGE}, "yaxis": axis(panel),
             "legend": f"legend{panel + 1}"}
            for panel in (PHASE, PREDICTION)
        ]  # fmt: skip
    return traces


def replayed_account(judged: Judged, pitch_deg: float) -> list[list[str]]:
    """Rows for the table over a figure: what the other strategy expects; no truth beside it."""
    reported = judged.last if judged.fired_ms is not None else None
    contact = "–" if reported is None or reported.expected_contact_ms is None else (
        figure(reported.expected_contact_ms, 1)
    )  # fmt: skip
    name = f"{judged.strategy} would have"
    landing = judged.counterfactual
    rows = []
    if landing is not None and landing.decidable:
        worked_out = _landing(landing, pitch_deg)
        rows = [[f"{name} landed, % of pitch, 95 %: worked out", worked_out, "–", "not in the log"]]
    return [
        *rows,
        [f"{name}: contact, ms after the request", contact, "–", "not in the log"],
        [f"{name}: phase, % of pitch", _phase(reported, pitch_deg), "–", "not in the log"],
    ]


def _phase(reported: Decision | None, pitch_deg: float) -> str:
    if reported is None or reported.predicted_phase_deg is None:
        return "–"
    to_pct = 100.0 / pitch_deg
    sd = to_pct * (reported.predicted_phase_sd_deg or 0.0)
    return f"{figure(to_pct * reported.predicted_phase_deg, 1, True)} ± {sd:.1f}"
