"""The guard's rows and a main sleeve that is stopped in flight or pulled out of its gear."""

from __future__ import annotations

import dataclasses

import pytest
from guard_cases import LIMITS, NOW, SETTINGS, SHEET, kept, place, ready
from guard_sleeve_cases import (
    BRAKE,
    CRAWL,
    FIRST,
    OFF_AT,
    ON_AT,
    ON_NOW,
    RANGE_HIGH,
    SECOND,
    SPLIT_LOW,
    THIRD,
    aborted,
    at,
    fired,
    row,
    slip_for,
    standing,
)

from meshpoint.controller.guard.limits import GUARD_NEUTRAL_M, guard_limits
from meshpoint.controller.guard.rules import Guard
from meshpoint.controller.guard.sleeve_motion import contact_between_us, longest_pulse_us
from meshpoint.controller.guard.view import GuardInputs

# -- braked in flight ------------------------------------------------------------------------


def test_a_firing_is_aborted_by_the_other_valve_whatever_slip_its_gear_has() -> None:
    assert aborted().blocks == 0


@pytest.mark.parametrize(
    ("fires", "brakes"), [(FIRST, SECOND), (SECOND, FIRST), (CRAWL, THIRD), (THIRD, CRAWL)]
)
def test_each_valve_is_braked_by_the_other_one_of_its_sleeve(fires: int, brakes: int) -> None:
    guard, slip_rpm = ready(), slip_for(fires)
    for ms, orders in ((0.0, {fires: (ON_AT, 4.0)}), (20.0, {brakes: (ON_AT, 22.0)})):
        assert row(guard, at(ms, slip_rpm=slip_rpm), orders) is None


def test_the_other_valve_on_for_a_tick_longer_engages_its_own_gear() -> None:
    guard = fired()
    assert row(guard, at(20), {FIRST: (ON_AT, 22)}) is None
    assert row(guard, at(30), {FIRST: (ON_AT, 22)}) == 3


def test_the_other_valve_alone_engages_its_gear() -> None:
    """Nothing has set the sleeve going: there is nothing to brake."""
    assert row(ready(), at(20), {FIRST: (ON_AT, 22)}) == 3


@pytest.mark.parametrize(("speed_m_s", "forbidden"), [(0.4, None), (-0.049, None), (-0.05, 3)])
def test_a_sleeve_that_moves_on_toward_the_other_gear_is_not_braked_by_its_valve(
    speed_m_s: float, forbidden: int | None
) -> None:
    assert row(fired(), at(20, 0.0, speed_m_s), {FIRST: (ON_AT, 22)}) == forbidden


@pytest.mark.parametrize(("later_ms", "forbidden"), [(20.0, None), (20.001, 3)])
def test_it_brakes_only_while_the_push_before_still_works(
    later_ms: float, forbidden: int | None
) -> None:
    guard = fired()
    assert row(guard, at(20)) is None
    seen = at(20 + later_ms)._replace(positions_us=NOW)
    assert row(guard, seen, {FIRST: (ON_NOW, 0)}) == forbidden


@pytest.mark.parametrize(("on_ms", "forbidden"), [(5.0, None), (5.001, 3)])
def test_it_brakes_no_longer_than_the_push_before_lasted(
    on_ms: float, forbidden: int | None
) -> None:
    """On now, it can be off again in 15 ms: a push of as long, no shorter one."""
    assert row(fired(on_ms), at(20), {FIRST: (ON_NOW, 0)}) == forbidden


@pytest.mark.parametrize(("off_ms", "forbidden"), [(13.0, None), (13.5, None), (13.6, 3)])
def test_after_a_short_push_it_brakes_as_long_as_it_stops_short_by_itself(
    off_ms: float, forbidden: int | None
) -> None:
    """13.5 ms from neutral, of the sheet's least stroke of 28."""
    guard = fired(on_ms=8.0)
    assert row(guard, at(20), {FIRST: (ON_AT, 22)}) is None
    assert row(guard, at(25), {FIRST: (OFF_AT, 22 + off_ms)}) == forbidden


@pytest.mark.parametrize(("way_mm", "forbidden"), [(1.5, 3), (1.501, None)])
def test_out_of_neutral_it_brakes_as_long_as_it_takes_a_command_to_end_it(
    way_mm: float, forbidden: int | None
) -> None:
    """14.95 ms: more than the 14.88 after which it stops short by itself, less than 15."""
    guard = fired(on_ms=8.0)
    assert row(guard, at(20, way_mm), {FIRST: (ON_AT, 22)}) is None
    assert row(guard, at(25, way_mm), {FIRST: (OFF_AT, 36.95)}) == forbidden


def test_a_sleeve_fired_again_in_flight_is_aborted_again() -> None:
    """Each push has lasted longer than its brake: 16 ms against 12."""
    guard = aborted()
    for fired_ms in (44.0, 84.0):
        assert row(guard, at(fired_ms - 4), {SECOND: (ON_AT, fired_ms)}) is None
        assert row(guard, at(fired_ms + 6), {SECOND: (ON_AT, fired_ms)}) is None
        assert row(guard, at(fired_ms + 16), {FIRST: (ON_AT, fired_ms + 18)}) is None
        assert row(guard, at(fired_ms + 26), {FIRST: (OFF_AT, fired_ms + 30)}) is None
    assert row(guard, at(120)) is None


def test_a_valve_brakes_one_push_once() -> None:
    """On for 16 ms, braked for 8: 8 are left, and what is on from 32 ms may be off at 45."""
    guard = fired()
    assert row(guard, at(20), {FIRST: (ON_NOW, 0)}) is None
    assert row(guard, at(25), {FIRST: (OFF_AT, 28)}) is None
    assert row(guard, at(30), {FIRST: (ON_AT, 32)}) == 3


@pytest.mark.parametrize(("speed_m_s", "forbidden"), [(0.05, None), (0.049, 3)])
def test_a_sleeve_seen_to_move_as_pushed_is_braked_from_beyond_neutral_as_well(
    speed_m_s: float, forbidden: int | None
) -> None:
    """Pushed back for 10 ms from 3.9 mm on first gear's side. Red before: as a command can end a
    pulse no sooner than 13 ms after it began, its brake was kept back, and it met second gear at
    -72 rpm."""
    guard = fired(on_ms=8.0)
    assert row(guard, at(18, -1.6, speed_m_s)) is None
    brake = {FIRST: (ON_AT, 22)}
    assert row(guard, at(20, -1.6, speed_m_s), brake) == forbidden


@pytest.mark.parametrize(("way_mm", "forbidden"), [(-4.2, 3), (-4.1, None)])
def test_and_no_longer_than_it_stops_short_for_what_is_beyond_its_push(
    way_mm: float, forbidden: int | None
) -> None:
    """13 ms against 7 are 6 more: from 4.1 mm a pulse of 6.03 stops short, from 4.2 one of 5.5."""
    guard = fired(on_ms=11.0)
    assert row(guard, at(18, way_mm, 0.05)) is None
    assert row(guard, at(20, way_mm, 0.05), {FIRST: (ON_AT, 22)}) == forbidden


def test_two_short_pushes_are_not_braked_as_if_they_were_one_long_one() -> None:
    """5 ms each within 20, before the sleeve is seen to stand: the brake could be off after 15."""
    guard = fired()
    assert row(guard, at(9)) is None
    assert row(guard, at(15), {SECOND: (ON_AT, 19)}) is None
    assert row(guard, at(24), {FIRST: (ON_NOW, 0)}) == 3


def test_a_valve_that_has_nothing_left_to_brake_is_on_anew_and_needs_air() -> None:
    """A push of 8 ms was braked for 13.5; the other gear's slip is in its window by now."""
    guard = fired(on_ms=12.0)
    assert row(guard, at(20), {FIRST: (ON_AT, 22)}) is None
    assert row(guard, at(25), {FIRST: (OFF_AT, 35.5)}) is None
    assert row(guard, at(36)) is None
    low = at(37, slip_rpm=slip_for(FIRST))._replace(supply_pa=4.9e5)
    assert row(guard, low, {FIRST: (ON_AT, 39)}) == 11


def test_both_valves_of_an_aborted_sleeve_are_never_on_together() -> None:
    assert row(fired(), at(20), {SECOND: (ON_AT, 4), FIRST: (ON_AT, 22)}) == 1
    assert row(fired(), at(20), {SECOND: (OFF_AT, 30), FIRST: (ON_AT, 29)}) == 1
    assert row(fired(), at(20), {SECOND: (OFF_AT, 30), FIRST: (ON_AT, 30)}) != 1


def test_what_has_been_set_going_is_braked_with_little_air_as_well() -> None:
    for orders, forbidden in (({FIRST: (ON_AT, 22)}, None), ({SPLIT_LOW: (ON_AT, 22)}, 11)):
        low = at(20)._replace(supply_pa=4.9e5)
        assert row(fired(), low, orders) == forbidden


def test_where_the_valve_side_cannot_schedule_each_frame_says_how_long_it_was_on() -> None:
    """The node wakes to end the pulse: another frame can act 5 ms later."""
    immediate = guard_limits(SHEET, dataclasses.replace(SETTINGS, valve_timing="immediate"))
    assert immediate.switch_again_us == 5_000
    for last_ms, forbidden in ((30.0, None), (30.1, 3)):
        guard = ready(immediate)
        for ms in (4.0, 14.0):
            assert row(guard, at(ms), {SECOND: (ON_NOW, 0)}) is None
        for ms in (20.0, 24.0):
            assert row(guard, at(ms), {FIRST: (ON_NOW, 0)}) is None
        assert row(guard, at(last_ms), {FIRST: (ON_NOW, 0)}) == forbidden


# -- how long and how soon, by the data sheet ------------------------------------------------


@pytest.mark.parametrize(
    ("way_mm", "most_ms"), [(-35.5, 28.0), (-0.5, 14.0), (3.875, 7.0), (4.5, 0.0), (5.0, 0.0)]
)
def test_the_longest_pulse_that_stops_short_of_the_teeth(way_mm: float, most_ms: float) -> None:
    """Half of the least stroke after the valve, 45 - 5 - 12 ms, for a way that ends 0.5 mm before
    the teeth at 5 mm; an eighth of the way takes half the time."""
    assert longest_pulse_us(LIMITS, 1e-3 * way_mm) == pytest.approx(1e3 * most_ms, abs=1e-3)


@pytest.mark.parametrize(
    ("stands_mm", "early_ms", "late_ms"),
    [(-3.0, 40.0, 50.0), (0.0, 40.0, 50.0), (4.375, 23.5, 39.0), (5.0, 7.0, 28.0)],
)
def test_a_second_stroke_meets_its_gear_the_sooner_the_nearer_it_stands(
    stands_mm: float, early_ms: float, late_ms: float
) -> None:
    """7 ms of the fastest valve and up to 33 on the way; 17 of the slowest, 11 until it breaks
    away, and up to 22."""
    found = contact_between_us(LIMITS, NOW, 1e-3 * stands_mm, 1e-3 * stands_mm)
    assert found == pytest.approx((NOW + 1e3 * early_ms, NOW + 1e3 * late_ms), abs=1e-3)


# -- pulled out of a gear --------------------------------------------------------------------


def pull(guard: Guard, from_ms: float, lasts_ms: float, rests_mm: float = 12.0) -> int | None:
    """The row that forbids a pull out of second gear, by first's valve; if none does, the sleeve
    then stands there."""
    end_ms = from_ms + lasts_ms
    assert row(guard, at(from_ms - 2.0, 12.0), {FIRST: (ON_AT, from_ms)}) is None
    found = row(guard, at(from_ms + 10.0, 12.0), {FIRST: (OFF_AT, end_ms)})
    for later_ms in (1.0, 60.0):
        assert row(guard, at(end_ms + later_ms, rests_mm)) is None
    return found


@pytest.mark.parametrize(("lasts_ms", "forbidden"), [(20.843, None), (20.844, 3)])
def test_a_gear_is_pulled_for_no_longer_than_the_fastest_sleeve_withstands(
    lasts_ms: float, forbidden: int | None
) -> None:
    """28 / 2 ms times the third root of the way over that of a stroke; 12 + 4.5 mm here."""
    assert pull(ready(), 5.0, lasts_ms) == forbidden


@pytest.mark.parametrize(
    ("rests_mm", "longer_ms", "forbidden"),
    [(12.0, 4.0, None), (12.0, 4.001, 3), (-1.5, 4.0, None), (-1.51, 4.0, 3), (0.0, 4.001, 3)],
)
def test_and_by_4_ms_longer_than_a_pull_that_did_not_take_it_beyond_neutral(
    rests_mm: float, longer_ms: float, forbidden: int | None
) -> None:
    guard = ready()
    assert pull(guard, 5.0, 20.0, rests_mm) is None
    assert pull(guard, 205.0, 20.0 + longer_ms) == forbidden


def test_a_shorter_pull_after_a_longer_one_takes_nothing_back() -> None:
    guard = ready()
    for from_ms, lasts_ms in ((5.0, 20.0), (205.0, 24.0), (405.0, 15.0), (605.0, 24.0)):
        assert pull(guard, from_ms, lasts_ms) is None


def test_a_pull_without_an_end_is_blocked_while_the_next_command_can_still_end_it() -> None:
    guard = ready()
    for ms, forbidden in ((0.0, None), (7.8, None), (7.9, 3)):
        assert row(guard, at(ms, 12.0), {FIRST: (ON_AT, 2.0)}) == forbidden


@pytest.mark.parametrize(("end_ms", "forbidden"), [(25.843, None), (25.844, 3), (14.0, 3)])
def test_its_end_may_be_said_with_its_beginning_by_the_sleeves_other_valve(
    end_ms: float, forbidden: int | None
) -> None:
    """A release that has passed says nothing of a valve that is asked to stay on."""
    guard = ready()
    for ms, found in ((3.0, None), (15.0, forbidden)):
        orders = {FIRST: (ON_AT, 5.0), SECOND: (OFF_AT, end_ms)}
        assert row(guard, at(ms, 12.0), orders) == found


def test_pulls_in_a_row_count_as_one_until_the_sleeve_is_seen_to_stand() -> None:
    guard = ready()
    assert row(guard, at(0, 12.0), {FIRST: (ON_AT, 2.0)}) is None
    assert row(guard, at(8, 12.0), {FIRST: (OFF_AT, 12.0)}) is None
    assert row(guard, at(13, 12.0), {FIRST: (ON_AT, 14.0)}) == 3


DRAG_RAD_S2 = 30.0
"""By so much a gear that is out falls behind its sleeve."""


def pulled_again(rests_mm: float = 12.0, drag_rad_s2: float = DRAG_RAD_S2, speed_m_s: float = 0.0,
                 after_ms: float = 130.0) -> int | None:  # fmt: skip
    """The row that forbids a second pull out of second gear, by first's valve, so long after the
    first one, which has ended at 25 ms and taken it out then: so its sensor shows, or its teeth."""
    guard = ready()

    def seen(ms: float, way_mm: float, speed_m_s: float = 0.0) -> GuardInputs:
        free_s = 1e-3 * max(0.0, ms - 25.0)
        return at(ms, way_mm, speed_m_s)._replace(gear_rad=7.0 - 0.5 * drag_rad_s2 * free_s**2)

    assert row(guard, seen(3, 12.0), {FIRST: (ON_AT, 5.0)}) is None
    assert row(guard, seen(15, 12.0), {FIRST: (OFF_AT, 25.0)}) is None
    for ms in range(30, 25 + round(after_ms), 10):
        assert row(guard, seen(ms, rests_mm, speed_m_s)) is None
    again = seen(25 + after_ms, rests_mm, speed_m_s)
    return row(guard, again, {FIRST: (ON_AT, 30.0 + after_ms)})


def test_a_gear_that_was_pulled_and_turns_free_is_not_pulled_again() -> None:
    """30 rad/s2 turn it by 4.5 degrees in 72 ms. Red before: whatever the shafts did, a gear
    measured in was pulled by 4 ms more each time, and its sleeve went on to the other gear."""
    assert pulled_again() == 13
    assert pulled_again(after_ms=60.0) is None
    assert pulled_again(drag_rad_s2=0.0) is None


def test_it_is_denied_as_it_stands_in_its_gear_by_its_sensor_alone() -> None:
    """One that moves is on its way out, and one that has moved out and back is none that sticks."""
    assert pulled_again(rests_mm=6.2) != 13
    assert pulled_again(rests_mm=6.21) == 13
    assert pulled_again(speed_m_s=0.06) != 13


def test_a_sleeve_whose_gear_is_denied_is_not_driven_until_it_is_measured_elsewhere() -> None:
    for valve in (FIRST, SECOND):
        guard = ready()
        kept(guard).pulled[0].pull(NOW - 100_000, 1.0)
        assert row(guard, at(0, 12.0)._replace(gear_rad=2.0), {valve: (ON_AT, 5.0)}) == 13
        assert guard.gear_is_denied
        assert row(guard, at(10, 0.0)._replace(gear_rad=None)) is None
        assert not guard.gear_is_denied


def test_a_gear_whose_slip_is_in_its_window_may_be_fired_out_of_another_one() -> None:
    guard = ready()
    for ms in (0.0, 10.0, 20.0):
        seen = at(ms, 12.0, slip_rpm=slip_for(FIRST))
        assert row(guard, seen, {FIRST: (ON_AT, 2.0)}) is None


# -- what else may move meanwhile ------------------------------------------------------------


@pytest.mark.parametrize(("valve", "forbidden"), [(THIRD, 2), (RANGE_HIGH, 8), (BRAKE, 5)], ids=str)
def test_a_sleeve_that_was_stopped_is_proven_neutral_once_it_is_seen_to_stand(
    valve: int, forbidden: int
) -> None:
    """Off at 34 ms, the slowest valve has shut 17 ms later."""
    third = {"slip_rpm": slip_for(THIRD)} if valve == THIRD else {}
    for sampled_ms, speed_m_s, found in (
        (50.999, 0.0, forbidden), (51.0, 0.0, None), (51.0, 0.05, forbidden),
        (51.0, -0.05, forbidden),
    ):  # fmt: skip
        seen = at(60, 0.0, speed_m_s, late_ms=60 - sampled_ms, **third)
        assert row(aborted(), seen, {valve: (ON_AT, 80)}) == found


@pytest.mark.parametrize(("speed_m_s", "forbidden"), [(-0.05, 8), (0.05, 8), (-0.049, None)])
def test_a_sleeve_that_a_pull_carries_through_neutral_is_not_proven_there(
    speed_m_s: float, forbidden: int | None
) -> None:
    guard = ready()
    assert row(guard, at(0, 12.0), {FIRST: (ON_AT, 4)}) is None
    assert row(guard, at(10, 12.0), {FIRST: (OFF_AT, 20)}) is None
    assert row(guard, at(50, 0.4, speed_m_s), {RANGE_HIGH: (ON_AT, 55)}) == forbidden


def test_noise_of_a_sleeve_that_nothing_has_driven_is_no_movement() -> None:
    assert row(ready(), at(0, 0.1, 0.06), {RANGE_HIGH: (ON_AT, 5)}) is None


def test_a_pull_goes_on_after_a_break_until_the_sleeve_has_come_to_neutral() -> None:
    """Blocked for a step on its way out, a sleeve is still pulled, and not on to the other gear."""
    for way_mm, forbidden in ((1.51, None), (1.5, 3)):
        guard = ready()
        assert pull(guard, -400.0, 20.0) is None
        assert pull(guard, -200.0, 24.0) is None
        assert row(guard, at(0, 12.0), {FIRST: (ON_AT, 1)}) is None
        assert row(guard, at(8, 6.0, -0.4)) is None
        assert row(guard, at(12, way_mm, -0.4), {FIRST: (ON_AT, 13)}) == forbidden


def test_a_pull_after_a_pulse_that_brought_the_sleeve_back_is_a_pull() -> None:
    """Before it is seen to stand: it is proven neutral once it is measured there and still."""
    guard = ready()
    assert row(guard, at(0, -4.7), {SECOND: (ON_AT, 2)}) is None
    assert row(guard, at(5, -4.7), {SECOND: (OFF_AT, 8)}) is None
    assert row(guard, at(10, -4.9), {SECOND: (ON_AT, 12)}) is None
    assert row(guard, at(14, -4.9), {SECOND: (OFF_AT, 19)}) is None
    assert row(guard, at(25, -1.0, late_ms=16.0)) is None
    assert row(guard, at(26, -1.0, late_ms=17.0), {RANGE_HIGH: (ON_AT, 35)}) is None


@pytest.mark.parametrize(("valve", "forbidden"), [(RANGE_HIGH, 8), (THIRD, 2)])
def test_a_sleeve_fired_after_its_pull_is_not_neutral_before_it_is_seen_to_stand(
    valve: int, forbidden: int
) -> None:
    """Pulled out of first gear, and fired into second by the same valve 6 ms after that: where it
    is measured it has not moved yet."""
    guard = ready()
    assert row(guard, at(22, -12.0), {SECOND: (ON_AT, 24)}) is None
    assert row(guard, at(32, -12.0), {SECOND: (OFF_AT, 42)}) is None
    assert row(guard, at(44, -1.0)) is None
    for ms in (46.0, 56.0, 66.0):
        assert row(guard, at(ms, -1.0, late_ms=20.0), {SECOND: (ON_AT, 50)}) is None
    assert row(guard, at(70, -1.0, late_ms=20.0)) is None
    seen = at(72, -1.0, late_ms=20.0, slip_rpm=slip_for(THIRD))
    assert row(guard, seen, {valve: (ON_AT, 74)}) == forbidden


@pytest.mark.parametrize(("off_ms", "forbidden"), [(6.999, None), (7.0, 5)])
def test_a_pull_that_ended_less_than_the_least_delay_ago_still_pulls(
    off_ms: float, forbidden: int | None
) -> None:
    """Its teeth will be out as the brake's air comes, though they are not yet."""
    guard = ready()
    assert row(guard, at(20, 12.0), {FIRST: (ON_AT, 22)}) is None
    assert row(guard, at(30, 9.0, -0.4), {FIRST: (OFF_AT, 40)}) is None
    seen = at(40 + off_ms, 5.5, -0.6)
    assert row(guard, seen, {BRAKE: (ON_AT, 50)}) == forbidden


def test_a_pulse_that_goes_on_counts_from_the_one_before() -> None:
    """0.5 ms and a break of 0.3: of 16 ms since the first one each command has 15 before it."""
    guard = standing(3.0)
    assert row(guard, at(110, 3.0), {FIRST: (ON_NOW, 0)}) is None
    assert row(guard, at(110.5, 3.0)) is None
    assert row(guard, at(110.8, 3.0), {FIRST: (ON_NOW, 0)}) is None
    assert row(guard, at(111.5, 3.0), {FIRST: (ON_NOW, 0)}) == 3


def test_a_pulse_whose_end_is_now_is_over() -> None:
    """On for 12 of the 16 ms that it may brake."""
    guard = fired()
    assert row(guard, at(20), {FIRST: (ON_AT, 22)}) is None
    assert row(guard, at(30), {FIRST: (OFF_AT, 34)}) is None
    assert row(guard, at(34), {FIRST: (ON_NOW, 0)}) == 3


def test_at_the_limits_themselves_teeth_are_out() -> None:
    """Of a sleeve that stands before them, and of one that is seen to move in neutral."""
    for place_m, speed_m_s in ((LIMITS.apart_m, 0.0), (GUARD_NEUTRAL_M, 0.1)):
        moves = (speed_m_s, 0.0)
        seen = place(at(110), 0, place_m)._replace(means_m_s=moves, speeds_m_s=moves)
        assert row(standing(0.0), seen, {BRAKE: (ON_AT, 112)}) is None


def test_a_firing_after_a_pulse_back_is_on_its_way_like_any_other() -> None:
    """Brought back from before first gear's teeth by 12 ms of second's valve, then fired by it."""
    guard = standing(-3.0)
    assert row(guard, at(110, -3.0), {SECOND: (ON_AT, 112)}) is None
    assert row(guard, at(120, -3.0), {SECOND: (OFF_AT, 124)}) is None
    for ms in (130.0, 140.0, 150.0):
        assert row(guard, at(ms, -2.0, late_ms=20.0), {SECOND: (ON_AT, 134)}) is None
    assert row(guard, at(160, -1.0)) is None
    assert row(guard, at(165, -1.0), {BRAKE: (ON_AT, 167)}) == 5


def test_pushes_in_a_row_stop_short_as_from_the_place_nearest_to_the_teeth() -> None:
    """Twice 5 ms within 12: from neutral they may take 13.5, from 3 mm 9.4."""
    for way_mm, forbidden in ((0.0, None), (3.0, 5)):
        guard = fired()
        assert row(guard, at(9)) is None
        assert row(guard, at(10, way_mm), {SECOND: (ON_AT, 11)}) is None
        assert row(guard, at(16, way_mm)) is None
        assert row(guard, at(20, way_mm), {BRAKE: (ON_AT, 22)}) == forbidden


def test_a_valve_that_is_withdrawn_as_it_goes_on_may_have_moved_its_sleeve() -> None:
    for on_ms, forbidden in ((10.0, 8), (10.001, None)):
        guard = ready()
        assert row(guard, at(0), {SECOND: (ON_AT, on_ms)}) is None
        assert row(guard, at(10)) is None
        assert row(guard, at(12), {RANGE_HIGH: (ON_AT, 15)}) == forbidden


@pytest.mark.parametrize(("push_ms", "forbidden"), [(13.495, None), (13.6, 5)])
def test_a_push_too_short_to_reach_the_teeth_keeps_only_neutral_in_doubt(
    push_ms: float, forbidden: int | None
) -> None:
    """13.5 ms from neutral: the gear stays free, and the brake may act on it."""
    guard = fired(20.0 - push_ms)
    assert row(guard, at(20)) is None
    assert row(guard, at(30), {BRAKE: (ON_AT, 32)}) == forbidden
    guard = fired(20.0 - push_ms)
    assert row(guard, at(20)) is None
    assert row(guard, at(30), {RANGE_HIGH: (ON_AT, 40)}) == 8
    assert row(guard, at(47, late_ms=10), {RANGE_HIGH: (ON_AT, 50)}) is None


@pytest.mark.parametrize(
    ("way_mm", "speed_m_s", "forbidden"),
    [(4.8, 0.0, None), (-4.8, 0.0, None), (4.81, 0.0, 5), (3.0, 0.051, 5), (3.0, -0.051, None)],
)
def test_the_brake_may_act_on_a_gear_whose_sleeve_stands_before_its_teeth(
    way_mm: float, speed_m_s: float, forbidden: int | None
) -> None:
    assert row(standing(way_mm), at(110, way_mm, speed_m_s), {BRAKE: (ON_AT, 112)}) == forbidden


def test_range_and_the_other_sleeve_wait_for_neutral() -> None:
    third = slip_for(THIRD)
    assert row(standing(3.0), at(110, 3.0), {RANGE_HIGH: (ON_AT, 112)}) == 8
    assert row(standing(3.0), at(110, 3.0, slip_rpm=third), {THIRD: (ON_AT, 112)}) == 2


@pytest.mark.parametrize(("now_ms", "forbidden"), [(17.0, 3), (18.0, None)])
def test_the_last_stop_is_judged_from_where_the_sleeve_stood_as_it_was_fired(
    now_ms: float, forbidden: int | None
) -> None:
    """From neutral a valve may be on for 13.5 ms and the sleeve stops short: until 17.5 ms after
    NOW. From the 3 mm to which it has come meanwhile it would be 9.4 ms."""
    seen = at(now_ms, 3.0, 0.4, late_ms=1.0, slip_rpm=140.0)
    assert row(fired(), seen, {SECOND: (ON_AT, 4)}) == forbidden
