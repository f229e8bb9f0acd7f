"""Intervals say what is known: shifts that repeat one another add nothing."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from meshpoint.testbench.campaign.intervals import Bootstrap, interval, quantile, rate_interval


@given(st.lists(st.booleans(), min_size=3, max_size=60), st.integers(1, 5))
def test_a_shift_told_twice_is_one_shift(outcomes: list[bool], times: int) -> None:
    runs = np.arange(len(outcomes))
    once = rate_interval(np.array(outcomes), runs)
    told = rate_interval(np.repeat(outcomes, times), np.repeat(runs, times))
    assert told == pytest.approx(once)


def test_the_interval_holds_the_true_rate_of_clustered_shifts() -> None:
    rng = np.random.Generator(np.random.PCG64(4))
    runs, each, true, held = 60, 4, 0.8, 0
    for _ in range(400):
        rates = rng.beta(8.0, 2.0, runs)  # gearboxes differ: mean 0.8
        hits = rng.random((runs, each)) < rates[:, None]
        low, high = rate_interval(hits.ravel(), np.repeat(np.arange(runs), each))
        held += low <= true <= high
    assert 0.92 <= held / 400 <= 0.98


def test_a_ratio_of_paired_strategies_keeps_the_pairing() -> None:
    rng = np.random.Generator(np.random.PCG64(5))
    runs = np.arange(50)
    slow = rng.uniform(400.0, 900.0, 50)
    bootstrap = Bootstrap(50)
    paired = interval(bootstrap.means(0.8 * slow, runs) / bootstrap.means(slow, runs))
    assert paired == [pytest.approx(0.8), pytest.approx(0.8)]


def test_a_quantile_is_one_of_the_values() -> None:
    values = np.arange(1.0, 101.0)
    assert quantile(values, 0.99) == 99.0
    assert quantile(values, 0.5) == 50.0
    resampled = Bootstrap(100).quantiles(values, np.arange(100), 0.5)
    assert set(resampled) <= set(values)
    assert abs(resampled.mean() - 50.0) < 2.0
