"""Intervals say what is known: shifts that repeat one another add nothing."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.stats import beta

from meshpoint.campaigns.clustered_rate import clustered_rate
from meshpoint.campaigns.intervals import (
    RESAMPLES,
    SEED,
    Mean,
    Quantile,
    Rate,
    interval,
    quantile,
    rate_interval,
    rate_ratio_interval,
    resample,
)


@given(st.lists(st.booleans(), min_size=3, max_size=60), st.integers(1, 5))
def test_a_shift_reported_twice_is_one_shift(outcomes: list[bool], times: int) -> None:
    runs = np.arange(len(outcomes))
    once = rate_interval(np.array(outcomes), runs)
    reported = rate_interval(np.repeat(outcomes, times), np.repeat(runs, times))
    assert reported == pytest.approx(once)


def test_the_interval_holds_the_true_rate_of_clustered_shifts() -> None:
    rng = np.random.Generator(np.random.PCG64(4))
    runs, each, true, held = 60, 4, 0.8, 0
    for _ in range(400):
        rates = rng.beta(8.0, 2.0, runs)  # gearboxes differ: mean 0.8
        hits = rng.random((runs, each)) < rates[:, None]
        low, high = rate_interval(hits.ravel(), np.repeat(np.arange(runs), each))
        held += low <= true <= high
    assert 0.92 <= held / 400 <= 0.98


def test_the_interval_holds_a_rate_near_one_of_few_runs_that_differ_much() -> None:
    """Mean 0.99 in 100 runs, most misses in a few gearboxes: half of the runs of this test show one
    to three runs with a miss, which say little of how misses go together."""
    rng = np.random.Generator(np.random.PCG64(6))
    runs, each, true, held = 100, 8, 0.99, 0
    for _ in range(400):
        rates = rng.beta(0.99, 0.01, runs)  # intra-class correlation 0.5
        hits = rng.random((runs, each)) < rates[:, None]
        low, high = rate_interval(hits.ravel(), np.repeat(np.arange(runs), each))
        held += low <= true <= high
    assert held / 400 >= 0.94


def test_a_hundred_runs_do_not_say_that_a_rate_is_over_99_percent() -> None:
    """Not where none of 800 shifts has missed, and not where one has: how misses go together in a
    run is not seen then."""
    hits = np.ones(800, dtype=bool)
    runs = np.repeat(np.arange(100), 8)
    assert rate_interval(hits, runs)[0] == pytest.approx(0.963, abs=1e-3)  # as 100 of 100
    hits[5] = False
    assert 0.95 < rate_interval(hits, runs)[0] < 0.98


def test_a_rate_of_shifts_that_are_independent_has_the_interval_of_a_binomial_one() -> None:
    """One shift a run: nothing can go together. Jeffreys' interval of 490 of 500, by the beta
    distribution's quantiles."""
    found = clustered_rate(np.repeat([1.0, 0.0], [490, 10]), np.ones(500))
    assert found.share == 0.98
    assert (found.low, found.high) == pytest.approx(beta(490.5, 10.5).ppf((0.025, 0.975)), abs=2e-4)


def test_misses_of_few_gearboxes_tell_less_than_as_many_that_are_spread() -> None:
    shifts = np.full(100, 8.0)
    one, spread = shifts.copy(), shifts.copy()
    one[0], spread[:8] = 0.0, 7.0
    together, apart = clustered_rate(one, shifts), clustered_rate(spread, shifts)
    assert together.share == apart.share == 0.99
    assert together.high - together.low > 1.25 * (apart.high - apart.low)
    assert together.low < apart.low < 0.99 < apart.high < together.high


def test_a_rate_without_a_miss_ends_at_one_and_with_nothing_but_misses_at_none() -> None:
    shifts = np.full(60, 6.0)
    assert 0.98 < clustered_rate(shifts, shifts).low < 0.99
    assert clustered_rate(shifts, shifts).high == 1.0
    assert clustered_rate(0.0 * shifts, shifts).low == 0.0


def test_a_ratio_of_rates_near_one_is_as_wide_as_its_rates() -> None:
    """100 of 100 against 100 of 100: resampling would say 1.00 to 1.00."""
    low, high = rate_ratio_interval(Rate(1.0, 0.963, 1.0), Rate(1.0, 0.963, 1.0))
    assert (low, high) == (pytest.approx(0.963, abs=1e-3), pytest.approx(1.038, abs=1e-3))
    low, high = rate_ratio_interval(Rate(0.5, 0.4, 0.6), Rate(0.8, 0.8, 0.8))  # the other is known
    assert (low, high) == (pytest.approx(0.5), pytest.approx(0.75))
    assert rate_ratio_interval(Rate(0.5, 0.4, 0.6), Rate(0.1, 0.0, 0.3)) == [None, None]


def test_a_ratio_of_paired_strategies_keeps_the_pairing() -> None:
    rng = np.random.Generator(np.random.PCG64(5))
    runs = np.arange(50)
    slow = rng.uniform(400.0, 900.0, 50)
    fast, slower = resample(50, [Mean(0.8 * slow, runs, 50), Mean(slow, runs, 50)])
    paired = interval(fast / slower)
    assert paired == [pytest.approx(0.8), pytest.approx(0.8)]


def test_a_quantile_is_one_of_the_values() -> None:
    values = np.arange(1.0, 101.0)
    assert quantile(values, 0.99) == 99.0
    assert quantile(values, 0.5) == 50.0
    (resampled,) = resample(100, [Quantile(values, np.arange(100), 0.5, 100)])
    assert set(resampled) <= set(values)
    assert abs(resampled.mean() - 50.0) < 2.0


def test_resamples_that_are_not_kept_give_what_kept_ones_gave() -> None:
    """Means and a high quantile, looked for among the greatest values alone, beside the same ones
    of all resamples at once; a strategy has none of its values in some of them."""
    rng = np.random.Generator(np.random.PCG64(6))
    clusters = np.sort(rng.integers(0, 600, 1500))
    values = rng.normal(size=1500).round(1)  # many are equal
    few = rng.integers(0, 3, 5)
    mean, high, rare = resample(
        600,
        [
            Mean(values, clusters, 600),
            Quantile(values, clusters, 0.99, 600),
            Quantile(values[:5], few, 0.99, 600),
        ],
    )
    kept = np.random.Generator(np.random.PCG64(SEED)).multinomial(
        600, np.full(600, 1.0 / 600), RESAMPLES
    )
    each = kept[:, clusters]
    assert mean == pytest.approx((each @ values) / each.sum(axis=1), abs=1e-12)

    def quantiles(of: NDArray[np.float64], owners: NDArray[np.int64]) -> NDArray[np.float64]:
        order = np.argsort(of, kind="stable")
        heaped = np.cumsum(kept[:, owners[order]], axis=1)
        return of[order][np.argmax(heaped >= 0.99 * heaped[:, -1:] - 1e-9, axis=1)]

    assert np.array_equal(high, quantiles(values, clusters))
    assert np.array_equal(rare, quantiles(values[:5], few))


def test_how_a_figure_varies_among_gearboxes_is_not_known_of_few() -> None:
    """Two that agree to the last millisecond are no proof of anything."""
    runs = np.arange(4)
    (few,) = resample(4, [Mean(np.full(4, 619.0), runs, 4)])
    assert interval(few) == [None, None]
    runs = np.arange(5)
    (enough,) = resample(5, [Mean(np.full(5, 619.0), runs, 5)])
    assert interval(enough) == [619.0, 619.0]
