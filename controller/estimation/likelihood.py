"""Figures of a model learned by their likelihood, from one shift's edges at a time.

A filter whose model is right has innovations e of variance s, independent of each other: the
probability of what it has seen falls with sum(e^2 / s + log s). What is known of each figure from
earlier shifts is its prior, a normal law of the figure's logarithm. Each figure in turn goes to the
minimum of the parabola through three runs of the filter; the parabola's curvature gives the
standard deviation.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

Deviance = Callable[[Sequence[float]], float]
"""Sum of squared innovations over their variances and of their logarithms, with these figures'
logarithms."""

REACH: Final = 0.5
"""Distance of the probes from the present value, in standard deviations."""
LEAST_REACH: Final = 0.01
"""Least distance of the probes, in the logarithm, so that the difference is one of the model and
not of digits."""
MOST_STEP: Final = 2.0
"""Longest step to a minimum, in distances of the probes."""
SWEEPS: Final = 2
GROWTH: Final = 1.1
"""Variances grow by this from shift to shift: temperatures, loads and roads change."""


@dataclass(frozen=True)
class Learned:
    """A positive figure: the mean and standard deviation of its logarithm, and of that what was
    known before anything was learned."""

    log: float
    sd: float
    least_log: float
    most_log: float
    prior_sd: float
    least_sd: float
    """It is never known better than this: a few shifts do not tell what the next will be like."""

    @property
    def value(self) -> float:
        """The figure itself."""
        return math.exp(self.log)


def prior(typical: float, factor: float, range_: tuple[float, float], least_sd: float) -> Learned:
    """A figure that lies within `factor` of a typical one, one standard deviation, and always in
    its range."""
    sd = math.log(factor)
    return Learned(math.log(typical), sd, math.log(range_[0]), math.log(range_[1]), sd, least_sd)


class Found(NamedTuple):
    """Figures, and their deviance to what they were learned from."""

    figures: list[Learned]
    deviance: float


def restored(known: Learned, value: float, sd: float) -> Learned:
    """A figure as an earlier run learned it; within its range, and no surer than it may be."""
    log = min(max(math.log(value), known.least_log), known.most_log)
    return replace(known, log=log, sd=min(max(sd, known.least_sd), known.prior_sd))


def learn(known: Sequence[Learned], deviance: Deviance, scanned: Sequence[int] = ()) -> Found:
    """The figures after one more shift, and their deviance. `scanned`: those whose deviance may
    have several minima; while they are not well known their whole ranges are looked at first."""
    grown = [replace(one, sd=min(one.prior_sd, one.sd * math.sqrt(GROWTH))) for one in known]
    at = [one.log for one in grown]
    sds = [one.sd for one in grown]

    def total(logs: Sequence[float]) -> float:
        off = sum(((log - one.log) / one.sd) ** 2 for log, one in zip(logs, grown, strict=True))
        found = deviance(logs) + off
        return found if math.isfinite(found) else math.inf

    least = total(at)
    at, least = _scan(at, least, [k for k in scanned if grown[k].sd > SCAN_SD], grown, total)
    if not math.isfinite(least):
        return Found(list(known), least)
    for _ in range(SWEEPS):
        for k, one in enumerate(grown):
            at, least, sds[k] = _step(at, least, k, one, total)
    found = [
        replace(one, log=log, sd=max(sd, one.least_sd))
        for one, log, sd in zip(grown, at, sds, strict=True)
    ]
    return Found(found, least)


SCAN_SD: Final = 0.12
"""A figure known better than this, by the standard deviation of its logarithm, is not scanned
for."""
SCAN_STEP: Final = 0.12
"""Distance of two values that a scan tries, in the logarithm: 12 %."""
MOST_SCANNED: Final = 17
"""A scan has no more steps than this over a figure's range: they are longer instead."""
REFINED: Final = 3
"""After a scan, this often values more closely around the best one are tried."""


def _scan(
    at: list[float], least: float, scanned: list[int], known: Sequence[Learned], total: Deviance
) -> tuple[list[float], float]:
    """The best on a grid of the figures that are not known well yet."""
    grids = [_grid(known[k]) for k in scanned]
    steps = [_spacing(known[k])[1] for k in scanned]
    for _ in range(1 + REFINED):
        for tried in itertools.product(*grids):
            logs = list(at)
            for k, log in zip(scanned, tried, strict=True):
                logs[k] = log
            found = total(logs)
            if found < least:
                at, least = logs, found
        # Two figures may make up for each other, which steps of one at a time would not find.
        steps = [step / 3.0 for step in steps]
        grids = [
            [at[k] + i * step for i in (-2, -1, 0, 1, 2)]
            for k, step in zip(scanned, steps, strict=True)
        ]
    return at, least


def _spacing(one: Learned) -> tuple[int, float]:
    """How many steps a figure's range is looked at in, and how long one is."""
    span = one.most_log - one.least_log
    count = min(MOST_SCANNED, math.ceil(span / SCAN_STEP))
    return count, span / count


def _grid(one: Learned) -> list[float]:
    count, step = _spacing(one)
    return [one.least_log + i * step for i in range(count + 1)]


def _step(
    at: list[float], least: float, k: int, one: Learned, total: Deviance
) -> tuple[list[float], float, float]:
    """The k-th figure to the minimum of the parabola: the figures, their deviance, and the k-th
    one's standard deviation."""
    reach = max(REACH * one.sd, LEAST_REACH)
    low, high = _with(at, k, at[k] - reach), _with(at, k, at[k] + reach)
    below, above = total(low), total(high)
    curvature = (below - 2.0 * least + above) / (reach * reach)
    if not math.isfinite(curvature):
        return at, least, one.sd
    # A probe may lie beyond the figure's range: it gives the slope there, and is never taken.
    inside = [probe for probe in ((low, below), (high, above))
              if one.least_log <= probe[0][k] <= one.most_log]  # fmt: skip
    best, found = min(((at, least), *inside), key=lambda tried: tried[1])
    if curvature <= 0.0:
        return best, found, one.sd
    step = -(above - below) / (2.0 * reach) / curvature
    step = min(max(step, -MOST_STEP * reach), MOST_STEP * reach)
    tried = _with(at, k, min(max(at[k] + step, one.least_log), one.most_log))
    now = total(tried)
    if now < found:
        best, found = tried, now
    return best, found, min(one.sd, math.sqrt(2.0 / curvature))


def _with(at: list[float], k: int, log: float) -> list[float]:
    return [*at[:k], log, *at[k + 1 :]]
