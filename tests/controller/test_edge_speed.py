"""The speed of one edge frame: teeth over the time they took."""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from meshpoint.controller.measure.inputs import SPAN_US, STAMPS, UNEVEN, EdgeSpeed
from meshpoint.dbc.messages import EdgesLayshaftRise

TEETH = 40
NOW_US = 5_000_000


def frame(intervals_us: list[int], newest: int = 500) -> EdgesLayshaftRise:
    """Read at NOW_US; the newest edge just then, the intervals back from it."""
    stamps = [NOW_US & 0xFFFF]
    for interval_us in intervals_us:
        stamps.append((stamps[-1] - interval_us) & 0xFFFF)
    padded = stamps + [0] * (STAMPS - len(stamps))
    return EdgesLayshaftRise(NOW_US, newest, len(stamps), False, False, False, tuple(padded))


def speed_of(intervals_us: list[int]) -> float | None:
    shaft = EdgeSpeed(TEETH)
    shaft.take(frame(intervals_us), NOW_US)
    return shaft.at(NOW_US)


@given(st.integers(200, 30_000), st.integers(1, STAMPS - 1))
def test_it_is_the_newest_teeth_over_their_time(interval_us: int, intervals: int) -> None:
    omega_rad_s = speed_of([interval_us] * intervals)
    assert omega_rad_s == pytest.approx(2.0 * math.pi / TEETH / (interval_us * 1e-6))


@given(st.integers(200, 3_000), st.integers(0, 5), st.floats(1.05, 3.0))
def test_a_tooth_too_many_or_too_few_gives_none(interval_us: int, at: int, times: float) -> None:
    intervals = [interval_us] * 5
    intervals.insert(at, round(interval_us * times))
    shares = [b / a for a, b in itertools.pairwise(intervals)]
    even = all(1.0 / UNEVEN < share < UNEVEN for share in shares)
    if sum(intervals) <= SPAN_US:
        assert (speed_of(intervals) is not None) == even


@given(st.integers(300, 5_000), st.integers(SPAN_US, 60_000))
def test_a_sensor_that_was_silent_is_not_one_slow_tooth(interval_us: int, silent_us: int) -> None:
    assert speed_of([silent_us, interval_us, interval_us]) is None


def test_one_edge_is_no_speed() -> None:
    assert speed_of([]) is None
