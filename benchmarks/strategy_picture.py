"""Draws one plan of release and firing: `docs/strategy.svg`.

    python -m benchmarks.strategy_picture docs/strategy.svg

What the controller predicts of slip and phase at the tick in which the brake's release is still
ahead, with the spread of the phase, and beside it what came, by the rig's truth. A shift in virtual
time, of a rigid driveline.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any, Final, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from meshpoint.bench.setup import Setup
from meshpoint.bench.simulate import simulate
from meshpoint.controller.core.core import ControllerCore
from meshpoint.controller.settings.settings import ControllerSettings, Window
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.link import read_alone
from meshpoint.dbc.messages import ShiftDecision, ShiftPrediction
from meshpoint.dbc.sensor_time import unwrap
from meshpoint.gearbox import GearboxSheet, load_sheet
from meshpoint.gearbox.gears import DRIVE_GEARS
from meshpoint.kernels.records import Vector
from meshpoint.report.collect import ReportCollector, ReportShift
from meshpoint.report.layout import BLUE, GREEN, GREY, INK, ORANGE
from meshpoint.report.phase import true_trajectory
from meshpoint.rig_sim.settings import Profile
from meshpoint.units import DEG, RPM

SEED: Final = 2
SHIFTS: Final = 4
PREDICTION: Final = CODECS[ShiftPrediction.__name__]
STEP_US: Final = 1_000
AHEAD_US: Final = 40_000
"""Drawn beyond the contact."""
LEAST_US: Final = 20_000
"""The release is ahead by at least this."""
NEAR_RPM: Final = 130.0
FROM_MS: Final = 40.0
CAME: Final = "what came, by the rig's truth:\nrelease and firing are planned again at each tick"


class Plan(NamedTuple):
    """What was planned, and what was predicted of it; times in us of the sensor clock."""

    message: ShiftPrediction
    from_us: float
    contact_us: float
    slip_rpm: Vector
    phase_deg: Vector
    """Unwrapped, around the gap that is aimed at."""
    sd_deg: Vector


class Watch:
    """Keeps the first plan of each shift whose release is still ahead."""

    def __init__(self, sheet: GearboxSheet) -> None:
        self.plans: dict[int, Plan] = {}
        """By the number of shifts that were over before it."""
        self._pitch_rad = sheet.dog.pitch_rad

    def look(self, core: ControllerCore, sent: list[Frame]) -> None:
        """After a step of the controller."""
        for frame in sent:
            if frame.can_id == PREDICTION.spec.can_id and core.shifts not in self.plans:
                message = read_alone(PREDICTION, frame)
                if isinstance(message, ShiftPrediction):
                    self._keep(core, message)

    def _keep(self, core: ControllerCore, message: ShiftPrediction) -> None:
        snapshot, shift = core.snapshot, core.running_shift
        ahead_us = (message.release_time_us - message.decision_time_us) % 2**32
        is_ahead = LEAST_US < ahead_us < 2**31
        is_aimed = message.decision is ShiftDecision.FIRE and message.phase_sd_rad > 0.0
        if not (is_aimed and is_ahead):
            return
        predictor = shift and snapshot and core.sequence.predictor(shift.target.main, snapshot)
        if not predictor:
            return
        start_us = predictor.layshaft.time_us
        contact_us = unwrap(message.contact_time_us, round(start_us))
        times = np.arange(start_us, contact_us + AHEAD_US, STEP_US).tolist()
        both = np.array([predictor.phase_and_slip(at) for at in times])
        phase = both[:, 0] - self._pitch_rad * np.round(
            predictor.phase_and_slip(contact_us)[0] / self._pitch_rad
        )
        sd = np.array([predictor.phase_sd_rad(at) for at in times])
        plan = Plan(message, start_us, contact_us, both[:, 1] / RPM, phase / DEG, sd / DEG)
        self.plans[core.shifts] = plan


def planned() -> tuple[Plan, ReportShift, GearboxSheet]:
    """The plan that is drawn, and its shift."""
    sheet = load_sheet("truck12")
    setup = Setup(sheet, ControllerSettings(), seed=SEED, shifts=SHIFTS, profile=Profile.CLEAN)
    watch, collector = Watch(sheet), ReportCollector(sheet)
    simulate(setup, lambda _time_us, frame: collector.receive(frame), on_step=watch.look)
    for number, shift in enumerate(collector.finish()):
        if number in watch.plans and shift.row.contact == "gap":
            return watch.plans[number], shift, sheet
    raise SystemExit(f"in {SHIFTS} shifts no release was planned together with an aimed firing")


def draw(plan: Plan, shift: ReportShift, sheet: GearboxSheet, path: Path) -> None:
    """The picture."""
    mpl.rcParams["svg.hashsalt"] = "meshpoint"
    figure = Figure(figsize=(9.5, 6.6), layout="constrained")
    axes = figure.subplots(2, 1, sharex=True, height_ratios=(2, 3))
    times_ms = np.arange(plan.slip_rpm.size) * STEP_US / 1e3
    zero_ms = shift.ms(round(plan.from_us) % 2**32)
    gear = DRIVE_GEARS[shift.row.to].main
    ratio = sheet.main_mesh(gear).ratio
    _slip(axes[0], plan, times_ms, _true_slip(shift, ratio, zero_ms), Window())
    _phase(axes[1], plan, times_ms, _true_phase(shift, gear.name.lower(), ratio, zero_ms), sheet)
    moments = {
        "brake valve off": plan.message.release_time_us,
        "sleeve valve on": plan.message.fire_time_us,
        "contact": plan.message.contact_time_us,
    }
    for above, (name, stamp) in enumerate(moments.items()):
        at_ms = shift.ms(stamp) - zero_ms
        for axis in axes:
            axis.axvline(at_ms, color=INK, lw=0.9, ls=":")
        axes[0].annotate(
            name, (at_ms, 1.0), xycoords=("data", "axes fraction"), textcoords="offset points",
            xytext=(0, 3 + 13 * (above % 2)), ha="center", va="bottom", weight="bold",
        )  # fmt: skip
    for axis in axes:
        axis.grid(alpha=0.25)
        axis.spines[["top", "right"]].set_visible(False)
    axes[1].set_xlabel("ms since the newest edge that the plan knows")
    axes[1].set_xlim(FROM_MS, times_ms[-1])
    figure.align_ylabels(axes)
    figure.suptitle(
        f"Release and firing planned together: gear {shift.row.from_} to {shift.row.to}\n"
        f"(simulated; sheet {sheet.name}, profile clean, seed {SEED})"
    )
    figure.savefig(path, metadata={"Date": None, "Creator": None})


def _slip(
    axis: Any, plan: Plan, times_ms: Vector, truth: tuple[Vector, Vector], window: Window
) -> None:
    low, high = window.contact_low_rad_s / RPM, window.contact_high_rad_s / RPM
    axis.axhspan(low, high, color=GREY, alpha=0.14, lw=0, label="allowed at contact")
    axis.plot(times_ms, plan.slip_rpm, color=BLUE, lw=2.4, label="predicted")
    axis.plot(*truth, color=INK, lw=1.0, label=CAME)
    axis.set_ylim(low - 10.0, NEAR_RPM)
    axis.set_ylabel("slip, rpm")
    axis.legend(loc="upper right", fontsize="small", framealpha=0.9, edgecolor="none")


def _phase(
    axis: Any, plan: Plan, times_ms: Vector, truth: tuple[Vector, Vector], sheet: GearboxSheet
) -> None:
    pitch, half = sheet.dog.pitch_rad / DEG, sheet.dog.backlash_rad / DEG / 2.0
    low, high = -1.3 * pitch, 1.3 * pitch
    for turn in (-1, 0, 1):
        axis.axhspan(
            turn * pitch - half, turn * pitch + half, color=GREEN, alpha=0.2, lw=0,
            label="gaps of the sleeve" if turn == 0 else None,
        )  # fmt: skip
    band = plan.phase_deg - plan.sd_deg, plan.phase_deg + plan.sd_deg
    axis.fill_between(times_ms, *band, color=BLUE, alpha=0.25, lw=0, label="its spread, ± 1 sd")
    axis.plot(times_ms, plan.phase_deg, color=BLUE, lw=2.4, label="tooth, predicted")
    axis.plot(*truth, color=INK, lw=1.0)
    contact_ms = (plan.contact_us - plan.from_us) / 1e3
    at = float(np.interp(contact_ms, times_ms, plan.phase_deg))
    sd = float(np.interp(contact_ms, times_ms, plan.sd_deg))
    axis.errorbar(
        [contact_ms], [at], [sd], color=ORANGE, marker="o", ms=7, mec=INK, capsize=5, lw=2,
        label=f"contact: {at:+.2f} ± {sd:.2f} deg", zorder=5,
    )  # fmt: skip
    axis.set_ylim(low, high)
    axis.set_ylabel("tooth against the sleeve, deg")
    axis.legend(loc="upper left", fontsize="small", framealpha=0.9, edgecolor="none")


def _true_slip(shift: ReportShift, ratio: float, zero_ms: float) -> tuple[Vector, Vector]:
    times, layshaft = (np.asarray(side) for side in shift.points("layshaft_rpm"))
    main = np.interp(times, *shift.points("main_rpm"))
    free = times <= (shift.contact_ms or times[-1])
    return times[free] - zero_ms, (ratio * layshaft - main)[free]


def _true_phase(
    shift: ReportShift, gear: str, ratio: float, zero_ms: float
) -> tuple[Vector, Vector]:
    found = true_trajectory(shift, gear, ratio)
    if found is None:
        raise SystemExit("the run has no truth")
    times, phase = found
    free = times <= (shift.contact_ms or times[-1])
    return times[free] - zero_ms, phase[free]


if __name__ == "__main__":
    draw(*planned(), Path(sys.argv[1]))
