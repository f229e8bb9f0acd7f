"""The guard's rows and a main sleeve that stands before a gear's teeth: for how long it may, and a
start that finds it there.
"""

from __future__ import annotations

import pytest
from guard_cases import LIMITS, place, ready
from guard_sleeve_cases import (
    BRAKE,
    CRAWL,
    FIRST,
    OFF_AT,
    ON_AT,
    SECOND,
    SPLIT_LOW,
    at,
    fired,
    row,
    standing,
)

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
