"""The guard over clutch and engine exactly at each of its limits: where a rule ends, to the last
bit, and what it begins with."""

from __future__ import annotations

from typing import Any

import pytest
from guard_cases import kept_of_driveline
from test_guard_driveline import CLOSE, HIGH, IN_GEAR, LIMITS, MAIN_RPM, OPEN, SECOND, torque

from meshpoint.controller.guard.driveline import (
    NO_OVERRIDE,
    SPEED_CONTROL,
    TORQUE_CONTROL,
    DrivelineCase,
    DrivelineGuard,
    DrivelineState,
    EngineWish,
    closing_onto_slip,
    closing_too_often,
    engine_beyond_the_gear,
)
from meshpoint.controller.guard.limits import (
    CLEAR_M,
    CLUTCH_CLOSED_SHARE,
    GUARD_NEUTRAL_M,
    LEAVING_M_S,
)
from meshpoint.gearbox import Split
from meshpoint.units import RPM

LOW = LIMITS.split_ratio[-1]
NOISE = 0.015
"""One and a half steps of TSC1's torque."""


def case(engine: EngineWish | None = None, **changes: Any) -> DrivelineCase:
    judged = DrivelineCase(IN_GEAR._replace(**changes), DrivelineState(), LIMITS)
    return judged if engine is None else judged._replace(engine=engine)


def at(first_second_m: float = 0.012, crawl_third_m: float = 0.0, splitter_m: float = 0.012) -> Any:
    return (first_second_m, crawl_third_m, splitter_m, -0.012)


def speed(rad_s: float) -> EngineWish:
    return EngineWish(SPEED_CONTROL, rad_s)


def test_what_is_known_before_anything_was_seen() -> None:
    nothing = DrivelineState(False, False, 0.0, (), None, own_share=None, torque_us=0)
    assert DrivelineState() == nothing
    assert case().engine == EngineWish(NO_OVERRIDE, 0.0) == (NO_OVERRIDE, 0.0, 0.0)
    guard = DrivelineGuard(LIMITS)
    assert guard.blocked_row is None
    assert guard.blocks == 0
    assert not guard.passes_clutch(CLOSE, IN_GEAR._replace(valid=False))  # not closed already
    assert guard.blocked_row == 15


def test_a_gear_is_in_from_just_beyond_its_limit() -> None:
    assert case(positions_m=at(LIMITS.engaged_m)).gear_in_mesh == 0
    assert case(positions_m=at(LIMITS.engaged_m + 1e-9)).gear_in_mesh == 4
    assert case(positions_m=at(-LIMITS.engaged_m - 1e-9)).gear_in_mesh == 3


def test_the_teeth_are_out_where_both_sleeves_are_clear_and_none_comes_back() -> None:
    clear_m = LIMITS.contact_m - CLEAR_M
    for position_m, are_out in ((clear_m, True), (clear_m + 1e-9, False)):
        for positions in (at(position_m), at(0.0, position_m), at(0.0, -position_m)):
            assert case(positions_m=positions).teeth_are_out is are_out
    for sign in (-1.0, 1.0):
        for goes_m_s, are_out in ((LEAVING_M_S, False), (LEAVING_M_S - 1e-9, True), (-1.0, True)):
            moves = (0.0, sign * goes_m_s)
            judged = case(positions_m=at(0.0, sign * clear_m), speeds_m_s=moves)
            assert judged.teeth_are_out is are_out
            in_neutral = case(positions_m=at(0.0, sign * GUARD_NEUTRAL_M), speeds_m_s=moves)
            assert in_neutral.teeth_are_out
            beyond = case(positions_m=at(0.0, sign * (GUARD_NEUTRAL_M + 1e-9)), speeds_m_s=moves)
            assert beyond.teeth_are_out is are_out
    assert not case(positions_m=at(0.0), agreeing=4).teeth_are_out
    assert not case(positions_m=at(0.0), valid=False).teeth_are_out


def test_the_speeds_that_a_closing_clutch_meets() -> None:
    """By its own sensor alone where the splitter stands in no step."""
    a, b, c, _ = IN_GEAR.speeds
    assert a is not None and b is not None and c is not None
    own, main = a.omega_rad_s, c.omega_rad_s
    for splitter_m in (0.0, LIMITS.engaged_m, -LIMITS.engaged_m):
        assert case(positions_m=at(splitter_m=splitter_m)).input_speeds() == [own]
        none = (None, b, c, None)
        assert case(positions_m=at(splitter_m=splitter_m), speeds=none).input_speeds() == []
    for splitter_m, split in ((0.012, HIGH), (-0.012, LOW)):
        judged = case(positions_m=at(splitter_m=splitter_m))
        expected = [own, b.omega_rad_s / split, main / (SECOND * split)]
        assert judged.input_speeds() == pytest.approx(expected)
    assert Split.LOW is not Split.HIGH and LOW < HIGH


def test_row_14_exactly_at_its_limits() -> None:
    top = LIMITS.input_max_rad_s
    assert not engine_beyond_the_gear(case(speed(top), positions_m=at(0.0)))
    assert engine_beyond_the_gear(case(speed(top + 1e-9), positions_m=at(0.0)))
    main = IN_GEAR.speeds[2]
    assert main is not None
    low, high = LIMITS.slip_rad_s
    ratio = LIMITS.main[4].ratio
    for splitter_m, split in ((0.012, LIMITS.split_ratio[1]), (-0.012, LOW)):
        positions = at(splitter_m=splitter_m)
        least = (main.omega_rad_s + low) / (ratio * split)
        most = (main.omega_rad_s + high) / (ratio * split)
        for wanted, is_beyond in (
            (least, False), (least - 1e-9, True), (most, False), (most + 1e-9, True)
        ):  # fmt: skip
            judged = case(speed(wanted), positions_m=positions)
            assert engine_beyond_the_gear(judged) is is_beyond


def test_row_14_a_splitter_exactly_at_its_limit_stands_in_no_step() -> None:
    in_low = case(speed(MAIN_RPM * RPM / (SECOND * LOW)), positions_m=at(splitter_m=0.012))
    assert engine_beyond_the_gear(in_low)
    edge = LIMITS.engaged_m
    assert not engine_beyond_the_gear(
        in_low._replace(seen=in_low.seen._replace(positions_m=at(splitter_m=edge)))
    )


@pytest.mark.parametrize("now", [0.4, -0.4])
def test_row_14_torque_exactly_at_its_limits(now: float) -> None:
    least, most = min(now, 0.0) - NOISE, max(now, 0.0) + NOISE
    for share, is_beyond in (
        (least, False), (least - 1e-9, True), (most, False), (most + 1e-9, True)
    ):  # fmt: skip
        wish = EngineWish(TORQUE_CONTROL, 0.0, share)
        known = DrivelineState(own_share=(min(now, 0.0), max(now, 0.0)))
        judged = case(wish, engine_torque_share=0.1 * now)._replace(state=known)
        assert engine_beyond_the_gear(judged) is is_beyond
        assert engine_beyond_the_gear(case(wish, engine_torque_share=now))  # as no request began


def test_row_15_exactly_at_its_limit() -> None:
    """Shafts that give no edges stand."""
    still = (None, None, None, None)
    most = LIMITS.plate_slip_rad_s
    assert not closing_onto_slip(case(speeds=still, engine_rad_s=most))
    assert closing_onto_slip(case(speeds=still, engine_rad_s=most + 0.5))


@pytest.mark.parametrize(("credits_", "is_too_often"), [(1.0, False), (1.0 - 1e-9, True)])
def test_row_16_exactly_at_its_limit(credits_: float, is_too_often: bool) -> None:
    judged = case()._replace(state=DrivelineState(credits=credits_))
    assert closing_too_often(judged) is is_too_often


def test_nothing_is_earned_while_no_time_passes() -> None:
    guard = DrivelineGuard(LIMITS)
    for _ in range(LIMITS.closings):
        assert guard.passes_clutch(CLOSE, IN_GEAR)
        assert guard.passes_clutch(OPEN, IN_GEAR)
    assert kept_of_driveline(guard).credits == 0.0
    assert not guard.passes_clutch(CLOSE, IN_GEAR)


def test_a_clutch_is_closed_and_its_plates_apart_exactly_at_their_limits() -> None:
    guard = DrivelineGuard(LIMITS)
    assert guard.passes_clutch(CLOSE, IN_GEAR)
    assert guard.passes_clutch(CLOSE, IN_GEAR._replace(clutch_closed=CLUTCH_CLOSED_SHARE))
    assert kept_of_driveline(guard).is_closed
    pulls = IN_GEAR._replace(clutch_closed=1.0, engine_torque_share=0.4)
    assert guard.passes_engine(torque(0.0), pulls)
    assert kept_of_driveline(guard).torque_us == LIMITS.tick_us
    apart = pulls._replace(clutch_closed=LIMITS.clutch_open_share)
    assert guard.passes_engine(torque(0.0), apart)
    assert kept_of_driveline(guard).torque_us == 0
