"""What the guard holds a command against, worked out by hand for the gearbox `truck12`; and the
limits of what it judges, exactly at each."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import pytest

from meshpoint.controller.guard.case import (
    MAIN_VALVES,
    NO_SPANS,
    OFF_AT,
    ON_AT,
    ON_NOW,
    GuardState,
    JudgedCommand,
    Span,
    Spans,
    ValveRequest,
    spans,
)
from meshpoint.controller.guard.limits import (
    CLEAR_M,
    GUARD_NEUTRAL_M,
    GuardLimits,
    MainValve,
    end_of,
    guard_limits,
)
from meshpoint.controller.guard.own_speed import ShaftSpeed
from meshpoint.controller.guard.view import GuardInputs
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.controller.settings.valve_name import ValveName
from meshpoint.gearbox import load_sheet

SHEET = load_sheet("truck12")
NOW_US = 5_000_000
FIRST, SECOND, CRAWL, THIRD = MAIN_VALVES
BY_HAND: dict[str, Any] = {
    "contact_m": 0.005,
    "sleeve_delay_us": 45_000.0,
    "sleeve_valve_us": 12_000.0,
    "teeth_out_us": 24_500.0,  # 12 ms, and 7 mm at 0.4 m/s, less 5 ms
    "stroke_m": 0.012,
    "clutch_open_share": 0.3,  # parts at 0.35 +- 0.05
    "sleeve_scatter_us": 5_000.0,
    "switch_again_us": 15_000,  # a tick and the bus
    "before_teeth_us": 500_000,
    "brake_lag_us": 45_000.0,
    "brake_nm_per_pa": 100.0 / 850_000.0,
    "atmosphere_pa": 101_300.0,
    "drag_rad_s2": 15.0 / 0.362930612244898,
    "drag_rate": 1.4 * 0.13 / 0.362930612244898,
    "input_max_rad_s": 1.01 * 2400.0 * math.pi / 30.0,
    "main_max_rad_s": 1.01 * 2400.0 * math.pi / 30.0 * (35 / 37) * (37 / 35),
    "brake_on_us": 2_500_000,
    "brake_j": 15_000.0,
    "brake_floor_rad_s": 100.0 * math.pi / 30.0,
    "valve_on_us": 3_000_000,
    "supply_low_pa": 500_000.0,
    "engaged_m": 0.011,
    "in_mesh_m": 0.0062,  # 5 mm, and an overlap of 1.0 +- 0.2
    "free_rad": math.radians(4.5),  # half of 7.5 and a fifth of them
    "plate_slip_rad_s": 78.59972466647235,  # the step from crawl to first, 1.455
    "clutch_travel_us": 300_000,
    "torque_away_us": 2_850_000,  # 2 + 0.25 + 0.6 s
    "engine_share_s2": 1.1 * 3.2 / 2500.0,
    "tick_us": 10_000,
    "closings": 4,
    "closing_again_us": 4_000_000,
    "request_us": 34_650_000,  # 2.25 + 0.6 + 1.5 + 4 * (2 + 0.6 + 2 * 2) + 3 * (0.5 + 2 * 0.4) s
}
PAIRS = {
    "brake_rad_s2": (100.0 / 1.4 / 0.4267676767676768, 140.0 / 0.362930612244898),
    "brake_delay_us": (0.85 * 12_000.0, 1.15 * 12_000.0),
    "input_drag": (15.0 / 0.11, 1.4 * 0.13 / 0.11),
    "slip_rad_s": (-60.0 * math.pi / 30.0, 120.0 * math.pi / 30.0),
}
GEAR_AT = {
    (3, -1, -1): 1, (3, 1, -1): 2, (4, -1, -1): 3, (4, 1, -1): 4, (6, -1, -1): 5, (6, 1, -1): 6,
    (3, -1, 1): 7, (3, 1, 1): 8, (4, -1, 1): 9, (4, 1, 1): 10, (6, -1, 1): 11, (6, 1, 1): 12,
    (5, -1, -1): 13, (5, 1, -1): 14,
}  # fmt: skip


def limits() -> GuardLimits:
    return guard_limits(SHEET, ControllerSettings())


def inputs(**changes: Any) -> GuardInputs:
    """In neutral, clutch open, everything turning and seen."""
    speed = ShaftSpeed(NOW_US, 100.0)
    values = {
        "now_us": NOW_US,
        "positions_m": (0.0, 0.0, 0.012, 0.012),
        "clutch_closed": 0.0,
        "supply_pa": 9.5e5,
        "brake_pa": 1.013e5,
        "speeds": (speed,) * 4,
        "agreeing": 0,
        "valid": True,
        "positions_us": NOW_US,
        "clutch_us": NOW_US,
    }
    return GuardInputs(**(values | changes))


def case(driven: dict[int, Span] | None = None, state: GuardState | None = None,
         **changes: Any) -> JudgedCommand:  # fmt: skip
    asked: Spans = tuple((driven or {}).get(valve) for valve in range(9)) if driven else NO_SPANS
    return JudgedCommand(asked, inputs(**changes), state or GuardState(), limits())


DRIVEN = Span(NOW_US, 1 << 62)


@pytest.mark.parametrize("name", BY_HAND)
def test_each_limit_is_as_worked_out_by_hand(name: str) -> None:
    assert getattr(limits(), name) == pytest.approx(BY_HAND[name], rel=1e-9)


def test_tables_and_pairs_are_as_worked_out_by_hand() -> None:
    found = limits()
    for name, pair in PAIRS.items():
        assert getattr(found, name) == pytest.approx(pair, rel=1e-9)
    assert found.gear_at == GEAR_AT
    assert {valve: (each.sleeve, each.direction) for valve, each in found.main.items()} == {
        3: (0, -1), 4: (0, 1), 5: (1, -1), 6: (1, 1)
    }  # fmt: skip
    ratios = {valve: each.ratio for valve, each in found.main.items()}
    assert ratios == pytest.approx({3: 23 / 53, 4: 28 / 41, 5: 17 / 57, 6: 37 / 35})
    assert found.split_ratio == pytest.approx({-1: 33 / 43, 1: 35 / 37})
    assert found.range_ratio == pytest.approx({-1: 4 / 15, 1: 1.0})
    fields = {field.name for field in dataclasses.fields(GuardLimits)}
    assert fields == {*BY_HAND, *PAIRS, "face_pulse_us", "gear_at", "main", "split_ratio",
                      "range_ratio", "splitter"}  # fmt: skip


def test_the_splitters_valves_are_those_of_a_sleeve_with_dog_teeth() -> None:
    """Its gears are driven by the layshaft, on the input shaft; with cones they are none."""
    dog = guard_limits(load_sheet("truck12-dog"), ControllerSettings())
    assert not limits().splitter
    assert limits().dogs == limits().main
    assert {valve: (each.sleeve, each.direction) for valve, each in dog.splitter.items()} == {
        1: (2, -1), 2: (2, 1)
    }  # fmt: skip
    ratios = {valve: each.ratio for valve, each in dog.splitter.items()}
    assert ratios == pytest.approx({1: 43 / 33, 2: 37 / 35})
    assert dog.main == limits().main
    longer_us = 1000 * (1500 + 2000 + 2000)
    assert dog.request_us - limits().request_us == longer_us


@pytest.mark.parametrize(
    "name",
    ["sleeve_delay_us", "input_max_rad_s", "main_max_rad_s", "brake_j", "valve_on_us",
     "before_teeth_us", "brake_on_us", "plate_slip_rad_s", "clutch_travel_us", "closings",
     "closing_again_us", "request_us"],
)  # fmt: skip
@pytest.mark.parametrize("value", [0.0, -1.0, math.inf, math.nan])
def test_limits_with_a_number_that_is_none_are_not_sane(name: str, value: float) -> None:
    assert limits().are_sane
    assert not dataclasses.replace(limits(), **{name: value}).are_sane


def test_the_other_limits_are_looked_at_too() -> None:
    sane = limits()
    assert dataclasses.replace(sane, brake_rad_s2=(0.0, 1e-9), brake_j=1e-9).are_sane
    assert not dataclasses.replace(sane, brake_rad_s2=(1.0, 0.0)).are_sane
    assert not dataclasses.replace(sane, slip_rad_s=(1.0, 1.0)).are_sane
    for name in ("split_ratio", "range_ratio"):
        assert not dataclasses.replace(sane, **{name: {-1: 1.0, 1: 0.0}}).are_sane
    assert not dataclasses.replace(sane, main=sane.main | {4: MainValve(0, 1, 0.0)}).are_sane


def test_an_end_begins_exactly_at_its_limit() -> None:
    assert [end_of(x, 0.011) for x in (0.0, 0.011, -0.011, 0.01101, -0.01101)] == [0, 0, 0, 1, -1]


def test_a_main_sleeve_is_neutral_and_driven_toward_a_gear_exactly_up_to_their_limits() -> None:
    contact_m = limits().contact_m
    for position_m, is_neutral in ((GUARD_NEUTRAL_M, True), (GUARD_NEUTRAL_M + 1e-9, False)):
        for positions in ((position_m, 0.0), (0.0, -position_m)):
            assert case(positions_m=(*positions, 0.012, 0.012)).main_is_neutral() is is_neutral
    apart_m = limits().apart_m
    assert apart_m == contact_m - 0.2e-3
    withstood = GuardState(withstood_us={SECOND: 40_000})
    for position_m, is_engaging in (
        (-apart_m, True), (-apart_m - 1e-9, False), (contact_m, True), (contact_m + 1e-9, False),
    ):  # fmt: skip
        driven = {SECOND: Span(NOW_US - 20_000, 1 << 62)}
        judged = case(driven, withstood, positions_m=(position_m, 0.0, 0.012, 0.012))
        assert bool(judged.engaging()) is is_engaging
    pulled = GuardState(pulls=frozenset({SECOND}), withstood_us={SECOND: 40_000})
    for position_m, is_engaging in ((GUARD_NEUTRAL_M, True), (GUARD_NEUTRAL_M - 1e-9, False)):
        judged = case({SECOND: DRIVEN}, pulled, positions_m=(position_m, 0.0, 0.012, 0.012))
        assert bool(judged.engaging()) is is_engaging


@pytest.mark.parametrize(
    ("position_m", "is_pulling"),
    [(-limits().apart_m, False), (-limits().apart_m - 1e-9, True), (0.001, False), (0.0, False)],
)
def test_a_valve_pulls_where_its_sleeve_may_be_in_the_other_gear(
    position_m: float, is_pulling: bool
) -> None:
    judged = case({SECOND: DRIVEN}, positions_m=(position_m, 0.0, 0.012, 0.012))
    assert judged.pulling() == (frozenset({SECOND}) if is_pulling else frozenset())


def test_contact_is_expected_within_the_scatter_around_the_delay() -> None:
    found = case().contact_us(SECOND, Span(NOW_US, 0))
    assert found == (NOW_US + 40_000.0, NOW_US + 50_000.0)


@pytest.mark.parametrize(
    ("positions_mm", "gear"),
    [((12, 0, 12, 12), 10), ((-12, 0, -12, -12), 1), ((0, 12, 12, -12), 6), ((0, -12, 12, 12), 0),
     ((0, 0, 12, 12), 0), ((12, 0, 0, 12), 0), ((11, 0, 12, 12), 0)],
)  # fmt: skip
def test_the_gear_that_all_sleeves_stand_in(positions_mm: tuple[int, ...], gear: int) -> None:
    positions = tuple(each * 1e-3 for each in positions_mm)
    assert case(positions_m=positions).gear_number() == gear


def test_the_clutch_is_foreseen_at_its_rate_but_not_far() -> None:
    moving = case(clutch_closed=0.5, clutch_per_s=-5.0, clutch_us=NOW_US - 10_000)
    assert moving.clutch_at(NOW_US) == pytest.approx(0.45)
    assert moving.clutch_at(NOW_US + 40_000) == pytest.approx(0.25)
    assert moving.clutch_at(NOW_US + 50_000) == moving.clutch_at(NOW_US + 10**6)
    assert moving.clutch_at(NOW_US + 50_000) == pytest.approx(0.2)
    assert moving.clutch_at(NOW_US - 10_000) == moving.clutch_at(0.0) == 0.5


@pytest.mark.parametrize(
    ("closed", "per_s", "at_us", "is_parted"),
    [
        (limits().clutch_open_share, 0.0, 0, True),
        (limits().clutch_open_share + 1e-9, 0.0, 0, False),
        (0.4, -5.0, 25_000, True),
        (0.4, -5.0, 15_000, False),  # not yet when it is driven
        (0.25, 5.0, 0, False),  # closed again before it could be withdrawn, 15 ms from now
        (0.25, 3.0, 0, True),
        (0.25, 3.0, 20_000, False),
    ],
)
def test_plates_are_parted_at_a_time_and_until_it_could_be_taken_back(
    closed: float, per_s: float, at_us: int, is_parted: bool
) -> None:
    judged = case(clutch_closed=closed, clutch_per_s=per_s)
    assert judged.is_parted(float(NOW_US + at_us)) is is_parted


def test_teeth_are_out_in_neutral_when_pulled_clear_or_fast_enough() -> None:
    def out(position_mm: float, speed_m_s: float = 0.0, at_ms: float = 0.0, valve: int = SECOND,
            read_ms: float = 0.0) -> bool:  # fmt: skip
        positions = (position_mm * 1e-3, 0.0, 0.012, 0.012)
        judged = case(
            {valve: DRIVEN}, GuardState(pulls=frozenset({valve} - {FIRST})),
            positions_m=positions, speeds_m_s=(speed_m_s, 0.0), means_m_s=(speed_m_s, 0.0),
            positions_us=NOW_US - round(read_ms * 1e3),
        )  # fmt: skip
        return judged.teeth_are_out(0, NOW_US + at_ms * 1e3)

    assert out(-1.5, 0.1)
    assert not out(-1.6, 0.1, valve=FIRST)  # pushed in, not pulled
    assert out(-4.8)  # it stands before the teeth
    assert out(-4.8, valve=FIRST)
    assert not out(-4.8 - 1e-6)
    assert not out(-4.5 - 1e-6, -0.05)
    assert out(-4.5 + 1e-6, -0.05)  # 7.5 mm of 12: the teeth are 0.5 mm past each other
    # 1 mm out at 0.2 m/s: s = a t^2 / 2 from 0.7 mm 1.5 ms ago, since 7 ms; 7.5 mm after 22.9 ms,
    # which is 14.4 ms from now.
    assert not out(-11.0, 0.2, 14.3)
    assert out(-11.0, 0.2, 14.5)
    assert out(-11.0, 0.2, 9.5, read_ms=5.0)
    assert not out(-11.0, 0.2, 9.3, read_ms=5.0)
    assert not out(-11.0, -0.2, 100.0)  # back in
    assert not out(-11.0, 0.0499, 1e4)
    assert out(-11.0, 0.05, 1e4)
    assert not out(-11.9, 0.1, 1e4)  # its samples say more than its way


def test_a_span_begins_where_its_valve_was_first_driven() -> None:
    on_now = ValveRequest((1, *[0] * 8), (0,) * 9)
    (first, *_) = spans(on_now, NO_SPANS, NOW_US)
    assert first == Span(NOW_US, 1 << 62)
    before: Spans = (Span(NOW_US, NOW_US + 5), *NO_SPANS[1:])
    assert spans(on_now, before, NOW_US)[0] == Span(NOW_US, 1 << 62)
    assert spans(on_now, before, NOW_US + 5)[0] == Span(NOW_US + 5, 1 << 62)
    on_at = ValveRequest((3, *[0] * 8), (NOW_US + 100,) + (0,) * 8)
    assert spans(on_at, before, NOW_US)[0] == Span(NOW_US, 1 << 62)
    assert spans(on_at, NO_SPANS, NOW_US)[0] == Span(NOW_US + 100, 1 << 62)
    late: Spans = (Span(NOW_US + 9, 1 << 62), *NO_SPANS[1:])
    assert spans(on_now, late, NOW_US)[0] == Span(NOW_US, 1 << 62)
    with pytest.raises(ValueError, match="argument"):
        spans(ValveRequest((1,) * 9, (0,) * 8), NO_SPANS, NOW_US)


@pytest.mark.parametrize(
    ("first", "release_us", "begun_us", "ends_us"),
    [
        ((ON_AT, 9), 23, None, 23),
        ((ON_AT, 9), 9, None, 1 << 62),  # of one instant, off before on
        ((ON_AT, 9), 8, None, 1 << 62),
        ((ON_NOW, 0), 1, -9, 1),
        ((ON_NOW, 0), 0, -9, 1 << 62),  # it has passed: nobody knows whether it was heard
        ((ON_NOW, 0), -5, -9, 1 << 62),
        ((OFF_AT, 10), 20, -9, 10),
        ((OFF_AT, 20), 10, -9, 10),
    ],
)
def test_a_release_of_the_other_valve_of_its_sleeve_ends_a_span(
    first: tuple[int, int], release_us: int, begun_us: int | None, ends_us: int
) -> None:
    orders = {ValveName.MAIN_FIRST: first, ValveName.MAIN_SECOND: (OFF_AT, release_us)}
    actions, times = zip(*(orders.get(valve, (0, -NOW_US)) for valve in ValveName), strict=True)
    before = list(NO_SPANS)
    if begun_us is not None:
        before[ValveName.MAIN_FIRST] = Span(NOW_US + begun_us, 1 << 62)
    request = ValveRequest(actions, tuple(NOW_US + time_us for time_us in times))
    span = spans(request, tuple(before), NOW_US)[ValveName.MAIN_FIRST]
    start_us = NOW_US + (first[1] if begun_us is None else begun_us)
    assert span == Span(start_us, ends_us if ends_us == 1 << 62 else NOW_US + ends_us)


def test_a_guard_begins_armed_and_cool_and_every_sleeve_valve_begins_to_be_driven() -> None:
    assert GuardState().armed
    assert GuardState().brake_j == 0.0
    for valve in range(9):
        assert case({valve: DRIVEN}).starting() == ([valve] if valve else [])


def test_a_sleeve_exactly_clear_is_out_and_one_whose_way_its_speed_explains_is_not_judged() -> None:
    of = limits()
    clear_m = of.stroke_m - of.contact_m + CLEAR_M
    position_m = -(of.stroke_m - clear_m)
    assert of.stroke_m - abs(position_m) == clear_m
    judged = case({SECOND: DRIVEN}, positions_m=(position_m, 0.0, 0.012, 0.012))
    assert judged.teeth_are_out(0, NOW_US)
    come_m = of.stroke_m - abs(-0.0117)
    speed_m_s = come_m / (0.5 * 3 * 1e-3)
    assert come_m - speed_m_s * (0.5 * 3 * 1e-3) == 0.0
    judged = case({SECOND: DRIVEN}, positions_m=(-0.0117, 0.0, 0.012, 0.012),
                  speeds_m_s=(speed_m_s, 0.0))  # fmt: skip
    assert not judged.teeth_are_out(0, NOW_US + 10**6)
