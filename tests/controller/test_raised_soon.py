"""How a gear that is too slow comes to its speed soonest: what the engine is asked for, and when
the clutch closes and opens."""

from __future__ import annotations

import math

import pytest
from shift_box import CONTACT_M, DOWN, SHEET, Box, aimed

from meshpoint.controller.measure.gearbox_view import VIEW_NEUTRAL_M
from meshpoint.controller.shift.engine import raise_ahead
from meshpoint.dbc.messages import ClutchAction, FaultCode, ShiftResult
from meshpoint.dbc.messages import ControllerState as State
from meshpoint.gearbox.gears import DRIVE_GEARS, SLEEVE_OF_MAIN

TOP_RAD_S = SHEET.limits.input_max_rad_s


def raising(box: Box, target: int) -> Box:
    box.ask(target)
    return box.until(State.SPEED_RAISING)


def needed_rad_s(box: Box, target: int) -> float:
    """The engine's speed at which the new gear has no slip."""
    gear = DRIVE_GEARS[target]
    return box.main / SHEET.main_mesh(gear.main).ratio / SHEET.split_mesh(gear.split).ratio


def test_an_engine_that_is_far_off_is_asked_for_the_most_and_then_for_the_gears_speed() -> None:
    """Its own control creeps into a speed: asked for the gear's, it took 30 to 100 ms longer."""
    box = raising(aimed(*DOWN[:2]), DOWN[2])
    needed = needed_rad_s(box, DOWN[2])
    for engine, rate_rad_s2, is_most in (
        (needed - 60.0, 0.0, True), (needed - 60.0, 300.0, True),
        (needed - 30.0, 400.0, False), (needed + 20.0, 0.0, False), (needed + 40.0, 0.0, False),
    ):  # fmt: skip
        for _ in range(8):
            box.now_us += 10_000
            engine += 0.01 * rate_rad_s2
            box.sequence.torque.take(box.now_us, None, 0.01, engine)
        box.sequence.step(box.snapshot(engine_rad_s=engine))
        asked = box.sequence.engine_rad_s or 0.0
        assert (asked == TOP_RAD_S) is is_most, (engine, rate_rad_s2)
        assert is_most or needed < asked < needed + 30.0
        box.engine = engine


def falls_short() -> Box:
    """The old gear's sleeve is out of its teeth and stays between them and neutral."""
    box = aimed(*DOWN[:2])
    box.ask(DOWN[2])
    box.until(State.DISENGAGING)
    side = SLEEVE_OF_MAIN[DRIVE_GEARS[DOWN[0]].main]
    assert 2.0 * VIEW_NEUTRAL_M < CONTACT_M - 0.5e-3
    box.stuck.add(side.sleeve)
    box.position_m[side.sleeve] = side.direction * 2.0 * VIEW_NEUTRAL_M
    while box.sequence.clutch is ClutchAction.OPEN:
        assert box.step() is State.DISENGAGING
    return box


def test_the_clutch_closes_while_a_sleeve_falls_short_of_neutral() -> None:
    """It took 90 ms more to come to neutral, and the engine waited for the plates meanwhile."""
    box = falls_short()
    for _ in range(4):
        assert box.step() is State.DISENGAGING
        assert box.sequence.clutch is ClutchAction.CLOSE
        assert box.sequence.engine_rad_s is not None
    box.stuck.clear()
    box.position_m[SLEEVE_OF_MAIN[DRIVE_GEARS[DOWN[0]].main].sleeve] = 0.0
    while box.running():
        box.step()
    assert box.records[-1].result is ShiftResult.ENGAGED
    assert box.records[-1].raises == 1


def test_a_gear_that_is_measured_in_again_opens_the_clutch() -> None:
    box = falls_short()
    side = SLEEVE_OF_MAIN[DRIVE_GEARS[DOWN[0]].main]
    box.position_m[side.sleeve] = side.direction * SHEET.sleeve.stroke_m
    while box.sequence.clutch is ClutchAction.CLOSE:
        assert box.step() is State.DISENGAGING
    assert box.sequence.engine_rad_s is None


@pytest.mark.parametrize("rate_rad_s2", [50.0, 500.0])
def test_the_clutch_opens_for_an_engine_that_rises_fast(rate_rad_s2: float) -> None:
    """A shaft's speed is some 10 ms older than the engine's: the plates were taken to slip as long
    as the engine rose, and opened 130 ms late."""
    box = raising(aimed(*DOWN[:2]), DOWN[2])
    gear = DRIVE_GEARS[DOWN[2]]
    ratio = SHEET.main_mesh(gear.main).ratio * SHEET.split_mesh(gear.split).ratio
    needed = needed_rad_s(box, DOWN[2])
    lag_s = SHEET.engine.lag_s
    gains = rate_rad_s2 * lag_s * (1.0 - math.exp(-0.1 / lag_s))
    box.clutch = 0.9
    first = needed - 0.06 * rate_rad_s2
    for k in range(60):
        engine = first + rate_rad_s2 * 0.01 * k
        box.engine = engine
        box.layshaft = (engine - 0.01 * rate_rad_s2) * SHEET.split_mesh(gear.split).ratio
        box.now_us += 10_000
        box.view.clutch.take(box.now_us, 0.9)
        box.sequence.step(box.snapshot(engine_rad_s=engine))
        if box.state is not State.SPEED_RAISING:
            break
    assert box.state is State.CLUTCH_PARTING
    comes = ratio * (engine + gains - needed)
    assert comes < 25.0


def test_no_shift_to_a_crawl_gear_begins_without_the_room_to_raise_it() -> None:
    """Crawl gears have the highest numbers: they were taken for upshifts, and ended in neutral."""
    old, new = (SHEET.overall_ratio(DRIVE_GEARS[number]) for number in (1, 13))
    box = aimed(1, TOP_RAD_S / 1.05 * old / new)
    refusal = box.ask(13)
    assert refusal is not None and "rpm" in refusal
    assert box.sequence.fault is FaultCode.INPUT_OVERSPEED
    assert aimed(1, TOP_RAD_S / 1.12 * old / new).ask(13) is None


def test_a_gear_with_little_room_is_raised_as_far_as_the_input_shaft_may_turn() -> None:
    """Drag that is believed to be 225 Nm asked for more than that: the engine was asked for
    nothing, and the shift ended in neutral."""
    box = raising(aimed(DOWN[0], 137.0, drag_nm=225.0), DOWN[2])
    asked = []
    while box.state in {State.SPEED_RAISING, State.CLUTCH_PARTING}:
        asked.append(box.sequence.engine_rad_s)
        box.step()
    assert all(wanted is not None and wanted <= TOP_RAD_S for wanted in asked[:-1])
    while box.running():
        box.step()
    assert box.records[-1].result is ShiftResult.ENGAGED


def test_the_engine_does_not_rise_ahead_of_a_change_of_range() -> None:
    """The main shaft's speed is another after it: on the way up, the engine was asked for the old
    one's."""
    box = Box(6, 120.0).ready()
    box.ask(7)
    box.until(State.DISENGAGING)
    context, shift = box.sequence, box.sequence.running
    for gear, is_asked in ((DRIVE_GEARS[7], False), (DRIVE_GEARS[4], True)):
        shift.target = gear
        slip = box.snapshot().speeds.slip_rad_s(gear.main)
        assert slip is not None
        box.main += slip + 20.0
        box.view.clutch.take(box.now_us, 0.0)
        box.view.work_out()
        raise_ahead(context, box.snapshot(), stays_out=False)
        assert (context.engine_rad_s is not None) is is_asked
