"""Log lines of the decisions and their reasons: brake, release, wait, fire; and of how a shift
ended."""

from __future__ import annotations

from typing import Final

from meshpoint.controller.plan.strategist import Plan
from meshpoint.controller.shift.table import ShiftRecord
from meshpoint.dbc.messages import ShiftDecision
from meshpoint.units import DEG, MS_US, RPM

LINES: Final = {
    ShiftDecision.BRAKE: "brake: contact planned in {contact:.0f} ms, at {slip:.1f} rpm",
    ShiftDecision.RELEASE: "release: contact in {contact:.0f} ms, at {slip:.1f} rpm",
    ShiftDecision.WAIT_FOR_SLIP: "wait: {slip:.1f} rpm at the earliest contact, too much yet",
    ShiftDecision.WAIT_FOR_GAP: "wait for the gap of least cost, too far ahead yet",
    ShiftDecision.FIRE: "fire in {fire:.1f} ms for contact in {contact:.1f} ms: {where}",
    ShiftDecision.COMMITTED: "fired, contact in {contact:.1f} ms: {where}",
}


def decision_line(plan: Plan, now_us: int) -> str | None:
    """The log line of a plan: its decision and its prediction; None for a plan without a decision.

    `where`: phase beside the gap's middle with its standard deviation, and slip."""
    line = LINES.get(plan.decision)
    if line is None:
        return None
    slip = plan.slip_rad_s / RPM
    where = (
        f"phase {plan.phase_rad / DEG:+.2f} +- {plan.phase_sd_rad / DEG:.2f} deg, {slip:.1f} rpm"
    )
    if plan.misses:
        where += ", outside the gap: no better contact within reach"
    if plan.phase_sd_rad == 0.0:
        where = f"phase unknown or not asked for, {slip:.1f} rpm"
    return line.format(
        slip=slip,
        where=where,
        fire=(plan.fire_us - now_us) / MS_US,
        contact=(plan.contact_us - now_us) / MS_US,
    )


def outcome_line(shift: ShiftRecord) -> str:
    """The log line of a shift that is over."""
    aborted = f", {shift.aborts} aborted" if shift.aborts else ""
    return (
        f"shift {shift.from_number} -> {shift.to_number}: {shift.result.name.lower()}"
        f", {shift.attempts} fired{aborted}, fault {shift.fault.name.lower()}"
    )
