"""Figures of a model: what is known of each, and how a shift's edges teach more of it.

A figure is a value and its deviation. A filter whose model is right has innovations e of variance
s, independent of each other: the probability of what it has seen falls with sum(e^2 / s + log s).
What is known of each figure from earlier shifts is its prior, a normal law of the figure's
logarithm. Each figure in turn goes to the minimum of the parabola through three runs of the filter;
the parabola's curvature gives the standard deviation.
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
SCAN_SD: Final = 0.12
"""A figure known better than this, by the standard deviation of its logarithm, is not scanned
for."""
SCAN_STEP: Final = 0.12
"""Distance of two values that a scan tries, in the logarithm: 12 %."""
MOST_SCANNED: Final = 17
"""A scan has no more steps than this over a figure's range: they are longer instead."""
REFINED: Final = 3
"""After a scan, this often values more closely around the best one are tried."""
TRIED_A_STEP: Final = 3
"""How many values of a grid a step of a search tries: as many as a parabola takes."""


class Estimate(NamedTuple):
    """A value and its standard deviation, in the unit that the name of the field says."""

    value: float
    sd: float


@dataclass(frozen=True)
class Figure:
    """A positive quantity that is learned: the mean and standard deviation of its logarithm, its
    range, and how little and how much may be known of it."""

    log: float
    sd: float
    least_log: float
    most_log: float
    prior_sd: float
    """Before anything was learned."""
    least_sd: float
    """It is never known better than this: a few shifts do not tell what the next will be like."""

    @property
    def value(self) -> float:
        """The quantity itself."""
        return math.exp(self.log)

    def after(self, log: float, sd: float) -> Figure:
        """What is known after a measurement of its logarithm with this standard deviation."""
        gain = self.sd**2 / (self.sd**2 + sd**2)
        after = self.log + gain * (log - self.log)
        after_sd = max(self.sd * math.sqrt(1.0 - gain), self.least_sd)
        return replace(self, log=self._within(after), sd=after_sd)

    def restored(self, value: float, sd: float) -> Figure:
        """As an earlier run learned it; within its range, and no surer than it may be."""
        log, sd = self._within(math.log(value)), min(max(sd, self.least_sd), self.prior_sd)
        return replace(self, log=log, sd=sd)

    def _within(self, log: float) -> float:
        return min(max(log, self.least_log), self.most_log)


def prior(typical: float, factor: float, range_: tuple[float, float], least_sd: float) -> Figure:
    """A quantity that lies within `factor` of a typical one, one standard deviation, and always in
    its range."""
    sd = math.log(factor)
    return Figure(math.log(typical), sd, math.log(range_[0]), math.log(range_[1]), sd, least_sd)


class Found(NamedTuple):
    """Figures, and their deviance to what they were learned from."""

    figures: list[Figure]
    deviance: float


def learn(known: Sequence[Figure], deviance: Deviance, scanned: Sequence[int] = ()) -> Found:
    """The figures after one more shift, and their deviance: `Search`, all of it at once."""
    search = Search(known, deviance, scanned)
    while not search.is_over:
        search.step()
    return search.found


class Search:
    """The figures after one more shift, looked for a little at each `step`."""

    def __init__(
        self,
        known: Sequence[Figure],
        deviance: Deviance,
        scanned: Sequence[int] = (),
        held: Sequence[int] = (),
    ) -> None:
        """`scanned`: those whose deviance may have several minima; while they are not well known
        their whole ranges are looked at first. `held`: those that stay as they are known."""
        self._known = list(known)
        self._grown = [
            replace(one, sd=min(one.prior_sd, one.sd * math.sqrt(GROWTH))) for one in known
        ]
        self._of = deviance
        self._at, self._least = [one.log for one in self._grown], math.nan
        self._sds = [one.sd for one in self._grown]
        self._scanned = [k for k in scanned if self._grown[k].sd > SCAN_SD]
        self._spacings = [_spacing(known[k])[1] for k in self._scanned]
        self._grid = list(itertools.product(*[_grid(known[k]) for k in self._scanned]))
        self._rounds = REFINED if self._scanned else 0
        self._held = frozenset(held)
        self._turns = [k for k in range(len(known)) if k not in self._held] * SWEEPS
        self._begun = False

    @property
    def is_over(self) -> bool:
        """Whether `found` has the figures."""
        return self._begun and not (self._scanned or self._turns)

    @property
    def found(self) -> Found:
        """The figures so far; what was known where not even that has a finite deviance."""
        if not math.isfinite(self._least):
            return Found(self._known, self._least)
        figures = [
            replace(one, log=log, sd=max(sd, one.least_sd))
            for one, log, sd in zip(self._grown, self._at, self._sds, strict=True)
        ]
        for k in self._held:
            figures[k] = self._known[k]
        return Found(figures, self._least)

    def step(self) -> None:
        """Some values of a scan, or one figure's parabola."""
        if not self._begun:
            self._begun, self._least = True, self._deviance(self._at)
        if self._scanned:
            self._scan()
        elif not math.isfinite(self._least):
            self._turns.clear()
        elif self._turns:
            self._move(self._turns.pop(0))

    def _deviance(self, logs: Sequence[float]) -> float:
        """With what was known before."""
        off = math.fsum(
            ((log - one.log) / one.sd) ** 2 for log, one in zip(logs, self._grown, strict=True)
        )
        found = self._of(logs) + off
        return found if math.isfinite(found) else math.inf

    def _scan(self) -> None:
        """The next values of the grid; after the last one a closer grid, or the end of the scan."""
        for tried in self._grid[:TRIED_A_STEP]:
            logs = list(self._at)
            for k, log in zip(self._scanned, tried, strict=True):
                logs[k] = log
            found = self._deviance(logs)
            if found < self._least:
                self._at, self._least = logs, found
        del self._grid[:TRIED_A_STEP]
        if self._grid:
            return
        if self._rounds == 0:
            self._scanned = []
            return
        # Two figures may make up for each other, which steps of one at a time would not find.
        self._rounds -= 1
        self._spacings = [spacing / 3.0 for spacing in self._spacings]
        self._grid = list(
            itertools.product(
                *[
                    [self._at[k] + i * spacing for i in (-2, -1, 0, 1, 2)]
                    for k, spacing in zip(self._scanned, self._spacings, strict=True)
                ]
            )
        )

    def _move(self, k: int) -> None:
        """The k-th figure to the minimum of the parabola through two probes and where it is."""
        one, at, least = self._grown[k], self._at, self._least
        reach = max(REACH * one.sd, LEAST_REACH)
        low, high = _with(at, k, at[k] - reach), _with(at, k, at[k] + reach)
        below, above = self._deviance(low), self._deviance(high)
        curvature = (below - 2.0 * least + above) / (reach * reach)
        self._sds[k] = one.sd
        if not math.isfinite(curvature):
            return
        # A probe may lie beyond the figure's range: it gives the slope there, and is never taken.
        inside = [probe for probe in ((low, below), (high, above))
                  if one.least_log <= probe[0][k] <= one.most_log]  # fmt: skip
        self._at, self._least = min(((at, least), *inside), key=lambda tried: tried[1])
        if curvature <= 0.0:
            return
        self._sds[k] = min(one.sd, math.sqrt(2.0 / curvature))
        step = -(above - below) / (2.0 * reach) / curvature
        step = min(max(step, -MOST_STEP * reach), MOST_STEP * reach)
        tried = _with(at, k, min(max(at[k] + step, one.least_log), one.most_log))
        now = self._deviance(tried)
        if now < self._least:
            self._at, self._least = tried, now


def _spacing(one: Figure) -> tuple[int, float]:
    """How many steps a figure's range is looked at in, and how long one is."""
    span = one.most_log - one.least_log
    count = min(MOST_SCANNED, math.ceil(span / SCAN_STEP))
    return count, span / count


def _grid(one: Figure) -> list[float]:
    count, step = _spacing(one)
    return [one.least_log + i * step for i in range(count + 1)]


def _with(at: list[float], k: int, log: float) -> list[float]:
    return [*at[:k], log, *at[k + 1 :]]
