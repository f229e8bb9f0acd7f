"""What the log says of a decision."""

from __future__ import annotations

from meshpoint.controller.core.reporter import decision_line, outcome_line
from meshpoint.controller.plan.strategist import Plan
from meshpoint.controller.shift.table import ShiftRecord
from meshpoint.dbc.messages import ShiftDecision, ShiftResult, Strategy
from meshpoint.gearbox.gears import DRIVE_GEARS
from meshpoint.units import DEG, RPM


def test_a_firing_says_when_and_what_it_expects() -> None:
    plan = Plan(ShiftDecision.FIRE, 112_500, 159_800, 0.2 * DEG, 0.3 * DEG, 18.0 * RPM)
    line = decision_line(plan, 100_000)
    assert line == "fire in 12.5 ms for contact in 59.8 ms: phase +0.20 +- 0.30 deg, 18.0 rpm"


def test_a_phase_nobody_knows_is_not_given_a_number() -> None:
    plan = Plan(ShiftDecision.COMMITTED, 0, 150_000, 0.0, 0.0, 30.0 * RPM)
    assert "unknown" in (decision_line(plan, 100_000) or "")


def test_nothing_decided_says_nothing() -> None:
    assert decision_line(Plan(ShiftDecision.NONE, 0, 0, 0.0, 0.0, 0.0), 0) is None


def test_the_end_of_a_shift_says_how_often_its_sleeve_was_fired_and_aborted_if_it_was() -> None:
    shift = ShiftRecord(8, 10, DRIVE_GEARS[10], 0, Strategy.TARGET_PHASE, attempts=1)
    shift.result = ShiftResult.ENGAGED
    assert outcome_line(shift) == "shift 8 -> 10: engaged, 1 fired, fault none"
    shift.aborts = 2
    assert outcome_line(shift) == "shift 8 -> 10: engaged, 1 fired, 2 aborted, fault none"
