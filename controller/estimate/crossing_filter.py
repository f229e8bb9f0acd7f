"""A crossing-time filter over one wheel's edges, by the model of either shaft, and its memory.

Edges that come late (their frame was lost, and the next one brought them) are older than the state.
The filter keeps its last few states: it goes back to one before the late edge and processes
everything since then again, in order of time.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from meshpoint.controller.estimate.crossing_kernels import (
    BATCHES_KEPT,
    FILTER,
    LATE,
    SWING_FILTER,
    TeethArrays,
    crossing_filter,
    swing_filter,
)
from meshpoint.controller.models.layshaft import LayshaftState, MotionModel, ahead, state_of
from meshpoint.controller.settings.filters import CrossingFilterTuning
from meshpoint.kernels.records import Layout, RecordMemory, Vector

MOST_REFUSED: Final = 0.1
"""Where a larger share of the edges was refused they show something else than the model."""
NO_TEETH: Final = TeethArrays(0).flat


class FilterMemory(RecordMemory):
    """A filter's memory, with views of the fields that are used often."""

    def _name_parts(self) -> None:
        self.time_us, self.x, self.p = self.part("time_us"), self.part("x"), self.part("p")
        self.tooth_rad, self.model = self.part("tooth_rad"), self.part("motion")
        self.nis = self.part("nis")
        self.log_variance = self.part("log_variance")
        self.held = self.part("held")

    def forget_past(self) -> None:
        """Makes all snapshots invalid."""
        self.held[0] = 0

    def go_back(self) -> None:
        """Restores the newest valid snapshot. There must be one (`held`)."""
        following = self.part("next")
        following[0] = (following[0] - 1) % BATCHES_KEPT
        self.held[0] -= 1
        self.part("snapshot")[:] = self.part("snapshots")[following[0]]


class FilterKind(NamedTuple):
    """A filter's record and kernel."""

    layout: Layout
    run: Callable[[Vector, Vector, Vector, Vector, Vector, Vector], int]


LAYSHAFT_FILTER: Final = FilterKind(FILTER, crossing_filter)
MAIN_FILTER: Final = FilterKind(SWING_FILTER, swing_filter)


class Pressures(NamedTuple):
    """Measured brake pressure, gauge, rising in time."""

    time_us: Vector
    pressure_pa: Vector


NO_PRESSURES: Final = Pressures(np.empty(0), np.empty(0))


_Batch = tuple[Vector, Pressures]
"""Times and angles of edges (2, n), and pressures."""


class FilterRun:
    """A filter's kernel and its memory, by a model that may change."""

    def __init__(
        self, tuning: CrossingFilterTuning, kind: FilterKind, tooth_rad: float, gate_sd: float
    ) -> None:
        """tooth_rad, gate_sd: as in `Filter`."""
        self._run, self._memory = kind.run, FilterMemory(kind.layout)
        self._model: RecordMemory | None = None
        self._memory.put(noise_scale=1.0, tooth_rad=tooth_rad, gate_sd=gate_sd)
        self._memory.put(edge_time_s=tuning.edge_time_s, pressure_sd_pa=tuning.pressure_sd_pa)

    def set_edge_time(self, edge_time_s: float) -> None:
        """Standard deviation of an edge's time from now on."""
        self._memory.put(edge_time_s=edge_time_s)

    def begin(self, time_us: float, x: Vector, p: Vector) -> None:
        """Starts from a new state and covariance at a sensor time (us)."""
        memory = self._memory
        memory.time_us[0], memory.x[:], memory.p[:] = time_us, x, p
        memory.log_variance[0], memory.nis[:] = 0.0, 0.0
        memory.forget_past()

    def _move_by(self, model: RecordMemory) -> None:
        if model is not self._model:
            self._model = model
            self._memory.model[:] = model.flat

    @property
    def nis(self) -> Vector:
        """Sum and number of normalised squared innovations (NIS) since it began."""
        return self._memory.nis

    @property
    def log_variance(self) -> float:
        """Sum of the logarithms of the innovations' variances."""
        return float(self._memory.log_variance[0])


class CrossingFilter(FilterRun):
    """State and covariance of one shaft at its newest edge."""

    def __init__(self, tuning: CrossingFilterTuning, kind: FilterKind = LAYSHAFT_FILTER) -> None:
        super().__init__(tuning, kind, tuning.tooth_error_rad, tuning.gate_sd)
        self._gate_sd = tuning.gate_sd
        self._sd_rad = tuning.tooth_error_rad
        self._taken: deque[_Batch] = deque(maxlen=BATCHES_KEPT)
        """The batches that belong to the snapshots in the memory."""

    def noise_adaptation(self, share: float) -> None:
        """How fast the process noise follows the innovations from now on, a share an edge; with 0
        it is the model's."""
        self._memory.put(noise_adaptation=share, noise_scale=1.0)

    def begin(self, time_us: float, x: Vector, p: Vector) -> None:
        """Starts from a new state and covariance at a sensor time (us)."""
        super().begin(time_us, x, p)
        self._taken.clear()

    def forget_past(self) -> None:
        """Call it when the model changes: batches before that cannot be processed again."""
        self._taken.clear()
        self._memory.forget_past()

    @property
    def time_us(self) -> float:
        """Time of the state."""
        return float(self._memory.time_us[0])

    @property
    def x(self) -> Vector:
        """The state, a view."""
        return self._memory.x

    @property
    def p(self) -> Vector:
        """Its covariance, a view."""
        return self._memory.p

    def deviance(self, edges: int) -> float:
        """Twice the negative logarithm of the likelihood of what was taken, but for a constant:
        the innovations' squares over their variances, and the variances' logarithms. Of this many
        edges one that the gate refused counts as if it were at the gate."""
        squares, count = self.nis.tolist()
        if count < (1.0 - MOST_REFUSED) * edges:
            return math.inf
        if count == 0.0:
            return 0.0
        at_gate = self._gate_sd**2 + self.log_variance / count
        return float(squares + self.log_variance + max(0.0, edges - count) * at_gate)

    def take(
        self,
        edges: Vector,
        sd_rad: float,
        pressures: Pressures,
        switches: Vector,
        model: RecordMemory,
    ) -> None:
        """New edges (2, n): times (us) and the angles they stand for (rad), with standard deviation
        `sd_rad`; and pressures between them."""
        memory = self._memory
        self._move_by(model)
        if sd_rad != self._sd_rad:
            self._sd_rad = memory.tooth_rad[0] = sd_rad
        flat = memory.flat
        while self._run(flat, edges, *pressures, switches, NO_TEETH) == LATE:
            edges, pressures = _merged(self._taken.pop(), (edges, pressures))
            memory.go_back()
        self._taken.append((edges, pressures))

    def latest(self) -> LayshaftState:
        """The state at the newest edge; where a prediction starts."""
        return state_of(self.x, self.p.copy(), self.time_us)

    def at(self, time_us: float, switches: Vector, model: MotionModel) -> LayshaftState:
        """The state at a time, with its spread grown to then."""
        return ahead(self.x, self.p, self.time_us, time_us, switches, model)


def _merged(early: _Batch, late: _Batch) -> _Batch:
    """Two batches as one, its edges in order of time."""
    (early_edges, early_pressures), (late_edges, late_pressures) = early, late
    edges = np.concatenate((early_edges, late_edges), axis=1)
    order = np.argsort(edges[0], kind="stable")
    pressures = Pressures(
        np.concatenate((early_pressures.time_us, late_pressures.time_us)),
        np.concatenate((early_pressures.pressure_pa, late_pressures.pressure_pa)),
    )
    # By rows: of a single edge numpy makes columns, and for those numba would compile once more.
    return np.ascontiguousarray(edges[:, order]), pressures
