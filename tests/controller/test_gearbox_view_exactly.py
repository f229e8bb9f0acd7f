"""What the view says of sleeves and clutch at the very limits, and where a sensor's offset goes."""

from __future__ import annotations

import math

import pytest

from meshpoint.controller.sensing.gearbox_view import GearboxView, SleeveTrack
from meshpoint.dbc.messages import SleevesAux, SleevesMain
from meshpoint.gearbox import MainGear, Range, Sleeve, Split, load_sheet

SHEET = load_sheet("truck12")
STROKE_M, CONTACT_M = SHEET.sleeve.stroke_m, SHEET.sleeve.to_contact_m
FIRST, THIRD = Sleeve.FIRST_SECOND, Sleeve.CRAWL_THIRD
Samples = tuple[float, ...]


def still(position_m: float) -> Samples:
    return (position_m,) * 10


def take(
    view: GearboxView, first: Samples, third: Samples, time_us: int = 0, fault: int = 0
) -> None:
    view.sleeves_main(SleevesMain(0, fault, first, third), time_us)


def seen(first_m: float = 0.0, third_m: float = 0.0, split_m: float = STROKE_M,
         range_m: float = -STROKE_M) -> GearboxView:  # fmt: skip
    view = GearboxView(SHEET)
    take(view, still(first_m), still(third_m))
    view.sleeves_aux(SleevesAux(0, 0, still(split_m), still(range_m)), 0)
    view.clutch.take(0, 0.0)
    view.work_out()
    return view


def test_before_anything_was_seen_nothing_is_known() -> None:
    """The supply is as good as can be, the brake is empty, the clutch counts as open."""
    view = GearboxView(SHEET)
    view.work_out()
    assert (view.main_gear, view.split, view.range_) == (None, None, None)
    assert (view.supply_pa, view.brake_gauge_pa) == (math.inf, 0.0)
    assert view.clutch_closed is None
    assert view.clutch_parted
    assert (view.oldest_us, view.complete, view.gear_number) == (0, False, -1)
    assert view.tracks == {}


@pytest.mark.parametrize(("position_m", "in_neutral"), [(0.99e-3, True), (1e-3, False)])
def test_a_sleeve_is_in_neutral_within_a_millimetre_of_the_middle(
    position_m: float, in_neutral: bool
) -> None:
    for sign in (1, -1):
        view = seen(first_m=sign * position_m)
        assert view.in_neutral(FIRST) is in_neutral
        assert view.in_neutral(THIRD)
        assert view.main_gear is (MainGear.NEUTRAL if in_neutral else None)
        assert view.position_m(FIRST) == sign * position_m


@pytest.mark.parametrize(("short_m", "side"), [(1e-3, 1), (1.01e-3, 0)])
def test_a_sleeve_is_in_mesh_within_a_millimetre_of_its_stroke(short_m: float, side: int) -> None:
    position_m = STROKE_M - short_m
    assert seen(first_m=position_m).side(FIRST) == side
    assert seen(first_m=-position_m).side(FIRST) == -side
    assert seen(first_m=position_m).main_gear is (MainGear.SECOND if side else None)
    assert seen(third_m=position_m).main_gear is (MainGear.THIRD if side else None)
    assert seen(split_m=-position_m).split is (Split.LOW if side else None)
    assert seen(range_m=position_m).range_ is (Range.HIGH if side else None)


def test_a_sensor_that_reports_a_fault_takes_all_gears_away_till_it_reports_none() -> None:
    view = seen(first_m=STROKE_M)
    assert (view.complete, view.gear_number) == (True, 4)
    take(view, still(STROKE_M), still(0.0), 10_000, fault=2)
    view.work_out()
    assert (view.complete, view.gear_number) == (False, -1)
    assert (view.main_gear, view.split, view.range_) == (None, None, None)
    view.sleeves_aux(SleevesAux(0, 1, still(STROKE_M), still(STROKE_M)), 10_000)
    take(view, still(STROKE_M), still(0.0), 20_000)
    view.work_out()
    assert (view.complete, view.split) == (False, None)
    view.sleeves_aux(SleevesAux(0, 0, still(STROKE_M), still(STROKE_M)), 20_000)
    view.work_out()
    assert (view.complete, view.split, view.range_) == (True, Split.HIGH, Range.HIGH)


def test_a_view_without_its_clutch_or_a_sleeve_is_not_complete() -> None:
    view = GearboxView(SHEET)
    take(view, still(0.0), still(0.0))
    view.clutch.take(0, 0.0)
    view.work_out()
    assert (view.complete, view.main_gear) == (False, None)
    with pytest.raises(KeyError):
        view.position_m(Sleeve.SPLITTER)
    other = GearboxView(SHEET)
    take(other, still(0.0), still(0.0), 30)
    other.sleeves_aux(SleevesAux(0, 0, still(0.0), still(0.0)), 20)
    assert (other.complete, other.oldest_us) == (False, 20)


def test_a_clutch_is_parted_as_far_as_the_sheet_is_sure() -> None:
    view = seen()
    for over, is_parted in ((0.0, True), (1e-6, False)):
        view.clutch.take(10_000, SHEET.clutch.surely_open_share + over)
        assert view.clutch_parted is is_parted
        assert view.clutch_closed == SHEET.clutch.surely_open_share + over


def test_gears_have_their_numbers_and_neutral_none() -> None:
    assert seen().gear_number == 0
    assert seen(split_m=0.0).gear_number == 0
    assert seen(first_m=-STROKE_M, split_m=-STROKE_M).gear_number == 1
    assert seen(first_m=-STROKE_M, split_m=0.0).gear_number == -1
    assert seen(first_m=-STROKE_M, range_m=0.0).gear_number == -1
    assert seen(first_m=0.5 * STROKE_M).gear_number == -1


def test_a_crossing_lies_between_the_samples_by_the_line_through_them() -> None:
    """Samples of 3, 2, 1 and 0 mm, newest first: 2.25 mm was passed three quarters of a millisecond
    ago. What goes the other way is told for the other way."""
    track = SleeveTrack(50_000, (3e-3, 2e-3, 1e-3, 0.0))
    assert track.crossing_us(2.25e-3, 1) == pytest.approx(49_250.0)
    assert track.crossing_us(0.5e-3, 1) == pytest.approx(47_500.0)
    assert track.crossing_us(3e-3, 1) == pytest.approx(50_000.0)
    assert track.crossing_us(0.0, 1) is None, "it was there before the oldest one"
    assert track.crossing_us(3.1e-3, 1) is None
    assert track.crossing_us(2.25e-3, -1) is None
    back = SleeveTrack(50_000, (-3e-3, -2e-3, -1e-3, 0.0))
    assert back.crossing_us(2.25e-3, -1) == pytest.approx(49_250.0)
    assert track.position_m == 3e-3


@pytest.mark.parametrize(("gap_us", "joined"), [(10_000, True), (9_000, False), (20_000, False)])
def test_samples_of_two_frames_in_a_row_are_joined_by_one_that_overlaps(
    gap_us: int, joined: bool
) -> None:
    """Of the frame before, eleven at most: ten, and one of that before it."""
    view = GearboxView(SHEET)
    frames = [tuple(1e-5 * (10 * k + 9 - j) for j in range(10)) for k in range(3)]
    for k, frame in enumerate(frames[:2]):
        take(view, frame, still(0.0), 10_000 * k)
    assert view.tracks[FIRST].samples_m == frames[1] + frames[0]
    take(view, frames[2], still(0.0), 10_000 + gap_us)
    expected = frames[2] + (frames[1] + frames[0])[:11] if joined else frames[2]
    assert view.tracks[FIRST].samples_m == expected
    assert view.tracks[FIRST].newest_us == 10_000 + gap_us


def test_a_contact_is_that_of_the_nominal_place_though_it_is_seen_four_tenths_before() -> None:
    """As far as the sleeve goes in that time at its speed; by the sensor's own rest, which goes to
    a resting sleeve's newest sample by a twentieth each frame."""
    ahead_us = 4e-4 / SHEET.sleeve.speed_m_s * 1e6
    for direction in (1, -1):
        view = GearboxView(SHEET)
        take(view, (5e-4, *(0.0,) * 9), still(0.0), 0)
        take(view, (9e-4, *(0.0,) * 9), still(0.0), 20_000)
        rest_m = 0.05 * 5e-4 * 0.95 + 0.05 * 9e-4
        level_m = CONTACT_M - 4e-4 + rest_m * direction
        way = tuple(direction * (level_m + 1e-4 - 3e-4 * k) for k in range(10))
        take(view, way, still(0.0), 70_000)
        contact = view.contact_us(FIRST, direction)
        assert contact == pytest.approx(70_000 - 1000.0 / 3.0 + ahead_us)
        assert view.contact_us(FIRST, -direction) is None


@pytest.mark.parametrize(("position_m", "moves"), [(0.99e-3, True), (1e-3, False)])
def test_a_sleeve_rests_within_a_millimetre_of_the_middle(position_m: float, moves: bool) -> None:
    """Then what its sensor shows goes into its offset: a twentieth of it."""
    view = seen(third_m=0.0)
    take(view, still(position_m), still(0.0), 10_000)
    limit_m = CONTACT_M - 4e-4
    off_m = 0.05 * position_m if moves else 0.0
    for over_m, is_free in ((-1e-9, True), (1e-9, False)):
        view.tracks[FIRST] = SleeveTrack(20_000, still(limit_m + off_m + over_m))
        assert view.main_box_free is is_free
        view.tracks[FIRST] = SleeveTrack(20_000, still(-limit_m + off_m - over_m))
        assert view.main_box_free is is_free


def test_neither_main_sleeve_may_be_at_the_teeth() -> None:
    limit_m = CONTACT_M - 4e-4
    assert seen(limit_m - 1e-9, -limit_m + 1e-9).main_box_free
    assert not seen(limit_m, 0.0).main_box_free
    assert not seen(0.0, -limit_m).main_box_free


def test_a_gear_is_engaged_when_its_sleeve_comes_within_the_last_millimetre() -> None:
    """To the microsecond."""
    view = seen()
    level_m = STROKE_M - 1e-3
    take(view, tuple(level_m + 2e-4 - 3e-4 * k for k in range(10)), still(0.0), 70_000)
    assert view.engaged_us(FIRST, 1) == 69_333
    assert view.engaged_us(FIRST, -1) is None
    assert view.engaged_us(THIRD, 1) is None
