"""The guard blocks what would break the gearbox, whatever the sequence believes.

Each row of docs/guard.md by itself, its limit from both sides; `closed_loop/test_guard_truth.py`
shows each against the rig's truth.
"""

from __future__ import annotations

import dataclasses
import math
from itertools import product

import pytest
from guard_cases import (
    ASKED,
    DRIVING,
    FOREVER,
    GEAR_OF,
    LIMITS,
    MAIN,
    NEUTRAL,
    NOW,
    OTHER_END,
    PAIRS,
    SHEET,
    SLEEVE,
    WAY,
    blocked_row,
    braking,
    encoded,
    kept,
    near,
    payload,
    place,
    ready,
    speeds,
)

from meshpoint.controller.guard.case import (
    NO_SPANS,
    GuardState,
    JudgedCommand,
    Span,
    ValveRequest,
    decode,
    spans,
)
from meshpoint.controller.guard.own_speed import ShaftSpeed as Speed
from meshpoint.controller.guard.rules import (
    GUARD_ROWS,
    PROOF_STEPS,
    Guard,
    slip_out_of_its_window,
)
from meshpoint.controller.settings.valve_name import ValveName
from meshpoint.dbc.messages import ValveAction, ValveCommand
from meshpoint.gearbox import MainGear, Split


def test_every_row_of_the_list_is_there_once() -> None:
    numbers = [row.number for row in GUARD_ROWS]
    assert len(numbers) == len({*numbers})
    assert {row.number for row in GUARD_ROWS if row.latches} == {1, 2}


@pytest.mark.parametrize("valve", ValveName)
@pytest.mark.parametrize("how", DRIVING)
def test_one_valve_alone_at_its_moment_may_be_driven(valve: ValveName, how: ValveAction) -> None:
    assert blocked_row(near(valve), valve, how=how) is None


@pytest.mark.parametrize("how", [ValveAction.OFF_NOW, ValveAction.OFF_AT])
def test_switching_off_is_always_allowed(how: ValveAction) -> None:
    worst = place(place(NEUTRAL, 0, 0.012), 1, -0.012)._replace(clutch_closed=1.0, valid=False)
    assert blocked_row(worst, *ValveName, how=how) is None


# -- what is driven --------------------------------------------------------------------------


def span_of(action: ValveAction, ahead_us: int, was: Span | None) -> Span | None:
    actions = (int(action),) + (0,) * 8
    times = ((NOW + ahead_us) & 0xFFFF_FFFF,) + (0,) * 8
    return spans(ValveRequest(actions, times), (was, *NO_SPANS[1:]), NOW)[0]


def test_a_span_goes_from_activation_to_release() -> None:
    on, late = Span(NOW - 50_000, FOREVER), Span(NOW + 5_000, FOREVER)
    assert span_of(ValveAction.ON_AT, 20_000, None) == Span(NOW + 20_000, FOREVER)
    assert span_of(ValveAction.ON_AT, -20_000, None) == Span(NOW, FOREVER)
    assert span_of(ValveAction.ON_AT, 20_000, on) == on
    assert span_of(ValveAction.ON_AT, 20_000, late) == Span(NOW + 20_000, FOREVER)
    assert span_of(ValveAction.ON_NOW, 0, None) == Span(NOW, FOREVER)
    assert span_of(ValveAction.ON_NOW, 0, on) == on
    assert span_of(ValveAction.OFF_AT, 20_000, on) == Span(on.start_us, NOW + 20_000)
    assert span_of(ValveAction.OFF_AT, 0, on) is None
    assert span_of(ValveAction.OFF_AT, 20_000, late) is None
    assert span_of(ValveAction.OFF_AT, 20_000, None) is None
    assert span_of(ValveAction.OFF_AT, 20_000, Span(NOW - 50_000, NOW)) is None
    assert span_of(ValveAction.OFF_NOW, 0, on) is None


# -- the rows --------------------------------------------------------------------------------


@pytest.mark.parametrize("pair", PAIRS)
@pytest.mark.parametrize("how", DRIVING)
def test_row_1_both_valves_of_a_sleeve(pair: tuple[ValveName, ValveName], how: ValveAction) -> None:
    assert blocked_row(NEUTRAL, *pair, how=how) == 1


@pytest.mark.parametrize("both", list(product(MAIN[:2], MAIN[2:])))
def test_row_2_two_sleeves_of_the_main_box(both: tuple[ValveName, ValveName]) -> None:
    assert blocked_row(NEUTRAL, *both) == 2


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize("own", MAIN)
def test_row_2_a_sleeve_while_the_other_is_not_proven_neutral(own: ValveName, side: float) -> None:
    """1.5 mm is proof."""
    for other_mm, row in ((1.4, None), (1.6, 2), (12.0, 2)):
        seen = place(near(own), 1 - SLEEVE[own], side * other_mm * 1e-3)
        assert blocked_row(seen, own) == row


@pytest.mark.parametrize("own", MAIN)
def test_row_3_slip_at_contact_far_outside_the_window(own: ValveName) -> None:
    """-60 and +120 rpm, and 10 rpm of doubt; drag may take more until contact, the brake none."""
    assert blocked_row(near(own), own) is None
    gear = GEAR_OF[own]
    for slip_rpm, row in ((-65.0, None), (-75.0, 3), (125.0, None), (400.0, 3)):
        seen = NEUTRAL._replace(speeds=speeds(gear=gear, slip_rpm=slip_rpm))
        assert blocked_row(seen, own) == row, slip_rpm


def test_row_3_is_judged_at_contact_not_now() -> None:
    """The brake is still on and releases before contact: 250 rpm now can be 20 by then, 700 not."""
    for slip_rpm, row in ((250.0, None), (700.0, 3)):
        guard, command = braking(NOW + 40_000)
        guard.passes(encoded(command), NEUTRAL._replace(speeds=speeds(slip_rpm=slip_rpm)))
        assert guard.blocked_row == row, slip_rpm


def test_row_3_counts_what_the_brake_must_take_at_least() -> None:
    """150 rpm/s at the least, for as long as it surely acts: a gear that is slow already will be
    far too slow."""
    seen = NEUTRAL._replace(speeds=speeds(slip_rpm=-55.0))
    for since_us, row in ((NOW - 20_000, None), (NOW - 400_000, 3)):
        guard = ready()
        kept(guard).spans = (Span(since_us, FOREVER), *NO_SPANS[1:])
        command = ValveCommand(
            brake_action=ValveAction.OFF_AT,
            brake_time_us=(NOW + 60_000) & 0xFFFF_FFFF,
            main_second_action=ValveAction.ON_AT,
            main_second_time_us=(NOW + 30_000) & 0xFFFF_FFFF,
        )
        guard.passes(encoded(command), seen)
        assert guard.blocked_row == row


def test_row_3_knows_that_the_brakes_pressure_outlasts_its_release() -> None:
    """Just released it may still take 250 rpm of slip away; long ago it does not."""
    seen = NEUTRAL._replace(speeds=speeds(slip_rpm=300.0))
    for ago_us, row in ((5_000, None), (400_000, 3)):
        guard = ready()
        kept(guard).brake_off_us = NOW - ago_us
        guard.passes(payload(ValveName.MAIN_SECOND), seen)
        assert guard.blocked_row == row


def test_row_3_the_engine_may_bring_any_slip() -> None:
    assert blocked_row(NEUTRAL._replace(clutch_closed=0.30), ValveName.MAIN_SECOND) is None
    assert blocked_row(NEUTRAL._replace(clutch_closed=0.31), ValveName.MAIN_SECOND) == 3


@pytest.mark.parametrize("own", MAIN)
def test_row_3_does_not_ask_once_the_gear_is_entered(own: ValveName) -> None:
    seen = NEUTRAL._replace(speeds=speeds(gear=GEAR_OF[own], slip_rpm=500.0))
    for way_mm, row in ((4.9, 3), (5.1, None)):
        assert blocked_row(place(seen, SLEEVE[own], WAY[own] * way_mm * 1e-3), own) == row


@pytest.mark.parametrize("shaft", [1, 2])
def test_row_4_engaging_on_a_lost_speed(shaft: int) -> None:
    lost: list[Speed | None] = list(speeds())
    lost[shaft] = None
    a, b, c, d = lost
    seen = NEUTRAL._replace(speeds=(a, b, c, d))
    assert blocked_row(seen, ValveName.MAIN_SECOND) == 4
    out = place(seen, 0, -0.012)
    assert blocked_row(out, ValveName.MAIN_SECOND) is None  # pulling a gear out needs no speed


@pytest.mark.parametrize("valve", [v for v in ValveName if v is not ValveName.BRAKE])
def test_row_7_a_valve_on_for_too_long(valve: ValveName) -> None:
    """Resent every tick; off for one frame in between begins anew, where a main sleeve is seen to
    stand meanwhile."""
    guard, on = ready(), payload(valve, how=ValveAction.ON_NOW)
    seen, limit_us = near(valve), LIMITS.valve_on_us
    turning = seen.speeds
    for later_us, row in ((0, None), (limit_us, None), (limit_us + 1, 7)):
        moved = tuple(s._replace(time_us=NOW + later_us) for s in turning if s is not None)
        guard.passes(on, seen._replace(now_us=NOW + later_us, speeds=moved))
        assert guard.blocked_row == row
    rested = seen._replace(positions_us=NOW + limit_us + 20_000)
    assert guard.passes(payload(), rested)
    assert guard.passes(on, rested)


@pytest.mark.parametrize("valve", ValveName)
def test_row_7_nothing_is_held_after_the_inputs_are_lost(valve: ValveName) -> None:
    assert blocked_row(near(valve)._replace(valid=False), valve) == 7


@pytest.mark.parametrize("valve", [ValveName.RANGE_LOW, ValveName.RANGE_HIGH])
@pytest.mark.parametrize("sleeve", [0, 1])
def test_row_8_the_range_moves_only_in_neutral(valve: ValveName, sleeve: int) -> None:
    assert blocked_row(place(NEUTRAL, sleeve, 1.4e-3), valve) is None
    assert blocked_row(place(NEUTRAL, sleeve, 1.6e-3), valve) == 8
    assert blocked_row(NEUTRAL, valve, ValveName.MAIN_SECOND) == 8


def test_row_8_the_range_does_not_go_down_at_speed() -> None:
    """The main shaft would turn 3.75 times as fast as the propeller shaft."""
    a, b, c, _ = speeds()
    limit = LIMITS.main_max_rad_s / 3.75
    for share, row in ((0.99, None), (1.01, 8)):
        seen = NEUTRAL._replace(speeds=(a, b, c, Speed(NOW, share * limit)))
        assert blocked_row(seen, ValveName.RANGE_LOW) == row
        assert blocked_row(seen, ValveName.RANGE_HIGH) is None
    assert blocked_row(NEUTRAL._replace(speeds=(a, b, c, None)), ValveName.RANGE_LOW) == 8


def test_row_9_a_gear_that_would_overspeed_the_input_shaft() -> None:
    """By the splitter as it stands, and by the worse one where it stands between."""
    ratio = SHEET.main_mesh(MainGear.FIRST).ratio
    top = 1.01 * SHEET.limits.input_max_rad_s
    for split, position_mm in ((Split.HIGH, 12.0), (Split.LOW, -12.0), (Split.LOW, 0.0)):
        limit = top * SHEET.split_mesh(split).ratio * ratio
        for share, row in ((0.99, None), (1.01, 9)):
            main = share * limit
            turning = (None, Speed(NOW, main / ratio), Speed(NOW, main), None)
            seen = place(NEUTRAL, 2, position_mm * 1e-3)._replace(speeds=turning)
            assert blocked_row(seen, ValveName.MAIN_FIRST) == row


def test_row_9_a_splitter_step_that_would_overspeed_the_input_shaft() -> None:
    limit = 1.01 * SHEET.limits.input_max_rad_s * SHEET.split_mesh(Split.LOW).ratio
    for share, row in ((0.99, None), (1.01, 9)):
        seen = NEUTRAL._replace(speeds=(None, Speed(NOW, share * limit), None, None))
        assert blocked_row(seen, ValveName.SPLIT_LOW) == row
        assert blocked_row(place(seen, 2, -0.012), ValveName.SPLIT_HIGH) is None
    unknown = NEUTRAL._replace(speeds=(None, None, None, None))
    assert blocked_row(unknown, ValveName.SPLIT_LOW) == 9


@pytest.mark.parametrize("valve", MAIN)
def test_row_10_a_gear_is_not_pulled_out_under_torque(valve: ValveName) -> None:
    """From the clutch, or from the brake's pressure."""
    in_mesh = place(NEUTRAL, SLEEVE[valve], -WAY[valve] * 0.012)
    assert blocked_row(in_mesh, valve) is None
    assert blocked_row(in_mesh._replace(clutch_closed=0.30), valve) is None
    assert blocked_row(in_mesh._replace(clutch_closed=0.31), valve) == 10
    assert blocked_row(in_mesh._replace(brake_pa=1.013e5 + 0.99e5), valve) is None
    assert blocked_row(in_mesh._replace(brake_pa=1.013e5 + 1.01e5), valve) == 10


@pytest.mark.parametrize(
    ("closed", "per_s", "row"),
    [
        (0.53, -10.0, None),  # the teeth are out no sooner than 24.5 ms on: 0.285 then
        (0.55, -10.0, 10),
        (0.53, 0.0, 10),
        (0.28, 5.0, 10),
    ],
)
def test_row_10_the_clutch_as_it_will_be_when_the_teeth_may_be_out(
    closed: float, per_s: float, row: int | None
) -> None:
    in_mesh = place(NEUTRAL, 0, 0.012)._replace(
        clutch_closed=closed, clutch_per_s=per_s, clutch_us=NOW
    )
    assert blocked_row(in_mesh, ValveName.MAIN_FIRST, at_us=NOW) == row


def test_row_10_a_pull_that_goes_on_while_the_clutch_stands_still() -> None:
    """Passed on a clutch that opens; it stops half way, and the pull is withdrawn."""
    guard, on = ready(), payload(ValveName.MAIN_FIRST, at_us=NOW)
    opening = place(NEUTRAL, 0, 0.012)._replace(
        clutch_closed=0.53, clutch_per_s=-10.0, clutch_us=NOW
    )
    assert guard.passes(on, opening)
    stuck = opening._replace(
        now_us=NOW + 10_000, clutch_closed=0.45, clutch_per_s=0.0, clutch_us=NOW + 10_000
    )
    assert not guard.passes(on, stuck)
    assert guard.blocked_row == 10


def test_row_10_nor_is_a_splitter_step() -> None:
    closed = NEUTRAL._replace(clutch_closed=1.0)
    assert blocked_row(closed, ValveName.SPLIT_LOW) == 10
    assert blocked_row(closed, ValveName.SPLIT_HIGH) is None  # it is in already
    assert blocked_row(place(closed, 2, -0.012), ValveName.SPLIT_HIGH) == 10


def test_a_valve_that_has_pulled_a_gear_out_may_stay_on_to_neutral_and_no_further() -> None:
    """Seen a read late: in neutral it is no engagement yet, 1.6 mm on it is."""
    guard, valve = ready(), ValveName.MAIN_CRAWL
    fast = NEUTRAL._replace(speeds=speeds(gear=MainGear.CRAWL, slip_rpm=200.0))
    on = payload(valve, at_us=NOW + 1_000)
    off = payload(valve, how=ValveAction.OFF_AT, at_us=NOW + 20_000)
    assert guard.passes(on, place(fast, 1, 0.012))
    for later_us, way_m in ((10_000, 0.0), (15_000, -1.4e-3)):
        seen_us = {"now_us": NOW + later_us, "positions_us": NOW + later_us - 1_000}
        assert guard.passes(off, place(fast, 1, way_m)._replace(**seen_us))
    far = place(fast, 1, -1.6e-3)._replace(now_us=NOW + 18_000, positions_us=NOW + 17_000)
    assert not guard.passes(off, far)
    assert guard.blocked_row == 3
    again = payload(valve, how=ValveAction.ON_NOW)
    assert not guard.passes(again, place(far, 1, 0.0))  # and not again without having pulled


@pytest.mark.parametrize("valve", ValveName)
def test_row_11_nothing_new_is_driven_without_air(valve: ValveName) -> None:
    for supply_pa, row in ((5.01e5, None), (4.99e5, 11)):
        assert blocked_row(near(valve)._replace(supply_pa=supply_pa), valve) == row
    guard = ready()
    assert guard.passes(payload(valve, how=ValveAction.ON_NOW), near(valve))
    held = near(valve)._replace(supply_pa=2e5)
    assert guard.passes(payload(valve, how=ValveAction.ON_NOW), held)


@pytest.mark.parametrize("valve", ValveName)
def test_row_12_nothing_is_driven_before_all_was_valid_three_steps_in_a_row(
    valve: ValveName,
) -> None:
    guard, seen = Guard(LIMITS, armed=True), near(valve)
    seen = seen._replace(requested_gear=ASKED)
    for valid in (True, True, False, True, True):
        assert guard.passes(payload(), seen._replace(valid=valid))
    again = Guard(LIMITS, armed=True)
    for _ in range(2):
        assert not again.passes(payload(valve), seen)
        assert again.blocked_row == 12
    assert again.passes(payload(valve), seen)
    assert guard.passes(payload(valve), seen)


@pytest.mark.parametrize("valve", ValveName)
@pytest.mark.parametrize("how", DRIVING)
def test_row_12_nothing_is_driven_by_a_guard_that_is_not_armed(
    valve: ValveName, how: ValveAction
) -> None:
    """The same commands at the same moments pass where it is."""
    guard, seen = Guard(LIMITS, armed=False), near(valve)
    for step in range(2 * PROOF_STEPS):
        assert guard.passes(payload(), seen)
        assert not guard.passes(payload(valve, how=how), seen)
        assert guard.blocked_row == 12
        assert guard.blocks == step + 1


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("input_max_rad_s", math.nan),
        ("main_max_rad_s", math.inf),
        ("brake_j", 0.0),
        ("valve_on_us", -1),
        ("slip_rad_s", (1.0, -1.0)),
    ],
)
def test_row_12_a_guard_whose_own_numbers_are_wrong_stays_shut(name: str, wrong: object) -> None:
    guard = Guard(dataclasses.replace(LIMITS, **{name: wrong}), armed=True)
    for _ in range(10):
        assert not guard.passes(payload(ValveName.SPLIT_HIGH), NEUTRAL)
        assert guard.blocked_row == 12


@pytest.mark.parametrize("agreeing", MAIN)
@pytest.mark.parametrize("valve", ValveName)
def test_row_13_a_gear_that_turns_with_its_sleeve_is_taken_to_be_in(
    agreeing: ValveName, valve: ValveName
) -> None:
    """Whatever the positions say: no brake, no range, no other sleeve; the gear itself may move."""
    seen = near(valve)._replace(agreeing=int(agreeing))
    free = {agreeing, OTHER_END[agreeing], ValveName.SPLIT_LOW, ValveName.SPLIT_HIGH}
    assert blocked_row(seen, valve) == (None if valve in free else 13)


# -- latches and decoding --------------------------------------------------------------------


@pytest.mark.parametrize(("mistake", "row"), [(PAIRS[1], 1), ((MAIN[0], MAIN[3]), 2)])
def test_a_command_that_should_never_be_made_latches(
    mistake: tuple[ValveName, ValveName], row: int
) -> None:
    """Rows 1 and 2 mean that the sequence is wrong: nothing is driven until it takes all back."""
    guard = ready()
    assert not guard.passes(payload(*mistake), NEUTRAL)
    for _ in range(3):
        assert not guard.passes(payload(ValveName.MAIN_SECOND), NEUTRAL)
        assert guard.blocked_row == row
    assert guard.blocks == 4
    assert guard.passes(payload(), NEUTRAL)
    assert guard.passes(payload(ValveName.MAIN_SECOND), NEUTRAL)


def test_a_row_that_depends_on_the_moment_does_not_latch() -> None:
    guard = ready()
    assert not guard.passes(payload(ValveName.BRAKE), NEUTRAL._replace(clutch_closed=0.5))
    assert guard.passes(payload(ValveName.BRAKE), NEUTRAL)


@pytest.mark.parametrize("length", [0, 5, 47, 49, 64])
def test_a_frame_of_another_length_is_no_valve_command(length: int) -> None:
    with pytest.raises(ValueError, match="48"):
        decode(bytes(length))


def test_row_3_leaves_a_lost_speed_to_row_4() -> None:
    """Asked by itself it has nothing to say: each row forbids its own."""
    seen = NEUTRAL._replace(speeds=(None, None, None, None))
    driven = (*NO_SPANS[:4], Span(NOW, FOREVER), *NO_SPANS[5:])
    assert not slip_out_of_its_window(JudgedCommand(driven, seen, GuardState(), LIMITS))


@pytest.mark.parametrize(("gained_us", "row"), [(2_000, None), (-50_000, None), (2_001, 12)])
def test_row_12_a_start_on_a_bus_that_still_delivers_old_frames(
    gained_us: int, row: int | None
) -> None:
    """They come faster than they were sent: the clock gains on the controller's."""
    guard = Guard(LIMITS, armed=True)
    for _ in range(10):
        assert guard.passes(
            payload(), NEUTRAL._replace(clock_gained_us=gained_us, requested_gear=ASKED)
        )
    assert guard.is_proven is (row is None)
    guard.passes(payload(ValveName.SPLIT_HIGH), NEUTRAL)
    assert guard.blocked_row == row
    # Once proven it goes on: what comes late then is known to be old.
    guard = ready()
    assert guard.passes(payload(ValveName.SPLIT_HIGH), NEUTRAL._replace(clock_gained_us=90_000))


def test_row_12_a_step_without_frames_proves_nothing() -> None:
    """Silence may be a node that hangs, whose old frames are still to come; it takes nothing of
    what was proven before, either."""
    silent = NEUTRAL._replace(has_heard=False)
    guard = Guard(LIMITS, armed=True)
    for seen in (NEUTRAL, NEUTRAL, silent, silent, silent):
        guard.passes(payload(), seen)
        assert not guard.is_proven
    guard.passes(payload(), NEUTRAL)
    assert guard.is_proven
    guard = Guard(LIMITS, armed=True)
    for seen in (NEUTRAL, NEUTRAL, silent._replace(valid=False), NEUTRAL):
        guard.passes(payload(), seen)
        assert not guard.is_proven


@pytest.mark.parametrize("error_us", [12_000, 12_001])
@pytest.mark.parametrize("sign", [-1, 1])
def test_row_19_commands_timed_by_another_clock_than_the_sensors(error_us: int, sign: int) -> None:
    seen = NEUTRAL._replace(clock_error_us=sign * error_us)
    assert blocked_row(seen, ValveName.BRAKE) == (19 if error_us > 12_000 else None)
    assert ready().passes(payload(), seen)
