"""A share of shifts and its interval, where the shifts of a run share a gearbox and few miss.

Each gearbox misses with a chance of its own, beta distributed with mean q and intra-class
correlation r, so that the misses of a run are beta-binomial (Skellam 1948). Few runs with a miss
tell little of r: the interval is that of q's posterior, averaged over r (Lee and Sabavala 1987).
The prior of q is Jeffreys' (Brown, Cai and DasGupta 2001), that of r the beta distribution (1, 3),
with a mean of 0.25: in campaigns of this gearbox 0.12 to 0.31 were found
(docs/decisions/0008-campaign.md).
"""

from __future__ import annotations

from functools import cache, lru_cache
from typing import Final, NamedTuple

import numpy as np
from scipy.special import betainc, betaln

from meshpoint.campaigns.intervals import Rate
from meshpoint.kernels.records import Vector

MISSES: Final = np.concatenate([np.geomspace(1e-5, 0.02, 160, endpoint=False),
                                np.linspace(0.02, 1.0 - 1e-5, 240)])  # fmt: skip
"""The shares of misses q that are looked at: close together where they are few."""
CORRELATIONS: Final = np.linspace(0.025, 0.975, 39)
NOMINAL: Final = 0.95


class _Prior(NamedTuple):
    """Of each cell of q and r its logarithm (r, q), and where the cells of q begin and end."""

    logs: Vector
    ends: Vector


@cache
def _prior() -> _Prior:
    ends = np.concatenate([[0.0], (MISSES[1:] + MISSES[:-1]) / 2.0, [1.0]])
    of_q = np.log(np.diff(betainc(0.5, 0.5, ends)))
    of_r = 2.0 * np.log(1.0 - CORRELATIONS)
    return _Prior(of_r[:, np.newaxis] + of_q, ends)


def clustered_rate(hits: Vector, shifts: Vector) -> Rate:
    """The share of `hits`, of each run, in its `shifts`; at least one run has one."""
    misses = shifts - hits
    kinds, counts = np.unique(np.stack([misses, shifts]), axis=1, return_counts=True)
    prior = _prior()
    logs = prior.logs.copy()
    for (missed, made), count in zip(kinds.T.tolist(), counts.tolist(), strict=True):
        logs += count * _log_chance(missed, made)
    weights = np.exp(logs - logs.max()).sum(axis=0)
    below = np.concatenate([[0.0], np.cumsum(weights / weights.sum())])
    tail = 0.5 * (1.0 - NOMINAL)
    least, most = np.interp((tail, 1.0 - tail), below, prior.ends).tolist()
    share = float(misses.sum() / shifts.sum())
    # Where none has missed, or each, the posterior's tail would shut out what was seen.
    return Rate(1.0 - share, 1.0 - max(most, share), 1.0 - min(least, share))


@lru_cache(maxsize=128)
def _log_chance(missed: float, made: float) -> Vector:
    """Logarithm of the chance that a run misses this many of the shifts made in it, (r, q), but for
    what does not depend on them."""
    size = ((1.0 - CORRELATIONS) / CORRELATIONS)[:, np.newaxis]
    a, b = MISSES * size, (1.0 - MISSES) * size
    found: Vector = betaln(a + missed, b + made - missed) - betaln(a, b)
    return found
