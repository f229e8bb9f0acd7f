"""Whether shifts take longer, or hit harder, after a change: sums of the same pairs, run by run.

The figure is the ratio of both sums, its interval Student's over runs (Cochran 1977, ch. 6), of
99.5 %: it is looked at again and again. Worse: the interval lies above 1, and the ratio beyond half
of the margin. Not worse: it lies below 1 + margin. Shifts of a change that lies between may be
called either, as with the share of gaps.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.special import stdtrit

from meshpoint.campaigns.verdict import FIRST_RUNS, Verdict

LEVEL: Final = 0.995
"""Of the interval at each interim analysis: with analyses as `verdict.looks` has them, less than 3
% of changes that change nothing are called worse (`tests/campaign/test_paired_ratio.py`)."""


class PairedRatio(NamedTuple):
    """A figure after a change over what it was before, of the same pairs."""

    value: float
    low: float
    high: float
    margin: float
    """By how much, as a share, it must have risen to be worse."""
    runs: int

    @property
    def verdict(self) -> Verdict:
        """What it says."""
        if self.runs < FIRST_RUNS:
            return Verdict.OPEN
        if self.low > 1.0 and self.value > 1.0 + 0.5 * self.margin:
            return Verdict.WORSE
        return Verdict.NOT_WORSE if self.high < 1.0 + self.margin else Verdict.OPEN

    def to_json(self) -> dict[str, Any]:
        """By name."""
        known = math.isfinite(self.value) and math.isfinite(self.high)
        return {
            "verdict": self.verdict.value,
            "ratio": round(self.value, 6) if known else None,
            "interval": [round(self.low, 6), round(self.high, 6)] if known else [None, None],
            "level": LEVEL,
            "margin": self.margin,
            "runs": self.runs,
        }


def paired_ratio(sums: Sequence[tuple[float, float]], margin: float) -> PairedRatio:
    """Of the sums before and after of each run's pairs. Where there was nothing before and is
    nothing after, the ratio is 1."""
    before, after = np.array(sums, np.float64).reshape(-1, 2).T
    runs, whole = before.size, float(before.sum())
    if whole == 0.0 or runs < 2:
        alike = whole == 0.0 and not after.any()
        value = 1.0 if alike else math.inf
        return PairedRatio(value, value, value, margin, runs)
    value = float(after.sum()) / whole
    residual = after - value * before
    error = math.sqrt(runs / (runs - 1) * float(residual @ residual)) / whole
    half = float(stdtrit(runs - 1, 0.5 + 0.5 * LEVEL)) * error
    return PairedRatio(value, value - half, value + half, margin, runs)
