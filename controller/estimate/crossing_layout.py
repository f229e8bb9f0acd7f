"""The memory of a crossing-time filter, and the arrays a wheel's teeth are learned by."""

from __future__ import annotations

from typing import Annotated, Final

import numpy as np

from meshpoint.controller.models.layshaft_kernels import STATES, Model, MotionState, MotionStep
from meshpoint.controller.models.swing import SWING_STATES
from meshpoint.kernels.records import (
    WORD_BYTES,
    Layout,
    Over,
    RecordMemory,
    Records,
    Vector,
    layout_of,
)

BATCHES_KEPT: Final = 4
"""Number of batches that can be undone: 40 ms, more than two lost frames."""


class FilterSnapshot:
    """A copy of the filter's state, to go back to when late edges arrive."""

    time_us: float
    """Of the state."""
    state: MotionState
    p: Annotated[Vector, STATES, STATES]
    """Its covariance."""
    noise_scale: float
    """Process noise over that of the model, by the innovations lately."""


SNAPSHOT_WORDS: Final = layout_of(FilterSnapshot).itemsize // WORD_BYTES


class Filter:
    """A crossing-time filter; the fields of `FilterSnapshot` come first."""

    time_us: float
    state: MotionState
    p: Annotated[Vector, STATES, STATES]
    noise_scale: float

    # Parameters.
    noise_adaptation: float
    """How fast `noise_scale` follows the innovations, a share an edge; 0: the model's noise
    holds."""
    edge_time_s: float
    """Standard deviation of an edge's time."""
    tooth_rad: float
    """Standard deviation of an edge's angle."""
    pressure_sd_pa: float
    """Standard deviation of the measured pressure."""
    gate_sd: float
    """An edge is refused if its innovation exceeds this many standard deviations."""
    model: Model

    # Results and working memory.
    squares: float
    """Sum of normalised squared innovations (NIS)."""
    count: float
    """Their number."""
    log_variance: float
    """Sum of the logarithms of the innovations' variances: with the squares, twice the negative
    logarithm of the likelihood of what was taken."""
    gated_in_a_row: int
    """Edges refused in a row."""
    held: int
    """How many snapshots of the ring are valid."""
    next: int
    """Index in the ring for the next snapshot."""
    step: MotionStep
    gain: Annotated[Vector, STATES]
    """The last Kalman gain."""
    ring: Annotated[Records[FilterSnapshot], BATCHES_KEPT]
    """Snapshots taken before each of the last batches."""

    x: Annotated[Vector, Over("state"), STATES]
    motion: Annotated[Vector, Over("model"), layout_of(Model).itemsize // WORD_BYTES]
    nis: Annotated[Vector, Over("squares"), 2]
    snapshot: Annotated[Vector, Over("time_us"), SNAPSHOT_WORDS]
    snapshots: Annotated[Vector, Over("ring"), BATCHES_KEPT, SNAPSHOT_WORDS]


FILTER: Final = layout_of(Filter)

# --- rows of what teeth are learned by, of N columns ------------------------------------------
RIGHT: Final = max(STATES, SWING_STATES)
"""Before it the state's derivatives by the tooth errors, a row a state; it is the right side of the
normal equations."""
ROW: Final = RIGHT + 1
"""What the kernel works with."""
NORMAL: Final = ROW + 1
"""From here on the matrix of the normal equations (N, N), its upper half."""

# --- what the kernel answers ---------------------------------------------------------------------
DONE: Final = 0
LATE: Final = 1
"""Nothing was taken: the batch begins before the state, and there is a snapshot to go back to."""


class FilterMemory(RecordMemory):
    """A filter's memory, with views of the fields that are used often."""

    def __init__(self, layout: Layout = FILTER) -> None:
        super().__init__(layout)
        self.part("noise_scale")[0] = 1.0

    def _name_parts(self) -> None:
        self.time_us, self.x, self.p = self.part("time_us"), self.part("x"), self.part("p")
        self.tooth_rad, self.model = self.part("tooth_rad"), self.part("motion")
        self.nis = self.part("nis")
        self.log_variance = self.part("log_variance")
        self.held = self.part("held")

    def set_sensor(
        self, edge_time_s: float, tooth_rad: float, pressure_sd_pa: float, gate_sd: float
    ) -> None:
        """Sets the standard deviations of edges and pressures, and the gate (`Filter`)."""
        values = {
            "edge_time_s": edge_time_s,
            "tooth_rad": tooth_rad,
            "pressure_sd_pa": pressure_sd_pa,
            "gate_sd": gate_sd,
        }
        for name, value in values.items():
            self.part(name)[0] = value

    def forget_past(self) -> None:
        """Makes all snapshots invalid."""
        self.held[0] = 0

    def go_back(self) -> None:
        """Restores the newest valid snapshot. There must be one (`held`)."""
        following = self.part("next")
        following[0] = (following[0] - 1) % BATCHES_KEPT
        self.held[0] -= 1
        self.part("snapshot")[:] = self.part("snapshots")[following[0]]


class TeethArrays:
    """The normal equations for the tooth errors of a wheel with N edges, rows of one array."""

    def __init__(self, edges: int) -> None:
        self.flat: Vector = np.zeros((NORMAL + edges, edges))

    @property
    def right(self) -> Vector:
        """Right side of the normal equations, a view."""
        right: Vector = self.flat[RIGHT]
        return right

    @property
    def normal(self) -> Vector:
        """Their matrix, its upper half; a view."""
        return self.flat[NORMAL:]
