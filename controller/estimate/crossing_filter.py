"""A crossing-time filter over one wheel's edges: its kernels for either shaft, and its memory.

The layshaft's are `crossing_kernels`; those of a main shaft whose driveline swings are the same
with the states of `models/swing`.

Edges that come late (their frame was lost, and the next one brought them) are older than the state.
The filter keeps its last few states: it goes back to one before the late edge and processes
everything since then again, in order of time.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import Annotated, Final, NamedTuple

import numpy as np

from meshpoint.controller.estimate.crossing_kernels import (
    BATCHES_KEPT,
    DONE,
    LATE,
    ROW,
    FilterMemory,
    TeethArrays,
    crossing_filter,
    follow,
    keep,
    learn,
    take_edge,
)
from meshpoint.controller.models.layshaft import LayshaftState, MotionModel, ahead, state_of
from meshpoint.controller.models.layshaft_kernels import OMEGA, THETA, mirror
from meshpoint.controller.models.swing import (
    RATE,
    SWING,
    SWING_MODEL_WORDS,
    SWING_STATES,
    SwingModel,
    SwingState,
    SwingStep,
    swing_on,
    swing_spread,
    swing_step,
)
from meshpoint.controller.settings.filters import CrossingFilterTuning
from meshpoint.kernels.jit import bare, inlined
from meshpoint.kernels.records import WORD_BYTES, Over, RecordMemory, Records, Vector, layout_of
from meshpoint.units import US

MOST_REFUSED: Final = 0.1
"""Where a larger share of the edges was refused they show something else than the model."""
NO_TEETH: Final = TeethArrays(0).flat


class SwingSnapshot:
    """A copy of the filter's state, to go back to when late edges arrive."""

    time_us: float
    state: SwingState
    p: Annotated[Vector, SWING_STATES, SWING_STATES]
    noise_scale: float


SWING_SNAPSHOT_WORDS: Final = layout_of(SwingSnapshot).itemsize // WORD_BYTES


class SwingFilter:
    """As `crossing_kernels.Filter`, with the states of a shaft that swings. No pressure is
    measured; the field is there because both filters are set up alike."""

    time_us: float
    state: SwingState
    p: Annotated[Vector, SWING_STATES, SWING_STATES]
    noise_scale: float

    # Parameters.
    noise_adaptation: float
    edge_time_s: float
    tooth_rad: float
    pressure_sd_pa: float
    gate_sd: float
    model: SwingModel

    # Results and working memory.
    squares: float
    count: float
    log_variance: float
    gated_in_a_row: int
    held: int
    next: int
    step: SwingStep
    gain: Annotated[Vector, SWING_STATES]
    ring: Annotated[Records[SwingSnapshot], BATCHES_KEPT]

    x: Annotated[Vector, Over("state"), SWING_STATES]
    motion: Annotated[Vector, Over("model"), SWING_MODEL_WORDS]
    nis: Annotated[Vector, Over("squares"), 2]
    snapshot: Annotated[Vector, Over("time_us"), SWING_SNAPSHOT_WORDS]
    snapshots: Annotated[Vector, Over("ring"), BATCHES_KEPT, SWING_SNAPSHOT_WORDS]


SWING_FILTER: Final = layout_of(SwingFilter)


def swing_memory() -> FilterMemory:
    """The memory of a main shaft's filter."""
    return FilterMemory(SWING_FILTER)


@bare
def swing_filter(
    memory: Vector, edges: Vector, pressure_us: Vector, pressure_pa: Vector, switches: Vector,  # noqa: ARG001
    teeth: Vector,
) -> int:  # fmt: skip
    """As `crossing_filter`, on a `SwingFilter`. A main shaft has no brake: pressures and switches
    are not read."""
    f = memory.view(SWING_FILTER)[0]
    edge_us, edge_rad = edges[0], edges[1]
    n = edge_us.shape[0]
    if f.held > 0 and n > 0 and edge_us[0] < f.time_us:
        return LATE
    keep(f, SWING_SNAPSHOT_WORDS)
    for k in range(n):
        if edge_us[k] <= f.time_us:
            continue
        swing_to(f, edge_us[k], teeth)
        innovation = edge_rad[k] - f.state.theta_rad
        s = take_edge(f, innovation, SWING_STATES, -1)
        if teeth.shape[1] > 0 and s > 0.0:
            learn(teeth, int(edges[2, k]), innovation, s)
            follow(teeth, f.gain, SWING_STATES)
    mirror(f.p, SWING_STATES)
    return DONE


@inlined
def swing_to(f: SwingFilter, to_us: float, teeth: Vector) -> None:
    """State, covariance, and what depends on them to a time."""
    dt, step = (to_us - f.time_us) * US, f.step
    swing_step(dt, f.model, step)
    swing_on(f.state, step)
    swing_spread(f.p, dt, step, f.model, f.noise_scale)
    if teeth.shape[1] > 0:
        carry_swing(teeth, step)
    f.time_us = to_us


@inlined
def carry_swing(teeth: Vector, step: SwingStep) -> None:
    """The derivatives of the state by the tooth errors after a step; row by row, ROW being free."""
    size, theta, omega = teeth.shape[1], teeth[THETA], teeth[ROW]
    for c in range(size):
        before = theta[c]
        theta[c], omega[c] = 0.0 + step.theta_by[0] * before, 0.0 + step.omega_by[0] * before
    for k in range(1, SWING_STATES):
        state, theta_by, omega_by = teeth[k], step.theta_by[k], step.omega_by[k]
        for c in range(size):
            theta[c] += theta_by * state[c]
            omega[c] += omega_by * state[c]
    for c in range(size):
        teeth[OMEGA, c] = omega[c]
    angle, speed, block = teeth[SWING], teeth[RATE], step.block
    for c in range(size):
        q, r = angle[c], speed[c]
        angle[c] = block[0] * q + block[1] * r
        speed[c] = block[2] * q + block[3] * r


class FilterKind(NamedTuple):
    """A filter's kernel with what makes its memory."""

    memory: Callable[[], FilterMemory]
    run: Callable[[Vector, Vector, Vector, Vector, Vector, Vector], int]


LAYSHAFT_FILTER: Final = FilterKind(FilterMemory, crossing_filter)
MAIN_FILTER: Final = FilterKind(swing_memory, swing_filter)


class Pressures(NamedTuple):
    """Measured brake pressure, gauge, rising in time."""

    time_us: Vector
    pressure_pa: Vector


NO_PRESSURES: Final = Pressures(np.empty(0), np.empty(0))


_Batch = tuple[Vector, Pressures]
"""Times and angles of edges (2, n), and pressures."""


class CrossingFilter:
    """State and covariance of one shaft at its newest edge."""

    def __init__(self, tuning: CrossingFilterTuning, kind: FilterKind = LAYSHAFT_FILTER) -> None:
        self._tuning = tuning
        self._run = kind.run
        self._memory = kind.memory()
        self._memory.set_sensor(
            tuning.edge_time_s, tuning.tooth_error_rad, tuning.pressure_sd_pa, tuning.gate_sd
        )
        self._sd_rad = tuning.tooth_error_rad
        self._model: RecordMemory | None = None
        self._taken: deque[_Batch] = deque(maxlen=BATCHES_KEPT)
        """The batches that belong to the snapshots in the memory."""

    def set_edge_time(self, edge_time_s: float) -> None:
        """Standard deviation of an edge's time from now on."""
        self._memory.part("edge_time_s")[0] = edge_time_s

    def noise_adaptation(self, share: float) -> None:
        """How fast the process noise follows the innovations from now on, a share an edge; with 0
        it is the model's."""
        memory = self._memory
        memory.part("noise_adaptation")[0], memory.part("noise_scale")[0] = share, 1.0

    def begin(self, time_us: float, x: Vector, p: Vector) -> None:
        """Starts from a new state and covariance at a sensor time (us)."""
        memory = self._memory
        memory.time_us[0] = time_us
        memory.x[:], memory.p[:] = x, p
        memory.log_variance[0] = 0.0
        memory.nis[:] = 0.0
        self.forget_past()

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

    @property
    def nis(self) -> Vector:
        """Sum and number of normalised squared innovations (NIS) since it was last cleared."""
        return self._memory.nis

    def deviance(self, edges: int) -> float:
        """Twice the negative logarithm of the likelihood of what was taken, but for a constant:
        the innovations' squares over their variances, and the variances' logarithms. Of this many
        edges one that the gate refused counts as if it were at the gate."""
        squares, count = self.nis.tolist()
        if count < (1.0 - MOST_REFUSED) * edges:
            return math.inf
        log_variance = self._memory.log_variance.item()
        if count == 0.0:
            return 0.0
        at_gate = self._tuning.gate_sd**2 + log_variance / count
        return float(squares + log_variance + max(0.0, edges - count) * at_gate)

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
        if model is not self._model:
            self._model = model
            memory.model[:] = model.flat
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
