"""Which tooth is which: a remembered tooth pattern found again in a wheel that was numbered anew.

After a restart or a standstill any tooth may be number 0. With e the edges' errors, N e = r the
normal equations of what was seen since (`teeth`), and e = R_k m + noise of variance s2 the
remembered pattern m turned by k teeth, the least sum of squares over e is, up to a constant

    J_k = |R_k m|2 / s2 - b_k' A^-1 b_k,    A = N + I / s2,    b_k = r + R_k m / s2,

which is the circular correlation of both patterns, each edge weighed by how well it was seen. J is
minus twice a log-likelihood: the least J wins where it leads the second by `MARGIN`.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from meshpoint.controller.estimate.crossing_kernels import inverse_of_positive
from meshpoint.kernels.records import Vector

MARGIN: Final = 30.0
"""By how much J of the best turn must lead: a likelihood ratio of e^15, some 3 million to 1."""
FITS: Final = 1.8
"""Largest deviance (J less that of the best free pattern, for each edge) of the same wheel:
expected 1 +- 0.15 for 45 teeth, measured 0.96 to 1.27. With few edges another wheel can come down
to 2."""
STRANGER: Final = 4.0
"""Above this deviance it is another wheel; in between, more edges are needed."""
AGED_RAD: Final = math.radians(0.01)
"""How much an edge's error may have changed since it was learned, for instance with temperature."""
LEAST_TURNS: Final = 2.0
"""Turns to be seen before patterns are compared: of 700 simulated other wheels two were accepted
after one turn, none after two."""


class ToothPattern(NamedTuple):
    """A pattern in a numbering that has been lost."""

    error_rad: Vector
    sd_rad: float
    edges: int
    """How many edges it was learned from."""

    @property
    def weight(self) -> float:
        """Inverse variance of an edge's error."""
        return 1.0 / (self.sd_rad**2 + AGED_RAD**2)


class PatternEquations(NamedTuple):
    """Equations of one window of free motion, or the sum of several."""

    normal: Vector
    right: Vector
    squares: float
    """Sum of the edges' squared normalised residuals with all errors at zero."""
    edges: float


class PatternMatch(NamedTuple):
    """Result of a comparison."""

    teeth: int
    """Remembered tooth number less present one, of the likeliest turn."""
    margin: float
    """How far J of the second likeliest lies above."""
    deviance: float
    """Of the likeliest, an edge: about 1 where it is the same wheel."""

    @property
    def certain(self) -> bool:
        """Whether the numbering is known again."""
        return self.deviance <= FITS and self.margin >= MARGIN

    @property
    def stranger(self) -> bool:
        """Whether no turn of the remembered pattern fits."""
        return self.deviance > STRANGER


def turned(error_rad: Vector, teeth: int) -> Vector:
    """The pattern in the present numbering, where tooth t is remembered tooth t + teeth."""
    return np.roll(error_rad, -2 * teeth)


def compare(
    memory: ToothPattern, seen: PatternEquations, free_sd_rad: float, only_as_drawn: bool
) -> PatternMatch | None:
    """Compares all turns; None before two turns were seen or where the equations do not hold.

    free_sd_rad: what an edge's error may be on any wheel. only_as_drawn: the wheel has missing
    teeth, so its numbers are those of the drawing and no other turn is possible."""
    size = memory.error_rad.size
    if seen.edges < LEAST_TURNS * size:
        return None
    turns = 1 if only_as_drawn else size // 2
    weight = memory.weight
    inverse = inverse_of_positive(seen.normal + weight * np.eye(size))
    free = inverse_of_positive(seen.normal + free_sd_rad**-2 * np.eye(size))
    patterns = np.stack([turned(memory.error_rad, k) for k in range(turns)])
    b = seen.right + weight * patterns
    j = weight * np.sum(patterns**2, axis=1) - np.einsum("ki,ij,kj->k", b, inverse, b)
    least_free = -float(seen.right @ free @ seen.right)
    if not (np.isfinite(j).all() and np.isfinite(least_free)):
        return None
    # Errors of the motion model enlarge all differences of J equally; the residual of the best free
    # pattern shows by how much.
    scale = max(1.0, (seen.squares + least_free) / seen.edges)
    order = np.argsort(j, kind="stable")
    best = int(order[0])
    margin = np.inf if turns == 1 else float(j[order[1]] - j[best]) / scale
    return PatternMatch(best, margin, (float(j[best]) - least_free) / size / scale)
