"""Draws a sleeve that is stopped in flight and fired again: `docs/abort.png`.

    python -m benchmarks.abort_picture docs/abort.png

One shift of a virtual truck in virtual time, all of it by the rig's truth: where the sleeve is, its
two valves, the air in its two chambers, and the tooth that it meets.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from matplotlib.figure import Figure

import meshpoint
from meshpoint.api.bench import rig_settings
from meshpoint.api.choices import setup_of
from meshpoint.bus.core import AroundCore, Step
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.gears import DRIVE_GEARS, SLEEVE_OF_MAIN, MainGear
from meshpoint.kernels.records import Integers, Vector
from meshpoint.report.layout import BLUE, GREEN, GREY, INK, ORANGE
from meshpoint.results.rows import ShiftRow
from meshpoint.rig_sim.core import RigCore
from meshpoint.rig_sim.truck.truth import TruckTruth
from meshpoint.units import BAR, DEG, MM

SEED: Final = 4
START: Final = 8
LEARNED: Final = (10, 12)
SHIFTS: Final = (10, 12) * 10
"""Into these gears, once the phases of `LEARNED` are known; the first one is drawn whose sleeve is
stopped well out of neutral, fired again from there, and meets a gap."""
OUT_MM: Final = 0.7
SAMPLE_US: Final = 200
BEFORE_MS, AFTER_MS = 12.0, 28.0
"""Drawn before the first firing and after the contact."""


class Sample(NamedTuple):
    """The rig's truth at an instant, seen in the direction of the gear."""

    time_us: float
    position_m: float
    towards_coil: bool
    against_coil: bool
    towards_pa: float
    against_pa: float
    phase_rad: float
    contact_us: float
    """When the sleeve would meet the gear, if its valve has just gone on; else not a number."""


class WatchedRig(AroundCore[RigCore]):
    """A rig that is sampled every fifth of a millisecond while a gear is watched."""

    def __init__(self, core: RigCore, sheet: GearboxSheet) -> None:
        super().__init__(core)
        self.sheet = sheet
        self.samples: list[Sample] = []
        self._gear: MainGear | None = None
        self._sample_us = 0

    def watch(self, gear: MainGear) -> None:
        """From now on; what was seen before is forgotten."""
        self._gear = gear
        self.samples.clear()

    @property
    def next_step_us(self) -> int:
        """The rig's own next step, or the next sample."""
        due_us = self._core.next_step_us
        return due_us if self._gear is None else min(due_us, self._sample_us)

    def step(self, now_us: int) -> Step:
        """The rig's step, then a sample of it."""
        step = self._core.step(now_us)
        self._sample_us = now_us + SAMPLE_US
        truth = self._core.truth
        if self._gear is not None and isinstance(truth, TruckTruth):
            was_on = bool(self.samples) and self.samples[-1].towards_coil
            self.samples.append(_sample(truth, self._gear, was_on=was_on))
        return step


def _sample(truth: TruckTruth, gear: MainGear, *, was_on: bool) -> Sample:
    where, time_us = SLEEVE_OF_MAIN[gear], truth.time_us
    axis = truth.axis(where.sleeve, time_us)
    own = 0 if where.direction > 0 else 1
    contact_us = math.nan
    if axis.coils[own] and not was_on:
        contact_us = truth.expected_contact_us(gear, time_us)[0] + truth.clock_start_us
    return Sample(
        time_us + truth.clock_start_us,
        axis.position_m * where.direction,
        axis.coils[own],
        axis.coils[1 - own],
        axis.pressures_pa[own],
        axis.pressures_pa[1 - own],
        truth.phase_rad(gear),
        contact_us,
    )


class Seen(NamedTuple):
    """The shift that is drawn, from before its last firing from neutral on."""

    row: ShiftRow
    sheet: GearboxSheet
    samples: dict[str, Vector]
    ms: Vector
    """Of each sample, since the first firing that is drawn."""
    fired_ms: float
    aborted_ms: float
    held_ms: float
    """From here on both valves are off."""
    again_ms: float
    missed_ms: float
    """When the sleeve would have met the gear without the abort."""
    contact_ms: float


def watched_shifts(seed: int, gears: Sequence[int]) -> Iterator[tuple[ShiftRow, WatchedRig]]:
    """Makes one shift after the other, and what was seen of each."""
    setup = setup_of(None, "truck", seed, "typical", (), ControllerSettings())
    rig = WatchedRig(RigCore(setup.sheet, rig_settings(setup, START)), setup.sheet)
    with meshpoint.Bench(seed=seed, as_built="typical", gear=START, rig=rig) as bench:
        bench.learn(*LEARNED)
        for gear in gears:
            rig.watch(DRIVE_GEARS[gear].main)
            yield bench.shift(gear), rig


def watched_shift() -> Seen:
    """The shift that is drawn."""
    for row, rig in watched_shifts(SEED, SHIFTS):
        if row.contact == "gap" and row.aborts == 1 and abs(row.halt_mm or 0.0) > OUT_MM:
            every = [np.array(values) for values in zip(*rig.samples, strict=True)]
            return _cut(row, rig.sheet, dict(zip(Sample._fields, every, strict=True)))
    raise SystemExit(f"in {len(SHIFTS)} shifts no sleeve was stopped and fired again")


def _cut(row: ShiftRow, sheet: GearboxSheet, samples: dict[str, Vector]) -> Seen:
    """The last firing, the abort and the firing before it, and what is drawn of them."""
    us = samples["time_us"]
    fired, again = us[_turns(samples["towards_coil"], on=True)][-2:]
    aborted = _last_before(us[_turns(samples["towards_coil"], on=False)], again)
    held = _last_before(us[_turns(samples["against_coil"], on=False)], again)
    if row.contact_us is None or not fired < aborted < held:
        raise SystemExit(f"no sleeve that is stopped and fired again: {row}")
    contact = us[np.flatnonzero(us % 2**32 <= row.contact_us)[-1]]
    drawn = (us > fired - 1e3 * BEFORE_MS) & (us < contact + 1e3 * AFTER_MS)
    missed = samples["contact_us"][np.flatnonzero(us >= fired)[0]]
    moments = (fired, aborted, held, again, missed, contact)
    kept = {name: values[drawn] for name, values in samples.items()}
    since = [float(moment - fired) / 1e3 for moment in moments]
    return Seen(row, sheet, kept, (us[drawn] - fired) / 1e3, *since)


def _last_before(times_us: Vector, time_us: float) -> float:
    return float(times_us[times_us < time_us][-1])


def _turns(coil: Vector, *, on: bool) -> Integers:
    """The samples at which a coil has just gone on, or off."""
    return np.flatnonzero(np.diff(coil.astype(int)) == (1 if on else -1)) + 1


def draw(seen: Seen, path: Path) -> None:
    """The picture."""
    figure = Figure(figsize=(10, 9), layout="constrained")
    axes = figure.subplots(4, 1, sharex=True, height_ratios=(3.2, 1.2, 2.4, 3.2))
    for axis, panel in zip(axes, (_sleeve, _valves, _chambers, _phase), strict=True):
        panel(axis, seen)
        axis.grid(alpha=0.25)
        axis.spines[["top", "right"]].set_visible(False)
        for moment in (seen.fired_ms, seen.aborted_ms, seen.again_ms, seen.contact_ms):
            axis.axvline(moment, color=INK, lw=0.9, ls=":")
    _name_moments(axes[0], seen)
    axes[-1].set_xlabel("ms since the firing")
    axes[-1].set_xlim(seen.ms[0], seen.ms[-1])
    figure.align_ylabels(axes)
    row = seen.row
    figure.suptitle(
        f"A sleeve that would meet a tooth is stopped short of it and fired again: gear "
        f"{row.from_} to {row.to}\n(simulated truth; sheet truck12, profile typical, seed {SEED})"
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110, metadata={"Software": None})


def _name_moments(axis: Any, seen: Seen) -> None:
    named = {
        "fired": seen.fired_ms,
        "aborted": seen.aborted_ms,
        "fired again": seen.again_ms,
        "gap met": seen.contact_ms,
    }
    for name, moment in named.items():
        axis.annotate(
            name, (moment, 1.0), xycoords=("data", "axes fraction"), xytext=(0, 3),
            textcoords="offset points", ha="center", va="bottom", color=INK, weight="bold",
        )  # fmt: skip


def _sleeve(axis: Any, seen: Seen) -> None:
    sleeve = seen.sheet.sleeve
    teeth_mm, stroke_mm = sleeve.to_contact_m / MM, sleeve.stroke_m / MM
    axis.axhspan(teeth_mm, stroke_mm, color=GREY, alpha=0.14, lw=0)
    axis.axhline(teeth_mm, color=GREY, lw=0.9)
    place_mm = seen.samples["position_m"] / MM
    axis.plot(seen.ms, place_mm, color=INK, lw=2.0)
    stands_mm = float(np.interp(seen.again_ms, seen.ms, place_mm))
    middle_ms = (seen.held_ms + seen.again_ms) / 2.0
    teeth = "the gear's teeth"
    axis.text(middle_ms, teeth_mm + 0.25, teeth, ha="center", fontsize="small", color=GREY)
    held = f"held by friction,\n{teeth_mm - stands_mm:.1f} mm before the teeth"
    axis.text(middle_ms, stands_mm + 0.6, held, ha="center", va="bottom", fontsize="small")
    axis.set_ylim(-0.4, stroke_mm + 0.4)
    axis.set_ylabel("sleeve, mm\nfrom neutral")


def _valves(axis: Any, seen: Seen) -> None:
    for lane, (name, colour) in enumerate((("against_coil", ORANGE), ("towards_coil", BLUE))):
        on = seen.samples[name].astype(bool)
        axis.fill_between(seen.ms, lane, lane + 0.7, where=on, color=colour, lw=0, step="post")
    axis.set_yticks([0.35, 1.35], ["against it", "towards the gear"])
    axis.set_ylim(-0.2, 1.9)
    axis.set_ylabel("valves\n(current on)")


def _chambers(axis: Any, seen: Seen) -> None:
    base_pa = seen.sheet.air.atmosphere_pa
    for name, colour, label in (
        ("towards_pa", BLUE, "chamber that pushes towards the gear"),
        ("against_pa", ORANGE, "chamber that pushes against it"),
    ):
        axis.plot(seen.ms, (seen.samples[name] - base_pa) / BAR, color=colour, lw=1.8, label=label)
    axis.set_ylabel("air in the\nchambers, bar")
    axis.legend(loc="upper center", fontsize="small", frameon=False)


def _phase(axis: Any, seen: Seen) -> None:
    pitch = seen.sheet.dog.pitch_rad / DEG
    half_gap = seen.sheet.dog.backlash_rad / DEG / 2.0
    phase = np.unwrap(seen.samples["phase_rad"] / DEG, period=pitch)
    phase -= pitch * np.round(np.interp(seen.contact_ms, seen.ms, phase) / pitch)
    low, high = float(phase.min()) - 0.3 * pitch, float(phase.max()) + 0.3 * pitch
    for turn in range(int(low // pitch) - 1, int(high // pitch) + 2):
        axis.axhspan(
            turn * pitch - half_gap, turn * pitch + half_gap, color=GREEN, alpha=0.2, lw=0,
            label="gaps of the sleeve" if turn == 0 else None,
        )  # fmt: skip
    free = seen.ms <= seen.contact_ms
    axis.plot(seen.ms[free], phase[free], color=INK, lw=2.0, label="the gear's tooth")
    axis.plot(seen.ms[~free], phase[~free], color=INK, lw=2.0, alpha=0.35)
    marks = (
        (seen.missed_ms, "X", ORANGE, "where it would have met without the abort"),
        (seen.contact_ms, "o", GREEN, "where it meets"),
    )
    for moment, marker, colour, label in marks:
        axis.plot(
            [moment], [np.interp(moment, seen.ms, phase)], ls="none", marker=marker, ms=11,
            color=colour, mec=INK, label=label, zorder=5,
        )  # fmt: skip
    axis.set_ylim(low, high + 0.5 * pitch)
    axis.set_ylabel("tooth against\nthe sleeve, deg")
    axis.legend(loc="upper left", fontsize="small", framealpha=0.9, edgecolor="none")


if __name__ == "__main__":
    draw(watched_shift(), Path(sys.argv[1]))
