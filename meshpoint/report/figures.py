"""One shift as Plotly describes a figure: plain dictionaries, drawn in the browser."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, Final

import numpy as np

from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.gears import DRIVE_GEARS, SLEEVE_OF_MAIN, Sleeve
from meshpoint.report.collect import BEFORE_S, Points, ReportShift
from meshpoint.report.layout import (
    BLUE,
    BLUE_BAND,
    BRAKE,
    GAP_BAND,
    GREEN,
    GREY,
    INK,
    ORANGE,
    PHASE,
    PREDICTION,
    PURPLE,
    SLEEVE,
    SLEEVE_NAME,
    SLIP,
    SPEED,
    VALVE,
    Figure,
    axis,
    layout_key,
)
from meshpoint.report.motion import motion
from meshpoint.report.phase import estimated_phase, true_phase
from meshpoint.report.replayed import (
    FAR,
    replayed_bars,
    replayed_events,
    replayed_predictions,
    replayed_trajectory,
)

HOLE_MS: Final = 50.0
"""A line is broken where the bus was silent for longer."""
VALVE_NAMES: Final = (
    "brake", "main_first", "main_second", "main_crawl", "main_third",
    "split_low", "split_high", "range_low", "range_high",
)  # fmt: skip
CLUTCH_CLOSED_PERCENT: Final = 95.0


def shift_figure(shift: ReportShift, sheet: GearboxSheet) -> Figure:
    """One shift: `data`, and what of the layout is its own: `axes`, `shapes`, `annotations`."""
    before, after = DRIVE_GEARS.get(shift.row.from_), DRIVE_GEARS[shift.row.to]
    gear, ratio = after.main.name.lower(), sheet.main_mesh(after.main).ratio
    shapes, annotations = _events(shift)
    target = SLEEVE_OF_MAIN[after.main]
    contact_mm = target.direction * sheet.sleeve.to_contact_m * 1e3
    shapes.append(_contact_line(contact_mm))
    sleeves = {target.sleeve: "solid"}
    if before is not None:
        sleeves.setdefault(SLEEVE_OF_MAIN[before.main].sleeve, "dot")
    valves = [*replayed_bars(shift), *_valves(shift)]
    more_shapes, more_annotations = replayed_events(shift)
    shapes, annotations = [*shapes, *more_shapes], [*annotations, *more_annotations]
    data = [
        *_speeds(shift, ratio),
        *_slips(shift, ratio),
        _line(BRAKE, "pressure", shift.points("pressure_bar"), ORANGE, width=2),
        *valves,
        *_sleeves(shift, sleeves),
        *_phases(shift, gear, ratio),
        *_predictions(shift),
        *replayed_predictions(shift),
        *replayed_trajectory(shift),
    ]
    return {
        "data": [trace for trace in data if trace["x"]],
        "axes": {
            "xaxis": {"range": [-1e3 * BEFORE_S, round(shift.row.duration_ms + 60.0, 1)]},
            layout_key(VALVE): {"range": [-0.6, max(1, len(valves)) - 0.4]},
            layout_key(PHASE): {"range": _phase_range(shift)},
        },
        "shapes": shapes,
        "annotations": annotations,
        "motion": motion(shift, sheet),
    }


def _phase_range(shift: ReportShift) -> list[float]:
    """The pitch of the contact, and two more on the side the phase comes from."""
    before, beyond = -260.0, 110.0
    return [-beyond, -before] if (shift.row.slip_rpm or 0.0) < 0.0 else [before, beyond]


def _events(shift: ReportShift) -> tuple[list[Figure], list[Figure]]:
    """Vertical lines through all panels, named above them where the page has room."""
    outcome, row = shift.outcome, shift.row
    events = [("request", 0.0), ("in gear" if row.result == "engaged" else "end", row.duration_ms)]
    if row.attempts:
        events.append(("valve", shift.ms(outcome.fire_time_us)))
    events += [("aborted", at_ms) for at_ms in shift.aborted_ms]
    if shift.contact_ms is not None:
        events.append((f"contact: {row.contact}", shift.contact_ms))
    shapes = [
        {
            "type": "line", "x0": round(at_ms, 2), "x1": round(at_ms, 2), "yref": "paper",
            "y0": 0, "y1": 1,
            "line": {"color": INK if "contact" in name else GREY, "width": 1, "dash": "dot"},
        }
        for name, at_ms in events
    ]  # fmt: skip
    annotations = [
        {
            "x": round(at_ms, 2), "y": 1, "yref": "paper", "yanchor": "bottom", "text": name,
            "showarrow": False, "font": {"size": 11, "color": INK},
        }
        for name, at_ms in sorted(events, key=lambda event: event[1])
    ]  # fmt: skip
    return shapes, annotations


def _contact_line(contact_mm: float) -> Figure:
    return {
        "type": "line", "xref": "x domain", "x0": 0, "x1": 1, "yref": axis(SLEEVE),
        "y0": contact_mm, "y1": contact_mm, "line": {"color": GREY, "width": 1, "dash": "dash"},
    }  # fmt: skip


def _trace(panel: int, name: str, points: Points, **more: Any) -> Figure:
    """A trace in a panel and its legend; broken where the bus was silent."""
    x: list[float | None] = []
    y: list[float | None] = []
    before_ms: float | None = None
    for at_ms, value in zip(*points, strict=True):
        if before_ms is not None and at_ms - before_ms > HOLE_MS:
            x.append(round(before_ms, 2))
            y.append(None)
        x.append(round(at_ms, 2))
        y.append(round(value, 2))
        before_ms = at_ms
    return {
        "type": "scatter", "mode": "lines", "name": name, "x": x, "y": y, "yaxis": axis(panel),
        "legend": f"legend{panel + 1}" if panel else "legend", **more,
    }  # fmt: skip


def _line(panel: int, name: str, points: Points, color: str, **style: Any) -> Figure:
    return _trace(panel, name, points, line={"color": color, "width": 2.6, **style})


def _bound(panel: int, points: Points, sd: list[float], color: str) -> list[Figure]:
    """Estimate +- standard deviation as a filled band, one for each stretch without a hole: a fill
    would go on across it."""
    plain = {"line": {"width": 0, "color": color}, "hoverinfo": "skip"}
    bands = []
    for start, end in _stretches(points[0]):
        times = points[0][start:end]
        both = list(zip(points[1][start:end], sd[start:end], strict=True))
        low, high = (times, [v - s for v, s in both]), (times, [v + s for v, s in both])
        fill = {"fill": "tonexty", "fillcolor": color, "showlegend": start == 0}
        bands += [
            _trace(panel, "", low, showlegend=False, **plain),
            _trace(panel, "± 1 sd", high, **fill, **plain),
        ]
    return bands


def _stretches(times_ms: list[float]) -> list[tuple[int, int]]:
    """From and to where the bus was not silent."""
    holes = [k for k, (a, b) in enumerate(pairwise(times_ms), 1) if b - a > HOLE_MS]
    ends = [0, *holes, len(times_ms)]
    return [(start, end) for start, end in pairwise(ends) if end > start]


def _scaled(points: Points, scale: float) -> Points:
    return points[0], [scale * value for value in points[1]]


def _at(times_ms: list[float], points: Points) -> list[float | None]:
    """The values of a series at the same instants; None where it has no sample."""
    known = dict(zip(*points, strict=True))
    return [known.get(at_ms) for at_ms in times_ms]


def _speeds(shift: ReportShift, ratio: float) -> list[Figure]:
    gear = _scaled(shift.points("estimated_layshaft_rpm"), ratio)
    gear_sd = _scaled(shift.points("estimated_layshaft_sd_rpm"), ratio)[1]
    return [
        *_bound(SPEED, gear, gear_sd, BLUE_BAND),
        _line(SPEED, "gear, estimate", gear, BLUE),
        _line(SPEED, "gear, truth", _scaled(shift.points("layshaft_rpm"), ratio), INK, width=1),
        _line(SPEED, "sleeve, estimate", shift.points("estimated_main_rpm"), GREEN),
        _line(SPEED, "sleeve, truth", shift.points("main_rpm"), INK, width=1, dash="dot"),
    ]


def _slips(shift: ReportShift, ratio: float) -> list[Figure]:
    """Gear less sleeve, near zero, where teeth meet; the bound is that of both shafts together."""
    times, gear = _scaled(shift.points("estimated_layshaft_rpm"), ratio)
    sleeve = _at(times, shift.points("estimated_main_rpm"))
    sleeve_sd = _at(times, shift.points("estimated_main_sd_rpm"))
    gear_sd = _scaled(shift.points("estimated_layshaft_sd_rpm"), ratio)[1]
    kept = [i for i, speed in enumerate(sleeve) if speed is not None]
    estimate: Points = ([times[i] for i in kept], [gear[i] - (sleeve[i] or 0.0) for i in kept])
    sd = [float((gear_sd[i] ** 2 + (sleeve_sd[i] or 0.0) ** 2) ** 0.5) for i in kept]
    true_times, true_gear = _scaled(shift.points("layshaft_rpm"), ratio)
    main = shift.points("main_rpm")
    truth: Points = ([], [])
    if main[0]:
        true_sleeve = np.interp(true_times, *main).tolist()
        truth = true_times, [g - s for g, s in zip(true_gear, true_sleeve, strict=True)]
    return [
        *_bound(SLIP, estimate, sd, BLUE_BAND),
        _line(SLIP, "estimate", estimate, BLUE),
        _line(SLIP, "truth", truth, INK, width=1),
    ]


def _valves(shift: ReportShift) -> list[Figure]:
    """A bar where a valve is driven or the clutch is not closed; lowest first."""
    bars = []
    for name in reversed(VALVE_NAMES):
        points = shift.points(f"valve_{name}")
        on = [value > 0.5 for value in points[1]]
        if any(on):
            color = ORANGE if name == "brake" else PURPLE
            bars.append(_bar(name.replace("_", " "), points[0], on, color))
    times, clutch = shift.points("clutch_percent")
    released = [value < CLUTCH_CLOSED_PERCENT for value in clutch]
    if any(released):
        bars.append(_bar("clutch open", times, released, GREY))
    return bars


def _bar(label: str, times_ms: list[float], on: list[bool], color: str) -> Figure:
    x: list[float | None] = []
    for (start_ms, end_ms), is_on in zip(pairwise(times_ms), on, strict=False):
        if is_on and x and x[-2] == round(start_ms, 2):
            x[-2] = round(end_ms, 2)
        elif is_on:
            x += [round(start_ms, 2), round(end_ms, 2), None]
    y = [None if at_ms is None else label for at_ms in x]
    return {
        "type": "scatter", "mode": "lines", "name": label, "x": x, "y": y, "yaxis": axis(VALVE),
        "line": {"color": color, "width": 11}, "showlegend": False, "hoverinfo": "skip",
    }  # fmt: skip


def _sleeves(shift: ReportShift, sleeves: dict[Sleeve, str]) -> list[Figure]:
    """The sleeves' ways, and on that of the new gear's a mark at each abort."""
    lines = [
        _line(SLEEVE, sleeve.name.lower().replace("_", "/"), shift.points(SLEEVE_NAME[sleeve]),
              PURPLE if dash == "solid" else GREY, width=2, dash=dash)
        for sleeve, dash in sleeves.items()
    ]  # fmt: skip
    aborts = shift.aborts_on(SLEEVE_NAME[next(iter(sleeves))])
    return [*lines, _marker(SLEEVE, "aborted", aborts, good=False)]


def _phases(shift: ReportShift, gear: str, ratio: float) -> list[Figure]:
    """In % of pitch, going on over the pitches: every gap that goes by is a band."""
    to_pct = 100.0 / shift.row.pitch_deg
    truth_deg = true_phase(shift, gear, ratio)
    estimate_deg = estimated_phase(shift, ratio, truth_deg)
    truth = _near_middle(_scaled(truth_deg, to_pct))
    estimate = _scaled(estimate_deg, to_pct)
    sds = _at(estimate[0], _scaled(shift.points("estimated_phase_sd_deg"), to_pct))
    sd = [value or 0.0 for value in sds]
    kept = [i for i, value in enumerate(estimate[1]) if abs(value) < FAR]
    estimate = ([estimate[0][i] for i in kept], [estimate[1][i] for i in kept])
    traces = [
        *_bound(PHASE, estimate, [sd[i] for i in kept], BLUE_BAND),
        _line(PHASE, "estimate", estimate, BLUE),
        _line(PHASE, "truth", truth, INK, width=1),
    ]
    if shift.contact_ms is not None and shift.contact_phase_deg is not None:
        point: Points = ([shift.contact_ms], [to_pct * shift.contact_phase_deg])
        traces.append(_marker(PHASE, "contact, truth", point, shift.row.contact == "gap"))
    return [*traces, _gap_legend(PHASE)]


def _near_middle(points: Points) -> Points:
    """The part of a phase curve within the pitches that have their gap drawn."""
    kept = [(at_ms, value) for at_ms, value in zip(*points, strict=True) if abs(value) < FAR]
    return [at_ms for at_ms, _ in kept], [value for _, value in kept]


def _marker(panel: int, name: str, points: Points, good: bool) -> Figure:
    symbol = "circle" if good else "x"
    color = GREEN if good else ORANGE
    marker = {"symbol": symbol, "size": 10, "color": color, "line": {"color": INK, "width": 1}}
    return _trace(panel, name, points) | {"mode": "markers", "marker": marker}


def _gap_legend(panel: int) -> Figure:
    """The band has no trace; this one stands for it in the legend."""
    marker = {"symbol": "square", "size": 12, "color": GAP_BAND}
    none = {"x": [None], "y": [None], "mode": "markers", "marker": marker, "hoverinfo": "skip"}
    return _trace(panel, "gap", ([], [])) | none


def _predictions(shift: ReportShift) -> list[Figure]:
    """The phase at contact as each step foresaw it, and what it came to."""
    if shift.row.reference != "known":
        return []
    to_pct = 100.0 / shift.row.pitch_deg
    predicted = _scaled(shift.points("predicted_phase_deg"), to_pct)
    sd = _scaled(shift.points("predicted_phase_sd_deg"), to_pct)[1]
    traces = [
        *_bound(PREDICTION, predicted, sd, BLUE_BAND),
        _line(PREDICTION, "prediction", predicted, BLUE),
    ]
    if shift.contact_ms is not None and shift.contact_phase_deg is not None:
        point: Points = ([shift.contact_ms], [to_pct * shift.contact_phase_deg])
        traces.append(_marker(PREDICTION, "outcome, truth", point, shift.row.contact == "gap"))
    return traces
