"""Jobs of study `campaign_statistics`: campaigns whose records are drawn, not made, and what
`--until` and `--against` say of them.

Every run has a gearbox with a rate of misses of its own, from a beta distribution whose spread
gives the intra-class correlation asked for.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaincinv

from meshpoint.campaigns.sequential import (
    Estimate,
    against_known,
    looks,
    paired_estimate,
    parse_goal,
    unknown,
)
from meshpoint.campaigns.verdict import Comparison, PairedRun, Verdict
from meshpoint.campaigns.verdict import looks as paired_looks
from meshpoint.kernels.records import Vector

Misses = NDArray[np.bool_]
QUANTILES: Final = np.concatenate(
    [np.linspace(0.0, 0.9, 1000, endpoint=False), 1.0 - np.geomspace(0.1, 1e-7, 3000)]
)


class Kind(StrEnum):
    """How the shifts after a change go together with those before."""

    BREAKS = "breaks alone"
    """Some gaps are missed, in runs of their own; nothing else is otherwise."""
    HALF = "half together"
    """The gearboxes that missed miss more often; half of the shifts keep their chance."""
    SAME_GEARBOXES = "same gearboxes"
    """The gearboxes that missed miss more often; the shifts are independent of those before."""
    INDEPENDENT = "independent"
    """Other gearboxes, other shifts."""


@cache
def _gearboxes(rate: float, icc: float) -> Vector:
    spread = (1.0 - icc) / icc
    quantiles: Vector = betaincinv(rate * spread, (1.0 - rate) * spread, QUANTILES)
    return quantiles


def gearbox_misses(rate: float, icc: float, luck: Vector) -> Vector:
    """Rates of misses of gearboxes with this quantile of the distribution."""
    return np.interp(luck, QUANTILES, _gearboxes(rate, icc))


def draw_change(
    rng: np.random.Generator, kind: Kind, misses: tuple[float, float], icc: float,
    size: tuple[int, int],
) -> tuple[Misses, Misses]:  # fmt: skip
    """Misses before and after, by run and shift; `misses`: their rates."""
    before, after = misses
    luck = rng.random((size[0], 1))
    chance = rng.random(size)
    missed = chance < gearbox_misses(before, icc, luck)
    if kind is Kind.BREAKS:
        if after <= before:
            return missed, missed
        broken = gearbox_misses((after - before) / (1.0 - before), icc, rng.random((size[0], 1)))
        return missed, missed | (rng.random(size) < broken)
    again = rng.random(size)
    if kind is Kind.INDEPENDENT:
        luck = rng.random((size[0], 1))
    elif kind is Kind.HALF:
        again = np.where(rng.random(size) < 0.5, chance, again)
    return missed, again < gearbox_misses(after, icc, luck)


def judge(missed: Misses, now: Misses, margin: float, baseline_runs: int | None) -> Comparison:
    """What `--against` says; `baseline_runs` None: the baseline is made along with the change."""
    counts = np.stack(
        [missed.size // len(missed) * np.ones(len(missed), np.int64),
         (now & ~missed).sum(1), (missed & ~now).sum(1), (missed & now).sum(1)]
    ).T.tolist()  # fmt: skip
    comparison = Comparison(margin)
    if baseline_runs is not None:
        whole = missed[:baseline_runs]
        comparison.shifts, comparison.misses = whole.size, int(whole.sum())
    taken = 0
    for runs in paired_looks(len(missed)):
        for seed in range(taken, runs):
            pairs, worse, better, both = counts[seed]
            comparison.take(PairedRun(seed, worse, better, both, pairs))
        taken = runs
        if baseline_runs is None:
            comparison.shifts = comparison.pairs
            comparison.misses = comparison.better + comparison.both
        if comparison.look() is not Verdict.OPEN:
            break
    return comparison


class Verdicts(NamedTuple):
    """Of simulated changes of one kind."""

    worse: float
    not_worse: float
    """Shares of all; the rest is not decided."""
    pairs: tuple[int, ...]
    """Made until the campaign ended, in ascending order."""
    worse_after: tuple[int, ...]
    """Those of the campaigns that ended with `worse`."""

    @property
    def median(self) -> float:
        """Pairs."""
        return float(np.median(self.pairs))


@dataclass(frozen=True)
class VerdictRun:
    """Simulated changes of one kind, each judged by `--against`."""

    kind: Kind
    misses: tuple[float, float]
    icc: float
    shifts: int
    margin: float
    runs: int
    has_baseline: bool
    """Of as many runs, made before; else the baseline is a commit, which runs along."""
    changes: int
    seed: int

    def run(self) -> Verdicts:
        """The verdicts."""
        rng = np.random.default_rng([self.seed, list(Kind).index(self.kind)])
        found = []
        for _ in range(self.changes):
            drawn = draw_change(rng, self.kind, self.misses, self.icc, (self.runs, self.shifts))
            comparison = judge(*drawn, self.margin, self.runs if self.has_baseline else None)
            found.append((comparison.verdict, comparison.pairs))
        shares = [sum(v is each for v, _ in found) / len(found) for each in Verdict]
        worse_after = tuple(sorted(n for v, n in found if v is Verdict.WORSE))
        return Verdicts(shares[0], shares[1], tuple(sorted(n for _, n in found)), worse_after)


class Coverage(NamedTuple):
    """Of simulated campaigns with one goal."""

    held: float
    """Share of the intervals that held the truth."""
    median_runs: float


@dataclass(frozen=True)
class CoverageRun:
    """Simulated campaigns of two strategies, each stopped by `--until`."""

    goal: str
    hits: tuple[float, float]
    """Rates of first contacts in a gap."""
    icc: float
    shifts: int
    runs: int
    campaigns: int
    seed: int
    is_integrated: bool = False
    """The gap rate of the second is integrated over the phase: a number of each gearbox."""

    def run(self) -> Coverage:
        """How often the interval held."""
        goal, (a, b) = parse_goal(self.goal), self.hits
        rng = np.random.default_rng([self.seed, round(1e6 * a), round(1e6 * b)])
        truth = a - b if goal.kind == "difference" else a / b
        found = [self._stopped(rng) for _ in range(self.campaigns)]
        held = sum(one.low <= truth <= one.high for one in found) / len(found)
        return Coverage(held, float(np.median([one.runs for one in found])))

    def _stopped(self, rng: np.random.Generator) -> Estimate:
        goal = parse_goal(self.goal)
        own, other = self.hits
        hits = self._hits(rng, own)
        others = self._shares(rng, other) if self.is_integrated else self._hits(rng, other)
        n = np.full(self.runs, float(self.shifts))
        estimate = against_known if self.is_integrated else paired_estimate
        found = unknown(0)
        for runs in looks(self.runs):
            found = estimate(goal.kind, hits[:runs], n[:runs], others[:runs], n[:runs])
            if found.half_width <= goal.half_width:
                break
        return found

    def _hits(self, rng: np.random.Generator, rate: float) -> Vector:
        spread = (1.0 - self.icc) / self.icc
        of_run = rng.beta(rate * spread, (1.0 - rate) * spread, self.runs)
        drawn: Any = rng.binomial(self.shifts, of_run)
        return np.asarray(drawn, dtype=np.float64)

    def _shares(self, rng: np.random.Generator, rate: float) -> Vector:
        """Gearboxes differ by a tenth of their mean in how much of a pitch is gap."""
        return self.shifts * rate * rng.uniform(0.9, 1.1, self.runs)
