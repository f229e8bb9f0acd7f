"""A campaign's figures: where the teeth met, time against energy, curves of the gap rate."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from meshpoint.campaigns.columns import Shifts
from meshpoint.campaigns.intervals import rate_interval
from meshpoint.campaigns.summary import by_strategy
from meshpoint.report.layout import BLUE, GREEN, GREY, INK, ORANGE, PURPLE, Figure
from meshpoint.report.overview import gap_band, plain_layout

CAMPAIGN_COLOURS: Final = (ORANGE, BLUE, PURPLE, GREEN, GREY, INK)
BIN_PERCENT: Final = 2.5
BINS: Final = 6
LEAST_IN_A_BIN: Final = 5
CURVES: Final[dict[str, tuple[str, str]]] = {
    "slip": ("slip at first contact, rpm", "slip_rpm"),
    "backlash": ("backlash, % of pitch", "backlash_percent"),
    "scatter": ("scatter of the sleeve's delay, sd in ms", "delay_sd_ms"),
}
"""Title, and the column of the judged shifts."""


def phase_histogram(shifts: Shifts, names: tuple[str, ...], gap_percent: float) -> Figure:
    """Phase at first contact, share of the shifts a bin."""
    edges = np.arange(-50.0, 50.0 + BIN_PERCENT, BIN_PERCENT)
    data = []
    for colour, name in zip(CAMPAIGN_COLOURS, names, strict=False):
        own = shifts.by(name)
        found = 100.0 * own.column("phase_error_deg") / own.column("pitch_deg")
        found = found[~np.isnan(found)]
        share = 100.0 * np.histogram(found, edges)[0] / max(1, found.size)
        data.append(
            {
                "type": "scatter", "mode": "lines", "name": name,
                "line": {"shape": "hvh", "color": colour, "width": 2},
                "x": (edges[:-1] + BIN_PERCENT / 2.0).tolist(), "y": share.round(3).tolist(),
            }
        )  # fmt: skip
    layout = plain_layout(
        "phase at first contact beside the target, % of pitch", f"% of shifts a {BIN_PERCENT} %"
    )
    layout["xaxis"] |= {"range": [-51, 51], "dtick": 25}
    layout["shapes"] = [gap_band("x", gap_percent / 2.0, "y")]
    return {"data": data, "layout": layout}


def frontier(points: list[tuple[str, dict[str, Any]]], names: tuple[str, ...]) -> Figure:
    """Mean duration against mean loss in impacts, a line a strategy through the sweep's points."""
    data = []
    for colour, name in zip(CAMPAIGN_COLOURS, names, strict=False):
        found = sorted(
            (strategies[name]["duration_ms_mean"], strategies[name]["impact_j_mean"], label)
            for label, strategies in points
            if strategies[name]["duration_ms_mean"] is not None
        )
        data.append(
            {
                "type": "scatter", "mode": _mode(found), "name": name,
                "line": {"color": colour, "width": 1}, "marker": {"size": 9, "color": colour},
                "x": [x for x, _, _ in found], "y": [y for _, y, _ in found],
                "text": [label for _, _, label in found],
            }
        )  # fmt: skip
    layout = plain_layout("mean duration, ms", "mean loss in flank impacts, J")
    layout["yaxis"]["rangemode"] = "tozero"
    return {"data": data, "layout": layout}


def gap_curve(shifts: Shifts, names: tuple[str, ...], title: str, column: str) -> Figure:
    """Share of first contacts in a gap over something drawn, in bins of equally many shifts; where
    it takes few values, as in a sweep, one point a value."""
    data = []
    for colour, (name, shots) in zip(
        CAMPAIGN_COLOURS, by_strategy(shifts, names).items(), strict=False
    ):
        values = shots.shifts.column(column)
        has = ~np.isnan(values)
        known = values[has]
        xs, rates, up, down = [], [], [], []
        for chosen in _bins(known):
            hits = shots.is_gap[has][chosen]
            clusters = np.unique(shots.cluster[has][chosen], return_inverse=True)[1]
            low, high = rate_interval(hits, clusters)
            rate = float(hits.mean())
            xs.append(round(float(known[chosen].mean()), 4))
            rates.append(round(100 * rate, 3))
            up.append(round(100 * (high - rate), 3))
            down.append(round(100 * (rate - low), 3))
        data.append(
            {
                "type": "scatter", "mode": _mode(xs), "name": name, "x": xs, "y": rates,
                "line": {"color": colour, "width": 1}, "marker": {"size": 8, "color": colour},
                "error_y": {"array": up, "arrayminus": down, "thickness": 1, "width": 3},
            }
        )  # fmt: skip
    layout = plain_layout(title, "first contact in a gap, %")
    layout["yaxis"]["range"] = [0, 103]
    return {"data": data, "layout": layout}


def _mode(points: Sequence[object]) -> str:
    """Two points are no curve: a line between them would only look like one."""
    return "lines+markers" if len(points) > 2 else "markers"


def _bins(values: np.ndarray[Any, Any]) -> list[np.ndarray[Any, Any]]:
    """Which values belong together: equal ones where there are few, else equally many."""
    rounded = values.round(9)
    different = np.unique(rounded)
    if different.size <= BINS and different.size * LEAST_IN_A_BIN <= values.size:
        return [np.flatnonzero(rounded == value) for value in different]
    count = max(1, min(BINS, values.size // LEAST_IN_A_BIN))
    groups = np.array_split(np.argsort(values, kind="stable"), count)
    return [group for group in groups if group.size]
