"""What is reported on the bus is what is known: outcome, prediction and estimates, each field for
itself; and small laws of what is commanded and read."""

from __future__ import annotations

import copy
import math
from types import SimpleNamespace
from typing import Any

import pytest
from test_shift_states import UP, aimed

from meshpoint.controller.core.reporter import (
    ANGLE_SD_TOP,
    angle,
    clip,
    decision_line,
    estimates,
    etc1,
    etc2,
    outcome,
    prediction,
)
from meshpoint.controller.measure.inputs import ShaftSpeedMeter, StepInputs
from meshpoint.controller.models.layshaft import Disturbance, LayshaftState
from meshpoint.controller.models.swing import ShaftState
from meshpoint.controller.plan.strategist import Plan
from meshpoint.controller.settings.settings import ValveTiming
from meshpoint.controller.settings.valve_name import ValveName
from meshpoint.controller.shift.table import ShiftRecord
from meshpoint.controller.shift.valve_board import OFF_HELD_US, ValveBoard
from meshpoint.dbc.messages import (
    EdgesInputRise,
    EdgesLayshaftRise,
    EdgesMainRise,
    EdgesPropellerRise,
    FaultCode,
    J1939Measured,
    PhaseReference,
    ReferenceSource,
    ShiftDecision,
    ShiftResult,
    Strategy,
)
from meshpoint.gearbox import MainGear, Range, Split, load_sheet
from meshpoint.gearbox.gears import DRIVE_GEARS
from meshpoint.units import DEG, RPM

SHEET = load_sheet("truck12")
PITCH = SHEET.dog.pitch_rad


def test_an_outcome_says_of_the_shift_what_the_shift_was() -> None:
    shift = aimed(*UP[:2]).shift(UP[2])
    reported, plan = outcome(shift, PITCH), shift.plan
    assert plan is not None
    assert (reported.from_gear, reported.to_gear, reported.attempts) == (UP[0], UP[2], 1)
    assert (reported.result, reported.fault) == (ShiftResult.ENGAGED, FaultCode.NONE)
    assert (reported.strategy, reported.reference) == (Strategy.TARGET_PHASE, PhaseReference.KNOWN)
    assert reported.reference_source is shift.reference_source
    assert (reported.request_time_us, reported.end_time_us) == (shift.request_us, shift.end_us)
    assert reported.fire_time_us == plan.fire_us
    assert reported.predicted_contact_time_us == plan.contact_us
    assert reported.measured_contact_time_us == shift.measured_contact_us
    assert reported.request_time_us < reported.fire_time_us < reported.measured_contact_time_us
    assert reported.measured_contact_time_us < reported.end_time_us
    for said, known in (
        (reported.predicted_phase_rad, plan.phase_rad),
        (reported.estimated_phase_rad, shift.estimated_phase_rad),
        (reported.predicted_phase_sd_rad, plan.phase_sd_rad),
        (reported.predicted_slip_rad_s, plan.slip_rad_s),
    ):
        assert said == pytest.approx(known) and said != 0.0


def test_a_shift_that_was_refused_has_neither_firing_nor_contact() -> None:
    shift = ShiftRecord(5, 9, DRIVE_GEARS[9], 1_000, Strategy.SPEED_WINDOW)
    shift.result, shift.fault = ShiftResult.REFUSED, FaultCode.LOW_SUPPLY
    reported = outcome(shift, PITCH)
    assert (reported.result, reported.fault) == (ShiftResult.REFUSED, FaultCode.LOW_SUPPLY)
    assert (reported.reference, reported.reference_source) == (
        PhaseReference.UNKNOWN,
        ReferenceSource.NONE,
    )
    nothing = (
        reported.fire_time_us, reported.predicted_contact_time_us,
        reported.measured_contact_time_us, reported.end_time_us, reported.predicted_phase_rad,
        reported.predicted_phase_sd_rad, reported.predicted_slip_rad_s,
        reported.estimated_phase_rad, reported.attempts,
    )  # fmt: skip
    assert not any(nothing)


def test_a_prediction_is_that_of_the_steps_decision() -> None:
    box = aimed(*UP[:2])
    box.ask(UP[2])
    seen = 0
    while box.running():
        box.step()
        plan, shift = box.sequence.decision, box.sequence.shift
        if plan is None or shift is None:
            continue
        reported, seen = prediction(box.now_us, plan, shift), seen + 1
        assert reported.decision_time_us == box.now_us
        assert reported.decision is plan.decision
        assert reported.release_time_us == (shift.release_us or 0)
        assert (reported.fire_time_us, reported.contact_time_us) == (plan.fire_us, plan.contact_us)
        assert reported.phase_rad == pytest.approx(plan.phase_rad)
        assert reported.phase_sd_rad == pytest.approx(min(plan.phase_sd_rad, ANGLE_SD_TOP))
        assert reported.slip_rad_s == pytest.approx(plan.slip_rad_s)
    assert seen > 10


def test_estimates_that_are_not_there_are_reported_as_not_valid_and_as_uncertain_as_can_be() -> (
    None
):
    layshaft = LayshaftState(9.0, 3.0, 140.0, 2e5, 1e-3, 0.2, 3e3)
    main = ShaftState(9.0, 4.0, 90.0, 2e-3, 0.3)
    tracker: Any = SimpleNamespace(free=True)
    reported = estimates(77, tracker, layshaft, main, 1e5, 5.0, 0.02, 0.003)
    assert reported.estimate_time_us == 77
    assert (
        reported.layshaft_valid,
        reported.main_valid,
        reported.phase_known,
        reported.model_valid,
    ) == (True,) * 4
    assert reported[1:] is not None
    assert reported.layshaft_angle_rad == 3.0
    assert reported.layshaft_speed_rad_s == 140.0
    assert (reported.layshaft_angle_sd_rad, reported.layshaft_speed_sd_rad_s) == (1e-3, 0.2)
    assert (reported.main_angle_rad, reported.main_speed_rad_s) == (4.0, 90.0)
    assert (reported.main_angle_sd_rad, reported.main_speed_sd_rad_s) == (2e-3, 0.3)
    assert (reported.brake_pressure_pa, reported.brake_pressure_sd_pa) == (3e5, 3e3)
    assert (reported.slip_rad_s, reported.phase_rad, reported.phase_sd_rad) == (5.0, 0.02, 0.003)
    tracker.free = False
    none = estimates(77, tracker, None, None, 1e5, 0.0, None, 0.0)
    assert not any((none.layshaft_valid, none.main_valid, none.phase_known, none.model_valid))
    assert none.phase_rad == 0.0
    for known, unknown in (
        (reported.layshaft_angle_sd_rad, none.layshaft_angle_sd_rad),
        (reported.layshaft_speed_sd_rad_s, none.layshaft_speed_sd_rad_s),
        (reported.main_angle_sd_rad, none.main_angle_sd_rad),
        (reported.main_speed_sd_rad_s, none.main_speed_sd_rad_s),
        (reported.brake_pressure_sd_pa, none.brake_pressure_sd_pa),
    ):
        assert unknown > 10.0 * known
    assert (none.layshaft_angle_rad, none.layshaft_speed_rad_s) == (0.0, 0.0)
    assert (none.main_angle_rad, none.main_speed_rad_s) == (0.0, 0.0)


def test_what_any_truck_tool_reads_of_gears_and_speeds() -> None:
    for number in (-1, 0, 1, 12):
        reported = etc2(SHEET, number, 9)
        assert reported.selected_gear == 9
        assert reported.current_gear == (None if number < 0 else number)
        ratio = SHEET.overall_ratio(DRIVE_GEARS[number]) if number > 0 else None
        assert reported.actual_ratio == ratio
        assert (reported.requested_range, reported.current_range) == (None, None)
    for engaged, shifting in ((True, False), (False, True)):
        told1 = etc1(engaged, shifting, 100.0, 150.0)
        assert told1.driveline_engaged is (J1939Measured.YES if engaged else J1939Measured.NO)
        assert told1.shift_in_process is (J1939Measured.YES if shifting else J1939Measured.NO)
        assert told1.converter_lockup is J1939Measured.NOT_AVAILABLE
        assert (told1.output_shaft_speed_rad_s, told1.input_shaft_speed_rad_s) == (100.0, 150.0)
        assert (told1.clutch_slip_fraction, told1.controlling_address) == (None, None)
    top = 8031.0 * math.pi / 30.0
    for speed, is_reported in ((0.0, True), (-0.1, False), (top - 0.1, True), (top, False)):
        told1 = etc1(True, False, speed, None)
        assert told1.output_shaft_speed_rad_s == (speed if is_reported else None)
        assert told1.input_shaft_speed_rad_s is None


@pytest.mark.parametrize("inertia", [0.3, 0.5])
def test_a_disturbance_stays_as_large_as_it_is_said_to_be(inertia: float) -> None:
    """Driven by noise of this density and forgotten at this rate, its variance comes to rest at
    the torque's square over the inertia's: v' = -2 r v + q."""
    rate, density = Disturbance(1.5, 0.04).density(inertia)
    assert rate == pytest.approx(1.0 / 0.04)
    variance = 0.0
    for _ in range(4_000):
        variance += (density - 2.0 * rate * variance) * 1e-4
    assert math.sqrt(variance) * inertia == pytest.approx(1.5, rel=1e-3)


@pytest.mark.parametrize("timing", list(ValveTiming))
def test_a_command_that_is_kept_is_always_what_would_be_said_anew(timing: ValveTiming) -> None:
    """Also as the time of a switch passes, and as an old one is said without its time."""
    board, now_us = ValveBoard(timing), 10_000_000
    board.schedule(ValveName.BRAKE, True, now_us + 5_000, now_us)
    board.schedule(ValveName.MAIN_FIRST, True, now_us + 2_000, now_us)
    board.schedule(ValveName.MAIN_FIRST, False, now_us + 40_000, now_us + 3_000)
    board.schedule(ValveName.RANGE_HIGH, False, now_us - 400_000, now_us)
    edges = [now_us + 2_000, now_us + 5_000, now_us + 40_000, now_us - 400_000 + OFF_HELD_US,
             now_us + 40_000 + OFF_HELD_US]  # fmt: skip
    unasked = copy.deepcopy(board)
    for at_us in sorted(edge + beside for edge in edges for beside in (-1, 0, 1, 2)):
        if at_us < now_us:
            continue
        assert board.message(at_us) == copy.deepcopy(unasked).message(at_us), at_us - now_us


def edge_frame(kind: type, speed: float, teeth: int, now_us: int) -> Any:
    every_us = round(2e6 * math.pi / teeth / speed)
    stamps = tuple((now_us - every_us * back) & 0xFFFF for back in range(27))
    return kind(now_us, 500, 27, False, False, False, stamps)


def test_speeds_are_those_of_their_shafts_and_slip_is_of_the_gear_against_its_sleeve() -> None:
    wheels, now_us = SHEET.wheels, 5_000_000
    given = {
        EdgesInputRise: (150.0, wheels.input_),
        EdgesLayshaftRise: (141.0, wheels.layshaft),
        EdgesMainRise: (88.0, wheels.main),
        EdgesPropellerRise: (23.5, wheels.propeller),
    }
    inputs = StepInputs()
    for kind, (speed, wheel) in given.items():
        inputs.edges[kind].append(edge_frame(kind, speed, wheel.teeth, now_us))
    meter = ShaftSpeedMeter(SHEET)
    speeds = meter.take(inputs, now_us)
    assert speeds.layshaft == pytest.approx(141.0, rel=1e-3)
    assert speeds.main == pytest.approx(88.0, rel=1e-3)
    assert speeds.propeller == pytest.approx(23.5, rel=1e-3)
    for gear in (MainGear.FIRST, MainGear.SECOND, MainGear.THIRD, MainGear.CRAWL):
        expected = SHEET.main_mesh(gear).ratio * 141.0 - 88.0
        assert speeds.slip_rad_s(gear) == pytest.approx(expected, abs=0.3)
    assert speeds.split_turns_together(Split.HIGH) is True
    assert speeds.split_turns_together(Split.LOW) is False
    assert speeds.range_turns_together(Range.LOW) is True
    assert speeds.range_turns_together(Range.HIGH) is False
    speeds = meter.take(StepInputs(), now_us + 100_000)
    assert speeds.slip_rad_s(MainGear.FIRST) is None
    assert not speeds.split_turns_together(Split.HIGH)


TURNS = 512.0 * math.pi


def test_an_angle_is_reported_modulo_256_turns_and_just_below_them_at_most() -> None:
    reported = [angle(given) for given in (3.0, TURNS + 3.0, -3.0)]
    assert reported == pytest.approx([3.0, 3.0, TURNS - 3.0])
    assert angle(-1e-18) == pytest.approx(TURNS - TURNS / 2.0**33, rel=1e-15)
    assert angle(-1e-18) < TURNS


@pytest.mark.parametrize(
    ("value", "sent"),
    [(-3.0, -2.0), (-2.0, -2.0), (0.5, 0.5), (4.0, 4.0), (4.1, 4.0), (math.inf, 4.0),
     (-math.inf, -2.0), (math.nan, 4.0)],
)  # fmt: skip
def test_what_a_signal_cannot_say_is_said_by_the_end_of_its_range(
    value: float, sent: float
) -> None:
    assert clip(value, 4.0, -2.0) == sent


FASTEST, WIDEST = 200_000.0 * RPM, 32.0 * DEG
"""The ends of the signals of speeds, and of the deviation of an angle."""


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_what_is_out_of_all_bounds_is_reported_at_the_signals_ends(sign: float) -> None:
    """300 rpm of deviation, 13 bar, phases of 20,000 deg; times as their low 32 bits."""
    tracker: Any = SimpleNamespace(free=False)
    layshaft = LayshaftState(0.0, 9.0, sign * 9e9, 9e9, 9e9, 9e9, 9e9)
    main = ShaftState(0.0, 9.0, sign * 9e9, 9e9, 9e9)
    reported = estimates((1 << 32) + 5, tracker, layshaft, main, 1e5, sign * 9e9, None, 9e9)
    assert reported.estimate_time_us == 5
    near = pytest.approx
    assert (
        reported.layshaft_angle_sd_rad,
        reported.main_angle_sd_rad,
        reported.phase_sd_rad,
    ) == near((WIDEST,) * 3)
    assert reported.layshaft_speed_sd_rad_s == reported.main_speed_sd_rad_s == near(300.0 * RPM)
    speeds = (reported.layshaft_speed_rad_s, reported.main_speed_rad_s, reported.slip_rad_s)
    assert speeds == near((sign * FASTEST,) * 3)
    assert reported.brake_pressure_pa == reported.brake_pressure_sd_pa == 13e5
    late = (1 << 32) + 7
    plan = Plan(ShiftDecision.FIRE, late, late + 1, sign * 9e9, 9e9, sign * 9e9)
    shift = ShiftRecord(5, 9, DRIVE_GEARS[9], (1 << 32) + 1_000, Strategy.TARGET_PHASE)
    shift.plan, shift.release_us = plan, late + 3
    ahead = prediction(late + 2, plan, shift)
    assert (ahead.phase_rad, ahead.phase_sd_rad) == near((sign * 20_000.0 * DEG, WIDEST))
    assert ahead.slip_rad_s == near(sign * FASTEST)
    assert (ahead.decision_time_us, ahead.release_time_us) == (9, 10)
    assert (ahead.fire_time_us, ahead.contact_time_us) == (7, 8)
    end = outcome(shift, 0.2)
    assert (end.predicted_phase_sd_rad, end.predicted_slip_rad_s) == near((WIDEST, sign * FASTEST))
    assert (end.request_time_us, end.fire_time_us, end.predicted_contact_time_us) == (1_000, 7, 8)


def test_an_outcome_s_phases_are_reported_within_half_a_pitch() -> None:
    shift = ShiftRecord(5, 9, DRIVE_GEARS[9], 0, Strategy.TARGET_PHASE)
    shift.plan, shift.estimated_phase_rad = Plan(ShiftDecision.FIRE, 1, 2, 0.25, 1e-3, -3.0), -0.35
    reported = outcome(shift, 0.2)
    assert (reported.predicted_phase_rad, reported.estimated_phase_rad) == pytest.approx(
        (0.05, 0.05)
    )


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
    if decision is ShiftDecision.COMMITTED:
        assert decision_line(plan._replace(misses=True), 100_000) == (
            f"{line}, outside the gap: no better contact within reach"
        )
        unknown = decision_line(plan._replace(phase_sd_rad=0.0), 100_000)
        assert unknown == "fired, contact in 59.8 ms: phase unknown or not asked for, 18.0 rpm"
