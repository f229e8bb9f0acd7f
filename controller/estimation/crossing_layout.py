"""Where everything stands in the arrays of a crossing-time filter, shared by kernel and callers.

A filter is two arrays, floats (FLOATS,) and integers (INTEGERS,): the kernel is handed a few arrays
whole, because each further one costs as much as half an edge. A third holds what a wheel's teeth
are learned by. `FilterArrays` and `TeethArrays` name their parts as views.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Final

import numpy as np
from numpy.typing import NDArray

from meshpoint.controller.motion.kernels import SEGMENTS, STATES, Vector

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
OFFSET: Final = P + STATES * STATES
"""Angle of a further wheel, by the exact ratio, less that of the shaft, rad."""
OFFSET_VAR: Final = OFFSET + 1
"""Its variance; 0 while it is not known."""
CROSS: Final = OFFSET_VAR + 1
"""Its covariances with the state (6,)."""
MOMENT: Final = CROSS + STATES
"""So many floats are a moment."""

# --- floats: what it is told ----------------------------------------------------------------------
SENSOR: Final = MOMENT
"""Sensor vector (5,); indices below."""
MOTION: Final = SENSOR + 5
"""[a, g, b_d] (3,) of `motion_kernels`."""
NOISE: Final = MOTION + 3
"""Densities of the driving noises (4,)."""
LAW: Final = NOISE + 4
"""Pressure law (2, SEGMENTS, 3)."""
MESH: Final = LAW + 2 * SEGMENTS * 3
"""How the offset moves (3,): its density while the mesh lies at one flank and while it may change
to the other, rad2/s, and how long after a switch of the brake it may, us."""
SCALE: Final = MESH + 3
"""Angle of the shaft over that of the wheel whose teeth are learned."""

# --- floats: what it says and works with --------------------------------------------------------
AGREEMENT: Final = SCALE + 1
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
HELD: Final = 3
"""How many moments of HISTORY may be gone back to."""
NEXT: Final = 4
"""Where in the ring the next one goes."""
FURTHER: Final = 5
"""How many of the edges, at their end, are those of a further wheel."""
ASTRAY: Final = 6
"""Edges of the further wheel refused in a row."""
INTEGERS: Final = 7

# --- rows of what teeth are learned by, of N columns ------------------------------------------
RIGHT: Final = STATES
"""Before it the state's derivatives by the tooth errors (6, N); it is the right side of the normal
equations."""
ROW: Final = RIGHT + 1
"""What the kernel works with."""
NORMAL: Final = ROW + 1
"""From here on the matrix of the normal equations (N, N), its upper half."""

# --- the sensor vector ---------------------------------------------------------------------------
SIGMA_TIME: Final = 0
SIGMA_ANGLE: Final = 1
SIGMA_PRESSURE: Final = 2
GATE: Final = 3
SIGMA_FURTHER: Final = 4
"""sd of an edge's time (s), of its angle (rad), of the measured pressure (Pa); how many sd an
innovation may have; sd of a further wheel's edge, as an angle of the shaft."""

# --- what the kernel answers ---------------------------------------------------------------------
DONE: Final = 0
LATE: Final = 1
"""Nothing was taken: the batch begins before the state, and there is a moment to go back to."""


class _Views(ABC):
    """Arrays whose parts are views: copied (a campaign copies whole controllers) as arrays alone,
    for copies of views would be arrays of their own."""

    def __getstate__(self) -> dict[str, object]:
        return {name: array for name, array in vars(self).items() if array.base is None}

    def __setstate__(self, arrays: dict[str, object]) -> None:
        vars(self).update(arrays)
        self._name_parts()

    @abstractmethod
    def _name_parts(self) -> None:
        """Makes the views anew."""


class FilterArrays(_Views):
    """A filter's two arrays and their parts; all parts are views."""

    x: Vector
    p: Vector
    cross: Vector
    sensor: Vector
    motion: Vector
    noise: Vector
    law: Vector
    mesh: Vector
    agreement: Vector
    moment: Vector
    history: Vector

    def __init__(self) -> None:
        self.floats: Vector = np.zeros(FLOATS)
        self.integers: Integers = np.zeros(INTEGERS, np.int64)
        self.floats[SCALE] = 1.0
        self._name_parts()

    def _name_parts(self) -> None:
        floats = self.floats
        self.x = floats[X:P]
        self.p = floats[P:OFFSET].reshape(STATES, STATES)
        self.cross = floats[CROSS:MOMENT]
        self.sensor = floats[SENSOR:MOTION]
        self.motion = floats[MOTION:NOISE]
        self.noise = floats[NOISE:LAW]
        self.law = floats[LAW:MESH].reshape(2, SEGMENTS, 3)
        self.mesh = floats[MESH:SCALE]
        self.agreement = floats[AGREEMENT:STEP]
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


class TeethArrays(_Views):
    """What the teeth of a wheel with N edges are learned by, rows of one array; all parts are
    views."""

    right: Vector
    normal: Vector

    def __init__(self, edges: int) -> None:
        self.floats: Vector = np.zeros((NORMAL + edges, edges))
        self._name_parts()

    def _name_parts(self) -> None:
        self.right = self.floats[RIGHT]
        self.normal = self.floats[NORMAL:]
