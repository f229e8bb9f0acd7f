"""The crossing-time Kalman filter, and the least squares by which it learns its wheel's teeth.

An edge's angle is exact and its time is noisy, so at the edge's stamp the shaft stands at y =
theta_k + delta_k with variance (omega sigma_t)^2 + sigma_delta^2: theta_k the nominal angle,
delta_k the tooth's own error where it is known, sigma_delta what is left of it. Measured brake
pressure is taken in between, in order of time.

Teeth: over nominal angles the filter's innovations would be white but for the tooth errors e, and
how each innovation depends on them the filter itself gives: with S the derivatives of the state by
the errors and m = e_tooth - S[theta], innovation + m e is white. Summed over a window, that is the
batch least squares for the teeth, in any motion that the filter's model follows, braking included.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Final, Generic, TypeVar

import numpy as np

from meshpoint.controller.models.layshaft_kernels import (
    DISTURBANCE,
    DRAG,
    LONGEST_S,
    OMEGA,
    PRESSURE,
    STATES,
    THETA,
    Model,
    MotionState,
    MotionStep,
    input_at,
    longest_in_segment,
    measure,
    mirror,
    spread_over,
    transition,
    valve_after,
)
from meshpoint.controller.models.swing import (
    RATE,
    SWING,
    SWING_STATES,
    SwingModel,
    SwingState,
    SwingStep,
    swing_on,
    swing_spread,
    swing_step,
)
from meshpoint.kernels.jit import bare, compiled, inlined, record_on
from meshpoint.kernels.records import Over, Records, Vector, layout_of
from meshpoint.units import US

BATCHES_KEPT: Final = 4
"""Number of batches that can be undone: 40 ms, more than two lost frames."""
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

MOST_IN_A_ROW: Final = 8
"""After this many refused edges in a row the filter's state is taken to be wrong, not the edges."""
LEAST_GAIN: Final = 0.2
SHORT_S: Final = 2e-3
"""In a shorter step a change of the pressure law's segment is ignored: its fit has larger
errors."""
MOST_NOISE_SCALE: Final = 1e4
"""A hundred times the model's accelerations."""
MOST_SWINGING: Final = 3
"""Edges refused in a row by which a shaft swings further than was thought; its modes are known, and
each edge that is refused costs more of a swing than of a steady trajectory."""
WIDER: Final = 10.0
"""A covariance is multiplied by this then."""
LED_SHARE: Final = 0.2
LED_RAD_S2: Final = 100.0
"""Standard deviations added when the filter was wrong: to the speed, as a share of it, and to the
steady acceleration."""


State = TypeVar("State")
Motion = TypeVar("Motion")
Step = TypeVar("Step")


class FilterSnapshot(Generic[State]):
    """A copy of the filter's state, to go back to when late edges arrive."""

    time_us: float
    """Of the state."""
    state: State
    p: Annotated[Vector, State, State]
    """Its covariance."""
    noise_scale: float
    """Process noise over that of the model, by the innovations lately."""


class Filter(FilterSnapshot[State], Generic[State, Motion, Step]):
    """A crossing-time filter by a model: the records of its state, of its motion, and of a step of
    it. The fields of `FilterSnapshot` come first."""

    # Parameters.
    noise_adaptation: float
    """How fast `noise_scale` follows the innovations, a share an edge; 0: the model's noise
    holds."""
    edge_time_s: float
    """Standard deviation of an edge's time."""
    tooth_rad: float
    """Standard deviation of an edge's angle."""
    pressure_sd_pa: float
    """Standard deviation of the measured pressure, where one is measured."""
    gate_sd: float
    """An edge is refused if its innovation exceeds this many standard deviations."""
    model: Motion

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
    step: Step
    gain: Annotated[Vector, State]
    """The last Kalman gain."""
    ring: Annotated[Records[FilterSnapshot[State]], BATCHES_KEPT]
    """Snapshots taken before each of the last batches."""

    x: Annotated[Vector, Over("state"), State]
    motion: Annotated[Vector, Over("model"), Motion]
    nis: Annotated[Vector, Over("squares"), 2]
    snapshot: Annotated[Vector, Over("time_us"), FilterSnapshot[State]]
    snapshots: Annotated[Vector, Over("ring"), BATCHES_KEPT, FilterSnapshot[State]]


LayshaftFilter = Filter[MotionState, Model, MotionStep]
SwingFilter = Filter[SwingState, SwingModel, SwingStep]
FILTER: Final = layout_of(LayshaftFilter)
SWING_FILTER: Final = layout_of(SwingFilter)


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


@bare
def crossing_filter(
    memory: Vector, edges: Vector, pressure_us: Vector, pressure_pa: Vector, switches: Vector,
    teeth: Vector,
) -> int:  # fmt: skip
    """The filter over a batch of edges and pressure samples, both rising in time, in place.

    memory: a `Filter`; edges (2, n): times and the angles they stand for; switches as in `travel`.
    To learn teeth: teeth as `TeethArrays` has it, and edges with a third row, which of the wheel's
    N edges each is; N = 0 otherwise.

    Returns LATE and takes nothing if the batch begins before the state's time and a snapshot is
    held to go back to; if none is held, edges not later than the state are skipped. Otherwise
    keeps a snapshot of the state before the batch and returns DONE."""
    f = record_on(memory, FILTER)
    edge_us = edges[0]
    n, m = edge_us.shape[0], pressure_us.shape[0]
    if f.held > 0 and n > 0 and edge_us[0] < f.time_us:
        return LATE
    keep(f)
    i, j, k = input_at(f.time_us, switches[0]), 0, 0
    while k < n or j < m:
        pressure_is_next = j < m and (k == n or pressure_us[j] < edge_us[k])
        when_us = pressure_us[j] if pressure_is_next else edge_us[k]
        late = when_us <= f.time_us
        if not late:
            i = move(f, when_us, i, switches, teeth)
        if pressure_is_next:
            if not late:
                take_pressure(f, pressure_pa[j], teeth)
            j += 1
        else:
            if not late:
                take_edge(f, edges, k, DRAG, teeth)
            k += 1
        f.state.gain = max(f.state.gain, LEAST_GAIN)
    mirror(f.p, STATES)
    return DONE


@inlined
def keep(f: Filter[Any, Any, Any]) -> None:
    """Copies the present state into the ring of snapshots."""
    for k in range(f.snapshot.shape[0]):
        f.snapshots[f.next, k] = f.snapshot[k]
    f.next = (f.next + 1) % BATCHES_KEPT
    f.held = min(f.held + 1, BATCHES_KEPT)


@inlined
def move(f: LayshaftFilter, to_us: float, i: int, switches: Vector, teeth: Vector) -> int:
    """State, covariance and tooth derivatives to a time; returns the number of switches passed."""
    t_us, state, model, step = f.time_us, f.state, f.model, f.step
    while t_us < to_us:
        u, until_us = valve_after(i, switches, to_us)
        dt = (until_us - t_us) * US
        part = dt
        if dt > SHORT_S:
            part = min(longest_in_segment(model, u, state.pressure_pa, dt), LONGEST_S)
        transition(state, part, u, model, step)
        spread_over(f.p, part, step, model, state.gain, f.noise_scale)
        if teeth.shape[1] > 0:
            carry(teeth, step.theta_by, step.omega_by)
            for c in range(teeth.shape[1]):
                teeth[PRESSURE, c] *= step.pressure_left
                teeth[DISTURBANCE, c] *= step.disturbance_left
        if part < dt:
            t_us += part / US
        else:
            t_us = until_us
            if i < switches.shape[1] and switches[0, i] <= until_us:
                i += 1
    f.time_us = to_us
    return i


@bare
def swing_filter(
    memory: Vector, edges: Vector, pressure_us: Vector, pressure_pa: Vector, switches: Vector,  # noqa: ARG001
    teeth: Vector,
) -> int:  # fmt: skip
    """As `crossing_filter`, on a `SwingFilter`. A main shaft has no brake: pressures and switches
    are not read."""
    f = record_on(memory, SWING_FILTER)
    edge_us = edges[0]
    n = edge_us.shape[0]
    if f.held > 0 and n > 0 and edge_us[0] < f.time_us:
        return LATE
    keep(f)
    for k in range(n):
        if edge_us[k] > f.time_us:
            swing_to(f, edge_us[k], teeth)
            take_edge(f, edges, k, -1, teeth)
    mirror(f.p, SWING_STATES)
    return DONE


@inlined
def swing_to(f: SwingFilter, to_us: float, teeth: Vector) -> None:
    """As `move`, in one step."""
    dt, step = (to_us - f.time_us) * US, f.step
    swing_step(dt, f.model, step)
    swing_on(f.state, step)
    swing_spread(f.p, dt, step, f.model, f.noise_scale)
    if teeth.shape[1] > 0:
        carry(teeth, step.theta_by, step.omega_by)
        angle, speed, block = teeth[SWING], teeth[RATE], step.block
        for c in range(teeth.shape[1]):
            q, r = angle[c], speed[c]
            angle[c] = block[0] * q + block[1] * r
            speed[c] = block[2] * q + block[3] * r
    f.time_us = to_us


@inlined
def take_pressure(f: LayshaftFilter, pressure_pa: float, teeth: Vector) -> None:
    """One sample of the measured pressure into the filter."""
    r = f.pressure_sd_pa * f.pressure_sd_pa
    innovation = pressure_pa - f.state.pressure_pa
    measure(f.x, f.p, PRESSURE, innovation, r, f.gain)
    for c in range(teeth.shape[1]):
        teeth[ROW, c] = -teeth[PRESSURE, c]
    follow(teeth, f.gain)


@inlined
def take_edge(f: Filter[Any, Any, Any], edges: Vector, k: int, led: int, teeth: Vector) -> None:
    """The k-th edge into the filter, and into what teeth are learned by. led: row of the steady
    acceleration that an unseen torque changes, or -1: there the whole covariance is widened
    instead."""
    innovation = edges[1, k] - f.state.theta_rad
    s = take_angle(f, innovation, led)
    if teeth.shape[1] > 0 and s > 0.0:
        learn(teeth, int(edges[2, k]), innovation, s)
        follow(teeth, f.gain)


@inlined
def take_angle(f: Filter[Any, Any, Any], innovation: float, led: int) -> float:
    """An edge's angle into the filter; returns the innovation's variance, 0 where the gate refused
    it."""
    p, omega = f.p, f.state.omega_rad_s
    sigma = omega * f.edge_time_s
    r = sigma * sigma + f.tooth_rad * f.tooth_rad
    square = innovation * innovation / (p[THETA, THETA] + r)
    if f.noise_adaptation > 0.0:
        surprise = min(square, f.gate_sd * f.gate_sd) - 1.0
        noise_scale = f.noise_scale * (1.0 + f.noise_adaptation * surprise)
        f.noise_scale = min(max(noise_scale, 1.0), MOST_NOISE_SCALE)
    if square > f.gate_sd * f.gate_sd:
        f.gated_in_a_row += 1
        if f.gated_in_a_row < (MOST_IN_A_ROW if led >= 0 else MOST_SWINGING):
            return 0.0
        # This many refused in a row: the state is wrong, so its covariance is widened.
        widen(f, innovation, led)
    else:
        f.squares += square
        f.count += 1.0
        f.log_variance += math.log(p[THETA, THETA] + r)
    f.gated_in_a_row = 0
    return measure(f.x, p, THETA, innovation, r, f.gain)


@inlined
def widen(f: Filter[Any, Any, Any], innovation: float, led: int) -> None:
    """Widens the covariance of a state that has been found wrong."""
    p, omega = f.p, f.state.omega_rad_s
    p[THETA, THETA] += innovation * innovation
    if led >= 0:
        p[OMEGA, OMEGA] += (LED_SHARE * omega) ** 2
        p[led, led] += LED_RAD_S2 * LED_RAD_S2
        return
    states = f.gain.shape[0]
    for j in range(states):
        for k in range(j, states):
            p[j, k] *= WIDER


@inlined
def learn(teeth: Vector, place: int, innovation: float, s: float) -> None:
    """Adds one innovation to the teeth's normal equations; ROW becomes its m."""
    size, row = teeth.shape[1], teeth[ROW]
    for c in range(size):
        row[c] = -teeth[THETA, c]
    row[place] += 1.0
    for c in range(size):
        weighted = row[c] / s
        teeth[RIGHT, c] -= weighted * innovation
        # Counted from 0 on, several are added at a time: an index from c on might be negative.
        equation, rest = teeth[NORMAL + c, c:], row[c:]
        for d in range(rest.shape[0]):
            equation[d] += weighted * rest[d]


@inlined
def follow(teeth: Vector, gain: Vector) -> None:
    """The derivatives by the tooth errors after an update."""
    for state in range(gain.shape[0]):
        for c in range(teeth.shape[1]):
            teeth[state, c] += gain[state] * teeth[ROW, c]


@inlined
def carry(teeth: Vector, theta_by: Vector, omega_by: Vector) -> None:
    """The derivatives of angle and speed by the tooth errors after a step; row by row, ROW being
    free."""
    size, theta, omega = teeth.shape[1], teeth[THETA], teeth[ROW]
    for c in range(size):
        omega[c] = 0.0
    for k in range(1, theta_by.shape[0]):
        state, by_theta, by_omega = teeth[k], theta_by[k], omega_by[k]
        for c in range(size):
            theta[c] += by_theta * state[c]
            omega[c] += by_omega * state[c]
    for c in range(size):
        teeth[OMEGA, c] = omega[c]


@compiled
def cholesky(matrix: Vector) -> Vector:
    """The lower factor of a symmetric positive definite matrix (n, n); NaN where it is not one. A
    wheel's equations are small: threads of a linear algebra library would cost more than the sum,
    and need not add up in the same order twice.

    Column by column, here and below, with the sums of all its elements side by side: each waits for
    its own last term alone."""
    n = matrix.shape[0]
    upper = np.zeros((n, n))
    for j in range(n):
        column = upper[j, j:]  # from the diagonal on
        for i in range(n - j):
            column[i] = matrix[j + i, j]
        for k in range(j):
            factor, before = upper[k, j], upper[k, j:]
            for i in range(n - j):
                column[i] -= before[i] * factor
        if not column[0] > 0.0:
            return np.full((n, n), np.nan)
        root = math.sqrt(column[0])
        for i in range(n - j):
            column[i] /= root
        column[0] = root
    return np.ascontiguousarray(upper.T)


@compiled
def inverse_by_root(lower: Vector) -> Vector:
    """The inverse of a matrix (n, n) by its lower factor; NaN where it has none."""
    n = lower.shape[0]
    if not lower[0, 0] > 0.0:
        return lower
    half, inverse = np.zeros((n, n)), np.empty((n, n))
    for i in range(n):
        row = half[i]
        for k in range(i):
            factor = lower[i, k]
            for c in range(k + 1):
                row[c] -= factor * half[k, c]
        for c in range(i):
            row[c] /= lower[i, i]
        row[i] = 1.0 / lower[i, i]
    sums = np.empty(n)
    for i in range(n):
        sums[:] = 0.0
        for k in range(i, n):
            factor = half[k, i]
            for j in range(i + 1):
                sums[j] += factor * half[k, j]
        for j in range(i + 1):
            inverse[i, j] = inverse[j, i] = sums[j]
    return inverse


def inverse_of_positive(matrix: Vector) -> Vector:
    """The inverse of a symmetric positive definite matrix (n, n); NaN where it is not one."""
    return inverse_by_root(cholesky(matrix))
