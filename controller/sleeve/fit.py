"""What the samples of a movement say: an iterated extended Kalman filter over a whole movement.

Unknown are what is learned of the sleeve (`law.PARAMETERS`), and how late each switch's spool is
beyond its valve's learned delay. Both have a prior; the law gives the places in between.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import numpy as np

from meshpoint.controller.sleeve.cylinder import DETENT, FEED, IN_GEAR, OFFSET, PARAMETERS
from meshpoint.controller.sleeve.law import Prior
from meshpoint.kernels.records import Vector

SAMPLE_SD_M: Final = 8e-5
"""Of a sample from the law: its noise, and what a law leaves out."""
INDEPENDENT: Final = 40
"""More samples than these weigh no more: what the law leaves out lasts longer than a sample."""
LARGEST_STEP_SDS: Final = 4.0
"""The law bends too much for a longer step."""
HALVINGS: Final = 4

Figures = Callable[[Vector], Vector]
"""From unknowns, one row each, to a figure of each row, or a row of figures."""


class Fitted(NamedTuple):
    """Unknowns (PARAMETERS + switches,) with covariance, and what is left of the samples (m)."""

    mean: Vector
    covariance: Vector
    left_m: Vector


def probes(count: int) -> Vector:
    """Steps for the slopes: of delays (s), logarithms, detents (kN), offset (mm)."""
    steps = np.full(count, 0.02)
    steps[:FEED] = 2e-4
    steps[DETENT] = steps[IN_GEAR] = 0.01
    steps[OFFSET] = 0.05
    steps[PARAMETERS:] = 2e-4
    return steps


def slopes(of: Figures, at: Vector, base: float | Vector, moved_by: Sequence[int]) -> Vector:
    """How each figure that `of` gives, here `base`, changes with each unknown: one column each.
    moved_by: those that it changes with at all."""
    steps = probes(len(at))
    tried = np.tile(at, (len(moved_by), 1))
    tried[range(len(moved_by)), moved_by] += steps[moved_by]
    rows = np.zeros((len(at), *np.shape(base)))
    rows[moved_by] = ((of(tried) - base).T / steps[moved_by]).T
    return rows.T


def fit(
    places: Figures,
    seen_m: Vector,
    prior: Prior,
    begin: Vector,
    iterations: int,
) -> Fitted:
    """The most likely unknowns, from `begin` on. places: the readings (m) that unknowns give."""
    noise = SAMPLE_SD_M**2 * max(1.0, len(seen_m) / INDEPENDENT)
    mean, covariance = prior
    inverse = np.linalg.inv(covariance)

    def cost(z: Vector, left: Vector) -> float:
        return float(left @ left) / noise + float((z - mean) @ inverse @ (z - mean))

    z, left = begin, seen_m - places(begin[np.newaxis])[0]
    now = cost(z, left)
    posterior: Vector = covariance
    for _ in range(iterations):
        slope = slopes(places, z, seen_m - left, range(len(z)))
        information = inverse + slope.T @ slope / noise
        posterior = np.asarray(np.linalg.inv(information), dtype=np.float64)
        step = posterior @ (slope.T @ left / noise - inverse @ (z - mean))
        step /= max(
            1.0, float(np.max(np.abs(step) / np.sqrt(np.diag(covariance)))) / LARGEST_STEP_SDS
        )
        for _ in range(HALVINGS):
            tried = z + step
            rest = seen_m - places(tried[np.newaxis])[0]
            then = cost(tried, rest)
            if then < now:
                z, left, now = tried, rest, then
                break
            step = 0.5 * step
        else:
            break
    return Fitted(z, posterior, left)
