"""What all figures of a report share: colours, panels, axes, and the gap as a band.

Colours are those of Okabe and Ito and one of Tol, which the colour blind can tell apart; what is
true is drawn dark and thin, what is believed blue with its bound.
"""

from __future__ import annotations

from typing import Any, Final

from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.gears import Sleeve

INK, GREY, GRID = "#1a1a1a", "#6b6b6b", "#e4e4e4"
BLUE, ORANGE, GREEN, PURPLE = "#0072b2", "#d55e00", "#009e73", "#aa4499"
BLUE_BAND, GAP_BAND = "rgba(0,114,178,.25)", "#d5efe4"
FONT: Final = {"family": "system-ui, 'Segoe UI', 'DejaVu Sans', sans-serif", "color": INK}
PAPER: Final = {
    "font": {**FONT, "size": 12}, "paper_bgcolor": "white", "plot_bgcolor": "white",
}  # fmt: skip
"""What every figure is printed on."""
SLIP_TOP_RPM: Final = 60.0
REPORT_HEIGHT_PX: Final = 1240
PITCHES_EACH_WAY: Final = 8
PANELS: Final = (
    ("speed, rpm", 2.8),
    ("slip, rpm", 2.0),
    ("brake, bar abs.", 1.5),
    ("", 1.5),
    ("sleeve, mm", 1.8),
    ("phase, % of pitch", 3.0),
    ("predicted phase<br>at contact, %", 2.2),
)
SPEED, SLIP, BRAKE, VALVE, SLEEVE, PHASE, PREDICTION = range(len(PANELS))
SPACE: Final = 0.018
SLEEVE_NAME: Final = {
    Sleeve.FIRST_SECOND: "sleeve_first_second_mm",
    Sleeve.CRAWL_THIRD: "sleeve_crawl_third_mm",
}
"""What a main sleeve's position is called among the traces."""
Figure = dict[str, Any]


def axis(panel: int) -> str:
    """What traces and shapes call the y axis of a panel."""
    return "y" if panel == 0 else f"y{panel + 1}"


def layout_key(panel: int) -> str:
    """What the layout calls the y axis of a panel."""
    return f"yaxis{panel + 1}" if panel else "yaxis"


def common_layout(sheet: GearboxSheet) -> Figure:
    """What the figures of all shifts share: panels, axes, legends and the gap."""
    layout: Figure = {
        "height": REPORT_HEIGHT_PX,
        "margin": {"l": 104, "r": 8, "t": 34, "b": 48},
        **PAPER,
        "hovermode": "x unified",
        "hoversubplots": "axis",
        "hoverlabel": {"bgcolor": "rgba(255,255,255,.92)", "font": {**FONT, "size": 11}},
        "dragmode": "zoom",
        "xaxis": {
            "domain": [0.0, 0.83],
            "anchor": axis(len(PANELS) - 1),
            "title": {"text": "time since the request, ms"},
            **axis_lines(),
            "showspikes": True,
            "spikemode": "across",
            "spikesnap": "cursor",
            "spikethickness": 1,
            "spikecolor": GREY,
            "spikedash": "dot",
            "hoverformat": ".1f",
        },
        "shapes": _gap_bands(sheet),
    }
    share = (1.0 - SPACE * (len(PANELS) - 1)) / sum(height for _, height in PANELS)
    top = 1.0
    for panel, (title, height) in enumerate(PANELS):
        bottom = max(0.0, top - share * height)
        layout[layout_key(panel)] = {
            "domain": [round(bottom, 5), round(top, 5)],
            "title": {"text": title, "standoff": 6},
            **axis_lines(),
            "automargin": False,
            "zeroline": panel in (SLIP, PHASE, PREDICTION),
            "zerolinecolor": "#b8b8b8",
            "nticks": 6,
        }
        layout[f"legend{panel + 1}" if panel else "legend"] = {
            "x": 0.84,
            "xanchor": "left",
            "y": round(top, 5),
            "yanchor": "top",
            "bgcolor": "rgba(0,0,0,0)",
            "font": {"size": 11},
            "traceorder": "normal",
        }
        top = bottom - SPACE
    layout[layout_key(SLIP)]["range"] = [-SLIP_TOP_RPM, SLIP_TOP_RPM]
    layout[layout_key(PHASE)]["dtick"] = 50
    layout[layout_key(PREDICTION)] |= {"range": [-50, 50], "dtick": 25}
    layout[layout_key(VALVE)] |= {"type": "category", "showgrid": False}
    return layout


def axis_lines() -> Figure:
    """An axis as a line with ticks outside and a light grid."""
    return {
        "showline": True,
        "linecolor": "#9a9a9a",
        "gridcolor": GRID,
        "ticks": "outside",
        "tickcolor": "#9a9a9a",
        "zeroline": False,
    }


def _gap_bands(sheet: GearboxSheet) -> list[Figure]:
    """The gaps of the sleeve in the phase panels: one every pitch."""
    half = 50.0 * sheet.dog.backlash_share
    each = range(-PITCHES_EACH_WAY, PITCHES_EACH_WAY + 1)
    bands = [_band(PHASE, 100.0 * n - half, 100.0 * n + half) for n in each]
    return [*bands, _band(PREDICTION, -half, half)]


def _band(panel: int, low: float, high: float) -> Figure:
    return {
        "type": "rect", "xref": "x domain", "x0": 0, "x1": 1, "yref": axis(panel),
        "y0": low, "y1": high, "fillcolor": GAP_BAND, "line": {"width": 0}, "layer": "below",
    }  # fmt: skip
