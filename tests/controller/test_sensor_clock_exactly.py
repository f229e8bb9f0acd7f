"""The sensor's clock stamp by stamp: what is late, what has jumped, and what the offset is."""

from __future__ import annotations

import pytest

from meshpoint.controller.sensing.sensor_clock import (
    WINDOW,
    SensorClockEstimate,
    unwrap,
    wrap,
)

WRAP = 1 << 32


def running(stamp: int = 1_000_000, now_us: int = 50_000_000) -> SensorClockEstimate:
    """One frame was read at this time of the sensor, and seen at this one of the controller."""
    clock = SensorClockEstimate()
    assert clock.stamp(stamp, now_us) == stamp
    return clock


BEGIN, NOW = 1_000_000, 50_000_000


def state(clock: SensorClockEstimate) -> tuple[int, int]:
    return clock.jumps, clock.late


@pytest.mark.parametrize(
    ("stamp", "near", "time_us"),
    [(5, WRAP + 7, WRAP + 5), (WRAP - 1, WRAP, WRAP - 1), ((1 << 31) - 1, 0, (1 << 31) - 1),
     (1 << 31, 0, -(1 << 31)), (3, 3 * WRAP - 4, 3 * WRAP + 3)],
)  # fmt: skip
def test_a_stamp_is_the_time_nearest_to_where_it_is_looked_for(
    stamp: int, near: int, time_us: int
) -> None:
    assert unwrap(stamp, near) == time_us
    assert wrap(time_us) == stamp


def test_before_a_stamp_there_is_no_sensor_time_and_behind_it_time_runs_on() -> None:
    assert SensorClockEstimate().now_us(77) == 0
    assert SensorClockEstimate().latest_us == 0
    clock = running()
    assert clock.now_us(NOW + 5) == BEGIN + 5
    assert clock.latest_us == BEGIN
    assert state(clock) == (0, 0)


def test_the_least_delay_of_the_newest_4000_stamps_is_the_offset() -> None:
    """A quick one counts till it is the four-thousand-and-first."""
    assert WINDOW == 4000
    clock = running()
    clock.stamp(BEGIN + 1_000, NOW + 700)
    assert clock.now_us(NOW + 700) == BEGIN + 1_000
    for k in range(1, 4_000):
        clock.stamp(BEGIN + 1_000 + 1_000 * k, NOW + 1_000 + 1_000 * k + k % 2)
        assert clock.now_us(NOW) == BEGIN + 300
    clock.stamp(BEGIN + 4_001_000, NOW + 4_001_000 + 40)
    assert clock.now_us(NOW) == BEGIN
    assert state(clock) == (0, 0)


def test_of_equal_least_delays_the_newest_is_kept_longest() -> None:
    clock = running()
    for k in range(1, 4_001):
        clock.stamp(BEGIN + 1_000 * k, NOW + 1_000 * k + (0 if k == 2_000 else 9))
    assert clock.now_us(NOW) == BEGIN
    for k in range(4_001, 6_000):
        clock.stamp(BEGIN + 1_000 * k, NOW + 1_000 * k + 9)
        assert clock.now_us(NOW) == BEGIN
    clock.stamp(BEGIN + 6_000_000, NOW + 6_000_009)
    assert clock.now_us(NOW) == BEGIN - 9


def test_frames_of_one_read_may_come_in_any_order() -> None:
    clock = running()
    clock.stamp(BEGIN + 10_000, NOW + 10_000)
    assert clock.stamp(BEGIN + 9_000, NOW + 10_000) == BEGIN + 9_000
    assert clock.latest_us == BEGIN + 10_000


@pytest.mark.parametrize(("ahead_us", "jumps"), [(500_000, 0), (500_001, 1)])
def test_a_stamp_half_a_second_ahead_is_of_another_clock(ahead_us: int, jumps: int) -> None:
    clock = running()
    time_us = clock.stamp(BEGIN + ahead_us, NOW)
    assert state(clock) == (jumps, 0)
    assert time_us == clock.latest_us == BEGIN + ahead_us
    assert clock.now_us(NOW) == BEGIN + ahead_us


@pytest.mark.parametrize(("behind_us", "jumps"), [(200_000, 0), (200_001, 1)])
def test_a_stamp_a_fifth_of_a_second_behind_the_newest_is_of_another_clock(
    behind_us: int, jumps: int
) -> None:
    clock = running()
    time_us = clock.stamp(BEGIN - behind_us, NOW)
    assert time_us == BEGIN - behind_us
    assert state(clock) == (jumps, 0)
    assert clock.latest_us == (BEGIN if jumps == 0 else BEGIN - behind_us)
    assert clock.now_us(NOW) == (BEGIN if jumps == 0 else BEGIN - behind_us)


@pytest.mark.parametrize(
    ("on_us", "waited_us", "came_late"),
    [(100_000, 700_000, True), (100_001, 700_000, False), (0, 500_001, True),
     (-200_000, 400_000, True), (-200_001, 400_000, False), (0, 500_000, False)],
)  # fmt: skip
def test_a_stamp_that_follows_the_newest_has_waited_however_late_it_comes(
    on_us: int, waited_us: int, came_late: bool
) -> None:
    """Ten lost frames on, or a fifth of a second back: more than half a second late it is late and
    no other clock's."""
    clock = running()
    assert clock.stamp(BEGIN + on_us, NOW + waited_us) == BEGIN + on_us
    jumped = not came_late and waited_us != 500_000
    assert state(clock) == (int(jumped), int(came_late))


def test_late_stamps_count_once_till_one_is_on_time() -> None:
    """On time: less than a twentieth of a second behind the clock."""
    clock = running()
    for k in range(1, 4):
        clock.stamp(BEGIN + 1_000 * k, NOW + 600_000 + 1_000 * k)
    assert state(clock) == (0, 1)
    clock.stamp(BEGIN + 90_000, NOW + 140_000)
    clock.stamp(BEGIN + 91_000, NOW + 700_000)
    assert state(clock) == (0, 1)
    clock.stamp(BEGIN + 92_000, NOW + 141_999)
    clock.stamp(BEGIN + 93_000, NOW + 800_000)
    assert state(clock) == (0, 2)


def test_a_restart_forgets_the_offset_and_takes_the_next_stamp_as_it_is() -> None:
    clock = running()
    clock.restart()
    assert state(clock) == (1, 0)
    assert clock.now_us(NOW) == 0
    assert clock.stamp(30, NOW + 5) == 30
    assert clock.now_us(NOW + 5) == 30
    assert state(clock) == (1, 0)


def test_a_clock_that_was_set_back_a_little_goes_on_from_there() -> None:
    clock = running(WRAP - 10)
    clock.stamp(10, NOW + 20)
    assert clock.latest_us == WRAP + 10
    assert clock.set_back(WRAP - 3, NOW + 40) == WRAP - 3
    assert clock.latest_us == WRAP - 3
    assert clock.now_us(NOW + 40) == WRAP - 3
    assert state(clock) == (1, 0)


def test_a_clock_that_has_jumped_is_unwrapped_near_the_newest_stamp() -> None:
    clock = running(WRAP - 1_000)
    assert clock.stamp(2_000_000, NOW + 1_000) == WRAP + 2_000_000
    assert state(clock) == (1, 0)
