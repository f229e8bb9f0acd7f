"""The clock of a live node, and how late its steps come."""

import math

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from meshpoint.bus.clock import Clock
from meshpoint.bus.statistics import Histogram

# On a busy machine any example may take long.
patient = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])


class Wall:
    def __init__(self) -> None:
        self.now_ns = 123_456_789

    def __call__(self) -> int:
        return self.now_ns


@given(st.lists(st.integers(0, 10**12)), st.floats(0.01, 100.0))
@patient
def test_a_clock_runs_speed_times_as_fast_as_the_wall(passes_ns: list[int], speed: float) -> None:
    wall = Wall()
    clock = Clock(speed, source_ns=wall)
    assert clock.now_us() == 0
    before_us = 0
    for pass_ns in passes_ns:
        wall.now_ns += pass_ns
        now_us = clock.now_us()
        assert type(now_us) is int
        assert now_us >= before_us
        before_us = now_us
    assert math.isclose(before_us, sum(passes_ns) * speed / 1000, rel_tol=1e-9, abs_tol=1.0)


def test_a_delay_is_in_wall_seconds_and_never_negative() -> None:
    wall = Wall()
    clock = Clock(4.0, source_ns=wall)
    assert clock.delay_s(2_000_000) == 0.5
    wall.now_ns += 400_000_000
    assert clock.delay_s(2_000_000) == pytest.approx(0.1)
    wall.now_ns += 400_000_000
    assert clock.delay_s(2_000_000) == 0.0


@pytest.mark.parametrize("speed", [0.0, -1.0, math.inf, math.nan])
def test_a_speed_that_is_none_is_refused(speed: float) -> None:
    with pytest.raises(ValueError, match="speed"):
        Clock(speed)


@given(st.lists(st.integers(0, 10**9), min_size=1), st.floats(0.01, 1.0))
@patient
def test_a_quantile_bounds_the_true_one_within_an_eighth(
    values: list[int], fraction: float
) -> None:
    histogram = Histogram()
    for value in values:
        histogram.add(value)
    true = sorted(values)[math.ceil(fraction * len(values)) - 1]
    assert true <= histogram.quantile(fraction) <= true * 1.125 + 1
    assert histogram.quantile(1.0) == histogram.maximum == max(values)


def test_a_histogram_without_values_says_zero() -> None:
    assert Histogram().quantile(0.99) == 0
