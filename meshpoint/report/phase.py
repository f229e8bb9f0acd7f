"""The phase of a gear as a curve: samples wrapped to half a pitch, joined by what the slip says.

Between two samples the slip shows about how many pitches went by, the samples tell the rest.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from meshpoint.kernels.records import Vector
from meshpoint.report.collect import Points, ReportShift

DEG_PER_RPM_MS: Final = 0.006


def unwrapped_deg(
    times_ms: Vector, phase_deg: Vector, slip_rpm: Vector, pitch_deg: float
) -> Vector:
    """The phase without its jumps. All of one length; times rise."""
    if len(times_ms) < 2:
        return phase_deg
    mean_rpm = 0.5 * (slip_rpm[1:] + slip_rpm[:-1])
    expected = mean_rpm * DEG_PER_RPM_MS * np.diff(times_ms)
    seen = np.diff(phase_deg)
    steps = seen + pitch_deg * np.round((expected - seen) / pitch_deg)
    return np.concatenate((phase_deg[:1], phase_deg[0] + np.cumsum(steps)))


def onto_branch(phase_deg: Vector, near_deg: Vector, pitch_deg: float) -> Vector:
    """The phase shifted by whole pitches to where it lies nearest to another curve."""
    shifted: Vector = phase_deg + pitch_deg * np.round((near_deg - phase_deg) / pitch_deg)
    return shifted


def true_phase(shift: ReportShift, gear: str, ratio: float) -> Points:
    """The rig's truth in degrees, in the pitch of the contact at the moment of contact."""
    times_ms, phase = shift.points(f"phase_{gear}_deg")
    at_ms, layshaft = shift.points("layshaft_rpm")
    main_ms, main = shift.points("main_rpm")
    if not times_ms or not at_ms or not main_ms:
        return [], []
    times = np.asarray(times_ms)
    slip = ratio * np.interp(times, at_ms, layshaft) - np.interp(times, main_ms, main)
    pitch = shift.row.pitch_deg
    curve = unwrapped_deg(times, np.asarray(phase), slip, pitch)
    return times_ms, _anchored(shift, times, curve, pitch)


def estimated_phase(shift: ReportShift, ratio: float, truth: Points) -> Points:
    """The controller's estimate in degrees, beside the truth where there is one."""
    times_ms, phase = shift.points("estimated_phase_deg")
    if not times_ms:
        return [], []
    times, pitch = np.asarray(times_ms), shift.row.pitch_deg
    if truth[0]:
        near = np.interp(times, *truth)
        return times_ms, onto_branch(np.asarray(phase), near, pitch).tolist()
    at_ms, layshaft = shift.points("estimated_layshaft_rpm")
    main_ms, main = shift.points("estimated_main_rpm")
    if not at_ms or not main_ms:
        return [], []
    slip = ratio * np.interp(times, at_ms, layshaft) - np.interp(times, main_ms, main)
    curve = unwrapped_deg(times, np.asarray(phase), slip, pitch)
    return times_ms, _anchored(shift, times, curve, pitch)


def true_trajectory(shift: ReportShift, gear: str, ratio: float) -> tuple[Vector, Vector] | None:
    """The rig's truth in degrees at the encoder's rate: its samples, 10 ms apart, joined by the
    slip. Times in ms; None without them."""
    sample_ms, sample_deg = true_phase(shift, gear, ratio)
    layshaft, main = shift.points("layshaft_rpm"), shift.points("main_rpm")
    if len(sample_ms) < 2:
        return None
    samples = np.asarray(sample_ms)
    grid = np.asarray(layshaft[0])
    grid = np.union1d(samples, grid[(grid >= samples[0]) & (grid <= samples[-1])])
    slip = ratio * np.interp(grid, *layshaft) - np.interp(grid, *main)
    way = 0.5 * (slip[1:] + slip[:-1]) * DEG_PER_RPM_MS * np.diff(grid)
    run = np.concatenate(([0.0], np.cumsum(way)))
    # What the sum of slips leaves out grows evenly between two samples.
    missing = np.asarray(sample_deg) - np.interp(samples, grid, run)
    return grid, run + np.interp(grid, samples, missing)


def _anchored(shift: ReportShift, times: Vector, curve: Vector, pitch: float) -> list[Any]:
    """Shifted by whole pitches so that the contact lies where the rig reported it; without one, so
    that the end lies within half a pitch of the middle."""
    anchor_ms, phase_deg = shift.contact_ms, shift.contact_phase_deg
    if anchor_ms is None or phase_deg is None:
        anchor_ms, phase_deg = shift.row.duration_ms, 0.0
    at_anchor = float(np.interp(anchor_ms, times, curve))
    shifted: list[Any] = (curve - pitch * np.round((at_anchor - phase_deg) / pitch)).tolist()
    return shifted
