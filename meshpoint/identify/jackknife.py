"""Intervals from leaving out one run, or group of runs, at a time."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from scipy.stats import chi2, t

from meshpoint.kernels.records import Vector

LEVEL: Final = 0.95


def jackknife_sd(without: Vector) -> Vector:
    """Standard deviation of an estimate from the estimates without each group, (groups, ...)."""
    groups = without.shape[0]
    spread = np.sum((without - without.mean(axis=0)) ** 2, axis=0)
    return np.asarray(np.sqrt((groups - 1) / groups * spread))


def student(freedom: float) -> float:
    """Half the 95 % interval in standard deviations that are known from this many degrees of
    freedom."""
    return float(t.ppf(0.5 + LEVEL / 2.0, max(freedom, 1.0)))


def scatter_interval(sd: float, freedom: float) -> tuple[float, float]:
    """The 95 % interval of a normal law's standard deviation."""
    outside = 0.5 * (1.0 - LEVEL)
    low = sd * math.sqrt(freedom / float(chi2.ppf(1.0 - outside, freedom)))
    high = sd * math.sqrt(freedom / float(chi2.ppf(outside, freedom)))
    return low, high
