"""Where everything stands in the arrays of a crossing-time filter, shared by kernel and callers.

A filter is two arrays, floats (FLOATS,) and integers (INTEGERS,): the kernel is handed a few arrays
whole, because each further one costs as much as half an edge. A third holds what a wheel's teeth
are learned by. `FilterArrays` and `TeethArrays` name their parts as views.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from controller.motion_kernels import SEGMENTS, STATES, Vector

Integers = NDArray[np.int64]

KEPT: Final = 4
"""Batches that can be taken back: 40 ms, more than two lost frames."""

# --- floats: what is kept of a moment to go back to -------------------------------------------
TIME: Final = 0
"""Time of the state, us."""
X: Final = 1
"""State (6,)."""
P: Final = X + STATES
"""Covariance (6, 6)."""
MOMENT: Final = P + STATES * STATES
"""So many floats are a moment."""

# --- floats: what it is told ----------------------------------------------------------------------
SENSOR: Final = MOMENT
"""Sensor vector (4,); indices below."""
MOTION: Final = SENSOR + 4
"""[a, g, b_d] (3,) of `motion_kernels`."""
NOISE: Final = MOTION + 3
"""Densities of the driving noises (4,)."""
LAW: Final = NOISE + 4
"""Pressure law (2, SEGMENTS, 3)."""

# --- floats: what it says and works with --------------------------------------------------------
AGREEMENT: Final = LAW + 2 * SEGMENTS * 3
"""Sum and number of normalised squared innovations (NIS) (2,)."""
STEP: Final = AGREEMENT + 2
"""Derivatives f (3, 6) of `transition`."""
KALMAN: Final = STEP + 3 * STATES
"""The last Kalman gain (6,)."""
HISTORY: Final = KALMAN + STATES
"""Moments (KEPT, MOMENT) before each of the last batches, a ring."""
FLOATS: Final = HISTORY + KEPT * MOMENT

# --- integers ------------------------------------------------------------------------------------
TAKEN: Final = 0
GATED: Final = 1
IN_A_ROW: Final = 2
"""Edges used, edges refused, edges refused in a row."""
TEETH: Final = 3
"""N, how many of a wheel's edges are being learned; 0: none."""
HELD: Final = 4
"""How many moments of HISTORY may be gone back to."""
NEXT: Final = 5
"""Where in the ring the next one goes."""
INTEGERS: Final = 6

# --- the sensor vector ---------------------------------------------------------------------------
SIGMA_TIME: Final = 0
SIGMA_ANGLE: Final = 1
SIGMA_PRESSURE: Final = 2
GATE: Final = 3
"""sd of an edge's time (s), of its angle (rad), of the measured pressure (Pa); how many sd an
innovation may have."""

# --- what the kernel answers ---------------------------------------------------------------------
DONE: Final = 0
LATE: Final = 1
"""Nothing was taken: the batch begins before the state, and there is a moment to go back to."""


class FilterArrays:
    """A filter's two arrays and their parts; all parts are views."""

    def __init__(self) -> None:
        self.floats: Vector = np.zeros(FLOATS)
        self.integers: Integers = np.zeros(INTEGERS, np.int64)
        floats = self.floats
        self.x = floats[X:P]
        self.p = floats[P:MOMENT].reshape(STATES, STATES)
        self.sensor = floats[SENSOR:MOTION]
        self.motion = floats[MOTION:NOISE]
        self.noise = floats[NOISE:LAW]
        self.law = floats[LAW:AGREEMENT].reshape(2, SEGMENTS, 3)
        self.agreement = floats[AGREEMENT:STEP]
        self.counts = self.integers[: IN_A_ROW + 1]
        self.moment = floats[:MOMENT]
        self.history = floats[HISTORY:].reshape(KEPT, MOMENT)

    @property
    def time_us(self) -> float:
        """Time of the state."""
        return float(self.floats[TIME])

    @time_us.setter
    def time_us(self, time_us: float) -> None:
        self.floats[TIME] = time_us

    def set_model(self, motion: Vector, law: Vector, noise: Vector) -> None:
        """The model that holds from here on."""
        self.motion[:], self.law[:], self.noise[:] = motion, law, noise

    def forget_past(self) -> None:
        """No moment can be gone back to."""
        self.integers[HELD] = 0

    def go_back(self) -> None:
        """To the moment before the newest batch that is still held. There must be one."""
        integers = self.integers
        integers[NEXT] = (integers[NEXT] - 1) % KEPT
        integers[HELD] -= 1
        self.moment[:] = self.history[integers[NEXT]]


class TeethArrays:
    """What the teeth of a wheel with N edges are learned by, in one array; all parts are views."""

    def __init__(self, edges: int) -> None:
        self.floats: Vector = np.zeros((STATES + 2 + edges) * edges)
        by_tooth, right, rest = np.split(self.floats, [STATES * edges, (STATES + 1) * edges])
        self.by_tooth = by_tooth.reshape(STATES, edges)
        """The state's derivatives by the tooth errors."""
        self.right = right
        self.normal = rest[edges:].reshape(edges, edges)
        """Right side and matrix (its upper half) of the normal equations. Before the matrix stands
        a row that the kernel works with."""
