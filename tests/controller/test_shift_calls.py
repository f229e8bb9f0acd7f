"""What the sequence does in the milliseconds about a sleeve's way: air for the brake as the old
teeth part, a firing withdrawn, a clutch that closes as the overlap holds."""

from __future__ import annotations

import math
from typing import Any

import pytest
from shift_box import (
    CONTACT_M,
    DELAY_MS,
    DOWN,
    FIRST_SECOND,
    LEAD_US,
    MAIN_SLEEVES,
    MS_US,
    PITCH,
    SHEET,
    STROKE_M,
    TICK_US,
    UP,
    Box,
    aimed,
)

from meshpoint.controller.plan.strategy import BUS_US
from meshpoint.controller.settings.valve_name import ValveName
from meshpoint.controller.shift.disengage import CLEAR_M
from meshpoint.dbc.messages import ClutchAction, FaultCode, ShiftDecision, ShiftResult
from meshpoint.dbc.messages import ControllerState as State
from meshpoint.gearbox import MainGear

GEAR, VALVE = MainGear.SECOND, ValveName.MAIN_SECOND


def going(*states: State, **other: Any) -> Box:
    """The shift up, as far as one of these states."""
    box = aimed(*UP[:2], **other)
    box.ask(UP[2])
    return box.until(*states)


@pytest.mark.parametrize(("gear", "speed", "target"), [UP, (7, 190.0, 9), (3, 120.0, 5),
                                                       (8, 150.0, 10), (9, 150.0, 11)])  # fmt: skip
@pytest.mark.parametrize("supply_pa", [8.5e5, 9.5e5])
def test_the_brakes_air_is_asked_in_the_first_step_that_sees_the_old_teeth_clear(
    gear: int, speed: float, target: int, supply_pa: float
) -> None:
    """By 1 mm, the valve that pulled them off; air is there a valve's delay later."""
    box = aimed(gear, speed, supply_pa=supply_pa)
    sleeve = max(MAIN_SLEEVES, key=lambda one: abs(box.position_m[one]))
    box.ask(target)
    while abs(box.position_m[sleeve]) > CONTACT_M - CLEAR_M:
        assert not box.board.command(ValveName.BRAKE).on
        box.step()
    assert box.board.command(ValveName.BRAKE).on
    box.until(State.IN_GEAR)
    record = box.records[-1]
    assert (record.result, record.pulses) == (ShiftResult.ENGAGED, 1)
    asked_us = LEAD_US + BUS_US + MS_US * DELAY_MS
    assert asked_us < box.air_us - box.out_us < asked_us + 2 * TICK_US


def test_a_sleeve_that_stops_on_its_way_out_takes_the_brakes_air_back() -> None:
    """No more air comes than until the next step sees it, and it is no use of the brake. With less
    air a sleeve is slow enough to be seen between its teeth and neutral."""
    box = going(State.DISENGAGING, supply_pa=8.0e5)
    while not box.board.command(ValveName.BRAKE).on:
        box.step()
        assert box.running()
    assert box.sequence.running.pulses == 1
    box.stuck.add(FIRST_SECOND)
    box.position_m[FIRST_SECOND] = -0.99 * STROKE_M
    box.step()
    assert not box.board.command(ValveName.BRAKE).on
    assert box.sequence.running.pulses == 0
    open_s = 1e-6 * (TICK_US + BUS_US - LEAD_US)
    most = 1.0 - math.exp(-open_s / SHEET.brake.time_constant_s)
    for _ in range(20):
        box.step()
        assert box.pressure_pa < most * SHEET.air.supply_gauge_pa
    assert box.pressure_pa < 0.01 * SHEET.air.supply_gauge_pa
    box.stuck.clear()
    box.until(State.IN_GEAR)
    assert box.records[-1].result is ShiftResult.ENGAGED


def test_no_brake_for_a_gear_that_is_too_slow_or_while_another_step_is_to_be_changed() -> None:
    for gear, speed, target in (DOWN, (6, 110.0, 7)):
        box = aimed(gear, speed)
        box.ask(target)
        while box.running():
            box.step()
            if box.state in (State.SYNCHRONISING, State.COASTING):
                break
            assert not box.board.command(ValveName.BRAKE).on


@pytest.mark.parametrize("known", [True, False])
def test_the_clutch_closes_as_soon_as_the_overlap_holds_the_sleeve_where_the_phase_is_known(
    known: bool,
) -> None:
    """A gear whose phase is not known yet is left to show on which flank it lies."""
    box = Box(*UP[:2], phase_rad=0.01 if known else None).ready()
    box.ask(UP[2])
    box.until(State.ENGAGING)
    for past_m in (0.0, 0.9e-3, 2.0e-3, 5.0e-3):
        box.stuck.add(FIRST_SECOND)
        box.position_m[FIRST_SECOND] = CONTACT_M + past_m
        box.step()
        closes = box.sequence.clutch is ClutchAction.CLOSE
        assert box.state is State.ENGAGING
        assert closes is (known and past_m > SHEET.dog.most_overlap_m)


def test_a_firing_that_the_valve_side_did_not_take_is_made_again_after_40_ms() -> None:
    box = going(State.ENGAGING)
    box.refused.add(VALVE)
    plan = box.sequence.running.plan
    assert plan is not None
    box.until(State.RETRACTING)
    assert 40_000 < box.now_us - plan.fire_us <= 50_000
    box.refused.clear()
    box.until(State.IN_GEAR)
    record = box.records[-1]
    assert (record.result, record.calls, record.attempts) == (ShiftResult.ENGAGED, 1, 1)


def test_a_brake_command_that_the_valve_side_did_not_take_is_sent_again_after_40_ms() -> None:
    box = going(State.DISENGAGING)
    box.refused.add(ValveName.BRAKE)
    box.until(State.SYNCHRONISING)
    first_us = box.board.command(ValveName.BRAKE).time_us
    while box.board.command(ValveName.BRAKE).time_us == first_us:
        box.step()
        assert box.now_us - first_us < 60_000
    assert box.now_us - first_us > 40_000
    assert box.board.command(ValveName.BRAKE).on


def test_a_firing_not_yet_sent_for_good_is_taken_back_where_the_gap_went_away() -> None:
    box = going(State.SYNCHRONISING, State.COASTING)
    while box.sequence.running.plan is None:
        box.step()
    box.theta_main += 0.5 * PITCH
    box.step()
    plan = box.sequence.running.plan
    if plan is None:
        assert not box.board.command(VALVE).on
    else:
        assert not plan.misses
    box.until(State.IN_GEAR)
    assert box.records[-1].result is ShiftResult.ENGAGED


@pytest.mark.parametrize("way", [UP, DOWN])
def test_what_carried_a_tooth_to_its_flank_is_reported_with_the_slip_at_contact(
    way: tuple[int, float, int],
) -> None:
    """For the phase reference: a sleeve that went straight in, and the slip as it did; none where
    drag might have turned it round within the gap."""
    box, reported, slips = Box(*way[:2]), [], []
    target = MainGear.SECOND if way is UP else MainGear.FIRST
    box.face = lambda _: slips.append(box.slip(target)) or False  # type: ignore[func-returns-value]
    box.references.locked = lambda *args: reported.append(args)  # type: ignore[method-assign]
    box.ready().shift(way[2])
    ((locked, slip),) = reported
    assert locked is target
    inertia = SHEET.inertia_kgm2(box.split)
    ratio = SHEET.main_mesh(target).ratio
    fall = ratio * SHEET.shafts.friction_nms * box.main / ratio / inertia
    crosses = slips[0] < 0.0 or slips[0] ** 2 > 2.0 * SHEET.dog.backlash_rad * fall
    assert slip == pytest.approx(slips[0] if crosses else 0.0, abs=0.6)


@pytest.mark.parametrize("known", [True, False])
def test_every_step_of_a_shift_says_what_is_being_decided(known: bool) -> None:
    """First to brake, then when to let it go, and when to fire, until it is done."""
    box = Box(*UP[:2], phase_rad=0.01 if known else None).ready()
    box.ask(UP[2])
    said = []
    while box.running():
        box.step()
        if box.sequence.decision is not None:
            said.append(box.sequence.decision.decision)
    order = [one for k, one in enumerate(said) if k == 0 or one is not said[k - 1]]
    waits = ShiftDecision.WAIT_FOR_GAP if known else ShiftDecision.WAIT_FOR_SLIP
    assert order[0] is ShiftDecision.BRAKE
    assert order[-2:] == [ShiftDecision.FIRE, ShiftDecision.COMMITTED]
    assert set(order[1:-2]) == ({waits} if known else {ShiftDecision.RELEASE, waits})


def test_the_range_is_not_taken_for_changed_before_its_shafts_turn_together() -> None:
    """Nor are the speeds believed that the estimators had before."""
    box = aimed(6, 110.0)
    box.ask(7)
    box.until(State.STEPS_CHANGING)
    snapshot, estimated = box.snapshot, [1.2]

    def late(**other: Any) -> Any:
        found = snapshot(**other)
        main = found.main
        assert main is not None
        wrong = main._replace(omega_rad_s=main.omega_rad_s * estimated[0])
        return snapshot(main_at=lambda _: wrong)

    box.snapshot = late  # type: ignore[method-assign]
    for _ in range(40):
        assert box.step() is State.STEPS_CHANGING
    estimated[0] = 1.04
    assert box.step() is not State.STEPS_CHANGING


def test_a_shift_that_changes_no_step_waits_for_no_speeds_to_agree() -> None:
    """Red before: a layshaft that the brake slowed quickly was estimated late for so long that the
    brake had brought it below its gear, and the engine had to raise it again."""
    box = aimed(*UP[:2])
    box.ask(UP[2])
    box.until(State.DISENGAGING)
    snapshot = box.snapshot

    def lagging(**other: Any) -> Any:
        found = snapshot(**other)
        late = found.layshaft.latest()._replace(omega_rad_s=1.1 * box.layshaft)
        found.layshaft.at = lambda _: late
        return found

    box.snapshot = lagging  # type: ignore[method-assign]
    assert box.until(State.SYNCHRONISING, most=20)
    assert State.STEPS_CHANGING not in box.trajectory


def test_speeds_that_never_agree_after_a_change_of_range_end_the_shift() -> None:
    box = aimed(6, 110.0)
    box.ask(7)
    box.until(State.STEPS_CHANGING)
    snapshot = box.snapshot
    nothing = {"main_at": lambda _: None}
    box.snapshot = lambda **other: snapshot(**nothing | other)  # type: ignore[method-assign]
    while box.running():
        box.step()
    record = box.records[-1]
    assert record.fault is FaultCode.SPEED_STALE
    assert record.result is ShiftResult.ENDED_IN_NEUTRAL
