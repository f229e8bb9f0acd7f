"""The crossing-time filter of a main shaft whose driveline swings: `crossing_kernels` with the
states of `models/swing_kernels`, and what it and the layshaft's filter are chosen by."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

from meshpoint.controller.estimate.crossing_kernels import (
    crossing_filter,
    follow,
    keep,
    learn,
    take_edge,
)
from meshpoint.controller.estimate.crossing_layout import DONE, LATE, ROW, FilterMemory
from meshpoint.controller.estimate.swing_layout import (
    SWING_FILTER,
    SWING_SNAPSHOT_WORDS,
    SwingFilter,
    swing_memory,
)
from meshpoint.controller.models.layshaft_kernels import OMEGA, THETA, mirror
from meshpoint.controller.models.swing import (
    RATE,
    SWING,
    SWING_STATES,
    SwingStep,
    swing_on,
    swing_spread,
    swing_step,
)
from meshpoint.kernels.jit import bare, inlined
from meshpoint.kernels.records import Vector
from meshpoint.units import US


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
