"""All shifts of a report in two figures: where they met, and how well that was foreseen."""

from __future__ import annotations

import math
from typing import Any, Final, Protocol

from meshpoint.gearbox import GearboxSheet
from meshpoint.report.collect import ReportShift
from meshpoint.report.layout import (
    BLUE,
    GAP_BAND,
    GREY,
    ORANGE,
    PAPER,
    Figure,
    axis_lines,
)

STYLES: Final = {
    "speed_window": {"color": ORANGE, "symbol": "diamond"},
    "target_phase": {"color": BLUE, "symbol": "circle"},
}
OTHER_STYLE: Final = {"color": GREY, "symbol": "square"}
OVERVIEW_HEIGHT_PX: Final = 340


class RunLike(Protocol):
    """What a figure needs of a run."""

    @property
    def shifts(self) -> list[ReportShift]:
        """Its shifts."""


def contacts_figure(runs: list[RunLike], sheet: GearboxSheet) -> Figure:
    """Every first contact: phase from the middle of the gap against slip."""
    data = []
    for name, style in _groups(runs):
        found = [
            (100 * shift.contact_phase_deg / shift.row.pitch_deg, shift.row.slip_rpm, key)
            for key, shift in _keyed(runs)
            if shift.row.strategy == name
            and shift.contact_phase_deg is not None
            and shift.row.slip_rpm is not None
        ]
        data.append(_points(name, style, found))
    half = 50 * sheet.dog.backlash_share
    layout = plain_layout("phase at contact, % of pitch", "slip at contact, rpm")
    layout["xaxis"] |= {"range": [-52, 52], "dtick": 25}
    layout["yaxis"]["rangemode"] = "tozero"
    layout["shapes"] = [gap_band("x", half, "y")]
    layout["annotations"] = [
        {"x": 0, "y": 1, "yref": "paper", "yanchor": "bottom", "text": "gap", "showarrow": False},
        {"x": -31, "y": 1, "yref": "paper", "yanchor": "bottom", "text": "tooth on tooth",
         "showarrow": False},
        {"x": 31, "y": 1, "yref": "paper", "yanchor": "bottom", "text": "tooth on tooth",
         "showarrow": False},
    ]  # fmt: skip
    return {"data": [trace for trace in data if trace["x"]], "layout": layout}


def predictions_figure(runs: list[RunLike], sheet: GearboxSheet) -> Figure:
    """Phase at contact, predicted +- standard deviation against what it came to."""
    data = []
    for name, style in _groups(runs):
        found, sds = [], []
        for key, shift in _keyed(runs):
            row = shift.row
            if row.strategy != name or shift.contact_phase_deg is None:
                continue
            if row.predicted_phase_deg is None:
                continue
            to_pct = 100 / row.pitch_deg
            predicted = to_pct * row.predicted_phase_deg
            # Beside the prediction, not a whole pitch from it.
            outcome = predicted + math.remainder(to_pct * shift.contact_phase_deg - predicted, 100)
            found.append((predicted, outcome, key))
            sds.append(round(to_pct * (row.predicted_phase_sd_deg or 0.0), 2))
        trace = _points(name, style, found)
        data.append(trace | {"error_x": {"array": sds, "thickness": 1, "width": 0}})
    half = 50 * sheet.dog.backlash_share
    layout = plain_layout("predicted, % of pitch (± 1 sd)", "phase at contact, % of pitch")
    layout["yaxis"] |= {"range": [-60, 60], "dtick": 25}
    layout["xaxis"] |= {"range": [-60, 60], "dtick": 25}
    diagonal = {"type": "line", "x0": -60, "y0": -60, "x1": 60, "y1": 60, "layer": "below",
                "line": {"color": GREY, "width": 1, "dash": "dot"}}  # fmt: skip
    layout["shapes"] = [gap_band("y", half, "x"), diagonal]
    return {"data": [trace for trace in data if trace["x"]], "layout": layout}


def _groups(runs: list[RunLike]) -> list[tuple[str, dict[str, str]]]:
    """The strategies that acted, each with its colour and symbol."""
    names = sorted({shift.row.strategy for run in runs for shift in run.shifts})
    return [(name, STYLES.get(name, OTHER_STYLE)) for name in names]


def _keyed(runs: list[RunLike]) -> list[tuple[str, ReportShift]]:
    return [(shift_key(r, s), shift) for r, run in enumerate(runs)
            for s, shift in enumerate(run.shifts)]  # fmt: skip


def shift_key(run: int, number: int) -> str:
    """What a link calls a shift, both counted from 0."""
    return f"shift-{run + 1}-{number + 1}"


def _points(name: str, style: dict[str, str], found: list[tuple[float, float, str]]) -> Figure:
    return {
        "type": "scatter", "mode": "markers", "name": name,
        "x": [round(x, 2) for x, _, _ in found], "y": [round(y, 2) for _, y, _ in found],
        "customdata": [key for _, _, key in found],
        "marker": {**style, "size": 9, "opacity": 0.8, "line": {"color": "white", "width": 1}},
    }  # fmt: skip


def gap_band(axis: str, half: float, along: str) -> Figure:
    """The gap as a band along a whole axis."""
    return {
        "type": "rect", f"{axis}0": -half, f"{axis}1": half, f"{along}ref": f"{along} domain",
        f"{along}0": 0, f"{along}1": 1, "fillcolor": GAP_BAND, "line": {"width": 0},
        "layer": "below",
    }  # fmt: skip


def plain_layout(x: str, y: str) -> dict[str, Any]:
    """The layout of a figure of one panel, its axes titled."""
    axis = {**axis_lines(), "zeroline": True, "zerolinecolor": "#b8b8b8"}
    return {
        "height": OVERVIEW_HEIGHT_PX,
        "margin": {"l": 64, "r": 10, "t": 30, "b": 76},
        **PAPER,
        "hovermode": "closest",
        "xaxis": {"title": {"text": x}, **axis},
        "yaxis": {"title": {"text": y, "standoff": 6}, **axis},
        "legend": {"orientation": "h", "x": 0.5, "xanchor": "center", "y": -0.24, "yanchor": "top"},
        "showlegend": True,
    }
