"""Sleeves that are stopped on their way or brought to neutral: an abort before a tooth, a pull that
ends before neutral, a sleeve found between neutral and a gear. That the two coils of a sleeve are
never on together is checked by the box in each step."""

from __future__ import annotations

from itertools import pairwise

import pytest
from shift_box import (
    CONTACT_M,
    DOWN,
    FAST_UP,
    FIRST_SECOND,
    MAIN_SLEEVES,
    PITCH,
    SHEET,
    STROKE_M,
    TICK_US,
    UP,
    Box,
    aimed,
    ticking,
)

from meshpoint.controller.measure.gearbox_view import VIEW_NEUTRAL_M
from meshpoint.controller.plan.strategy import BUS_US
from meshpoint.controller.settings.valve_name import ValveName
from meshpoint.dbc.messages import ClutchAction, FaultCode, ShiftResult
from meshpoint.dbc.messages import ControllerState as State
from meshpoint.dbc.sensor_time import READ_CYCLE_US
from meshpoint.gearbox import MainGear

VALVE, OPPOSITE = ValveName.MAIN_SECOND, ValveName.MAIN_FIRST
MAIN_VALVES = (ValveName.MAIN_FIRST, ValveName.MAIN_SECOND, ValveName.MAIN_CRAWL,
               ValveName.MAIN_THIRD)  # fmt: skip
PRESSED_PA = 2e5
HALF_GAP: float = 0.5 * SHEET.dog.backlash_rad


def kicked(kick: float, way: tuple[int, float, int] = UP, tick_ms: int = 10) -> Box:
    """A shift up, its sleeve just fired, and the main shaft jerks."""
    box = aimed(*way[:2], settings=ticking(tick_ms))
    box.ask(way[2])
    box.until(State.ENGAGING)
    box.theta_main += kick * PITCH
    return box


@pytest.mark.parametrize("kick", [0.35, 0.5, -0.4])
def test_a_sleeve_that_would_meet_a_tooth_is_stopped_and_fired_again_from_where_it_stands(
    kick: float,
) -> None:
    """What was stopped is no attempt, and the next firing meets the gap. The brake was released
    before the first one: while the layshaft falls at its full torque, the guard lets no sleeve be
    fired that may be at the teeth at once."""
    met: list[float] = []
    box = kicked(kick, FAST_UP)
    box.face = lambda phase: met.append(phase) or False  # type: ignore[func-returns-value]
    fired_us = box.board.command(VALVE).time_us
    last_us = fired_us + box.sequence.sleeves.abort_after_us(MainGear.SECOND)
    box.until(State.HALTED, most=4)
    assert box.now_us <= last_us < box.now_us + 2 * TICK_US, "no step sooner than it has to"
    assert not box.board.command(VALVE).on
    while box.state is State.HALTED:
        stood_m = box.position_m[FIRST_SECOND]
        assert stood_m < CONTACT_M
        box.step()
    assert met == []
    box.until(State.IN_GEAR)
    record = box.records[-1]
    assert State.RETRACTING not in box.trajectory
    assert (record.result, record.attempts, record.aborts) == (ShiftResult.ENGAGED, 1, 1)
    assert record.halt_m == pytest.approx(stood_m, abs=0.5e-3)
    assert len(met) == 1
    assert abs(met[0]) < HALF_GAP


@pytest.mark.parametrize("tick_ms", [5, 10, 20])
@pytest.mark.parametrize("input_rad_s", [190.0, 191.0])
def test_of_any_tick_a_sleeve_is_stopped_after_the_last_read_by_which_it_can_be(
    input_rad_s: float, tick_ms: int
) -> None:
    """No step sooner, and without another read no step later: red before, where of a tick of 5 ms
    the one after that read was waited for, which knows no more."""
    box = kicked(0.5, (7, input_rad_s, 9), tick_ms)
    fired_us = box.board.command(VALVE).time_us
    last_us = fired_us + box.sequence.sleeves.abort_after_us(MainGear.SECOND)
    box.until(State.HALTED, most=40)
    next_us = box.now_us + max(box.tick_us, READ_CYCLE_US)
    assert box.has_read
    assert box.now_us <= last_us - BUS_US < next_us


def test_a_sleeve_on_its_way_to_a_gap_is_not_stopped() -> None:
    box = kicked(0.0)
    box.until(State.IN_GEAR)
    assert (box.records[-1].aborts, box.records[-1].attempts) == (0, 1)


def test_a_sleeve_past_the_last_instant_in_which_it_can_be_stopped_goes_on() -> None:
    box = kicked(0.0)
    plan = box.sequence.running.plan
    assert plan is not None
    while box.now_us < plan.fire_us + 1e6 * (SHEET.sleeve.delay_s - SHEET.sleeve.valve_delay_s):
        box.step()
    box.theta_main += 0.5 * PITCH
    box.step()
    assert box.state is State.ENGAGING
    assert box.board.command(VALVE).on


def test_a_sleeve_with_no_gap_within_reach_goes_back_to_neutral_after_150_ms_at_most() -> None:
    """A tooth stays before a tooth, and the gear turns so fast that its gap is far on each side.
    The brake's air is out."""
    box = kicked(0.5, FAST_UP)
    box.until(State.HALTED, most=6)
    began_us = box.now_us
    while box.state is State.HALTED:
        box.layshaft = (box.main + 1.0) / SHEET.main_mesh(MainGear.SECOND).ratio
        box.theta_main += box.phase(MainGear.SECOND) - 0.5 * PITCH
        assert box.now_us - began_us <= 150_000 + TICK_US
        box.step()
    assert box.state is State.RETRACTING
    box.until(State.COASTING, State.SPEED_RAISING)
    assert box.view.main_gear is MainGear.NEUTRAL
    assert box.sequence.running.attempts == 0
    box.until(State.IN_GEAR)
    assert box.records[-1].result is ShiftResult.ENGAGED


def test_a_main_shaft_that_jerks_at_each_firing_ends_the_shift_in_its_gear_all_the_same() -> None:
    """Aborts may take as long as a shift may synchronise; then the sleeve goes as it was fired."""
    box = kicked(0.5)
    before = State.ENGAGING
    while box.running():
        if box.state is State.ENGAGING and before is not State.ENGAGING:
            box.theta_main += 0.5 * PITCH
        before = box.state
        box.step()
    record = box.records[-1]
    assert record.aborts >= 2
    assert (record.result, record.attempts) == (ShiftResult.ENGAGED, 1)


@pytest.mark.parametrize(("gear", "speed", "target"), [UP, (9, 150.0, 11), (8, 150.0, 10)])
def test_a_gear_is_pulled_out_by_a_pulse_that_ends_before_neutral(
    gear: int, speed: float, target: int
) -> None:
    """The sleeve comes to rest there by itself, and never gets near the other gear."""
    box = aimed(gear, speed)
    sleeve = max(MAIN_SLEEVES, key=lambda one: abs(box.position_m[one]))
    side = 1.0 if box.position_m[sleeve] > 0.0 else -1.0
    box.ask(target)
    box.until(State.DISENGAGING)
    (pull,) = [box.board.command(valve) for valve in MAIN_VALVES if box.board.command(valve).on]
    while box.state is State.DISENGAGING:
        box.step()
        if box.now_us < pull.until_us:
            assert box.position_m[sleeve] * side > CONTACT_M
    while box.state in (State.STEPS_CHANGING, State.SYNCHRONISING):
        assert box.position_m[sleeve] * side > -VIEW_NEUTRAL_M
        box.step()
    assert pull.until_us - pull.time_us < 30_000


@pytest.mark.parametrize("share", [-0.8, -0.4, 0.2, 0.4, 0.8])
def test_a_start_with_a_sleeve_between_neutral_and_a_gear_brings_it_to_neutral(
    share: float,
) -> None:
    """With the clutch open."""
    box = Box(*UP[:2])
    box.position_m[FIRST_SECOND] = share * STROKE_M
    while box.step() is State.STARTING:
        assert box.sequence.clutch is ClutchAction.OPEN
        if any(box.board.command(valve).on for valve in MAIN_VALVES):
            assert box.view.clutch_parted
        assert box.now_us < 6_500_000
    assert box.state is State.NEUTRAL


@pytest.mark.parametrize("state", [State.STARTING, State.FAULTED])
def test_a_sleeve_that_does_not_come_to_neutral_is_tried_again_each_300_ms(state: State) -> None:
    """A pulse each time: it does not take all the air."""
    box = Box(*UP[:2]) if state is State.STARTING else faulted()
    box.position_m[FIRST_SECOND] = 0.4 * STROKE_M
    box.stuck.add(FIRST_SECOND)
    tried = set()
    for _ in range(150):
        assert box.step() is state
        tried |= {box.board.command(valve).time_us for valve in MAIN_VALVES
                  if box.board.command(valve).on}  # fmt: skip
    times_us = sorted(tried)
    gaps_us = [later - sooner for sooner, later in pairwise(times_us)]
    assert len(gaps_us) >= 2
    assert min(gaps_us) > 300_000
    box.stuck.clear()
    box.until(State.NEUTRAL)


def faulted() -> Box:
    """A shift that has lost its positions between two gears, and has them again."""
    box = aimed(*UP[:2])
    box.ask(UP[2])
    box.until(State.DISENGAGING)
    box.lost = FaultCode.POSITION_STALE
    box.until(State.FAULTED)
    for _ in range(20):
        box.step()
    box.lost = FaultCode.NONE
    return box


@pytest.mark.parametrize("left_m", [-4e-3, 3e-3, 8e-3])
def test_a_sleeve_that_leaves_neutral_while_the_gear_is_braked_is_brought_back_the_brake_let_go(
    left_m: float,
) -> None:
    box = aimed(*UP[:2])
    box.ask(UP[2])
    box.until(State.SYNCHRONISING)
    assert box.board.command(ValveName.BRAKE).on
    box.position_m[FIRST_SECOND] = left_m
    box.step()
    assert box.state is State.DISENGAGING
    assert not box.board.command(ValveName.BRAKE).on
    while box.state is State.DISENGAGING:
        box.step()
    assert box.view.main_gear is MainGear.NEUTRAL
    box.until(State.IN_GEAR)
    assert box.records[-1].result is ShiftResult.ENGAGED


def test_a_sleeve_that_leaves_neutral_while_the_engine_raises_the_gear_finds_the_clutch_open() -> (
    None
):
    """Else the layshaft would hang on the engine, and the gear could not be synchronised."""
    box = aimed(*DOWN[:2])
    box.ask(DOWN[2])
    box.until(State.SPEED_RAISING)
    box.position_m[FIRST_SECOND] = 3e-3
    box.step()
    assert box.state is State.DISENGAGING
    assert box.sequence.clutch is ClutchAction.OPEN
    assert box.sequence.engine_rad_s is None
    box.until(State.IN_GEAR)
    assert box.records[-1].result is ShiftResult.ENGAGED


def test_a_gear_is_not_braked_below_its_speed_while_the_old_ones_sleeve_stands_short() -> None:
    """Red before: the brake that came ahead was let go only once the sleeve was in neutral, and the
    engine had to raise the gear again."""
    box = aimed(*UP[:2])
    box.ask(UP[2])
    while box.position_m[FIRST_SECOND] < -3e-3:
        box.step()
    box.stuck.add(FIRST_SECOND)
    box.position_m[FIRST_SECOND] = -3e-3
    while box.pressure_pa < PRESSED_PA:
        assert box.step() is State.DISENGAGING
    while box.pressure_pa > 0.1 * PRESSED_PA:
        assert box.step() is State.DISENGAGING
    assert box.slip(MainGear.SECOND) > 0.0
    box.stuck.clear()
    box.until(State.IN_GEAR)
    assert box.records[-1].result is ShiftResult.ENGAGED
    assert box.records[-1].raises == 0
