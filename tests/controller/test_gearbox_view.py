"""Sleeve positions turned into gears."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from meshpoint.controller.measure.gearbox_view import GearboxView, SleeveTrack
from meshpoint.dbc.messages import SleevesAux, SleevesMain
from meshpoint.gearbox import GearboxSheet, MainGear, Range, Sleeve, Split, load_sheet

SHEET = load_sheet("thesis")
STROKE = 12.0


def view_at(first_second: float, crawl_third: float, splitter: float, range_: float) -> GearboxView:
    """All sleeves standing, in mm."""
    view = GearboxView(SHEET)
    view.sleeves_main(
        SleevesMain(
            sleeve_first_second_m=(first_second * 1e-3,) * 10,
            sleeve_crawl_third_m=(crawl_third * 1e-3,) * 10,
        ),
        0,
    )
    view.sleeves_aux(
        SleevesAux(sleeve_splitter_m=(splitter * 1e-3,) * 10, sleeve_range_m=(range_ * 1e-3,) * 10),
        0,
    )
    view.clutch.take(0, 1.0)
    view.work_out()
    return view


@pytest.mark.parametrize(
    ("number", "first_second", "crawl_third", "splitter", "range_"),
    [
        (1, -1, 0, -1, -1),
        (2, -1, 0, 1, -1),
        (3, 1, 0, -1, -1),
        (4, 1, 0, 1, -1),
        (5, 0, 1, -1, -1),
        (6, 0, 1, 1, -1),
        (7, -1, 0, -1, 1),
        (8, -1, 0, 1, 1),
        (9, 1, 0, -1, 1),
        (10, 1, 0, 1, 1),
        (11, 0, 1, -1, 1),
        (12, 0, 1, 1, 1),
        (13, 0, -1, -1, -1),
        (14, 0, -1, 1, -1),
        (-1, 0, -1, 1, 1),  # crawl in the high range is no gear of this box
        (0, 0, 0, 1, 1),
        (0, 0, 0, 0, 0),
        (-1, 1, 0, 0, 1),  # splitter under way
        (-1, 1, 0, 1, 0),
    ],
)
def test_the_gear_follows_from_where_the_sleeves_stand(
    number: int, first_second: int, crawl_third: int, splitter: int, range_: int
) -> None:
    sides = (first_second, crawl_third, splitter, range_)
    assert view_at(*(side * STROKE for side in sides)).gear_number == number
    assert view_at(*(side * (STROKE - 0.9) for side in sides)).gear_number == number


@settings(deadline=None)
@given(first_second=st.floats(-12, 12), crawl_third=st.floats(-12, 12))
def test_between_neutral_and_mesh_there_is_no_gear(first_second: float, crawl_third: float) -> None:
    """1.5 mm from the middle is neutral: its detent brings a sleeve there. 1 mm from the stroke is
    in mesh, all else is under way."""
    view = view_at(first_second, crawl_third, STROKE, STROKE)
    gear = view.main_gear
    if max(abs(first_second), abs(crawl_third)) < 1.49:
        assert gear is MainGear.NEUTRAL
    elif min(abs(abs(first_second) - 11.0), abs(abs(crawl_third) - 11.0)) < 0.01:
        return  # on the very edge either is right
    elif abs(first_second) > 11.01:
        assert gear is (MainGear.FIRST if first_second < 0 else MainGear.SECOND)
    elif abs(crawl_third) > 11.01:
        assert gear is (MainGear.CRAWL if crawl_third < 0 else MainGear.THIRD)
    elif 1.51 < max(abs(first_second), abs(crawl_third)) < 10.99:
        assert gear is None


def test_a_sleeve_at_the_teeth_takes_the_layshaft_its_freedom() -> None:
    """Contact is at 5 mm: there the sleeve rubs on a tooth, or is in the gap."""
    assert view_at(4.5, 0, STROKE, STROKE).main_box_free
    assert view_at(0, -4.5, STROKE, STROKE).main_box_free
    assert not view_at(4.9, 0, STROKE, STROKE).main_box_free
    assert not view_at(0, -5.4, STROKE, STROKE).main_box_free


def test_nothing_is_known_before_all_has_been_seen(sheet: GearboxSheet) -> None:
    view = GearboxView(sheet)
    assert not view.complete
    view.sleeves_main(SleevesMain(), 0)
    view.sleeves_aux(SleevesAux(), 0)
    assert not view.complete
    view.clutch.take(0, 0.0)
    assert view.complete
    with pytest.raises(KeyError):
        GearboxView(sheet).position_m(Sleeve.RANGE)


def test_before_anything_was_seen_supply_is_as_good_as_can_be_and_the_clutch_counts_as_open() -> (
    None
):
    view = GearboxView(SHEET)
    view.work_out()
    assert (view.supply_pa, view.brake_gauge_pa) == (math.inf, 0.0)
    assert (view.clutch_closed, view.clutch_parted) == (None, True)
    assert (view.main_gear, view.gear_number) == (None, -1)


def test_a_clutch_is_parted_as_far_as_the_sheet_is_sure() -> None:
    view = view_at(0, 0, STROKE, STROKE)
    for over, is_parted in ((0.0, True), (1e-6, False)):
        view.clutch.take(10_000, SHEET.clutch.surely_open_share + over)
        assert view.clutch_parted is is_parted


def test_a_sensor_that_reports_a_fault_takes_all_gears_away_till_it_reports_none() -> None:
    view = view_at(STROKE, 0, STROKE, STROKE)
    assert (view.complete, view.gear_number) == (True, 10)
    second, still = (STROKE * 1e-3,) * 10, (0.0,) * 10
    for time_us, fault, is_known in ((10_000, 2, False), (20_000, 0, True)):
        view.sleeves_main(SleevesMain(0, fault, second, still), time_us)
        view.work_out()
        assert view.complete is is_known
        assert view.gear_number == (10 if is_known else -1)
        assert (view.split, view.range_) == ((Split.HIGH, Range.HIGH) if is_known else (None, None))


def test_a_gear_is_engaged_when_its_sleeve_comes_within_the_last_millimetre() -> None:
    """To the microsecond."""
    view, level_m = view_at(0, 0, STROKE, STROKE), SHEET.sleeve.stroke_m - 1e-3
    way = tuple(level_m + 2e-4 - 3e-4 * k for k in range(10))
    view.sleeves_main(SleevesMain(0, 0, way, (0.0,) * 10), 70_000)
    assert view.engaged_us(Sleeve.FIRST_SECOND, 1) == 69_333
    assert view.engaged_us(Sleeve.FIRST_SECOND, -1) is None
    assert view.engaged_us(Sleeve.CRAWL_THIRD, 1) is None


def test_the_splitter_step_is_where_its_sleeve_is() -> None:
    assert view_at(0, 0, -STROKE, 0).split is Split.LOW
    assert view_at(0, 0, STROKE, 0).split is Split.HIGH
    assert view_at(0, 0, 3.0, 0).split is None


@settings(deadline=None)
@given(
    speed_m_s=st.floats(0.02, 2.0),
    direction=st.sampled_from([-1, 1]),
    passed_us=st.floats(1.0, 8_999.0),
)
def test_a_crossing_is_where_the_line_between_samples_says(
    speed_m_s: float, direction: int, passed_us: float
) -> None:
    """A sleeve at constant speed: the crossing is exact, wherever between two samples it lies."""
    newest_us, level = 500_000, 4.99e-3
    ages = [k * 1000.0 for k in range(10)]
    samples = [direction * (level + speed_m_s * (passed_us - age) * 1e-6) for age in ages]
    track = SleeveTrack(newest_us, tuple(samples))
    crossing = track.crossing_us(level, direction)
    assert crossing is not None
    assert abs(crossing - (newest_us - passed_us)) < 0.01
    assert track.crossing_us(level, -direction) is None


def test_a_sleeve_that_stands_or_goes_back_crosses_nothing() -> None:
    stands = SleeveTrack(0, (5e-3,) * 10)
    back = SleeveTrack(0, tuple(4e-3 + k * 5e-4 for k in range(10)))
    for track in (stands, back):
        assert track.crossing_us(5e-3, 1) is None


@pytest.mark.parametrize("back_ms", [0.5, 5.5, 9.5, 12.5, 18.5])
def test_a_sleeve_is_seen_to_pass_a_level_wherever_between_two_frames_it_does(
    back_ms: float,
) -> None:
    """A frame's ten samples reach 9 ms back, and frames come every 10 ms; a step that is late
    takes two of them, and the level may have been passed in the first."""
    view = GearboxView(SHEET)
    passed_ms = 20.0 - back_ms
    for newest_ms in (10, 20):
        samples = [(newest_ms - k - passed_ms) * 1e-3 + 5e-3 for k in range(10)]
        view.sleeves_main(
            SleevesMain(sleeve_first_second_m=tuple(samples)), newest_us := newest_ms * 1000
        )
    crossed_us = view.tracks[Sleeve.FIRST_SECOND].crossing_us(5e-3, 1)
    assert crossed_us == pytest.approx(newest_us - back_ms * 1000, abs=1.0)


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("crawl", [False, True])
def test_the_box_is_free_since_a_sleeve_left_its_teeth_and_the_plates_had_parted(
    side: int, crawl: bool
) -> None:
    """The sleeve runs 1 mm a millisecond; teeth begin 0.4 mm before contact. A sleeve that stands
    clear says no more than that it did so through its samples."""
    view = view_at(0, 0, 1, 1)
    clear_mm = 1e3 * SHEET.sleeve.to_contact_m - 0.4
    out = tuple(side * 1e-3 * (clear_mm - 2.25 + i) for i in range(10))
    still = (0.0,) * 10
    sleeves = (still, out) if crawl else (out, still)
    view.clutch.take(190_000, 0.0)
    view.clutch.take(200_000, 0.0)
    view.sleeves_main(
        SleevesMain(sleeve_first_second_m=sleeves[0], sleeve_crawl_third_m=sleeves[1]), 200_000
    )
    assert view.main_box_free
    assert view.free_since_us == pytest.approx(200_000 - 2_250)
    view.sleeves_main(SleevesMain(sleeve_first_second_m=still, sleeve_crawl_third_m=still), 230_000)
    assert view.free_since_us == 230_000 - 9_000
    view.clutch.take(230_000, 1.0)
    view.clutch.take(240_000, 0.0)
    assert view.free_since_us == 240_000
