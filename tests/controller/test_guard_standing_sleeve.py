"""The guard's rows and a main sleeve that stands before a gear's teeth: for how long it may, a
start that finds it there, its way back, and a second stroke from there.
"""

from __future__ import annotations

import pytest
from guard_cases import LIMITS, NOW, kept, place, ready
from guard_sleeve_cases import (
    BRAKE,
    CRAWL,
    FIRST,
    OFF_AT,
    ON_AT,
    SECOND,
    SPLIT_LOW,
    aborted,
    at,
    fired,
    row,
    standing,
)

from meshpoint.controller.guard.case import NO_SPANS, GuardState, JudgedCommand, Span
from meshpoint.controller.guard.rules import Guard

# -- how long it may stand there -------------------------------------------------------------


@pytest.mark.parametrize("way_mm", [1.51, 5.0, -1.51])
@pytest.mark.parametrize(("stood_ms", "forbidden"), [(500.0, None), (500.001, 20)])
@pytest.mark.parametrize("valve", [BRAKE, SPLIT_LOW, SECOND])
def test_row_20_a_sleeve_that_stood_before_the_teeth_for_too_long(
    way_mm: float, stood_ms: float, forbidden: int | None, valve: int
) -> None:
    if valve == SECOND and way_mm < 0.0:
        return  # it brings the sleeve back
    if valve == BRAKE and way_mm == 5.0:
        return  # row 5's, at the teeth
    guard = standing(way_mm)
    now_ms = 100 + stood_ms
    assert row(guard, at(now_ms, way_mm), {valve: (ON_AT, now_ms + 5)}) == forbidden


def test_row_20_holds_for_each_sleeve() -> None:
    guard = ready()
    for ms, forbidden in ((0.0, None), (500.0, None), (501.0, 20)):
        seen = place(at(ms), 1, 3e-3)
        assert row(guard, seen, {SPLIT_LOW: (ON_AT, ms + 5)} if ms else {}) == forbidden
        if ms == 500.0:
            assert row(guard, seen) is None


def test_row_20_the_way_back_is_free_and_ends_it() -> None:
    guard = standing(3.0)
    assert row(guard, at(700, 3.0), {SECOND: (ON_AT, 705)}) == 20
    assert row(guard, at(710, 3.0), {FIRST: (ON_AT, 712)}) is None
    assert row(guard, at(720, 3.0), {FIRST: (OFF_AT, 722)}) is None
    assert row(guard, at(730, 1.5, -0.2), {SECOND: (ON_AT, 732)}) is None  # braked
    assert row(guard, at(740, 0.5, -0.1), {SECOND: (OFF_AT, 744)}) is None
    assert row(guard, at(800, 0.0)) is None
    assert row(guard, at(810, 0.0), {SECOND: (ON_AT, 815)}) is None


def test_row_20_what_is_under_way_goes_on_and_what_waits_does_not() -> None:
    for on_ms, forbidden in ((595.0, None), (601.0, None), (620.0, 20)):
        guard = standing(3.0)
        assert row(guard, at(590, 3.0), {SECOND: (ON_AT, on_ms)}) is None
        assert row(guard, at(601, 3.0), {SECOND: (ON_AT, on_ms)}) == forbidden


def test_row_20_asks_sleeves_that_no_valve_drives() -> None:
    """One on its way, or at a tooth's face with its valve on, does not stand before the teeth."""
    guard = fired()
    for ms in (20.0, 30.0, 40.0, 50.0):
        assert row(guard, at(ms, 4.99 * ms / 50), {SECOND: (ON_AT, 4)}) is None
    orders = {SECOND: (ON_AT, 4.0), SPLIT_LOW: (ON_AT, 610.0)}
    assert row(guard, at(600, 5.0), orders) is None


def test_row_20_positions_that_are_not_believed_end_nothing() -> None:
    guard = standing(3.0)
    assert row(guard, at(400, 0.0)._replace(valid=False)) is None
    assert row(guard, at(700, 3.0), {SPLIT_LOW: (ON_AT, 705)}) == 20


def test_row_20_with_another_clock_the_time_begins_anew() -> None:
    guard = standing(3.0)
    assert row(guard, at(-50_000, 3.0)._replace(clock_is_new=True)) is None
    for ms, forbidden in ((-49_501.0, None), (-49_499.0, 20)):
        for before_ms in (30, 20, 10):
            assert row(guard, at(ms - before_ms, 3.0)) is None
        assert row(guard, at(ms, 3.0), {SPLIT_LOW: (ON_AT, ms + 5)}) == forbidden
        assert row(guard, at(ms, 3.0)) is None


# -- a start that finds a sleeve there -------------------------------------------------------


def unasked() -> Guard:
    """Past the self-test, and nobody has asked for a gear."""
    guard = Guard(LIMITS, armed=True)
    for ms in (0.0, 10.0, 20.0):
        assert row(guard, at(ms, 3.0)) is None
    return guard


@pytest.mark.parametrize("way_mm", [1.51, 3.0, 4.7, 5.0])
def test_row_17_a_sleeve_found_before_the_teeth_is_brought_back_unasked(way_mm: float) -> None:
    guard = unasked()
    assert row(guard, at(30, way_mm), {FIRST: (ON_AT, 32)}) is None
    assert row(guard, at(40, way_mm), {FIRST: (OFF_AT, 41)}) is None
    assert row(guard, at(50, way_mm, -0.2), {SECOND: (ON_AT, 56)}) is None
    assert row(guard, at(60, 0.5, -0.1), {SECOND: (OFF_AT, 64)}) is None


@pytest.mark.parametrize(
    ("way_mm", "valve"), [(3.0, SECOND), (1.5, FIRST), (5.01, FIRST), (12.0, FIRST), (3.0, 1)]
)
def test_row_17_nothing_else_is_set_going_unasked(way_mm: float, valve: int) -> None:
    judged = row(unasked(), at(30, way_mm), {valve: (ON_AT, 35)})
    assert judged == (3 if way_mm == 1.5 else 17)


def test_row_17_a_gear_that_turns_with_its_sleeve_is_not_brought_out_unasked() -> None:
    lying = at(30, 3.0)._replace(agreeing=SECOND)
    assert row(unasked(), lying, {FIRST: (ON_AT, 32)}) == 17


def test_row_2_of_two_sleeves_before_their_teeth_one_after_the_other_is_brought_back() -> None:
    for other_mm, forbidden in ((4.8, None), (-4.8, None), (4.81, 2), (12.0, 2)):
        seen = place(at(30, 3.0), 1, 1e-3 * other_mm)
        assert row(unasked(), seen, {FIRST: (ON_AT, 32)}) == forbidden
        seen = place(at(30, other_mm), 1, 3e-3)
        assert row(unasked(), seen, {CRAWL: (ON_AT, 32)}) == forbidden
    both = place(at(30, 3.0), 1, 3e-3)
    assert row(ready(), both, {SECOND: (ON_AT, 35)}) == 2


# -- back to neutral -------------------------------------------------------------------------


@pytest.mark.parametrize(("since_ms", "forbidden"), [(99.0, None), (98.9, 3), (102.0, None)])
def test_a_sleeve_before_the_teeth_comes_back_by_a_pulse_at_any_slip(
    since_ms: float, forbidden: int | None
) -> None:
    """16 ms from 2.96 mm before the middle: 4.5 + 2.96 is 1.493 of 5 mm."""
    guard = standing(2.964, 99.0 - 10.0)
    assert row(guard, at(90, 2.964), {FIRST: (ON_AT, since_ms)}) is None
    assert row(guard, at(100, 2.964), {FIRST: (ON_AT, since_ms)}) == forbidden


def test_pulses_in_a_row_count_as_one_until_the_sleeve_is_seen_to_stand() -> None:
    guard = standing(3.0)
    assert row(guard, at(110, 3.0), {FIRST: (ON_AT, 112)}) is None
    assert row(guard, at(120, 3.0), {FIRST: (OFF_AT, 122)}) is None
    assert row(guard, at(130, 3.0)) is None
    assert row(guard, at(140, 3.0), {FIRST: (ON_AT, 142)}) == 3
    assert row(guard, at(155, 2.0, late_ms=7.9)) is None  # sampled 17 ms after it is off
    assert row(guard, at(156, 2.0), {FIRST: (ON_AT, 158)}) is None


def push(guard: Guard, from_ms: float, lasts_ms: float, way_mm: float) -> int | None:
    """The row that forbids a push of a standing sleeve to neutral, by first's valve, once its end
    is commanded; if none does, it stays where it is."""
    assert row(guard, at(from_ms - 2.0, way_mm), {FIRST: (ON_AT, from_ms)}) is None
    found = row(guard, at(from_ms + 4.0, way_mm), {FIRST: (OFF_AT, from_ms + lasts_ms)})
    for later_ms in (1.0, 60.0):
        assert row(guard, at(from_ms + lasts_ms + later_ms, way_mm)) is None
    return found


@pytest.mark.parametrize(("way_mm", "most_ms"), [(3.0, 11.02), (1.6, 9.955), (4.7, 12.15)])
def test_a_standing_sleeve_is_pushed_to_neutral_no_longer_than_stops_short_by_a_late_valve(
    way_mm: float, most_ms: float
) -> None:
    """14 ms times the third root of the way that ends 0.5 mm before the opposite teeth over 5 mm,
    less the 5 ms by which a valve may make a pulse longer. At any slip of the opposite gear."""
    assert push(standing(way_mm), 110.0, most_ms, way_mm) is None
    assert push(standing(way_mm), 110.0, most_ms + 0.01, way_mm) == 3


def test_what_a_push_has_not_done_it_may_try_again_by_4_ms_more_from_no_nearer_neutral() -> None:
    for way_mm, lasts_ms, forbidden in (
        (4.0, 15.5, None), (4.2, 15.5, None), (4.0, 15.51, 3), (3.9, 12.0, 3)
    ):  # fmt: skip
        guard = standing(4.0)
        assert push(guard, 110.0, 11.5, 4.0) is None
        assert push(guard, 210.0, lasts_ms, way_mm) == forbidden


@pytest.mark.parametrize(("lasts_ms", "forbidden"), [(15.0, 3), (15.1, None)])
def test_a_push_is_judged_by_its_end_once_that_cannot_come_later(
    lasts_ms: float, forbidden: int | None
) -> None:
    """15 ms ahead another command can end it sooner: until then it is judged as before."""
    guard = standing(3.0)
    assert row(guard, at(108, 3.0), {FIRST: (ON_AT, 110)}) is None
    assert row(guard, at(110, 3.0), {FIRST: (OFF_AT, 110 + lasts_ms)}) == forbidden


# -- a second stroke -------------------------------------------------------------------------


def test_a_sleeve_that_stands_before_its_teeth_is_fired_again() -> None:
    guard = standing(4.0)
    for ms in (110.0, 120.0, 130.0, 140.0, 150.0):
        assert row(guard, at(ms, 4.0), {SECOND: (ON_AT, 115)}) is None


@pytest.mark.parametrize(("way_mm", "called_ms"), [(0.0, (135.0, 150.0)), (4.375, (118.5, 133.5))])
def test_its_last_call_comes_as_much_sooner(way_mm: float, called_ms: tuple[float, float]) -> None:
    """Contact 23.5 ms after the valve at the earliest, from neutral 40; how the shafts swing is not
    known."""
    first_ms, end_ms = called_ms
    for ms, forbidden in (
        (first_ms - 1e-3, None), (first_ms, 3), (end_ms - 1e-3, 3), (end_ms, None)
    ):  # fmt: skip
        guard = standing(way_mm)
        assert row(guard, at(105, way_mm), {SECOND: (ON_AT, 110)}) is None
        unknown = at(ms, way_mm)._replace(swings=(None, None))
        assert row(guard, unknown, {SECOND: (ON_AT, 110)}) == forbidden, ms


def test_one_that_is_not_seen_to_stand_may_be_at_the_teeth_already() -> None:
    """7 ms after its valve, of which the guard cannot take back any."""
    for swing_known, forbidden in ((True, None), (False, 3)):
        guard = aborted()
        seen = at(45, 0.0)
        seen = seen if swing_known else seen._replace(swings=(None, None))
        assert row(guard, seen, {SECOND: (ON_AT, 50)}) == forbidden
        guard = standing(0.0)
        seen = at(145, 0.0) if swing_known else at(145, 0.0)._replace(swings=(None, None))
        assert row(guard, seen, {SECOND: (ON_AT, 150)}) is None


def test_one_that_was_pushed_and_called_back_may_be_anywhere_up_to_before_the_teeth() -> None:
    """0.5 mm before them at most: a third of the way to 0.464 of the time; or still in neutral."""
    guard = fired(12.0)
    assert row(guard, at(20)) is None
    span = Span(NOW + 60_000, 1 << 62)
    for late_ms, early_ms in ((10.0, 22.317), (2.9, 40.0)):
        assert row(guard, at(40, late_ms=late_ms)) is None
        spans = (*NO_SPANS[:SECOND], span, *NO_SPANS[SECOND + 1 :])
        judged = JudgedCommand(spans, at(40, late_ms=late_ms), kept(guard), LIMITS)
        early_us, late_us = judged.contact_us(SECOND, span)
        assert early_us == pytest.approx(span.start_us + 1e3 * early_ms, abs=1.0)
        assert late_us == pytest.approx(span.start_us + 50_000.0)


def test_where_a_sleeve_stood_is_kept_once_its_valve_may_have_moved_it() -> None:
    """A sleeve that is measured on its way does not count as one that begins there."""
    state = GuardState(stood_m={SECOND: 0.0})
    for late_ms, early_ms in ((17.9, 40.0), (18.0, 23.5)):
        span = Span(NOW - 25_000, 1 << 62)
        seen = at(0.0, 4.375, late_ms=late_ms)
        judged = JudgedCommand((*NO_SPANS[:4], span, *NO_SPANS[5:]), seen, state, LIMITS)
        early_us, _ = judged.contact_us(SECOND, span)
        assert early_us == pytest.approx(span.start_us + 1e3 * early_ms, abs=1e-3)


@pytest.mark.parametrize(
    ("second_mm", "ms", "forbidden"), [(0.0, 20.0, None), (0.0, 30.0, 3), (4.375, 20.0, 3)]
)
def test_the_last_sample_before_it_sets_off_says_where_it_stood(
    second_mm: float, ms: float, forbidden: int | None
) -> None:
    """The valve, on at 4 ms, moves nothing before 11; from neutral the last call is from 29 ms on,
    from 4.375 mm from 12.5 on. What is sampled later is on its way."""
    guard = ready()
    assert row(guard, at(0.0), {SECOND: (ON_AT, 4)}) is None
    assert row(guard, at(10.0, second_mm), {SECOND: (ON_AT, 4)}) is None
    unknown = at(ms, 4.6, late_ms=5.0)._replace(swings=(None, None))
    assert row(guard, unknown, {SECOND: (ON_AT, 4)}) == forbidden


def test_with_another_clock_a_sleeve_on_its_way_is_so_until_it_is_seen_to_stand() -> None:
    guard = aborted()
    assert row(guard, at(-50_000)._replace(clock_is_new=True)) is None
    for ms in (-49_998, -49_996, -49_994):
        assert row(guard, at(ms)) is None
    assert row(guard, at(-49_992), {BRAKE: (ON_AT, -49_990)}) == 5
    assert row(guard, at(-49_970), {BRAKE: (ON_AT, -49_968)}) is None
