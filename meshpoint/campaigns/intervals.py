"""95 % intervals for shifts that come in clusters: those of one run share a gearbox.

Rates: Wilson's interval (1927) on the effective number of shifts, n over the design effect of the
clusters (Rao and Scott 1992): it says something at 0 and at 1 too, where resampling says nothing.
Few runs with a miss say little of how misses go together: the design effect is between the one seen
and the worst, a whole run like its first shift, by how many such runs there are.
Means, quantiles and ratios: percentile bootstrap over whole runs, with the same resamples for the
strategies compared, so that a ratio keeps the pairing (Efron and Tibshirani 1993, ch. 8). A ratio
of rates of which one has few misses is taken from the intervals of both (Donner and Zou
2012).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any, Final, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from meshpoint.kernels.records import Integers, Vector
from meshpoint.results.wilson import wilson

FEW_RUNS: Final = 5
"""This many runs before resampling shows how a figure varies among runs; of a rate, this many with
a miss and with a hit. Two runs that agree would have an interval of no width."""
RESAMPLES: Final = 1000
SEED: Final = 0xB007
AT_ONCE: Final = 250_000
Weights = NDArray[np.uint8]
"""How often each run is in a resample: a line a resample, a column a run."""
Interval = tuple[float, float]


class Rate(NamedTuple):
    """A share of shifts and the ends of its interval."""

    share: float
    low: float
    high: float


def rate_interval(hits: NDArray[np.bool_], clusters: Integers) -> Interval:
    """Interval of a share of shifts; `clusters` numbers the run of each shift from 0."""
    n = hits.size
    if n == 0:
        return 0.0, 1.0
    effective = n / design_effect(hits, clusters)
    return wilson(float(hits.mean()) * effective, effective)


def design_effect(hits: NDArray[np.bool_], clusters: Integers) -> float:
    """Variance of the rate over what independent shifts would have; never taken below 1. Of k runs
    that show how they differ, the worst counts 1 / (1 + k)."""
    n, rate = hits.size, float(hits.mean())
    count = int(clusters.max()) + 1
    worst = n / count
    if rate in (0.0, 1.0):
        return worst
    if count == 1:
        return 1.0
    residual = np.bincount(clusters, hits - rate, minlength=count)
    variance = count / (count - 1) * float(residual @ residual) / n**2
    seen = max(1.0, variance * n / (rate * (1.0 - rate)))
    doubt = 1.0 / (1.0 + telling_runs(hits, clusters))
    return max(seen, doubt * worst + (1.0 - doubt) * seen)


def telling_runs(hits: NDArray[np.bool_], clusters: Integers) -> int:
    """How many runs have a miss, or have a hit, whichever are fewer."""
    return min(np.unique(clusters[~hits]).size, np.unique(clusters[hits]).size)


def rate_ratio_interval(of: Rate, to: Rate) -> list[float | None]:
    """Interval of a ratio of two rates from the intervals of both (MOVER), as if they were
    independent: too wide rather than too narrow for shifts on the same draws. None at a rate that
    may be zero."""
    (a, a_low, a_high), (b, b_low, b_high) = of, to
    if b_low <= 0.0:
        return [None, None]
    middle = a * b

    def end(a_end: float, b_end: float, side: float) -> float:
        product = a_end * b_end * (2.0 * a - a_end) * (2.0 * b - b_end)
        root = math.sqrt(max(0.0, middle * middle - product))
        return (middle + side * root) / (b_end * (2.0 * b - b_end))

    return [finite(end(a_low, b_high, -1.0)), finite(end(a_high, b_low, 1.0))]


class Resampled(Protocol):
    """A figure of which resamples are wanted."""

    def of(self, weights: Weights) -> Vector:
        """Its value in each of some resamples."""


class Mean:
    """The mean of some values; `clusters` numbers the run of each from 0."""

    def __init__(self, values: Vector, clusters: Integers, runs: int) -> None:
        self._sums = np.bincount(clusters, values, minlength=runs)
        self._counts = np.bincount(clusters, minlength=runs).astype(np.float64)

    def of(self, weights: Weights) -> Vector:
        """In each resample; NaN in one that has no value."""
        often = weights.astype(np.float64)
        with np.errstate(invalid="ignore", divide="ignore"):
            found: Vector = (often @ self._sums) / (often @ self._counts)
        return found


class Quantile:
    """The least value that `share` of some values do not exceed; `clusters` numbers the run of
    each from 0."""

    def __init__(self, values: Vector, clusters: Integers, share: float, runs: int) -> None:
        order = np.argsort(values, kind="stable")[::-1]
        self._share, self._falling, self._owners = share, values[order], clusters[order]
        self._counts = np.bincount(clusters, minlength=runs).astype(np.float64)

    def of(self, weights: Weights) -> Vector:
        """In each resample."""
        # A high quantile lies among the greatest: twice as many as there should be above it nearly
        # always hold it.
        most = self._falling.size
        first = min(most, math.ceil(2.0 * (1.0 - self._share) * most) + 64)
        above = self._above(weights, first)
        beyond = above == first
        if first < most and beyond.any():
            above[beyond] = self._above(weights[beyond], most)
        found: Vector = self._falling[np.minimum(above, most - 1)]
        return found

    def _above(self, weights: Weights, first: int) -> Integers:
        """How many of the `first` greatest values lie above the quantile."""
        found: list[Integers] = []
        for rows in _parts(first, weights.shape[0]):
            some = weights[rows]
            total = (some.astype(np.float64) @ self._counts)[:, None]
            heaped = np.cumsum(some[:, self._owners[:first]], axis=1, dtype=np.int32)
            found.append(np.sum(total - heaped >= self._share * total - 1e-9, axis=1))
        return np.concatenate(found)


def resample(runs: int, figures: Sequence[Resampled]) -> list[Vector]:
    """Each figure in each resample of whole runs: the same resamples for all of them. NaN where
    there are fewer than `FEW_RUNS`.

    The resamples are drawn once, a few at a time, and none is kept."""
    if runs < FEW_RUNS:
        return [np.full(RESAMPLES, np.nan) for _ in figures]
    rng = np.random.Generator(np.random.PCG64(SEED))
    share = np.full(runs, 1.0 / runs)
    found = [np.empty(RESAMPLES) for _ in figures]
    for rows in _parts(runs, RESAMPLES):
        # How often a run is in a resample is a dozen at most: a byte each, not eight.
        weights = rng.multinomial(runs, share, rows.stop - rows.start).astype(np.uint8)
        for values, figure in zip(found, figures, strict=True):
            values[rows] = figure.of(weights)
    return found


def _parts(width: int, many: int) -> Iterator[slice]:
    """This many rows of this width, a few at a time, so that they take little memory."""
    rows = max(1, AT_ONCE // max(1, width))
    for start in range(0, many, rows):
        yield slice(start, min(start + rows, many))


def quantile(values: Vector, share: float) -> float:
    """The least value that `share` of the values do not exceed."""
    ordered = np.sort(values)
    return float(ordered[max(0, int(np.ceil(share * ordered.size - 1e-9)) - 1)])


def interval(resampled: Vector) -> list[float | None]:
    """Its 2.5 and 97.5 per cent; None where a resample has no such figure."""
    if not resampled.size or np.isnan(resampled).any():
        return [None, None]
    low, high = np.quantile(resampled, (0.025, 0.975), method="nearest")
    return [finite(float(low)), finite(float(high))]


def finite(value: Any) -> float | None:
    """A number as it can stand in JSON."""
    return round(float(value), 6) if np.isfinite(value) else None
