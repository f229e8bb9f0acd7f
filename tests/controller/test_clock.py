"""Sensor time: 32 bits on the wire, integers that never wrap inside."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from meshpoint.controller.measure.clock import BACK_US, JUMP_US, WINDOW, SensorClockEstimate
from meshpoint.dbc.sensor_time import HALF, unwrap, wrap

TIMES = st.integers(-(1 << 40), 1 << 40)


@settings(deadline=None)
@given(time_us=TIMES, off=st.integers(-HALF, HALF - 1))
def test_a_time_within_36_minutes_of_where_it_should_be_is_found_again(
    time_us: int, off: int
) -> None:
    assert unwrap(wrap(time_us), time_us - off) == time_us


@settings(deadline=None)
@given(stamp=st.integers(0, (1 << 32) - 1), near=TIMES)
def test_unwrapping_keeps_the_stamp_and_goes_to_the_nearest(stamp: int, near: int) -> None:
    time_us = unwrap(stamp, near)
    assert wrap(time_us) == stamp
    assert abs(time_us - near) <= HALF


@settings(deadline=None, max_examples=30)
@given(
    start_us=st.integers(0, (1 << 32) - 1),
    delays=st.lists(st.integers(100, 30_000), min_size=1, max_size=60),
    repeat=st.integers(1, 40),
    ppm=st.integers(-200, 200),
)
def test_the_clock_runs_on_and_lags_by_the_least_delay_seen(
    start_us: int, delays: list[int], repeat: int, ppm: int
) -> None:
    """Against the plain minimum over the window, with frames early and late and a drift."""
    clock, offsets, last_us = SensorClockEstimate(), [], start_us
    for k, delay_us in enumerate(delays * repeat):
        elapsed_us = 40_000 + 1_400 * k
        sensor_us = start_us + elapsed_us + elapsed_us * ppm // 1_000_000
        now_us = elapsed_us + delay_us
        assert wrap(clock.stamp(wrap(sensor_us), now_us)) == wrap(sensor_us)
        offset = now_us - sensor_us
        offsets.append(offset)
        seen = clock.now_us(now_us)
        base = (now_us - min(offsets[-WINDOW:])) - seen
        assert base % (1 << 32) == 0
        last_us = sensor_us
    assert clock.jumps == 0
    assert wrap(clock.latest_us) == wrap(last_us)


def test_before_the_first_stamp_there_is_no_time() -> None:
    assert SensorClockEstimate().now_us(123_456) == 0


@settings(deadline=None)
@given(
    old_us=st.integers(0, (1 << 32) - 1),
    new_us=st.integers(0, (1 << 32) - 1),
    late_us=st.integers(0, 20_000),
)
def test_a_clock_that_started_anew_is_noticed(old_us: int, new_us: int, late_us: int) -> None:
    """A rig that was switched off and on counts from another value: never taken for a delay."""
    clock = SensorClockEstimate()
    for k in range(5):
        clock.stamp(wrap(old_us + 10_000 * k), 10_000 * k)
    jumped = clock.stamp(new_us, 50_000 + late_us)
    apart = (new_us - (old_us + 50_000 + late_us) + HALF) % (1 << 32) - HALF
    behind_newest_us = 40_000 - (apart + 50_000 + late_us)
    assert clock.jumps == (abs(apart) > JUMP_US or behind_newest_us > BACK_US)
    assert wrap(jumped) == new_us
    if clock.jumps:
        assert wrap(clock.now_us(50_000 + late_us)) == new_us


def on_time(clock: SensorClockEstimate, count: int = 50) -> int:
    """Reads every 10 ms, heard 1 ms later; the time of the last one."""
    for k in range(count):
        clock.stamp(10_000 * k, 10_000 * k + 1_000)
    return 10_000 * (count - 1)


def test_frames_that_waited_are_late_and_no_jump_of_the_clock() -> None:
    """An overloaded bus or machine: the stamps go on as they should, but come over 0.5 s later."""
    clock = SensorClockEstimate()
    last_us = on_time(clock)
    for k in range(1, 40):
        assert (
            clock.stamp(last_us + 10_000 * k, last_us + 10_000 * k + 700_000)
            == last_us + 10_000 * k
        )
    assert (clock.jumps, clock.late) == (0, 1)
    assert clock.now_us(last_us + 2_000_000) == last_us + 1_999_000, "it is not set by late frames"
    on_again_us = last_us + 1_000_000
    for k in range(5):
        clock.stamp(on_again_us + 10_000 * k, on_again_us + 10_000 * k + 1_000)
    clock.stamp(on_again_us + 50_000, on_again_us + 700_000)
    assert (clock.jumps, clock.late) == (0, 2)


def test_a_stamp_of_a_clock_that_was_set_back_a_little_is_not_late() -> None:
    """Where the counter shows it: the offset is learned anew, and the unwrapping goes on."""
    clock, ahead_us, now_us = SensorClockEstimate(), (1 << 32) - 50_000, 0
    for now_us in range(0, 100_000, 10_000):
        clock.stamp(wrap(now_us - 3_000 + ahead_us), now_us)
    before_us, now_us = clock.now_us(now_us), now_us + 10_000
    set_back_us = now_us - 3_000 + ahead_us - 25_000
    assert clock.set_back(wrap(set_back_us), now_us) == set_back_us
    assert clock.jumps == 1
    assert clock.latest_us == clock.now_us(now_us) == set_back_us < before_us


BEGIN_US, NOW_US = 1_000_000, 50_000_000


@pytest.mark.parametrize(
    ("on_us", "waited_us", "jumps", "late"),
    [
        # Ahead of the clock by no more than half a second.
        (500_000, 0, 0, 0), (500_001, 0, 1, 0),
        # Behind the newest stamp by no more than a fifth of one.
        (-200_000, 0, 0, 0), (-200_001, 0, 1, 0),
        # A stamp that follows the newest, ten lost frames on at most, has waited, however long.
        (0, 500_000, 0, 0), (0, 500_001, 0, 1), (100_000, 700_000, 0, 1), (100_001, 700_000, 1, 0),
        (-200_000, 400_000, 0, 1), (-200_001, 400_000, 1, 0),
    ],
)  # fmt: skip
def test_a_stamp_is_in_time_or_late_or_of_another_clock(
    on_us: int, waited_us: int, jumps: int, late: int
) -> None:
    clock = SensorClockEstimate()
    clock.stamp(BEGIN_US, NOW_US)
    assert clock.stamp(BEGIN_US + on_us, NOW_US + waited_us) == BEGIN_US + on_us
    assert (clock.jumps, clock.late) == (jumps, late)
    newest_us = BEGIN_US + on_us if jumps else BEGIN_US + max(0, on_us)
    assert clock.latest_us == newest_us


def test_a_restart_forgets_the_offset_and_takes_the_next_stamp_as_it_is() -> None:
    clock = SensorClockEstimate()
    clock.stamp(BEGIN_US, NOW_US)
    clock.restart()
    assert (clock.jumps, clock.now_us(NOW_US)) == (1, 0)
    assert clock.stamp(30, NOW_US + 5) == clock.now_us(NOW_US + 5) == 30
    assert clock.jumps == 1
