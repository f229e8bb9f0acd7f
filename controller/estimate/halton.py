"""Numbers that fill a space evenly without any randomness: Halton's sequences (1960).

`scipy.stats.qmc.Halton` gives the same bits; to load it would cost a node 0.8 s and 68 MB.
"""

from __future__ import annotations

import math
from functools import cache
from statistics import NormalDist
from typing import Final

import numpy as np

from meshpoint.kernels.records import Vector

PRIMES: Final = (2, 3, 5, 7, 11, 13, 17, 19, 23, 29)
"""A sequence each."""


@cache
def even(count: int) -> Vector:
    """Numbers that fill 0 to 1 evenly, (len(PRIMES), count)."""
    found = np.zeros((len(PRIMES), count))
    for row, base in zip(found, PRIMES, strict=True):
        rest, share = np.arange(1, count + 1), 1.0
        while rest.any():
            share /= base
            row += share * (rest % base)
            rest //= base
    return found


@cache
def normal(count: int) -> Vector:
    """The same as numbers of the normal law."""
    law = NormalDist()
    return np.array([[law.inv_cdf(value) for value in row] for row in even(count).tolist()])


@cache
def scattered_twice(count: int) -> Vector:
    """Numbers of the normal law that go with no others, neither those above nor those of another
    row nor their own from another place on; each row twice over, (len(PRIMES), 2 count).

    Fractions of i^2 times the root of a prime are spread evenly, and so are their differences
    between any two rows and any two places (Weyl 1916)."""
    law, squares = NormalDist(), np.arange(1.0, count + 1.0) ** 2
    rows = [(squares * math.sqrt(base) % 1.0).tolist() for base in PRIMES]
    found = np.array([[law.inv_cdf(value) for value in row] for row in rows])
    return np.concatenate((found, found), axis=1)
