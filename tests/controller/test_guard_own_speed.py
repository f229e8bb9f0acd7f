"""The guard's own speeds exactly at their limits."""

from __future__ import annotations

import math

import pytest

from meshpoint.controller.guard.listening import (
    Edges,
)
from meshpoint.controller.guard.own_speed import GuardSpeed, ShaftSpeed, TeethCounted, teeth_us

TEETH = 40
PITCH = 2.0 * math.pi / TEETH


def lows(newest_us: int, *took_us: int) -> tuple[int, ...]:
    times = [newest_us]
    for each in took_us:
        times.append(times[-1] - each)
    return tuple(time & 0xFFFF for time in times)


def test_teeth_are_taken_for_15_ms() -> None:
    assert teeth_us(lows(99_000, *[5_000] * 9)) == [5_000] * 3
    assert teeth_us(lows(99_000, *[4_999] * 9)) == [4_999] * 4
    assert teeth_us(lows(99_000, 20_000, 20_000)) == [20_000]
    assert teeth_us(lows(99_000, 14_999, 14_999)) == [14_999] * 2
    assert teeth_us(lows(99_000, 4_000)) == [4_000]
    assert teeth_us(lows(3_000, 4_000, 4_000)) == [4_000, 4_000]  # over the wrap of 16 bits


@pytest.mark.parametrize(
    ("took_us", "is_alike"),
    [((1_000, 1_699), True), ((1_000, 1_700), False), ((1_700, 1_001), True),
     ((1_700, 1_000), False), ((1_000, 1_600, 900), False), ((1_000, 0), False), ((0,), False),
     ((1_000, 1_699, 2_800), True)],
)  # fmt: skip
def test_neighbouring_teeth_do_not_differ_by_more_than_a_factor(
    took_us: tuple[int, ...], is_alike: bool
) -> None:
    assert teeth_us(lows(50_000, *took_us)) == (list(took_us) if is_alike else [])


@pytest.mark.parametrize("silent_us", [15_000, 16_100, 44_000, 51_000, 63_000])
def test_a_sensor_that_was_silent_is_not_one_slow_tooth(silent_us: int) -> None:
    """The first edge behind a silence is young, and the gap before it as long as a whole span."""
    assert teeth_us(lows(90_000, silent_us, 2_100, 2_100)) == []
    shaft = GuardSpeed(TEETH)
    shaft.take(Edges(30_000, 20, lows(29_900, *[2_100] * 6)))
    newest_us = 29_900 + silent_us
    back = Edges(newest_us + 100, 21, lows(newest_us, silent_us, *[2_100] * 5))
    shaft.take(back)
    speed = shaft.at(newest_us + 100)
    assert speed is None or speed.omega_rad_s == pytest.approx(PITCH / 2.1e-3)
    assert (speed is None) is (silent_us > 45_000)


def test_a_speed_is_the_mean_over_its_teeth_in_the_middle_of_their_time() -> None:
    shaft, now_us = GuardSpeed(TEETH), (5 << 32) + 70_000
    assert shaft.at(now_us) is None
    assert shaft.counted is None
    shaft.take(Edges(now_us - 500, 7, lows(now_us - 900, *[4_000] * 6)))
    found = shaft.at(now_us)
    assert found == ShaftSpeed(now_us - 900 - 8_000, pytest.approx(PITCH / 4e-3))
    assert shaft.counted == TeethCounted(now_us - 900, 7)


def test_teeth_are_counted_on_and_never_by_a_stamp_that_only_looks_young() -> None:
    shaft = GuardSpeed(TEETH)
    shaft.take(Edges(10_000, 65_534, lows(9_000, 4_000, 4_000)))
    shaft.take(Edges(20_000, 3, lows(19_000, 4_000, 4_000)))
    assert shaft.counted == TeethCounted(19_000, 65_534 + 5)
    shaft.take(Edges(90_000, 3, lows(19_000, 4_000, 4_000)))  # 19 ms + 65.5 ms = 84.5 ms
    assert shaft.counted == TeethCounted(19_000, 65_534 + 5)
    assert shaft.at(90_000) is None
    shaft.take(Edges(91_000, 4, lows(90_500, 4_000, 4_000)))
    assert shaft.counted == TeethCounted(90_500, 65_534 + 6)
    assert shaft.at(91_000) is not None


def test_two_edges_are_a_speed() -> None:
    shaft = GuardSpeed(TEETH)
    shaft.take(Edges(10_000, 5, lows(9_000, 4_000)))
    assert shaft.at(10_000) == ShaftSpeed(7_000, pytest.approx(PITCH / 4e-3))


def test_a_tooth_is_as_old_as_it_was_when_its_sensor_was_read() -> None:
    """Read 3 ms ago, and 19.5 ms after its last edge."""
    shaft = GuardSpeed(TEETH)
    shaft.take(Edges(92_000, 5, lows(72_500, *[4_000] * 6)))
    assert shaft.at(95_000) is not None


@pytest.mark.parametrize(
    ("rad_s", "held", "is_counted"),
    [(5.0, 27, True), (4.999, 27, False), (None, 27, False), (100.0, 26, False)],
)
def test_teeth_count_while_a_wheel_turns_and_its_array_is_full(
    rad_s: float | None, held: int, is_counted: bool
) -> None:
    shaft = GuardSpeed(TEETH)
    shaft.take(Edges(60_000, 5, lows(59_000, *[2_000] * (held - 1))))
    speed = None if rad_s is None else ShaftSpeed(59_000, rad_s)
    assert shaft.turned(speed) == (TeethCounted(59_000, 5) if is_counted else None)


@pytest.mark.parametrize("count", [0, 1])
def test_fewer_than_two_edges_are_no_speed(count: int) -> None:
    shaft = GuardSpeed(TEETH)
    shaft.take(Edges(10_000, 5, lows(9_000, 4_000, 4_000)))
    shaft.take(Edges(20_000, 5, lows(9_000)[:count]))
    assert shaft.at(20_000) is None


@pytest.mark.parametrize(
    ("tooth_us", "silent_us", "is_dead"),
    [(4_000, 20_000, False), (4_000, 20_001, True), (8_000, 24_000, False), (8_000, 24_001, True)],
)
def test_a_sensor_is_dead_after_20_ms_or_three_teeth(
    tooth_us: int, silent_us: int, is_dead: bool
) -> None:
    shaft = GuardSpeed(TEETH)
    shaft.take(Edges(30_000, 5, lows(30_000, *[tooth_us] * 6)))
    now_us = 30_000 + silent_us
    shaft.take(Edges(now_us, 5, lows(30_000, *[tooth_us] * 6)))
    assert (shaft.at(now_us) is None) is is_dead


@pytest.mark.parametrize(
    ("tooth_us", "silent_us", "is_lost"),
    [(4_000, 25_000, False), (4_000, 25_001, True), (9_000, 27_000, False), (9_000, 27_001, True)],
)
def test_a_shaft_without_frames_is_lost_after_25_ms_or_three_teeth(
    tooth_us: int, silent_us: int, is_lost: bool
) -> None:
    shaft = GuardSpeed(TEETH)
    shaft.take(Edges(30_000, 5, lows(30_000, *[tooth_us] * 6)))
    assert (shaft.at(30_000 + silent_us) is None) is is_lost


@pytest.mark.parametrize(
    ("tooth_us", "held_us", "is_lost"),
    [(4_000, 45_000, False), (4_000, 45_001, True), (20_000, 60_000, False),
     (20_000, 60_001, True)],
)  # fmt: skip
def test_an_earlier_speed_stands_in_for_teeth_that_are_unlike(
    tooth_us: int, held_us: int, is_lost: bool
) -> None:
    shaft = GuardSpeed(TEETH)
    shaft.take(Edges(30_000, 5, lows(30_000, *[tooth_us] * 3)))
    before = shaft.at(30_000)
    for now_us in (45_000, 30_000 + held_us):
        shaft.take(Edges(now_us, now_us // 1_000, lows(now_us, 1_000, 9_000)))
    assert before is not None
    assert shaft.at(30_000 + held_us) == (None if is_lost else before)
