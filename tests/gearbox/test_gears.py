"""The 14 gears of a 12+2-speed range-splitter box."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise

import pytest

from meshpoint.gearbox import MainGear, Range, Split, drive_gear, load_sheet
from meshpoint.gearbox.gears import DRIVE_GEARS, MAIN_GEARS, SLEEVE_OF_MAIN, main_box_only


def test_gears_are_numbered_split_first_then_main_then_range() -> None:
    """The table of the documentation, written out."""
    table = {
        number: (gear.main.name[0], gear.split.name[0], gear.range_.name[0])
        for number, gear in DRIVE_GEARS.items()
    }
    main = "FFSSTTFFSSTTCC"
    split = "LHLHLHLHLHLHLH"
    range_ = "LLLLLLHHHHHHLL"
    assert table == {
        i + 1: (m, s, r) for i, (m, s, r) in enumerate(zip(main, split, range_, strict=True))
    }


def test_every_combination_is_one_gear_at_most() -> None:
    kinds = {(gear.main, gear.split, gear.range_) for gear in DRIVE_GEARS.values()}
    assert len(kinds) == 14
    assert (MainGear.CRAWL, Split.LOW, Range.HIGH) not in kinds
    assert [drive_gear(13).name, drive_gear(14).name, drive_gear(8).name] == ["C1", "C2", "8"]


@pytest.mark.parametrize("number", [0, -1, 15])
def test_neutral_is_no_drive_gear(number: int) -> None:
    with pytest.raises(KeyError):
        drive_gear(number)


def test_gears_rise_in_speed_with_their_number_and_crawl_is_the_lowest() -> None:
    """Overall ratio falls from 1 to 12; both crawl gears lie above first."""
    sheet = load_sheet("thesis")
    ratios = {number: sheet.overall_ratio(gear) for number, gear in DRIVE_GEARS.items()}
    assert all(ratios[a] > ratios[b] for a, b in pairwise(range(1, 13)))
    assert ratios[13] > ratios[14] > ratios[1]


def test_overall_ratio_is_the_exact_product_of_tooth_counts() -> None:
    """Gear 8: splitter 34/36, first 23/50, range direct. Gear 1 through planets 20/(20+74)."""
    sheet = load_sheet("thesis")
    assert sheet.overall_ratio(drive_gear(8)) == float(1 / (Fraction(34, 36) * Fraction(23, 50)))
    low = Fraction(30, 41) * Fraction(23, 50) * Fraction(20, 94)
    assert sheet.overall_ratio(drive_gear(1)) == float(1 / low)


@pytest.mark.parametrize(("from_", "to"), [(8, 10), (7, 9), (10, 12), (1, 3), (10, 8), (2, 14)])
def test_the_main_box_alone_moves_two_numbers_apart(from_: int, to: int) -> None:
    assert main_box_only(from_, to)


@pytest.mark.parametrize(("from_", "to"), [(8, 8), (7, 8), (6, 7), (8, 14), (2, 8), (5, 7)])
def test_splitter_and_range_changes_are_no_shift_of_the_main_box_alone(from_: int, to: int) -> None:
    assert not main_box_only(from_, to)


def test_each_main_gear_is_one_end_of_a_sleeve() -> None:
    ends = {(side.sleeve, side.direction) for side in SLEEVE_OF_MAIN.values()}
    assert len(ends) == len(MAIN_GEARS) == 4
    assert {direction for _, direction in ends} == {-1, 1}
    assert set(SLEEVE_OF_MAIN) == set(MAIN_GEARS) == set(MainGear) - {MainGear.NEUTRAL}
