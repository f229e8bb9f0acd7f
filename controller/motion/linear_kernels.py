"""The numeric inner loops of the controller, each one function for live, replay and studies alike.

Compiled by numba; with NUMBA_DISABLE_JIT=1 the same code runs as plain Python. State is updated in
place, because boxing a returned tuple costs more than a whole batch of edges.

The model is the state space of thesis 4.15 with x = [theta_LS, omega_LS, p_valve - p_0]:

    omega' = -a omega - g p,   p' = -b p + b K u,   a = c/J, b = 1/tau, g = C_db/J, K supply gauge

(C_db taken positive: the brake acts against rotation.) Its zero-order hold (5.17, 5.18) in closed
form, with phi_x = (1 - e^(-x D))/x, h = (e^(-aD) - e^(-bD))/(b - a), H = (phi_a - phi_b)/(b - a):

    Phi   = [[1, phi_a, -g H], [0, e^(-aD), -g h], [0, 0, e^(-bD)]]
    Gamma = [-g((D - phi_a)/a - H), -g(phi_a - h), 1 - e^(-bD)] K
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from meshpoint.controller.jit import compiled

Vector = NDArray[np.float64]

RATE_A: Final = 0
"""Indices into the model vector [a, b, g, K]."""
RATE_B: Final = 1
BRAKE_G: Final = 2
SUPPLY_K: Final = 3
US: Final = 1e-6


@compiled
def hold(dt: float, model: Vector, phi: Vector, gamma: Vector) -> None:
    """Phi and Gamma over `dt` seconds. phi[0..5]: the six elements of Phi that are not 0 or 1,
    (0,1) (0,2) (1,1) (1,2) (2,2); gamma[0..2]. Written in place."""
    a, b, g = model[0], model[1], model[2]
    if abs(b - a) < 1e-6 * b:
        # Equal rates are a removable singularity; a part in a million of tau is below any data.
        b = a + 1e-6 * b
    e_a, e_b = math.exp(-a * dt), math.exp(-b * dt)
    if a * dt < 1e-3:
        phi_a = dt * (1.0 - a * dt * (0.5 - a * dt * (1.0 / 6.0 - a * dt / 24.0)))
        rest = dt * dt * (0.5 - a * dt * (1.0 / 6.0 - a * dt * (1.0 / 24.0 - a * dt / 120.0)))
    else:
        phi_a = -math.expm1(-a * dt) / a
        rest = (dt - phi_a) / a
    phi_b = -math.expm1(-b * dt) / b
    h = (e_a - e_b) / (b - a)
    big_h = (phi_a - phi_b) / (b - a)
    phi[0], phi[1], phi[2], phi[3], phi[4] = phi_a, -g * big_h, e_a, -g * h, e_b
    gamma[0] = -g * (rest - big_h) * model[3]
    gamma[1] = -g * (phi_a - h) * model[3]
    gamma[2] = b * phi_b * model[3]


@compiled
def advance(x: Vector, dt: float, u: float, model: Vector, phi: Vector, gamma: Vector) -> None:
    """One zero-order-hold step of the state, in place (thesis 5.17)."""
    hold(dt, model, phi, gamma)
    x[0] += phi[0] * x[1] + phi[1] * x[2] + gamma[0] * u
    x[1] = phi[2] * x[1] + phi[3] * x[2] + gamma[1] * u
    x[2] = phi[4] * x[2] + gamma[2] * u


@compiled
def propagate(
    x: Vector, t_us: float, to_us: float, switch_us: Vector, switch_u: Vector, model: Vector
) -> None:
    """Moves the state from `t_us` to `to_us` through every brake switch between, in place.

    switch_us must rise; switch_u[i] holds from switch_us[i] on; before the first one u = 0."""
    phi, gamma = np.empty(5), np.empty(3)
    u, i, n = 0.0, 0, switch_us.shape[0]
    while i < n and switch_us[i] <= t_us:
        u = switch_u[i]
        i += 1
    while i < n and switch_us[i] < to_us:
        advance(x, (switch_us[i] - t_us) * US, u, model, phi, gamma)
        t_us, u = switch_us[i], switch_u[i]
        i += 1
    advance(x, (to_us - t_us) * US, u, model, phi, gamma)


@compiled
def spread(p: Vector, dt: float, phi: Vector, w: Vector) -> None:
    """Covariance prediction P = Phi P Phi' + Q (5.3) with Q = (w dt)(w dt)' (5.8), in place."""
    f01, f02, f11, f12, f22 = phi[0], phi[1], phi[2], phi[3], phi[4]
    p00, p01, p02 = p[0, 0], p[0, 1], p[0, 2]
    p11, p12, p22 = p[1, 1], p[1, 2], p[2, 2]
    r00 = p00 + f01 * p01 + f02 * p02
    r01 = p01 + f01 * p11 + f02 * p12
    r02 = p02 + f01 * p12 + f02 * p22
    r11 = f11 * p11 + f12 * p12
    r12 = f11 * p12 + f12 * p22
    q0, q1, q2 = w[0] * dt, w[1] * dt, w[2] * dt
    p[0, 0] = r00 + f01 * r01 + f02 * r02 + q0 * q0
    p[0, 1] = f11 * r01 + f12 * r02 + q0 * q1
    p[0, 2] = f22 * r02 + q0 * q2
    p[1, 1] = f11 * r11 + f12 * r12 + q1 * q1
    p[1, 2] = f22 * r12 + q1 * q2
    p[2, 2] = f22 * p22 * f22 + q2 * q2
    p[1, 0], p[2, 0], p[2, 1] = p[0, 1], p[0, 2], p[1, 2]


@compiled
def correct(x: Vector, p: Vector, y: float, r: float) -> None:
    """Measurement update with C = [1, 0, ...] (5.4-5.7), in place; any number of states."""
    n = x.shape[0]
    s = p[0, 0] + r
    innovation = y - x[0]
    gain = p[:, 0] / s
    row = p[0, :].copy()
    for i in range(n):
        x[i] += gain[i] * innovation
        for j in range(n):
            p[i, j] -= gain[i] * row[j]


@compiled
def thesis_filter(
    x: Vector,
    p: Vector,
    t_us: float,
    edge_us: Vector,
    edge_rad: Vector,
    switch_us: Vector,
    switch_u: Vector,
    model: Vector,
    w: Vector,
    r: float,
) -> float:
    """The thesis's event-driven Kalman filter (5.1-5.9) over a batch of edges, in place.

    x (3,), p (3, 3) at time `t_us`; edge_us rising, edge_rad the angle each edge stands for (5.9);
    brake switches as in `propagate`. Returns the time of the new state. Edges not later than the
    state are skipped: they were used before."""
    phi, gamma = np.empty(5), np.empty(3)
    u, i, n = 0.0, 0, switch_us.shape[0]
    for k in range(edge_us.shape[0]):
        if edge_us[k] <= t_us:
            continue
        while i < n and switch_us[i] <= t_us:
            u = switch_u[i]
            i += 1
        while i < n and switch_us[i] < edge_us[k]:
            dt = (switch_us[i] - t_us) * US
            advance(x, dt, u, model, phi, gamma)
            spread(p, dt, phi, w)
            t_us, u = switch_us[i], switch_u[i]
            i += 1
        dt = (edge_us[k] - t_us) * US
        advance(x, dt, u, model, phi, gamma)
        spread(p, dt, phi, w)
        t_us = edge_us[k]
        correct(x, p, edge_rad[k], r)
    return t_us


@compiled
def cruise_filter(
    x: Vector,
    p: Vector,
    t_us: float,
    edge_us: Vector,
    edge_rad: Vector,
    acceleration_rad_s2: float,
    edge_time_s: float,
) -> float:
    """Constant-speed Kalman filter over a batch of edges, x = [theta, omega], in place.

    Process noise is a random acceleration held over each interval; the measurement's variance is
    (omega sigma_t)^2, since the angle of an edge is exact and its time is not. Returns the time of
    the new state."""
    for k in range(edge_us.shape[0]):
        if edge_us[k] <= t_us:
            continue
        dt = (edge_us[k] - t_us) * US
        q = acceleration_rad_s2 * dt
        x[0] += x[1] * dt
        p[0, 0] += dt * (p[0, 1] + p[1, 0] + dt * p[1, 1]) + 0.25 * q * q * dt * dt
        p[0, 1] += dt * p[1, 1] + 0.5 * q * q * dt
        p[1, 0] = p[0, 1]
        p[1, 1] += q * q
        t_us = edge_us[k]
        sigma = x[1] * edge_time_s
        correct(x, p, edge_rad[k], sigma * sigma + 1e-12)
    return t_us
