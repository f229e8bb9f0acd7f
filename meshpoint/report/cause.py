"""Why a sleeve met a tooth, or was stopped before it did: a sentence a shift.

What was promised is the prediction that was fired on; what came of it is the rig's truth, or
without one the controller's own estimate afterwards. In between, the truth is put in the place of
one belief after the other: when the sleeve arrives, how the layshaft turns until then, how the main
shaft does, and what the phase was when it was planned. The sum of the four is what the prediction
was off by. Of a log whose controller is not repeated the shafts' beliefs are not known apart: they
are one part then.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np

from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.gears import DRIVE_GEARS
from meshpoint.kernels.records import Vector
from meshpoint.report.beliefs import Belief
from meshpoint.report.collect import Firing, Points, ReportShift
from meshpoint.report.phase import DEG_PER_RPM_MS, true_trajectory
from meshpoint.results.faults import MEANING
from meshpoint.results.rows import is_aimed
from meshpoint.units import DEG, MS_US

JUMP_RPM: Final = 4.0
"""A main shaft that changes its speed by more from one sample of the truth to the next, 10 ms
later, was struck: free of torque it does not."""


class Part(NamedTuple):
    """What one belief's error has made of the phase at contact, and how that came about."""

    name: str
    deg: float
    how: str

    def __str__(self) -> str:
        return f"{self.name} {self.deg:+.2f}" + (f" ({self.how})" if self.how else "")


class _Truth(NamedTuple):
    """The shafts by the rig's reference, over the time since the request (ms)."""

    phase_deg: Points
    layshaft_rpm: Points
    main_rpm: Points
    ratio: float

    def phase_at(self, at_ms: float) -> float:
        return float(np.interp(at_ms, *self.phase_deg))

    def slip_rpm(self, at_ms: float) -> float:
        layshaft, main = (np.interp(at_ms, *p) for p in (self.layshaft_rpm, self.main_rpm))
        return float(self.ratio * layshaft - main)

    def gear_turns_deg(self, from_ms: float, to_ms: float) -> float:
        """By how much the layshaft turns the gear."""
        times, rpm = (np.asarray(side) for side in self.layshaft_rpm)
        inside = times[(times > from_ms) & (times < to_ms)]
        grid: Vector = np.concatenate(([from_ms], inside, [to_ms]))
        speed = self.ratio * np.interp(grid, times, rpm)
        return float(DEG_PER_RPM_MS * np.sum(0.5 * (speed[1:] + speed[:-1]) * np.diff(grid)))


def cause(shift: ReportShift, sheet: GearboxSheet) -> str | None:
    """The sentence of a shift that missed its gap, aborted a firing, or failed; None of another."""
    said = _missed(shift, sheet) or _aborted(shift, sheet)
    row = shift.row
    if row.result == "engaged":
        return said
    failed = f"Not engaged, {row.result.replace('_', ' ')}"
    failed += "" if row.fault == "none" else f": {MEANING[shift.outcome.fault]}"
    return f"{failed}. {said}" if said else f"{failed}."


def _missed(shift: ReportShift, sheet: GearboxSheet) -> str | None:
    """Why the first contact met a tooth."""
    row, half_deg = shift.row, 0.5 * sheet.dog.backlash_rad / DEG
    if row.contact == "tooth" and not is_aimed(row):
        why = "this strategy does not aim"
        if row.reference != "known":
            why = "where the gear's teeth are was not known yet"
        return f"Met a tooth by chance: {why}."
    at_ms, met_deg, by = _contact(shift, half_deg)
    firing = shift.fired_before(at_ms) if at_ms else None
    if at_ms is None or met_deg is None or firing is None or not is_aimed(row):
        return None
    parts = _parts(shift, sheet, firing, at_ms, met_deg)
    aborts = sum(aborted_ms < at_ms for aborted_ms in shift.aborted_ms)
    after = {0: "", 1: ", after an abort"}.get(aborts, f", after {aborts} aborts")
    return (
        f"Fired for {_expected(firing)} deg{after}, met a tooth at {met_deg:+.2f}{by} "
        f"(the gap ends at ±{half_deg:.2f}): {_sum(parts)}."
    )


def _contact(shift: ReportShift, half_deg: float) -> tuple[float | None, float | None, str]:
    """When and at which phase a tooth was met, and by which witness; None where none was."""
    row, outcome = shift.row, shift.outcome
    if row.contact is not None:
        is_tooth = row.contact == "tooth"
        return (shift.contact_ms, shift.contact_phase_deg, "") if is_tooth else (None, None, "")
    estimated_deg = outcome.estimated_phase_rad / DEG
    if outcome.measured_contact_time_us == 0 or abs(estimated_deg) <= half_deg:
        return None, None, ""
    at_ms = shift.ms(outcome.measured_contact_time_us)
    return at_ms, estimated_deg, " by the controller's own estimate"


def _aborted(shift: ReportShift, sheet: GearboxSheet) -> str | None:
    """Why the last sleeve that was stopped on its way was."""
    if not shift.aborted_ms:
        return None
    at_ms, row = shift.aborted_ms[-1], shift.row
    firing = next((f for f in reversed(shift.firings) if f.decided_ms < at_ms), None)
    stopped = f"stopped {at_ms - firing.fire_ms:.0f} ms later" if firing else "stopped"
    which = "" if len(shift.aborted_ms) == 1 else f", the last of {row.aborts} aborts"
    if firing is None or not firing.sd_deg:
        return f"A sleeve on its way was {stopped}{which}: its contact was not aimed at."
    truth = _truth(shift, sheet)
    fired = f"Fired for {_expected(firing)} deg, {stopped}{which}"
    if truth is None:
        return f"{fired}: the phase that was expected in flight is not in the log."
    pitch_deg, half_deg = row.pitch_deg, 0.5 * sheet.dog.backlash_rad / DEG
    would_deg = math.remainder(truth.phase_at(firing.contact_ms), pitch_deg)
    meets, vain = ("the gap", " in vain") if abs(would_deg) < half_deg else ("a tooth", "")
    parts = _parts(shift, sheet, firing, firing.contact_ms, would_deg)
    return f"{fired}{vain}: it would have met {meets} at {would_deg:+.2f} deg: {_sum(parts)}."


def _expected(firing: Firing) -> str:
    return f"{firing.phase_deg:+.2f} ± {firing.sd_deg:.2f}"


def _sum(parts: list[Part]) -> str:
    """The whole, then its parts, the largest first."""
    ordered = sorted(parts, key=lambda part: -abs(part.deg))
    whole = sum(part.deg for part in parts)
    shares = [str(ordered[0]), *(str(part._replace(how="")) for part in ordered[1:])]
    return f"{whole:+.2f} deg off, of which {', '.join(shares)}"


def _parts(
    shift: ReportShift, sheet: GearboxSheet, firing: Firing, at_ms: float, met_deg: float
) -> list[Part]:
    """Of the phase at a contact less the one that was predicted."""
    truth, belief = _truth(shift, sheet), firing.belief
    late_ms, slip_rpm, pitch_deg = at_ms - firing.contact_ms, firing.slip_rpm, shift.row.pitch_deg
    sleeve_deg = DEG_PER_RPM_MS * slip_rpm * late_ms
    if truth is None or belief is None:
        whole_deg = math.remainder(met_deg - firing.phase_deg, pitch_deg)
        rest = "the log says no more"
        if truth is not None:
            rest = f"slip {truth.slip_rpm(at_ms):+.0f} instead of {slip_rpm:+.0f} rpm"
        return [
            Part("the sleeve", sleeve_deg, _late(late_ms, slip_rpm)),
            Part("shafts and reference", whole_deg - sleeve_deg, rest),
        ]
    from_ms = firing.contact_ms - belief.before_contact_us / MS_US
    layshaft_deg, main_deg = _moved(belief, at_ms - from_ms)
    planned_deg = _moved(belief, firing.contact_ms - from_ms)
    sleeve_deg = layshaft_deg - main_deg - (planned_deg[0] - planned_deg[1])
    turned_deg = truth.gear_turns_deg(from_ms, at_ms)
    main_turned_deg = turned_deg - (truth.phase_at(at_ms) - truth.phase_at(from_ms))
    off_deg = math.remainder(truth.phase_at(from_ms) - belief.phase_rad / DEG, pitch_deg)
    of_layshaft, of_main = turned_deg - layshaft_deg, main_deg - main_turned_deg
    after_ms = at_ms - from_ms
    return [
        Part("the sleeve", sleeve_deg, _late(late_ms, slip_rpm)),
        Part("the layshaft", of_layshaft, _faster("gear", of_layshaft, after_ms)),
        Part("the main shaft", of_main, _of_main(truth, from_ms, at_ms, of_main)),
        Part("the reference", off_deg, "so far off was the phase when it was fired"),
    ]


def _moved(belief: Belief, after_ms: float) -> tuple[float, float]:
    layshaft_rad, main_rad = belief.moved_rad(after_ms * MS_US)
    return layshaft_rad / DEG, main_rad / DEG


def _late(late_ms: float, slip_rpm: float) -> str:
    late = "late" if late_ms > 0.0 else "early"
    return f"{abs(late_ms):.1f} ms {late} at {slip_rpm:+.0f} rpm of slip"


def _faster(what: str, deg: float, within_ms: float) -> str:
    rpm = deg / (DEG_PER_RPM_MS * max(within_ms, 1.0))
    than = "faster" if rpm > 0.0 else "slower"
    return f"its {what} turned {abs(rpm):.1f} rpm {than} than predicted"


def _of_main(truth: _Truth, from_ms: float, at_ms: float, deg: float) -> str:
    """A jump of the main shaft's speed, where there is one that goes the same way; it turns
    faster where the phase falls back."""
    inside = [(t, n) for t, n in zip(*truth.main_rpm, strict=True) if from_ms - 10.0 < t < at_ms]
    jumps = [(b[1] - a[1], a[0], b[0]) for a, b in pairwise(inside)]
    jump, before_ms, after_ms = max(
        jumps, key=lambda found: -found[0] * math.copysign(1.0, deg), default=(0.0, 0.0, 0.0)
    )
    if -jump * math.copysign(1.0, deg) < JUMP_RPM:
        return _faster("shaft", -deg, at_ms - from_ms)
    ago_ms = at_ms - 0.5 * (before_ms + after_ms)
    slips = f"{truth.slip_rpm(before_ms):+.0f} to {truth.slip_rpm(after_ms):+.0f} rpm"
    return f"struck {ago_ms:.0f} ms before contact, which took the slip from {slips}"


def _truth(shift: ReportShift, sheet: GearboxSheet) -> _Truth | None:
    """None where the log has none."""
    gear = DRIVE_GEARS[shift.row.to].main
    ratio = sheet.main_mesh(gear).ratio
    trajectory = true_trajectory(shift, gear.name.lower(), ratio)
    if trajectory is None:
        return None
    times, phases = trajectory
    phase: Points = (times.tolist(), phases.tolist())
    return _Truth(phase, shift.points("layshaft_rpm"), shift.points("main_rpm"), ratio)
