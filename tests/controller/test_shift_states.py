"""The shift sequence alone (shift_box.py): what it commands in which order."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from shift_box import (
    CONTACT_M,
    DELAY_MS,
    DOWN,
    FAST_UP,
    FIRST_SECOND,
    LEAD_US,
    MAIN_SLEEVES,
    MS_US,
    PITCH,
    PUSHED,
    SHEET,
    SPLIT,
    STROKE_M,
    TICK_US,
    UP,
    WAYS,
    Box,
    aimed,
)

from meshpoint.controller.plan.strategy import BUS_US
from meshpoint.controller.settings.valve_name import ValveName
from meshpoint.controller.shift.step_snapshot import StepSnapshot
from meshpoint.controller.shift.table import ShiftRecord
from meshpoint.dbc.messages import (
    ClutchAction,
    FaultCode,
    ShiftResult,
    Strategy,
)
from meshpoint.dbc.messages import ControllerState as State
from meshpoint.gearbox import MainGear, Sleeve, Split
from meshpoint.gearbox.gears import DRIVE_GEARS, SLEEVE_OF_MAIN


def test_a_controller_starts_until_the_guard_s_self_test_is_passed() -> None:
    """Whoever reads that a gear is in asks for the next, once, and is not heard in vain."""
    box = Box(7, 150.0, phase_rad=0.01, is_self_tested=False)
    for _ in range(60):
        box.ask(9)
        assert box.step() is State.STARTING
    assert (box.records, box.clutch) == ([], 1.0)
    box.is_self_tested = True
    assert box.ready().shift(9).result is ShiftResult.ENGAGED


def test_a_request_is_refused_while_the_guard_tests_itself_again() -> None:
    """With another clock of the sensors. A shift begun then would open the clutch and find every
    valve blocked (row 12)."""
    box = Box(7, 150.0, phase_rad=0.01).ready()
    box.is_self_tested = False
    refusal = box.ask(9)
    assert refusal == "request for gear 9 refused: the guard's self-test is not passed again yet"
    assert (box.step(), box.clutch) == (State.IN_GEAR, 1.0)


@pytest.mark.parametrize("way", WAYS)
def test_a_shift_takes_its_way_and_ends_in_its_gear(way: tuple[int, float, int]) -> None:
    box = aimed(*way[:2])
    record = box.shift(way[2])
    assert box.trajectory == WAYS[way]
    assert (record.result, record.fault) == (ShiftResult.ENGAGED, FaultCode.NONE)
    assert box.view.gear_number == way[2]
    assert (record.from_number, record.to_number) == (way[0], way[2])
    assert record.raises == (1 if way is DOWN else 0)
    assert record.pulses == (1 if way in (UP, FAST_UP) else 0)
    assert record.attempts == (0 if way is SPLIT else 1)
    assert (box.sequence.engine_rad_s, box.sequence.engine_share) == (None, None)
    assert not any(box.board.command(valve).on for valve in ValveName)


def test_splitter_and_range_change_while_the_main_box_is_in_neutral() -> None:
    box = aimed(6, 110.0)
    box.ask(7)
    moved = set()
    while box.running() or box.state is not State.IN_GEAR:
        box.step()
        for valve in (ValveName.SPLIT_LOW, ValveName.RANGE_HIGH):
            if box.board.driven(valve, box.now_us):
                moved.add(valve)
                assert box.state is State.STEPS_CHANGING
                assert box.view.main_gear is MainGear.NEUTRAL
        for valve in (ValveName.SPLIT_HIGH, ValveName.RANGE_LOW):
            assert not box.board.driven(valve, box.now_us)
    assert moved == {ValveName.SPLIT_LOW, ValveName.RANGE_HIGH}
    assert box.records[-1].result is ShiftResult.ENGAGED
    assert box.view.gear_number == 7


@pytest.mark.parametrize(
    ("rests", "pushed"), [(False, ValveName.SPLIT_LOW), (True, ValveName.SPLIT_HIGH)]
)
def test_a_splitter_left_between_its_steps_is_brought_in_by_the_high_one_if_the_layshaft_rests(
    rests: bool, pushed: ValveName
) -> None:
    """As an outage in its change leaves it. The new gear has the low step, which the guard forbids
    while the layshaft rests: it comes behind the high one."""
    box, seen = aimed(9, 110.0), set()
    box.position_m |= dict.fromkeys((*MAIN_SLEEVES, Sleeve.SPLITTER), 0.0)
    box.clutch, shows = 0.0, box.snapshot

    def snapshot(**other: Any) -> StepSnapshot:
        shot = shows(**other)
        if rests and box.view.split is None:
            return replace(shot, speeds=shot.speeds._replace(layshaft=None))
        return shot

    box.snapshot = snapshot  # type: ignore[method-assign]
    box.until(State.NEUTRAL)
    box.ask(7)
    while box.view.split is None and box.running():
        seen |= {valve for valve in PUSHED[Sleeve.SPLITTER] if box.board.command(valve).on}
        box.step()
    assert seen == {pushed}
    assert box.view.split is (Split.HIGH if rests else Split.LOW)


def events(box: Box, number: int) -> dict[str, int]:
    """When things first happen in a shift, in us since it was asked for."""
    box.ask(number)
    began_us, found = box.now_us, {}

    def note(name: str, happens: bool) -> None:
        if happens:
            found.setdefault(name, box.now_us - began_us)

    while box.running():
        box.step()
        gear = SLEEVE_OF_MAIN[DRIVE_GEARS[number].main]
        note("opens", box.sequence.clutch is ClutchAction.OPEN)
        note("parted", box.clutch <= SHEET.clutch.kiss_share - SHEET.clutch.kiss_tolerance)
        note("moves", abs(box.position_m[FIRST_SECOND]) < STROKE_M - 1e-5)
        note("out", box.mesh is MainGear.NEUTRAL)
        note("brakes", box.pressure_pa > 0.0)
        note("in", box.position_m[gear.sleeve] * gear.direction > CONTACT_M)
    return found


def test_clutch_sleeve_and_brake_follow_each_other_without_waiting() -> None:
    """The old gear's sleeve moves as the plates part, and the brake's air comes as the gear is
    seen to be out, no sooner: within two steps and the valve's delay."""
    found = events(aimed(*UP[:2]), UP[2])
    assert found["opens"] <= 10_000
    assert -10_000 <= found["moves"] - found["parted"] <= 20_000
    asked_us = LEAD_US + BUS_US + MS_US * DELAY_MS
    assert asked_us < found["brakes"] - found["out"] < asked_us + 2 * TICK_US


@pytest.mark.parametrize("phase", [k / 8.0 for k in range(8)])
def test_a_tooth_meets_the_middle_of_its_gap_from_any_angle(phase: float) -> None:
    """Both when the gear is braked down to its speed and when the engine brought it up."""
    for gear, speed, target in (UP, DOWN):
        box, met = Box(gear, speed, phase_rad=phase * PITCH), []
        box.face = lambda at, met=met: met.append(at) or False  # type: ignore[func-returns-value]
        box.ready()
        record = box.shift(target)
        assert (record.aimed, record.reference_known, record.attempts) == (True, True, 1)
        assert len(met) == 1
        assert abs(met[0]) < 0.5 * SHEET.dog.backlash_rad
        assert record.estimated_phase_rad == pytest.approx(met[0], abs=0.02 * PITCH)
        assert record.measured_contact_us is not None
        assert record.plan is not None
        travelled_us = record.measured_contact_us - record.plan.fire_us
        assert record.aborts == 0
        assert travelled_us == pytest.approx(1e6 * SHEET.sleeve.delay_s, abs=2_000)


def test_without_a_known_phase_the_sleeve_goes_by_the_slip_alone_and_the_record_says_so() -> None:
    box = Box(*UP[:2]).ready()
    record = box.shift(UP[2])
    assert (record.aimed, record.reference_known) == (False, False)
    assert record.strategy is Strategy.SPEED_WINDOW
    assert record.result is ShiftResult.ENGAGED
    assert aimed(*UP[:2]).shift(UP[2]).strategy is Strategy.TARGET_PHASE


def test_a_sleeve_that_meets_a_tooth_goes_back_and_is_fired_again_until_its_attempts_are_used() -> (
    None
):
    for blocked in (1, 2, 3):
        left, box = [blocked], aimed(*UP[:2])

        def face(_: float, left: list[int] = left) -> bool:
            left[0] -= 1
            return left[0] >= 0

        box.face = face
        # A tooth lets no sleeve in that rests on it.
        record = rested(box, left)
        assert record.attempts == min(blocked + 1, box.settings.limits.attempts)
        ended = ShiftResult.ENDED_IN_NEUTRAL if blocked == 3 else ShiftResult.ENGAGED
        fault = FaultCode.ENGAGE_FAILED if blocked == 3 else FaultCode.NONE
        assert (record.result, record.fault) == (ended, fault)
        assert box.trajectory.count(State.RETRACTING) == blocked


def test_a_sleeve_that_goes_in_as_it_is_let_go_has_engaged() -> None:
    """Red before: on a tooth that friction held in its way as long as the valve pressed. Once let
    go the tooth went by, what air was left pushed the sleeve in, and it was pulled out again."""
    box = aimed(*UP[:2])
    box.face = lambda _: box.state is not State.RETRACTING
    record = box.shift(UP[2])
    assert (record.result, record.attempts) == (ShiftResult.ENGAGED, 1)
    assert box.trajectory[-3:] == [State.RETRACTING, State.CLUTCH_CLOSING, State.IN_GEAR]
    assert box.view.gear_number == UP[2]


def rested(box: Box, left: list[int]) -> ShiftRecord:
    """The shift up; a tooth under which a sleeve rests stays there until it has gone back."""
    passes, gear, resting = box.face, SLEEVE_OF_MAIN[DRIVE_GEARS[UP[2]].main], [False]

    def face(phase: float) -> bool:
        resting[0] = resting[0] or passes(phase)
        return resting[0]

    box.face = face
    box.ask(UP[2])
    began_us = None
    while box.running():
        box.step()
        if resting[0] and began_us is None and box.state is State.ENGAGING:
            began_us = box.now_us
        if began_us is not None and box.board.driven(ValveName.BRAKE, box.now_us):
            began_us = box.now_us  # by a pulse that is to move the tooth on
        if began_us is not None and box.state is not State.ENGAGING:
            limit_us = 1_000 * box.settings.limits.face_ms
            assert limit_us - 10_000 <= box.now_us - began_us <= limit_us + 20_000
            assert not box.board.command(PUSHED[gear.sleeve][1]).on
            began_us = None
        if resting[0] and box.position_m[gear.sleeve] < 0.9 * CONTACT_M:
            resting[0] = False
        if box.state is State.RETRACTING:
            assert box.position_m[gear.sleeve] > -0.5 * CONTACT_M, "towards the other gear"
    box.until(State.IN_GEAR, State.NEUTRAL)
    return box.records[-1]
