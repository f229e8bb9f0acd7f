"""One shift as a picture: speeds, pressure and valves, sleeve, phase with the gaps drawn."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Final

from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.gears import DRIVE_GEARS, SLEEVE_OF_MAIN
from meshpoint.report.collect import Points, ReportShift
from meshpoint.report.layout import SLEEVE_NAME
from meshpoint.report.phase import estimated_phase, true_phase

PITCHES_BEFORE: Final = 2.6
PITCHES_BEYOND: Final = 1.1
"""How much of the phase's trajectory is drawn on the side it comes from, and on the other."""


def plot_shift(path: Path, shift: ReportShift, sheet: GearboxSheet, gearbox: str) -> None:
    """Draws the shift into a PNG. gearbox: which one, as the title says it."""
    from matplotlib.figure import Figure  # loading it takes longer than most commands

    row = shift.row
    figure = Figure(figsize=(10, 9), layout="constrained")
    axes = figure.subplots(4, 1, sharex=True, height_ratios=(3, 2, 2, 3))
    gear = DRIVE_GEARS[row.to].main
    ratio = sheet.main_mesh(gear).ratio
    _speeds(axes[0], shift, ratio)
    _pressure(axes[1], shift, gear.name.lower())
    _sleeve(axes[2], shift, SLEEVE_NAME[SLEEVE_OF_MAIN[gear].sleeve], sheet)
    _phase(axes[3], shift, gear.name.lower(), sheet)
    for axis in axes:
        axis.grid(alpha=0.3)
        if shift.contact_ms is not None:
            axis.axvline(shift.contact_ms, color="black", lw=0.8, ls=":")
    axes[-1].set_xlabel("ms since the request (dotted: contact)")
    missed = "" if row.phase_error_deg is None else f", phase error {row.phase_error_deg:+.2f} deg"
    figure.suptitle(
        f"gear {row.from_} to {row.to}, {row.strategy}: {row.contact} at "
        f"{row.slip_rpm or 0.0:+.0f} rpm slip{missed}\n(simulated, {gearbox})"
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def _line(axis: Any, points: Points, scale: float = 1.0, **style: Any) -> None:
    times_ms, values = points
    if times_ms:
        axis.plot(times_ms, [scale * value for value in values], **style)


def _speeds(axis: Any, shift: ReportShift, ratio: float) -> None:
    _line(axis, shift.points("layshaft_rpm"), ratio, label="target gear (truth)", color="tab:blue")
    _line(
        axis, shift.points("estimated_layshaft_rpm"), ratio, label="target gear (estimated)",
        color="tab:orange", ls="none", marker=".", ms=4,
    )  # fmt: skip
    _line(axis, shift.points("main_rpm"), label="sleeve on the main shaft", color="tab:green")
    axis.set_ylabel("rpm")
    if axis.get_legend_handles_labels()[0]:  # none of them is on a classic bus
        axis.legend(loc="upper right", fontsize="small")


def _pressure(axis: Any, shift: ReportShift, gear: str) -> None:
    _line(axis, shift.points("pressure_bar"), label="brake pressure, bar absolute", color="tab:red")
    steps: dict[str, Any] = {"ds": "steps-post"}
    _line(
        axis, shift.points("valve_brake"), 4.0, label="brake valve", color="tab:red", alpha=0.5,
        **steps,
    )  # fmt: skip
    _line(
        axis, shift.points(f"valve_main_{gear}"), 4.0, label="sleeve valve", color="tab:purple",
        **steps,
    )  # fmt: skip
    axis.set_ylabel("bar, valves")
    axis.legend(loc="upper right", fontsize="small")


def _sleeve(axis: Any, shift: ReportShift, name: str, sheet: GearboxSheet) -> None:
    _line(axis, shift.points(name), color="tab:purple")
    _line(
        axis, shift.aborts_on(name), ls="none", marker="X", ms=8, mec="black", color="tab:red",
        label="aborted",
    )  # fmt: skip
    if shift.aborted_ms:
        axis.legend(loc="upper left", fontsize="small")
    for side in (-1e3, 1e3):
        axis.axhline(side * sheet.sleeve.to_contact_m, color="grey", lw=0.8, ls="--")
    axis.set_ylabel("sleeve, mm\n(dashed: contact)")


def _phase(axis: Any, shift: ReportShift, gear: str, sheet: GearboxSheet) -> None:
    """The tooth's trajectory past the gaps of the sleeve, to the gap it meets or misses."""
    ratio = sheet.main_mesh(DRIVE_GEARS[shift.row.to].main).ratio
    half_gap = math.degrees(sheet.dog.backlash_rad) / 2.0
    pitch = math.degrees(sheet.dog.pitch_rad)
    for turn in range(-4, 5):
        axis.axhspan(
            turn * pitch - half_gap, turn * pitch + half_gap, color="tab:green", alpha=0.2, lw=0,
            label="gaps of the sleeve" if turn == 0 else None,
        )  # fmt: skip
    truth = true_phase(shift, gear, ratio)
    _line(axis, truth, label="gear tooth (truth)", color="tab:blue")
    _line(
        axis, estimated_phase(shift, ratio, truth), label="estimated", color="tab:orange",
        ls="none", marker=".", ms=5,
    )  # fmt: skip
    if shift.contact_ms is not None and shift.contact_phase_deg is not None:
        good = shift.row.contact == "gap"
        axis.plot(
            [shift.contact_ms], [shift.contact_phase_deg], ls="none", ms=10, mec="black",
            marker="o" if good else "X", color="tab:green" if good else "tab:red",
            label=f"contact: {shift.row.contact}",
        )  # fmt: skip
    before, beyond = PITCHES_BEFORE * pitch, PITCHES_BEYOND * pitch
    reversed_ = (shift.row.slip_rpm or 0.0) < 0.0
    axis.set_ylim((-beyond, before) if reversed_ else (-before, beyond))
    axis.set_ylabel("gear tooth against\nthe sleeve, deg")
    axis.legend(loc="lower right", fontsize="small")
