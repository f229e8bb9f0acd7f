"""When a campaign may stop: looks at fixed numbers of runs, an interval that allows for them.

The interval of a paired figure is made of the runs' own means, as runs are what is drawn (Student's
t over runs; Cochran 1977, ch. 9, for the ratio). Where one of two gap rates is integrated
(`estimate`), nearly all of the chance is in the other one, which misses seldom, in few of the runs:
that one has an interval of its own (`clustered_rate`), and both make the interval of difference or
ratio (MOVER; Donner and Zou 2012).

One that is looked at until it is narrow enough is too short by a little (Chow and Robbins 1965):
few looks, each at 1.19 times the runs of the one before, and none before `LEAST_RUNS`, keep its
coverage near what it says (`python -m benchmarks.studies campaign_statistics` measures it).
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from scipy.special import stdtrit

from meshpoint.campaigns.clustered_rate import NOMINAL, clustered_rate
from meshpoint.campaigns.columns import Shifts
from meshpoint.campaigns.intervals import Rate, rate_ratio_interval
from meshpoint.campaigns.spec import is_blind
from meshpoint.kernels.records import Vector

LEAST_RUNS: Final = 32
GROWTH: Final = 2.0**0.25
GAP: Final = "first_contact_gap"
FIGURES: Final = (GAP, "duration_ms", "impact_j")
KINDS: Final = ("difference", "ratio")
GOAL_FORM: Final = '"FIGURE KIND +-X", as "first_contact_gap difference +-1%"'


@dataclass(frozen=True)
class Goal:
    """An interval no wider than `half_width` to either side, of one strategy against another."""

    figure: str
    kind: str
    half_width: float

    def __str__(self) -> str:
        return f"{self.figure} {self.kind} +-{self.half_width:g}"


@dataclass(frozen=True)
class Estimate:
    """A figure of one strategy less, or over, that of another."""

    value: float
    low: float
    high: float
    runs: int

    @property
    def half_width(self) -> float:
        """Half of the interval's width."""
        return 0.5 * (self.high - self.low)

    def to_json(self) -> dict[str, Any]:
        """By name."""
        known = math.isfinite(self.half_width)
        return {
            "value": round(self.value, 6) if known else None,
            "ci95": [round(self.low, 6), round(self.high, 6)] if known else [None, None],
            "runs": self.runs,
        }


def unknown(runs: int) -> Estimate:
    """What so few runs tell."""
    return Estimate(math.nan, -math.inf, math.inf, runs)


def parse_goal(text: str) -> Goal:
    """`first_contact_gap difference +-1%`. ValueError names what is allowed."""
    found = re.fullmatch(r"\s*(\w+)\s+(\w+)\s+(?:\+-|±)\s*([0-9.]+)\s*(%?)\s*", text)
    if found is None:
        raise ValueError(f"{text!r}, allowed is {GOAL_FORM}")
    figure, kind, number, percent = found.groups()
    if figure not in FIGURES:
        raise ValueError(f"figure {figure!r}, allowed are {', '.join(FIGURES)}")
    if kind not in KINDS:
        raise ValueError(f"kind {kind!r}, allowed are {', '.join(KINDS)}")
    try:
        half_width = float(number) / (100.0 if percent else 1.0)
    except ValueError:
        raise ValueError(f"{number!r} is no number") from None
    if not 0.0 < half_width < math.inf:
        raise ValueError(f"+-{number}{percent}, allowed is more than 0")
    return Goal(figure, kind, half_width)


def looks(most_runs: int) -> Iterator[int]:
    """The numbers of runs at which it is looked, the last of them `most_runs`."""
    runs = float(LEAST_RUNS)
    while runs < most_runs:
        yield round(runs)
        runs *= GROWTH
    yield most_runs


def estimate(
    goal: Goal, shifts: Shifts, strategy: str, other: str, *, plain: bool = False
) -> Estimate:
    """The figure of `strategy` against `other` from the runs so far.

    A strategy that is blind to the phase meets it as it comes, evenly spread over the pitch: each
    contact then counts by the share of phases at which it would have been in a gap, which has the
    same mean and none of the chance. plain: it counts as it was."""
    seeds, run = np.unique(shifts.column("seed"), return_inverse=True)
    integrated = [goal.figure == GAP and not plain and is_blind(name) for name in (strategy, other)]
    sums = []
    for name, is_integrated in zip((strategy, other), integrated, strict=True):
        own = shifts.is_("strategy", name)
        values = _values(goal.figure, shifts.where(own), is_integrated=is_integrated)
        has = ~np.isnan(values)
        of = run[own][has]
        sums.append(np.bincount(of, values[has], minlength=seeds.size))
        sums.append(np.bincount(of, minlength=seeds.size).astype(np.float64))
    table = np.array(sums)
    table = table[:, (table[1] > 0) & (table[3] > 0)]
    if table.shape[1] < 2:
        return unknown(table.shape[1])
    if integrated == [False, True]:
        return against_known(goal.kind, *table)
    return paired_estimate(goal.kind, *table)


def against_known(kind: str, hits: Vector, n: Vector, known: Vector, known_n: Vector) -> Estimate:
    """Of `hits` in `n` shifts against an integrated rate, sums `known` over `known_n` shifts, one
    number a run."""
    runs, rate = hits.size, clustered_rate(hits, n)
    mean = float(known.sum() / known_n.sum())
    margin = _t_margin(runs) * math.sqrt(_variance(_parts(known, known_n)))
    if kind == "ratio":
        low, high = rate_ratio_interval(rate, Rate(mean, mean - margin, mean + margin))
        if low is None or high is None:
            return unknown(runs)
        return Estimate(rate.share / mean, low, high, runs)
    value = rate.share - mean
    below, above = rate.share - rate.low, rate.high - rate.share
    return Estimate(
        value, value - math.hypot(below, margin), value + math.hypot(above, margin), runs
    )


def paired_estimate(kind: str, a: Vector, a_n: Vector, b: Vector, b_n: Vector) -> Estimate:
    """Of sums `a` over `a_n` shifts and `b` over `b_n`, one number a run.

    Where no two runs differ, each strategy is given half a shift more that went the other way:
    an interval of width zero would say too much (Agresti and Min 2005)."""
    runs = a.size
    mean_a, mean_b = a.sum() / a_n.sum(), b.sum() / b_n.sum()
    part_a, part_b = _parts(a, a_n), _parts(b, b_n)
    if kind == "difference":
        value, parts = mean_a - mean_b, part_a - part_b
    elif mean_b == 0.0:
        return unknown(runs)
    else:
        value = mean_a / mean_b
        parts = (part_a - value * part_b) / mean_b
    least = 0.5 / runs**2 / (1.0 if kind == "difference" else mean_b**2)
    margin = _t_margin(runs) * math.sqrt(max(_variance(parts), least))
    return Estimate(float(value), value - margin, value + margin, runs)


def _parts(sums: Vector, n: Vector) -> Vector:
    """What each run adds to the mean's error. Its residual is taken from the whole's mean: runs of
    unequal length count by their shifts."""
    whole: float = n.sum()
    found: Vector = (sums - sums.sum() / whole * n) * sums.size / whole
    return found


def _variance(parts: Vector) -> float:
    """Of the mean, from what each run adds to its error."""
    return float(parts @ parts) / (parts.size - 1) / parts.size


def _t_margin(runs: int) -> float:
    return float(stdtrit(runs - 1, 0.5 + NOMINAL / 2.0))


def _values(figure: str, shifts: Shifts, *, is_integrated: bool) -> Vector:
    """What each shift counts; NaN where it has no such figure."""
    if figure != GAP:
        values: Vector = shifts.column(figure)
        return values
    hits: Vector = shifts.is_gap.astype(np.float64)
    if is_integrated:
        return np.where(shifts.is_("contact", None), hits, shifts.column("gap_share"))
    return hits
