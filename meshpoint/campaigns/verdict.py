"""Whether a change has made shifts worse: pairs of the same draw, before and after.

A pair is worse (a gap before, none after), better (the other way round), missed by both, or hit by
both. The evidence is the logarithm of a ratio of likelihoods: the largest that the counts have
where the share of gaps has fallen by `margin` or more, over the largest that they have where it has
not. Both are taken over every rate of misses before and over every degree to which before and after
go together, from always to as if independent, because neither is known. Shifts of the baseline that
have no partner yet count as well: they tell how often it misses. Without a change, worse pairs are
then no more frequent than those misses, which says more than that they are as frequent as better
ones (McNemar 1947): with 3 % of the pairs worse and none better, five of them, 156 pairs at the
median, would be the least for an error of 5 %.

Shifts of one run share a gearbox: the evidence is divided by the design effect, that of `ICC` or
the one seen in the worse pairs, whichever is more. It is looked at after fixed numbers of runs, and
the evidence asked for rises with them. `python -m benchmarks.studies campaign_statistics` measures
how often the verdict is wrong, and after how many pairs it comes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.special import xlogy

WORSE_FROM: Final = 2.4
NOT_WORSE_FROM: Final = -3.5
"""Evidence from which a verdict is given at the first looks."""
RISE: Final = 0.3
FEW_CHANGED: Final = 16
"""Beyond this many pairs that are worse or better, each doubling asks for `RISE` more before shifts
are called worse: who has looked more often was more often deceived by chance."""
NO_MORE: Final = 0.4
"""More is asked for, too, where the pairs are the whole baseline, and in part where they are a part
of it: how often it misses is then known from the same shifts alone."""
LEAST_WORSE: Final = 3
"""This many more pairs are worse than better before the change is called worse."""
FIRST_RUNS: Final = 16
EVERY_RUNS: Final = 8
"""When the runs are compared: after this many, and then after every this many more."""
ICC: Final = 0.12
"""How much the misses of one run go together at least (docs/campaign.md)."""
LEAST_MISSES: Final = 0.005
"""A baseline without a miss is not one that never misses."""
MOST_MISSES: Final = 0.5
APART: Final = np.array([1.0, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2, 0.1, 0.05, 0.02, 0.0])
"""Shares of the baseline's misses that the change may hit: 1 where the two are independent."""


class Verdict(Enum):
    """What the pairs so far say."""

    WORSE = "worse"
    NOT_WORSE = "not worse"
    OPEN = "not decided"
    """More pairs are needed."""


class PairedRun(NamedTuple):
    """The pairs of one run."""

    seed: int
    worse: int
    better: int
    both: int
    """Missed before and after."""
    pairs: int


class Counts(NamedTuple):
    """Pairs so far, and the baseline's shifts without a partner yet."""

    pairs: int = 0
    worse: int = 0
    better: int = 0
    both: int = 0
    unpaired: int = 0
    unpaired_misses: int = 0


@dataclass
class Comparison:
    """The evidence so far; fed with the pairs of whole runs in order of their seeds.

    margin: by how much the share of gaps must fall to matter.
    shifts, misses: of the whole baseline, as far as it is there.
    """

    margin: float
    shifts: int = 0
    misses: int = 0
    runs: int = 0
    pairs: int = 0
    worse: int = 0
    better: int = 0
    both: int = 0
    worse_squares: int = 0
    """Sum over runs of the square of their worse pairs: how much these go together."""
    evidence: float = 0.0
    verdict: Verdict = Verdict.OPEN

    def take(self, run: PairedRun) -> None:
        """The pairs of one more run."""
        self.runs += 1
        self.pairs += run.pairs
        self.worse += run.worse
        self.better += run.better
        self.both += run.both
        self.worse_squares += run.worse**2

    def look(self) -> Verdict:
        """What all runs taken so far say."""
        if self.pairs == 0:
            return self.verdict
        found = evidence(self._counts(), self.margin) / self._design_effect()
        rise = RISE * math.log2(max(1.0, (self.worse + self.better) / FEW_CHANGED))
        rise += NO_MORE * min(1.0, self.pairs / max(1, self.shifts))
        enough_worse = self.worse - self.better >= LEAST_WORSE
        self.evidence = found
        if found >= WORSE_FROM + rise and enough_worse:
            self.verdict = Verdict.WORSE
        elif found <= NOT_WORSE_FROM:
            self.verdict = Verdict.NOT_WORSE
        else:
            self.verdict = Verdict.OPEN
        return self.verdict

    def to_json(self) -> dict[str, Any]:
        """By name."""
        return {
            "verdict": self.verdict.value,
            "runs": self.runs,
            "pairs": self.pairs,
            "worse": self.worse,
            "better": self.better,
            "missed_by_both": self.both,
            "misses_before": (self.better + self.both) / self.pairs if self.pairs else None,
            "misses_after": (self.worse + self.both) / self.pairs if self.pairs else None,
            "baseline": {"shifts": self.shifts, "misses": self.misses},
            "evidence": round(self.evidence, 6),
            "margin": self.margin,
        }

    def _counts(self) -> Counts:
        return Counts(
            self.pairs, self.worse, self.better, self.both,
            max(0, self.shifts - self.pairs), max(0, self.misses - self.better - self.both),
        )  # fmt: skip

    def _design_effect(self) -> float:
        seen = self.worse_squares / self.worse if self.worse else 1.0
        return max(seen, 1.0 + (self.pairs / self.runs - 1.0) * ICC)


def looks(most_runs: int) -> Iterator[int]:
    """The numbers of runs at which it is looked, the last of them `most_runs`."""
    yield from range(FIRST_RUNS, most_runs, EVERY_RUNS)
    yield most_runs


def evidence(counts: Counts, margin: float) -> float:
    """Of independent pairs, that the share of gaps has fallen by `margin` or more."""
    return _best(counts, margin) - _best(counts, 0.0)


def _best(counts: Counts, margin: float) -> float:
    """Logarithm of the largest likelihood where the share of gaps has fallen by `margin` or more;
    by nothing at all where that is 0.

    Counts are taken as Poisson's: with p the rate of misses before and a the share of them that
    the change may hit, pairs are better at the rate a p, worse at a p + fall, missed by both at
    (1 - a) p. For each a the best p has a closed form."""
    n, worse, before = counts.pairs, counts.worse, counts.better + counts.both
    before += counts.unpaired_misses
    weight = n * (1.0 + APART) + counts.unpaired
    if margin == 0.0:
        misses = (worse + before) / weight
    else:
        # d/dp of worse log(a p + margin) + before log p - weight p is 0
        linear = weight * margin - (worse + before) * APART
        root = np.sqrt(linear**2 + 4.0 * weight * APART * before * margin)
        misses = before / weight
        positive = APART > 0.0
        misses[positive] = (root - linear)[positive] / (2.0 * weight * APART)[positive]
    misses = np.clip(misses, LEAST_MISSES, MOST_MISSES)
    worse_rate = APART * misses + margin
    if margin > 0.0:
        # a fall by more than the margin, where the counts say so
        free = min(max(before / (n + counts.unpaired), LEAST_MISSES), MOST_MISSES)
        is_more = worse / n - APART * free >= margin
        misses = np.where(is_more, free, misses)
        worse_rate = np.where(is_more, worse / n, worse_rate)
    likelihood = (
        xlogy(worse, worse_rate) - n * worse_rate
        + xlogy(counts.better, APART * misses)
        + xlogy(counts.both, (1.0 - APART) * misses)
        + xlogy(counts.unpaired_misses, misses)
        - (n + counts.unpaired) * misses
    )  # fmt: skip
    return float(likelihood.max())
