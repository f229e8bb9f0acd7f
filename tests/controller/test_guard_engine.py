"""What row 14 makes of the engine's own trajectory and torque, exactly at its limits: how fast the
engine is taken to change its speed, and what of its torque may still be asked for."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import pytest
from guard_cases import kept_of_driveline
from test_guard_driveline import IN_GEAR, LIMITS, NOW, torque

from meshpoint.controller.guard.driveline import (
    TORQUE_NOISE,
    DrivelineCase,
    DrivelineGuard,
    DrivelineState,
    _turning_share,
)
from meshpoint.dbc.link import Transmitter
from meshpoint.dbc.messages import TSC1
from meshpoint.dbc.node import Node

TICK_US = LIMITS.tick_us
END = Transmitter(Node.TRANSMISSION_CONTROL).encode(TSC1()).data
PULLS = IN_GEAR._replace(clutch_closed=1.0)
SHARE = LIMITS.engine_share_s2


def turning(*measurements: tuple[int, float], clutch_closed: float = 1.0) -> tuple[float, float]:
    """Of these times and speeds."""
    seen = PULLS._replace(clutch_closed=clutch_closed)
    return _turning_share(DrivelineCase(seen, DrivelineState(engine=deque(measurements)), LIMITS))


def even(rise_rad_s: float, span_us: int, count: int = 6) -> list[tuple[int, float]]:
    """The first and the last of this many measurements are this far apart; what lies between is
    wild."""
    wild = [(NOW + 1 + k, 900.0 - 7.0 * k) for k in range(count - 2)]
    return [(NOW, 100.0), *wild, (NOW + span_us, 100.0 + rise_rad_s)]


@pytest.mark.parametrize("rise", [10.0, -10.0])
def test_the_engines_acceleration_is_taken_from_first_to_last_look(rise: float) -> None:
    """10 rad/s in 50 ms, with 3 rad/s2 of doubt, on the engine's inertia."""
    rate = rise / 0.05
    expected = (SHARE * (rate - 3.0), SHARE * (rate + 3.0))
    assert turning(*even(rise, 50_000)) == pytest.approx(expected)
    assert turning(*even(rise, 50_000, count=5)) == (0.0, 0.0)
    assert turning(*even(1.0, 0)) == pytest.approx((SHARE * (1e6 - 3.0), SHARE * (1e6 + 3.0)))


@pytest.mark.parametrize("tick_us", [5_000, 10_000, 20_000])
@pytest.mark.parametrize("end_us", [90_000, 115_000, 400_000])
def test_at_any_tick_it_is_that_of_the_last_reads(tick_us: int, end_us: int) -> None:
    """The engine says its speed each 10 ms. Red before: six steps of 5 ms are 25 ms, in which a
    speed that was said once may stand at either end, or at both."""
    limits = replace(LIMITS, tick_us=tick_us)
    guard = DrivelineGuard(limits)
    for now_us in range(0, end_us + 1, tick_us):
        said = 100.0 + 40.0 * 1e-6 * (now_us - now_us % 10_000)
        seen = PULLS._replace(now_us=NOW + now_us, engine_rad_s=said)
        guard.passes_engine(torque(0.0), seen)
    found = _turning_share(DrivelineCase(seen, kept_of_driveline(guard), limits))
    assert found == pytest.approx((SHARE * (40.0 - 3.0), SHARE * (40.0 + 3.0)))


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_an_acceleration_within_its_own_doubt_turns_nothing(sign: float) -> None:
    for rise, turns in ((3.0, False), (3.0 + 1e-6, True)):
        found = turning(*even(sign * rise, 1_000_000))
        assert (found != (0.0, 0.0)) is turns
    assert turning(*even(0.0, 50_000)) == (0.0, 0.0)


def test_plates_that_are_surely_apart_turn_nothing() -> None:
    edge, measurements = LIMITS.clutch_open_share, even(10.0, 50_000)
    assert turning(*measurements, clutch_closed=edge) == (0.0, 0.0)
    assert turning(*measurements, clutch_closed=edge + 1e-9) != (0.0, 0.0)


def looked(*steps: tuple[int, float | None]) -> list[tuple[int, float]]:
    """What the guard keeps of the engine's speeds, after steps at these times."""
    guard = DrivelineGuard(LIMITS)
    for after_us, speed in steps:
        guard.passes_engine(
            torque(0.0), IN_GEAR._replace(now_us=NOW + after_us, engine_rad_s=speed)
        )
    return [(time_us - NOW, speed) for time_us, speed in kept_of_driveline(guard).engine]


def test_six_measurements_are_kept_each_of_its_own_time() -> None:
    trajectory = [(TICK_US * k, 100.0 + k) for k in range(8)]
    assert looked(*trajectory) == trajectory[2:]
    assert looked(trajectory[0]) == trajectory[:1]
    assert (
        looked(*trajectory[:3], (2 * TICK_US, 999.0)) == trajectory[:3]
    )  # the same step once more
    assert looked((0, 1.0), (1, 2.0)) == [(0, 1.0), (1, 2.0)]


@pytest.mark.parametrize(
    ("pause_us", "goes_on"), [(2 * TICK_US, True), (2 * TICK_US + 1, False), (-1, False)]
)
def test_after_a_pause_the_engine_is_looked_at_anew(pause_us: int, goes_on: bool) -> None:
    found = looked((0, 1.0), (pause_us, 2.0))
    assert found == ([(0, 1.0)] if goes_on else []) + [(pause_us, 2.0)]


def test_without_a_speed_there_is_no_trajectory() -> None:
    assert looked((0, 1.0), (TICK_US, None)) == []
    assert looked((0, 1.0), (TICK_US, None), (2 * TICK_US, 3.0)) == [(2 * TICK_US, 3.0)]


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_up_to_the_engines_own_torque_some_may_be_given_back(sign: float) -> None:
    """While the request lasts: shafts that swing may need it. Never more than the engine gave."""
    guard = DrivelineGuard(LIMITS)
    for share, asked, passes in (
        (0.4, 0.4, True), (0.3, 0.0, True), (0.1, 0.4, True), (0.2, 0.43, False), (0.6, 0.43, False)
    ):  # fmt: skip
        seen = PULLS._replace(engine_torque_share=sign * share)
        assert guard.passes_engine(torque(sign * asked), seen) is passes


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_request_that_begins_anew_gives_back_no_more_than_was_left(sign: float) -> None:
    """However often it ends and begins: with what the signal's steps allow each time, it could
    come to any torque."""
    guard, given = DrivelineGuard(LIMITS), 0.2
    for _ in range(20):
        seen = PULLS._replace(engine_torque_share=sign * given)
        if guard.passes_engine(torque(sign * (given + 0.01)), seen):
            given += 0.01
        assert guard.passes_engine(END, seen)
    assert given < 0.2 + TORQUE_NOISE
    assert guard.passes_engine(torque(0.0), PULLS._replace(engine_torque_share=sign * 0.1))
    regained = PULLS._replace(engine_torque_share=sign * 0.2)
    assert not guard.passes_engine(torque(sign * 0.2), regained)


def test_a_torque_that_nobody_says_is_no_bound() -> None:
    """Red where what is asked for is measured by a torque that was said before."""
    guard, unknown = DrivelineGuard(LIMITS), PULLS._replace(engine_torque_share=None)
    assert not guard.passes_engine(torque(0.0), unknown)
    assert guard.passes_engine(torque(0.2), PULLS._replace(engine_torque_share=0.2))
    assert not guard.passes_engine(torque(0.0), unknown)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_new_shift_begins_with_the_engines_own_torque(sign: float) -> None:
    """All of it has been taken away; the plates part, and meet again."""
    guard, pulls = DrivelineGuard(LIMITS), PULLS._replace(engine_torque_share=0.4 * sign)
    assert guard.passes_engine(torque(0.0), PULLS._replace(engine_torque_share=0.0))
    assert not guard.passes_engine(torque(0.4 * sign), pulls)
    apart = pulls._replace(clutch_closed=LIMITS.clutch_open_share)
    guard.passes_engine(torque(0.0), apart._replace(valid=False))  # not seen to be
    assert not guard.passes_engine(torque(0.4 * sign), pulls)
    guard.passes_engine(torque(0.0), apart)
    assert guard.passes_engine(torque(0.4 * sign), pulls)
