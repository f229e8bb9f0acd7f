"""A cloud of particles resampled around those that explain the edges.

Each is drawn as often as its weight says, and what does not move by itself is spread a little, so
that copies of one driveline part. The spread is Liu and West's (2001): shrunk towards the mean, it
leaves mean and covariance as they were, and what was found of two quantities together - a wide
backlash with a late flank, a fast vehicle with fast wheels - stays together. Mean and covariance
are those of the drivelines at the same flank or between them: over all of these at once they would
be of drivelines that move by different laws.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from meshpoint.controller.models.backlash import (
    HALF,
    HILL,
    LOSS,
    STIFF,
    TYRE,
    TYRE_STIFF,
    VEHICLE,
    WAY,
    WHEELS,
)
from meshpoint.kernels.records import Integers, Vector

KERNEL: Final = 0.4
"""Spread of each driveline, in standard deviations of those in the same contact; Liu and West's h.
Theirs is 0.1 to 0.3, for one draw in a step of data; here more, as the road shakes the wheels."""
SHRUNK: Final = math.sqrt(1.0 - KERNEL**2)
SPREAD: Final = (WAY, WHEELS, TYRE, VEHICLE, HILL)
"""What is spread; of what follows the logarithms."""
SHARES: Final = (STIFF, LOSS, HALF, TYRE_STIFF)
LEAST_APART: Final = 1e-6
"""Added to a correlation of 1 in square: so few drivelines may stand for a contact that some of
their quantities depend on the others."""
LEAST_SD: Final = 1e-140
"""Of a smaller one the square has too few digits for a correlation."""
FLANKS: Final = 3
"""Contacts: at the flank of coast, between, at the flank of drive."""


def drawn(weights: Vector, count: int) -> Integers:
    """This many indices, each as often as its weight says, by one row of even steps."""
    places = (np.arange(count) + 0.5) / count
    return np.minimum(np.searchsorted(np.cumsum(weights), places), weights.size - 1)


def resampled(x: Vector, weights: Vector, numbers: Vector) -> Vector:
    """Drivelines (ROWS, n) resampled by their weights (n,) and spread by independent numbers of a
    standard normal law (9, n)."""
    chosen = drawn(weights, x.shape[1])
    # By rows in memory as before: of columns numba would make every kernel once more.
    found = np.take(x, chosen, axis=1)
    before, contact = _quantities(x), _contacts(x)
    after = np.take(before, chosen, axis=1)
    for flank in range(FLANKS):
        there, taken = contact == flank, contact[chosen] == flank
        if taken.any():
            mean, root = _mean_and_root(before[:, there], weights[there])
            off = after[:, taken] - mean
            after[:, taken] = mean + SHRUNK * off + KERNEL * (root @ numbers[:, taken])
    found[SPREAD, :] = after[: len(SPREAD)]
    found[SHARES, :] = np.exp(after[len(SPREAD) :])
    return found


def _quantities(x: Vector) -> Vector:
    """What is spread, (9, n)."""
    return np.concatenate((x[SPREAD, :], np.log(x[SHARES, :])))


def _contacts(x: Vector) -> Integers:
    """Where each driveline lies in its backlash, 0 to 2 (n,)."""
    contacts: Integers = (x[WAY] >= 0.0).astype(np.int64)
    contacts += x[WAY] > 2.0 * x[HALF]
    return contacts


def _mean_and_root(quantities: Vector, weights: Vector) -> tuple[Vector, Vector]:
    """Mean (9, 1) and a root of the covariance (9, 9)."""
    total = float(weights.sum())
    # Rounding may draw the last driveline though it weighs nothing.
    shares = weights / total if total > 0.0 else np.full(weights.size, 1.0 / weights.size)
    mean = (quantities @ shares)[:, np.newaxis]
    off = quantities - mean
    covariance = (off * shares) @ off.T
    sd = np.sqrt(np.diag(covariance))
    apart = np.where(sd > LEAST_SD, sd, 1.0)
    related = covariance / np.outer(apart, apart)
    if not np.isfinite(related).all():
        return mean, np.zeros_like(related)  # squares of numbers beyond all sense
    np.fill_diagonal(related, 1.0 + LEAST_APART)
    return mean, sd[:, np.newaxis] * np.linalg.cholesky(related)
