"""A further wheel's edges in the crossing-time filter: the offset between two wheels as a state.

A wheel on a shaft that turns with the filter's own by an exact ratio i stands at theta_2; its edge,
as an angle of the filter's shaft, is

    i (theta_2k + delta_2k) = theta + o,      R = (omega sigma_t)^2 + (i sigma_delta2)^2

o is constant but for the mesh's backlash: a random walk, slow while the mesh lies at one flank,
fast while it may change to the other. It is a seventh state: beside P its variance and its
covariances c with the six. An update of one of the six by gain K and variance s takes c_i^2 / s
from its variance and K c_i from c; an edge of the further wheel has H = [1 0 0 0 0 0 | 1]. Where o
is not known, the first edge gives it: o = y - theta, c = -P e_theta, variance p_theta + R, which
is the limit of a prior without bounds.

Pieces of `crossing_filter`; floats and integers as `crossing_layout` has them.
"""

from __future__ import annotations

from typing import Final

from meshpoint.controller.estimation.crossing_layout import (
    AGREEMENT,
    ASTRAY,
    CROSS,
    GATE,
    GATED,
    MESH,
    OFFSET,
    OFFSET_VAR,
    SENSOR,
    SIGMA_FURTHER,
    SIGMA_TIME,
    TAKEN,
    Integers,
)
from meshpoint.controller.jit import inlined
from meshpoint.controller.motion.kernels import OMEGA, STATES, THETA, Vector

MOST_IN_A_ROW: Final = 8
"""So many refused edges in a row mean that the filter is wrong, not the edges."""


@inlined
def carry_offset(floats: Vector, f: Vector, dt: float, loose: bool) -> None:
    """The offset over a step; f of `transition`; loose: the mesh may change its flank."""
    theta, omega = floats[CROSS], 0.0
    for k in range(1, STATES):
        theta += f[0, k] * floats[CROSS + k]
        omega += f[1, k] * floats[CROSS + k]
    floats[CROSS], floats[CROSS + 1] = theta, omega
    floats[CROSS + 2] *= f[2, 2]
    floats[CROSS + 3] *= f[2, 3]
    floats[OFFSET_VAR] += dt * (floats[MESH + 1] if loose else floats[MESH])


@inlined
def follow_offset(floats: Vector, i: int, innovation: float, s: float, gain: Vector) -> None:
    """The offset after the i-th state was measured: innovation, its variance, the gain used."""
    shared = floats[CROSS + i]
    floats[OFFSET] += shared / s * innovation
    floats[OFFSET_VAR] -= shared / s * shared
    for k in range(STATES):
        floats[CROSS + k] -= gain[k] * shared


@inlined
def take_further(
    floats: Vector, integers: Integers, x: Vector, p: Vector, angle: float, gain: Vector
) -> None:
    """One edge of the further wheel, as an angle of the shaft, into the filter."""
    sigma, tooth = x[OMEGA] * floats[SENSOR + SIGMA_TIME], floats[SENSOR + SIGMA_FURTHER]
    r = sigma * sigma + tooth * tooth
    if floats[OFFSET_VAR] <= 0.0:
        floats[OFFSET] = angle - x[THETA]
        floats[OFFSET_VAR] = p[THETA, THETA] + r
        for k in range(STATES):
            floats[CROSS + k] = -p[THETA, k]
        return
    innovation = angle - x[THETA] - floats[OFFSET]
    own = floats[CROSS] + floats[OFFSET_VAR]
    s = p[THETA, THETA] + floats[CROSS] + own + r
    square = innovation * innovation / s
    if square > floats[SENSOR + GATE] * floats[SENSOR + GATE]:
        integers[GATED] += 1
        integers[ASTRAY] += 1
        if integers[ASTRAY] >= MOST_IN_A_ROW:
            # The wheels stand otherwise to each other than before.
            floats[OFFSET_VAR], integers[ASTRAY] = 0.0, 0
        return
    integers[ASTRAY] = 0
    integers[TAKEN] += 1
    floats[AGREEMENT] += square
    floats[AGREEMENT + 1] += 1.0
    for k in range(STATES):
        gain[k] = (p[THETA, k] + floats[CROSS + k]) / s
    for j in range(STATES):
        x[j] += gain[j] * innovation
        for k in range(j, STATES):
            p[j, k] -= gain[j] * s * gain[k]
        floats[CROSS + j] -= gain[j] * own
    floats[OFFSET] += own / s * innovation
    floats[OFFSET_VAR] -= own / s * own
