"""The guard's rows for a splitter with dog teeth: those of a main sleeve, on the input shaft."""

from __future__ import annotations

from typing import Final

import pytest
from guard_cases import NOW, SETTINGS, payload, ready, swing_within

from meshpoint.controller.guard.case import JudgedCommand, decode, spans
from meshpoint.controller.guard.limits import guard_limits
from meshpoint.controller.guard.own_speed import ShaftSpeed
from meshpoint.controller.guard.rules import (
    Guard,
    back_and_forth,
    disengage_under_torque,
    engage_on_unknown_speed,
    input_overspeed,
    slip_out_of_its_window,
    two_sleeves_of_the_main_box,
)
from meshpoint.controller.guard.view import GuardInputs
from meshpoint.controller.settings.valve_name import ValveName
from meshpoint.gearbox import MainGear, Split, load_sheet
from meshpoint.units import RPM

DOG: Final = load_sheet("truck12-dog")
LIMITS: Final = guard_limits(DOG, SETTINGS)
LOW, HIGH = ValveName.SPLIT_LOW, ValveName.SPLIT_HIGH
IN_THIRD, NEUTRAL, IN_HIGH = 0.012, 0.0, 0.012


def at(
    slip_rpm: float, split: Split = Split.HIGH, layshaft_rpm: float = 1100.0,
    splitter_m: float = NEUTRAL,
) -> GuardInputs:  # fmt: skip
    """In third gear, the clutch open, the input shaft this much faster than a step's gear."""
    layshaft = layshaft_rpm * RPM
    turning = (
        layshaft / DOG.split_mesh(split).ratio + slip_rpm * RPM,
        layshaft,
        layshaft * DOG.main_mesh(MainGear.THIRD).ratio,
        layshaft * DOG.main_mesh(MainGear.THIRD).ratio,
    )
    a, b, c, d = (ShaftSpeed(NOW - 10_000, omega) for omega in turning)
    e, f, g = (
        swing_within(speed, 0.0, speed.omega_rad_s, speed.omega_rad_s) for speed in (b, c, a)
    )
    return GuardInputs(
        NOW, (0.0, IN_THIRD, splitter_m, 0.012), 0.0, 9.5e5, 1.013e5, (a, b, c, d), 0,
        valid=True, swings=(e, f, g), positions_us=NOW - 5_000,
        speeds_m_s=(0.0, 0.0, 0.0), means_m_s=(0.0, 0.0, 0.0),
    )  # fmt: skip


def guard(seen: GuardInputs) -> Guard:
    return ready(LIMITS, seen)


def case(seen: GuardInputs, *valves: ValveName, at_us: int = NOW + 20_000) -> JudgedCommand:
    one = guard(seen)
    wished = spans(decode(payload(*valves, at_us=at_us)), (None,) * 9, NOW)
    return JudgedCommand(wished, seen, one._state, LIMITS)


@pytest.mark.parametrize(("slip_rpm", "allowed"), [(50.0, True), (110.0, True), (700.0, False),
                                                   (-50.0, True), (-75.0, False)])  # fmt: skip
def test_it_is_fired_where_the_input_shaft_has_the_slip_of_the_window(
    slip_rpm: float, allowed: bool
) -> None:
    """Row 3: sleeve less gear. 700 rpm is more than drag at its most takes until contact."""
    seen = at(slip_rpm)
    assert guard(seen).passes(payload(HIGH), seen) is allowed
    assert slip_out_of_its_window(case(seen, HIGH)) is not allowed


def test_not_with_the_clutch_closed() -> None:
    seen = at(50.0)._replace(clutch_closed=0.31)
    assert slip_out_of_its_window(case(seen, HIGH))


@pytest.mark.parametrize("shaft", [0, 1])
def test_not_at_a_speed_that_is_unknown(shaft: int) -> None:
    """Row 4: input shaft and layshaft; the main shaft's is not asked."""
    seen = at(50.0)
    a, b, c, d = (None if k == shaft else speed for k, speed in enumerate(seen.speeds))
    assert engage_on_unknown_speed(case(seen._replace(speeds=(a, b, c, d)), HIGH))
    e, f, _, h = seen.speeds
    assert not engage_on_unknown_speed(case(seen._replace(speeds=(e, f, None, h)), HIGH))


def test_no_step_is_engaged_that_turns_the_input_shaft_too_fast() -> None:
    """Row 9: by the layshaft, whatever the input shaft does now. 2,424 rpm is the limit."""
    top = LIMITS.input_max_rad_s / RPM
    for split, valve in ((Split.LOW, LOW), (Split.HIGH, HIGH)):
        layshaft = top * DOG.split_mesh(split).ratio
        assert not input_overspeed(case(at(20.0, split, 0.999 * layshaft), valve))
        assert input_overspeed(case(at(20.0, split, 1.001 * layshaft), valve))


def test_the_valve_of_the_low_step_may_pull_the_high_one_out_at_any_speed() -> None:
    """Row 9 is for engaging: a pulse that stops in neutral turns nothing."""
    layshaft = LIMITS.input_max_rad_s / RPM * DOG.split_mesh(Split.HIGH).ratio * 0.99
    assert not input_overspeed(case(at(0.0, Split.HIGH, layshaft, IN_HIGH), LOW))


def test_it_is_pulled_out_with_the_plates_apart_alone() -> None:
    """Row 10: as a main sleeve, by when its teeth may be out."""
    seen = at(0.0, splitter_m=IN_HIGH)
    assert not disengage_under_torque(case(seen, LOW))
    assert disengage_under_torque(case(seen._replace(clutch_closed=0.6), LOW))
    pressed = seen._replace(brake_pa=1.013e5 + 1.2e5)
    assert disengage_under_torque(case(pressed, LOW))


def test_one_pulled_for_longer_than_stops_short_is_judged_as_fired_at_the_other_step() -> None:
    """Row 3: from one step through neutral into the teeth of the other, 23 % off."""
    one, seen = guard(at(0.0, splitter_m=IN_HIGH)), at(0.0, splitter_m=IN_HIGH)
    assert one.passes(payload(LOW, at_us=NOW), seen)
    later = seen._replace(now_us=NOW + 30_000, positions_us=NOW + 25_000)
    assert not one.passes(payload(LOW, at_us=NOW), later)
    assert one.blocked_row == 3


def test_it_is_not_driven_to_its_teeth_with_a_main_sleeve() -> None:
    """Row 2: both hold the layshaft."""
    seen = at(50.0)
    assert not two_sleeves_of_the_main_box(case(seen, HIGH))
    assert two_sleeves_of_the_main_box(case(seen, HIGH, ValveName.MAIN_CRAWL))


def test_it_may_be_braked_in_neutral_at_once() -> None:
    """Row 18 is for cones and for the range."""
    seen = at(50.0)
    judged = case(seen, HIGH)
    judged.state.group_us[int(LOW)] = NOW - 20_000
    assert not back_and_forth(judged)
    judged = case(seen, ValveName.RANGE_HIGH)
    judged.state.group_us[int(ValveName.RANGE_LOW)] = NOW - 20_000
    assert back_and_forth(judged)
