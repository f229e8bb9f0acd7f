"""What is told on the bus and in the log at the ends of what a signal holds."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest
from test_reporter import Told
from test_shift_states import UP, aimed

from meshpoint.controller.motion.models import LayshaftState
from meshpoint.controller.motion.swing import ShaftState
from meshpoint.controller.planning.strategist import Plan
from meshpoint.controller.report.log_lines import decision_line
from meshpoint.controller.report.messages import angle, clip, estimates, outcome, prediction
from meshpoint.controller.shift.table import ShiftRecord
from meshpoint.dbc.messages import ETC2, ControllerEstimates, ShiftDecision, Strategy
from meshpoint.gearbox.gears import DRIVE_GEARS

DEG, RPM = math.pi / 180.0, math.pi / 30.0
TURNS = 512.0 * math.pi


def test_an_angle_is_told_modulo_256_turns_and_just_below_them_at_most() -> None:
    assert angle(3.0) == 3.0
    assert angle(TURNS + 3.0) == pytest.approx(3.0)
    assert angle(-3.0) == pytest.approx(TURNS - 3.0)
    top = angle(-1e-18)
    assert top < TURNS
    assert TURNS - top == pytest.approx(TURNS / 2.0**33)


def test_a_value_is_told_within_its_range_and_one_that_is_none_as_the_largest() -> None:
    assert [clip(value, 5.0) for value in (-1.0, 0.0, 3.0, 5.0, 6.0)] == [0.0, 0.0, 3.0, 5.0, 5.0]
    assert [clip(value, 5.0, -5.0) for value in (-6.0, -5.0, -1.0)] == [-5.0, -5.0, -1.0]
    assert clip(math.nan, 5.0, -5.0) == 5.0


def test_what_is_out_of_all_bounds_is_told_at_the_signals_ends() -> None:
    """32 deg and 300 rpm of deviation, 200,000 rpm, 13 bar."""
    tracker: Any = SimpleNamespace(free=False)
    layshaft = LayshaftState(0.0, 9.0, -9e9, 9e9, 9e9, 9e9, 9e9)
    main = ShaftState(0.0, 9.0, 9e9, 9e9, 9e9)
    told = estimates((1 << 32) + 5, tracker, layshaft, main, 1e5, -9e9, None, 9e9)
    assert told.estimate_time_us == 5
    assert told.layshaft_angle_sd_rad == told.main_angle_sd_rad == pytest.approx(32.0 * DEG)
    assert told.layshaft_speed_sd_rad_s == told.main_speed_sd_rad_s == pytest.approx(300.0 * RPM)
    assert told.layshaft_speed_rad_s == pytest.approx(-200_000.0 * RPM)
    assert told.main_speed_rad_s == pytest.approx(200_000.0 * RPM)
    assert told.slip_rad_s == pytest.approx(-200_000.0 * RPM)
    assert told.phase_sd_rad == pytest.approx(32.0 * DEG)
    assert told.brake_pressure_pa == told.brake_pressure_sd_pa == 13e5
    backwards = ShaftState(0.0, 9.0, -9e9, 0.0, 0.0)
    fast = LayshaftState(0.0, 9.0, 9e9, -2e5, 0.0, 0.0, 0.0)
    told = estimates(0, tracker, fast, backwards, 1e5, 9e9, 0.01, 0.0)
    assert told.main_speed_rad_s == pytest.approx(-200_000.0 * RPM)
    assert told.layshaft_speed_rad_s == told.slip_rad_s == pytest.approx(200_000.0 * RPM)
    assert told.brake_pressure_pa == 0.0
    assert (told.phase_rad, told.phase_known) == (0.01, True)


def test_shafts_that_are_not_known_are_told_with_the_largest_deviations() -> None:
    tracker: Any = SimpleNamespace(free=True)
    told = estimates(0, tracker, None, None, 1e5, 0.0, None, 0.0)
    assert told.layshaft_angle_sd_rad == told.main_angle_sd_rad == pytest.approx(32.0 * DEG)
    assert told.layshaft_speed_sd_rad_s == told.main_speed_sd_rad_s == pytest.approx(300.0 * RPM)
    assert (told.brake_pressure_pa, told.brake_pressure_sd_pa) == (1e5, 13e5)
    assert (told.layshaft_angle_rad, told.main_angle_rad) == (0.0, 0.0)
    assert (told.layshaft_speed_rad_s, told.main_speed_rad_s) == (0.0, 0.0)


def shift_of(plan: Plan | None, release_us: int | None = None) -> ShiftRecord:
    shift = ShiftRecord(5, 9, DRIVE_GEARS[9], (1 << 32) + 1_000, Strategy.TARGET_PHASE)
    shift.plan, shift.release_us = plan, release_us
    return shift


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_plan_out_of_all_bounds_is_told_at_the_signals_ends(sign: float) -> None:
    """Phases of 20,000 deg; times as their low 32 bits."""
    late = (1 << 32) + 7
    plan = Plan(ShiftDecision.FIRE, late, late + 1, sign * 9e9, 9e9, sign * 9e9)
    told = prediction(late + 2, plan, shift_of(plan, late + 3))
    assert told.phase_rad == pytest.approx(sign * 20_000.0 * DEG)
    assert told.phase_sd_rad == pytest.approx(32.0 * DEG)
    assert told.slip_rad_s == pytest.approx(sign * 200_000.0 * RPM)
    assert (told.decision_time_us, told.release_time_us) == (9, 10)
    assert (told.fire_time_us, told.contact_time_us) == (7, 8)
    assert prediction(0, plan, shift_of(plan)).release_time_us == 0
    end = outcome(shift_of(plan), 0.2)
    assert end.predicted_phase_sd_rad == pytest.approx(32.0 * DEG)
    assert end.predicted_slip_rad_s == pytest.approx(sign * 200_000.0 * RPM)
    assert (end.request_time_us, end.fire_time_us) == (1_000, 7)
    assert end.predicted_contact_time_us == 8


def test_an_outcome_s_phases_are_told_within_half_a_pitch() -> None:
    plan = Plan(ShiftDecision.FIRE, 1, 2, 0.25, 1e-3, -3.0)
    shift = shift_of(plan)
    shift.estimated_phase_rad = -0.35
    shift.measured_contact_us, shift.end_us = (1 << 32) + 30, (1 << 32) + 40
    told = outcome(shift, 0.2)
    assert told.predicted_phase_rad == pytest.approx(0.05)
    assert told.estimated_phase_rad == pytest.approx(0.05)
    assert (told.predicted_phase_sd_rad, told.predicted_slip_rad_s) == (1e-3, -3.0)
    assert (told.measured_contact_time_us, told.end_time_us) == (30, 40)


@pytest.mark.parametrize(
    ("decision", "line"),
    [
        (ShiftDecision.BRAKE, "brake: contact planned in 60 ms, at 18.0 rpm"),
        (ShiftDecision.RELEASE, "release: contact in 60 ms, at 18.0 rpm"),
        (ShiftDecision.WAIT_FOR_SLIP, "wait: 18.0 rpm at the earliest contact, too much yet"),
        (ShiftDecision.WAIT_FOR_GAP, "wait for the gap of least cost, too far ahead yet"),
        (ShiftDecision.FIRE,
         "fire in 12.5 ms for contact in 59.8 ms: phase -0.20 +- 0.30 deg, 18.0 rpm"),
        (ShiftDecision.COMMITTED, "fired, contact in 59.8 ms: phase -0.20 +- 0.30 deg, 18.0 rpm"),
    ],
)  # fmt: skip
def test_a_line_of_the_log_says_what_was_decided(decision: ShiftDecision, line: str) -> None:
    plan = Plan(decision, 112_500, 159_800, -0.2 * DEG, 0.3 * DEG, 18.0 * RPM)
    assert decision_line(plan, 100_000) == line


def test_a_line_says_where_no_better_contact_is_within_reach_and_where_no_phase_is_known() -> None:
    plan = Plan(ShiftDecision.COMMITTED, 0, 150_000, 0.1 * DEG, 0.3 * DEG, 18.0 * RPM)
    assert decision_line(plan._replace(misses=True), 100_000) == (
        "fired, contact in 50.0 ms: phase +0.10 +- 0.30 deg, 18.0 rpm, outside the gap: no "
        "better contact within reach"
    )
    unknown = Plan(ShiftDecision.COMMITTED, 0, 150_000, 0.1, 0.0, 18.0 * RPM)
    assert decision_line(unknown, 100_000) == (
        "fired, contact in 50.0 ms: phase unknown or not asked for, 18.0 rpm"
    )


def test_a_status_frame_holds_the_low_bits_of_its_counters_and_of_the_run_s_hash() -> None:
    """And what the step before consumed; nothing before the first."""
    told = Told(aimed(*UP[:2]))
    told.frames()
    first = told.status(now_us=10_000, lateness_us=70_000, blocks=65_537)
    assert (first.step_number, first.step_time_us, first.previous_step_time_us) == (0, 10_000, 0)
    assert (first.consumed_count, first.consumed_crc) == (11, 0xABCD)
    assert (first.previous_consumed_count, first.previous_consumed_crc) == (0, 0)
    assert (first.e2e_errors, first.format_errors) == (3, 5)
    assert (first.foreign_frames, first.guard_blocks) == (70_000 - 65_536, 1)
    assert (first.invalid_channels, first.step_lateness_us) == (9, 65_535)
    assert first.run_hash_low == told.header.run_hash % (1 << 32)
    assert first.run_hash_high == told.header.run_hash >> 32
    assert (first.current_gear, first.target_gear) == (UP[0], UP[0])
    assert first.cold_start
    second = told.status(now_us=20_000, lateness_us=65_534)
    assert (second.step_number, second.previous_step_time_us) == (1, 10_000)
    assert (second.previous_consumed_count, second.previous_consumed_crc) == (11, 0xABCD)
    assert (second.step_lateness_us, second.guard_blocks) == (65_534, 0)


def test_the_gear_is_told_each_tenth_step() -> None:
    told = Told(aimed(*UP[:2]))
    seen = []
    for k in range(21):
        if ETC2 in told.frames():
            seen.append(k)
        told.status()
    assert seen == [0, 10, 20]


def test_slip_is_told_of_the_gear_in_mesh_where_both_shafts_are_known() -> None:
    told = Told(aimed(*UP[:2]))
    assert abs(told.frames()[ControllerEstimates].slip_rad_s) < 1.0
    told.has_main = False
    own = told.frames()[ControllerEstimates]
    assert (own.slip_rad_s, own.phase_known, own.phase_sd_rad) == (0.0, False, 0.0)
