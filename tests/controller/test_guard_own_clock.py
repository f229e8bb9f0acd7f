"""The guard's own clock exactly at its limits."""

from __future__ import annotations

import pytest

from meshpoint.controller.guard.own_clock import GuardClock, signed_us


def clock_at(offset_us: int = 0, seconds: int = 1) -> GuardClock:
    """Heard a frame each 10 ms since 0: the sensors' clock is the controller's, less this."""
    clock = GuardClock()
    for now_us in range(0, seconds * 1_000_000 + 1, 10_000):
        clock.hear(now_us - offset_us, now_us)
    return clock


def test_times_are_compared_the_shorter_way_round() -> None:
    half = 1 << 31
    assert [signed_us(x) for x in (0, 1, -1, half - 1, half, -half, 2 * half - 1)] == [
        0, 1, -1, half - 1, -half, -half, -1
    ]  # fmt: skip


@pytest.mark.parametrize(("back_us", "is_another"), [(20_000, False), (20_001, True)])
def test_a_stamp_20_ms_behind_the_newest_is_of_another_clock(
    back_us: int, is_another: bool
) -> None:
    clock = clock_at()
    clock.hear(1_000_000 - back_us, 1_000_000)
    assert clock.now_us(1_000_000) == (1_000_000 - back_us if is_another else 1_000_000)


@pytest.mark.parametrize(
    ("stamp", "now_us", "said_us"),
    [
        (1_500_000, 1_000_000, 1_500_000),  # ahead: what is heard least late is the clock
        (1_500_001, 1_000_000, 1_500_001),
        (1_100_000, 1_600_001, 1_600_001),  # late by more than 0.5 s, but it goes on
        (1_100_001, 1_600_002, 1_100_001),  # late by as much, and 100.001 ms on
        (1_100_001, 1_600_001, 1_600_001),  # by 0.5 s: late
    ],
)
def test_a_stamp_half_a_second_off_is_of_another_clock_unless_it_goes_on(
    stamp: int, now_us: int, said_us: int
) -> None:
    clock = clock_at()
    clock.hear(stamp, now_us)
    assert clock.now_us(now_us) == said_us


def test_a_stamp_far_ahead_clears_what_was_heard_before() -> None:
    clock = clock_at()
    clock.hear(1_500_001 + 10_000, 1_010_000)
    clock.hear(1_500_001 + 15_000, 1_020_000)  # later by 5 ms: nothing of before makes it less
    clock.hear(2_500_000 + 10_000, 2_010_000)
    assert clock.now_us(2_010_000) == 2_010_000 + 500_001


def test_each_seconds_least_is_kept_for_six_seconds_in_which_stamps_were_heard() -> None:
    clock = GuardClock()
    clock.hear(0, 0)
    for second in range(1, 6):
        for ms in (0, 990):
            now_us = second * 1_000_000 + 1_000 * ms
            clock.hear(now_us - 4_000 - 1_000 * (ms == 0), now_us)
    assert clock.now_us(5_999_999) == 5_999_999
    clock.hear(6_000_000 - 6_000, 6_000_000)  # the seventh second: the first is forgotten
    assert clock.now_us(6_000_000) == 6_000_000 - 4_000
    clock.restart()
    assert clock.now_us(6_000_000) is None
    clock.hear(6_010_000 - 9_000, 6_010_000)
    assert clock.now_us(6_010_000) == 6_010_000 - 9_000


@pytest.mark.parametrize(("less_us", "goes_on"), [(20_000, False), (20_001, True)])
def test_seconds_in_which_a_bus_catches_up_push_nothing_out(less_us: int, goes_on: bool) -> None:
    """What had waited comes less late from second to second: only the last of them is kept."""
    clock = clock_at(seconds=5)
    for second in range(6, 14):
        now_us = second * 1_000_000
        late_us = 450_000 - (second - 6) * less_us
        clock.hear(now_us - late_us, now_us)
    assert clock.now_us(13_000_000) == (13_000_000 if goes_on else 13_000_000 - late_us)
