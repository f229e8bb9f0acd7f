"""One shift as a picture: speeds, pressure and valves, sleeve, phase with the gap drawn."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.gears import DRIVE_GEARS, SLEEVE_OF_MAIN
from meshpoint.testbench.report.layout import SLEEVE_NAME
from meshpoint.testbench.results.rows import ShiftRow
from meshpoint.testbench.results.traces import Traces

BEFORE_S, AFTER_S = 0.05, 0.15


def plot_shift(path: Path, traces: Traces, row: ShiftRow, sheet: GearboxSheet) -> None:
    """Draws the shift of `row` into a PNG."""
    from matplotlib.figure import Figure  # loading it takes longer than most commands

    start, end = traces.time_s(row.request_us), traces.time_s(row.end_us)
    window = (start - BEFORE_S, end + AFTER_S)
    figure = Figure(figsize=(10, 9), layout="constrained")
    axes = figure.subplots(4, 1, sharex=True, height_ratios=(3, 2, 2, 3))
    draw = _Drawing(traces, window, start)
    gear = DRIVE_GEARS[row.to].main
    _speeds(axes[0], draw, sheet.main_mesh(gear).ratio)
    _pressure(axes[1], draw, gear.name.lower())
    _sleeve(axes[2], draw, SLEEVE_NAME[SLEEVE_OF_MAIN[gear].sleeve], sheet)
    _phase(axes[3], draw, gear.name.lower(), sheet)
    for axis in axes:
        axis.grid(alpha=0.3)
        if row.contact_us is not None:
            contact_ms = 1e3 * (traces.time_s(row.contact_us) - start)
            axis.axvline(contact_ms, color="black", lw=0.8, ls=":")
    axes[-1].set_xlabel("ms since the request (dotted: contact)")
    missed = "" if row.phase_error_deg is None else f", phase error {row.phase_error_deg:+.2f} deg"
    figure.suptitle(
        f"gear {row.from_} to {row.to}, {row.strategy}: {row.contact} at "
        f"{row.slip_rpm or 0.0:+.0f} rpm slip{missed} (simulated)"
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


class _Drawing:
    """Draws a series of the window in ms since the request."""

    def __init__(self, traces: Traces, window: tuple[float, float], start_s: float) -> None:
        self._traces, self._window, self._start_s = traces, window, start_s

    def line(self, axis: Any, name: str, scale: float = 1.0, **style: Any) -> None:
        series = self._traces.series.get(name)
        if series is None:
            return
        times, values = series.between(*self._window)
        axis.plot([1e3 * (t - self._start_s) for t in times], [scale * v for v in values], **style)


def _speeds(axis: Any, draw: _Drawing, ratio: float) -> None:
    draw.line(axis, "layshaft_rpm", ratio, label="target gear (truth)", color="tab:blue")
    draw.line(
        axis, "estimated_layshaft_rpm", ratio, label="target gear (estimated)",
        color="tab:orange", ls="none", marker=".", ms=4,
    )  # fmt: skip
    draw.line(axis, "main_rpm", label="sleeve on the main shaft", color="tab:green")
    axis.set_ylabel("rpm")
    axis.legend(loc="upper right", fontsize="small")


def _pressure(axis: Any, draw: _Drawing, gear: str) -> None:
    draw.line(axis, "pressure_bar", label="brake pressure, bar absolute", color="tab:red")
    draw.line(
        axis, "valve_brake", 4.0, label="brake valve", color="tab:red", alpha=0.5, ds="steps-post"
    )
    draw.line(
        axis, f"valve_main_{gear}", 4.0, label="sleeve valve", color="tab:purple", ds="steps-post"
    )
    axis.set_ylabel("bar, valves")
    axis.legend(loc="upper right", fontsize="small")


def _sleeve(axis: Any, draw: _Drawing, name: str, sheet: GearboxSheet) -> None:
    draw.line(axis, name, color="tab:purple")
    for side in (-1e3, 1e3):
        axis.axhline(side * sheet.sleeve.to_contact_m, color="grey", lw=0.8, ls="--")
    axis.set_ylabel("sleeve, mm\n(dashed: contact)")


def _phase(axis: Any, draw: _Drawing, gear: str, sheet: GearboxSheet) -> None:
    half_gap = math.degrees(sheet.dog.backlash_rad) / 2.0
    half_pitch = math.degrees(sheet.dog.pitch_rad) / 2.0
    axis.axhspan(-half_gap, half_gap, color="tab:green", alpha=0.2, label="gap")
    style: dict[str, Any] = {"ls": "none", "marker": ".", "ms": 4}
    draw.line(axis, f"phase_{gear}_deg", label="phase (truth)", color="tab:blue", **style)
    draw.line(axis, "estimated_phase_deg", label="phase (estimated)", color="tab:orange", **style)
    axis.set_ylim(-half_pitch, half_pitch)
    axis.set_ylabel("phase, deg")
    axis.legend(loc="upper right", fontsize="small")
