"""Main box and splitter one after the other, where both have dog teeth."""

from __future__ import annotations

import itertools
from types import SimpleNamespace
from typing import Any

import pytest

from meshpoint.controller.shift.legs import next_leg
from meshpoint.gearbox import MainGear, Range, Split, load_sheet
from meshpoint.gearbox.gears import DRIVE_GEARS

DOG, CONES = load_sheet("truck12-dog"), load_sheet("truck12")
PAIRS = [(a, b) for a in DRIVE_GEARS for b in DRIVE_GEARS if a != b]


def view(main: MainGear, split: Split | None, range_: Range | None) -> Any:
    return SimpleNamespace(main_gear=main, split=split, range_=range_)


def legs(from_: int, to: int) -> list[int]:
    """The gears of a shift, one after the other."""
    found, at = [], DRIVE_GEARS[from_]
    while at.number != to:
        at = next_leg(DOG, view(at.main, at.split, at.range_), DRIVE_GEARS[to])
        found.append(at.number)
        assert len(found) < 4
    return found


@pytest.mark.parametrize(("from_", "to"), PAIRS)
def test_no_more_than_two_legs_each_of_one_change(from_: int, to: int) -> None:
    way = [from_, *legs(from_, to)]
    assert len(way) <= 3
    for one, other in itertools.pairwise(way):
        a, b = DRIVE_GEARS[one], DRIVE_GEARS[other]
        assert (a.split is not b.split) != ((a.main, a.range_) != (b.main, b.range_))


@pytest.mark.parametrize(("from_", "to"), PAIRS)
def test_on_the_way_the_input_shaft_turns_no_faster_than_before_or_after(
    from_: int, to: int
) -> None:
    most = max(DOG.overall_ratio(DRIVE_GEARS[each]) for each in (from_, to))
    assert all(DOG.overall_ratio(DRIVE_GEARS[leg]) <= most for leg in legs(from_, to))


@pytest.mark.parametrize(("from_", "to"), [(2, 3), (3, 2), (11, 10), (7, 6)])
def test_with_cones_there_is_one_leg(from_: int, to: int) -> None:
    at = DRIVE_GEARS[from_]
    assert next_leg(CONES, view(at.main, at.split, at.range_), DRIVE_GEARS[to]).number == to


def test_out_of_neutral_the_main_box_comes_first_in_the_step_that_is_in() -> None:
    neutral = view(MainGear.NEUTRAL, Split.LOW, Range.HIGH)
    assert next_leg(DOG, neutral, DRIVE_GEARS[8]).number == 7
    assert next_leg(DOG, view(MainGear.FIRST, Split.LOW, Range.HIGH), DRIVE_GEARS[8]).number == 8


def test_a_splitter_left_in_no_step_goes_into_the_high_one_before_the_main_box_changes() -> None:
    between = view(MainGear.FIRST, None, Range.HIGH)
    assert next_leg(DOG, between, DRIVE_GEARS[9]).number == 8
    assert next_leg(DOG, between, DRIVE_GEARS[7]).number == 7
