"""A geared wheel's edges in the crossing-time filter: the offset between two wheels as a state.

A wheel on a shaft that turns with the filter's own by an exact ratio i stands at theta_2; its edge,
as an angle of the filter's shaft, is

    i (theta_2k + delta_2k) = theta + o,      R = (omega sigma_t)^2 + (i sigma_delta2)^2

o is constant but for the mesh's backlash: a random walk, slow while the mesh lies at one flank,
fast while it may change to the other. It is a seventh state: beside P its variance and its
covariances c with the six. An update of one of the six by gain K and variance s takes c_i^2 / s
from its variance and K c_i from c; an edge of the geared wheel has H = [1 0 0 0 0 0 | 1]. Where o
is not known, the first edge gives it: o = y - theta, c = -P e_theta, variance p_theta + R, which
is the limit of a prior without bounds.

Pieces of `crossing_filter`, on its `Filter`.
"""

from __future__ import annotations

from typing import Final

from meshpoint.controller.estimation.crossing_layout import Filter
from meshpoint.controller.jit import inlined
from meshpoint.controller.motion.kernels import DISTURBANCE, OMEGA, PRESSURE, STATES, THETA

MOST_IN_A_ROW: Final = 8
"""After this many refused edges in a row the filter's state is taken to be wrong, not the edges."""


@inlined
def carry_offset(f: Filter, dt: float, loose: bool) -> None:
    """The offset over a step of the shaft; loose: the mesh may change its flank."""
    by, step = f.offset_by, f.step
    theta, omega = by[THETA], 0.0
    for k in range(1, STATES):
        theta += step.theta_by[k] * by[k]
        omega += step.omega_by[k] * by[k]
    by[THETA], by[OMEGA] = theta, omega
    by[PRESSURE] *= step.pressure_left
    by[DISTURBANCE] *= step.disturbance_left
    f.offset_rad2 += dt * (f.loose_rad2_s if loose else f.at_flank_rad2_s)


@inlined
def follow_offset(f: Filter, i: int, innovation: float, s: float, states: int) -> None:
    """The offset after the i-th of the states was measured: innovation and its variance."""
    by = f.offset_by
    shared = by[i]
    f.offset_rad += shared / s * innovation
    f.offset_rad2 -= shared / s * shared
    for k in range(states):
        by[k] -= f.gain[k] * shared


@inlined
def take_geared(f: Filter, angle_rad: float, states: int) -> None:
    """One edge of the geared wheel, as an angle of the shaft, into the filter of so many states."""
    p, by, x, gain = f.p, f.offset_by, f.x, f.gain
    sigma, tooth = f.state.omega_rad_s * f.edge_time_s, f.geared_tooth_rad
    r = sigma * sigma + tooth * tooth
    if f.offset_rad2 <= 0.0:
        f.offset_rad = angle_rad - f.state.theta_rad
        f.offset_rad2 = p[THETA, THETA] + r
        for k in range(states):
            by[k] = -p[THETA, k]
        return
    innovation = angle_rad - f.state.theta_rad - f.offset_rad
    own = by[THETA] + f.offset_rad2
    s = p[THETA, THETA] + by[THETA] + own + r
    square = innovation * innovation / s
    if square > f.gate_sd * f.gate_sd:
        f.astray_in_a_row += 1
        if f.astray_in_a_row >= MOST_IN_A_ROW:
            # The offset between the wheels has changed.
            f.offset_rad2, f.astray_in_a_row = 0.0, 0
        return
    f.astray_in_a_row = 0
    f.squares += square
    f.count += 1.0
    for k in range(states):
        gain[k] = (p[THETA, k] + by[k]) / s
    for j in range(states):
        x[j] += gain[j] * innovation
        for k in range(j, states):
            p[j, k] -= gain[j] * s * gain[k]
        by[j] -= gain[j] * own
    f.offset_rad += own / s * innovation
    f.offset_rad2 -= own / s * own
