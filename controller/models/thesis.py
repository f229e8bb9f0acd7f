"""The thesis's layshaft and filter, each one function for live, replay and studies.

The model is the state space of thesis 4.15 with x = [theta_LS, omega_LS, p_valve - p_0]:

    omega' = -a omega - g p,   p' = -b p + b K u,   a = c/J, b = 1/tau, g = C_db/J, K supply gauge

(C_db taken positive: the brake acts against rotation.) Its zero-order hold (5.17, 5.18) in closed
form, with phi_x = (1 - e^(-x D))/x, h = (e^(-aD) - e^(-bD))/(b - a), H = (phi_a - phi_b)/(b - a):

    Phi   = [[1, phi_a, -g H], [0, e^(-aD), -g h], [0, 0, e^(-bD)]]
    Gamma = [-g((D - phi_a)/a - H), -g(phi_a - h), 1 - e^(-bD)] K

The hold over the known future brake commands is exact for the model, not only at sampling points,
because every switch of the input is a step of its own.

Compiled by numba; with NUMBA_DISABLE_JIT=1 the same code runs as plain Python. State is updated in
place, because boxing a returned tuple costs more than a whole batch of edges.
"""

from __future__ import annotations

import math
from typing import Annotated, Final

from meshpoint.gearbox import GearboxSheet, Split
from meshpoint.kernels.jit import compiled, inlined, new_record, record_on
from meshpoint.kernels.records import Over, Vector, filled, layout_of
from meshpoint.units import US


class Linear:
    """The model's parameters."""

    friction_per_s: float
    """`a`: viscous friction over inertia."""
    brake_per_s: float
    """`b`: one over the brake's time constant."""
    brake_rad_s2_pa: float
    """`g`: deceleration by the brake's pressure."""
    supply_pa: float
    """`K`: the pressure that the brake's tends to with the valve on."""


class Hold:
    """The elements of Phi and Gamma that are not 0 or 1; u: the valve's input."""

    theta_by_omega: float
    theta_by_pressure: float
    omega_by_omega: float
    omega_by_pressure: float
    pressure_by_pressure: float
    theta_by_u: float
    omega_by_u: float
    pressure_by_u: float


class ThesisFilter:
    """State and parameters of `thesis_filter`."""

    time_us: float
    """Of the state."""
    x: Annotated[Vector, 3]
    """Angle (rad), speed (rad/s), brake pressure (Pa, gauge)."""
    p: Annotated[Vector, 3, 3]
    """Its covariance."""
    linear: Linear
    w: Annotated[Vector, 3]
    """Process noise of the state, a second."""
    r_rad2: float
    """Variance of an edge's angle."""
    model: Annotated[Vector, Over("linear"), 4]


class CruiseFilter:
    """State and parameters of `cruise_filter`."""

    time_us: float
    """Of the state."""
    x: Annotated[Vector, 2]
    """Angle (rad), speed (rad/s)."""
    p: Annotated[Vector, 2, 2]
    """Its covariance."""
    acceleration_rad_s2: float
    """Standard deviation of the acceleration that drives it."""
    edge_time_s: float
    """Standard deviation of an edge's time."""


LINEAR: Final = layout_of(Linear)
HOLD: Final = layout_of(Hold)
THESIS_FILTER: Final = layout_of(ThesisFilter)
CRUISE_FILTER: Final = layout_of(CruiseFilter)


@inlined
def hold(dt: float, linear: Linear, held: Hold) -> None:
    """Phi and Gamma over `dt` seconds, written to `held`."""
    a, b, g = linear.friction_per_s, linear.brake_per_s, linear.brake_rad_s2_pa
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
    held.theta_by_omega, held.theta_by_pressure = phi_a, -g * big_h
    held.omega_by_omega, held.omega_by_pressure = e_a, -g * h
    held.pressure_by_pressure = e_b
    held.theta_by_u = -g * (rest - big_h) * linear.supply_pa
    held.omega_by_u = -g * (phi_a - h) * linear.supply_pa
    held.pressure_by_u = b * phi_b * linear.supply_pa


@inlined
def advance(x: Vector, dt: float, u: float, linear: Linear, held: Hold) -> None:
    """One zero-order-hold step of the state (3,), in place (5.17), `held` with it."""
    hold(dt, linear, held)
    x[0] += held.theta_by_omega * x[1] + held.theta_by_pressure * x[2] + held.theta_by_u * u
    x[1] = held.omega_by_omega * x[1] + held.omega_by_pressure * x[2] + held.omega_by_u * u
    x[2] = held.pressure_by_pressure * x[2] + held.pressure_by_u * u


@compiled
def propagate(x: Vector, t_us: float, to_us: float, switches: Vector, model: Vector) -> None:
    """Moves the state from `t_us` to `to_us` through every brake switch between, in place.

    switches (2, n): rising times, and the u that holds from each on; before the first one u = 0.
    model: a `Linear`."""
    switch_us, switch_u = switches[0], switches[1]
    linear, held = record_on(model, LINEAR), new_record(HOLD)
    u, i, n = 0.0, 0, switch_us.shape[0]
    while i < n and switch_us[i] <= t_us:
        u = switch_u[i]
        i += 1
    while i < n and switch_us[i] < to_us:
        advance(x, (switch_us[i] - t_us) * US, u, linear, held)
        t_us, u = switch_us[i], switch_u[i]
        i += 1
    advance(x, (to_us - t_us) * US, u, linear, held)


@inlined
def spread(p: Vector, dt: float, held: Hold, w: Vector) -> None:
    """Covariance prediction P = Phi P Phi' + Q (5.3) with Q = (w dt)(w dt)' (5.8), in place; held:
    Phi over the same time."""
    f01, f02, f11 = held.theta_by_omega, held.theta_by_pressure, held.omega_by_omega
    f12, f22 = held.omega_by_pressure, held.pressure_by_pressure
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
def thesis_filter(memory: Vector, edge_us: Vector, edge_rad: Vector, switches: Vector) -> None:
    """The thesis's event-driven Kalman filter (5.1-5.9) over a batch of edges, in place.

    memory: a `ThesisFilter`; edge_us rising, edge_rad the angle each edge stands for (5.9);
    switches as in `propagate`. Edges not later than the state are skipped: they were used before.
    """
    f = record_on(memory, THESIS_FILTER)
    x, p, w, t_us = f.x, f.p, f.w, f.time_us
    linear, held = f.linear, new_record(HOLD)
    switch_us, switch_u = switches[0], switches[1]
    u, i, n = 0.0, 0, switch_us.shape[0]
    for k in range(edge_us.shape[0]):
        if edge_us[k] <= t_us:
            continue
        while i < n and switch_us[i] <= t_us:
            u = switch_u[i]
            i += 1
        while i < n and switch_us[i] < edge_us[k]:
            dt = (switch_us[i] - t_us) * US
            advance(x, dt, u, linear, held)
            spread(p, dt, held, w)
            t_us, u = switch_us[i], switch_u[i]
            i += 1
        dt = (edge_us[k] - t_us) * US
        advance(x, dt, u, linear, held)
        spread(p, dt, held, w)
        t_us = edge_us[k]
        correct(x, p, edge_rad[k], f.r_rad2)
    f.time_us = t_us


@compiled
def cruise_filter(memory: Vector, edge_us: Vector, edge_rad: Vector) -> None:
    """Constant-speed Kalman filter over a batch of edges, in place; memory: a `CruiseFilter`.

    Process noise is a random acceleration held over each interval; the measurement's variance is
    (omega sigma_t)^2, since the angle of an edge is exact and its time is not."""
    f = record_on(memory, CRUISE_FILTER)
    x, p = f.x, f.p
    for k in range(edge_us.shape[0]):
        if edge_us[k] <= f.time_us:
            continue
        dt = (edge_us[k] - f.time_us) * US
        q = f.acceleration_rad_s2 * dt
        x[0] += x[1] * dt
        p[0, 0] += dt * (p[0, 1] + p[1, 0] + dt * p[1, 1]) + 0.25 * q * q * dt * dt
        p[0, 1] += dt * p[1, 1] + 0.5 * q * q * dt
        p[1, 0] = p[0, 1]
        p[1, 1] += q * q
        f.time_us = edge_us[k]
        sigma = x[1] * f.edge_time_s
        correct(x, p, edge_rad[k], sigma * sigma + 1e-12)


def layshaft_model(sheet: GearboxSheet, split: Split) -> Vector:
    """The `kernels.Linear` model [a, b, g, K] from the data sheet (4.4, 4.13, 4.15)."""
    inertia = sheet.inertia_kgm2(split)
    return filled(
        LINEAR,
        friction_per_s=sheet.shafts.friction_nms / inertia,
        brake_per_s=1.0 / sheet.brake.time_constant_s,
        brake_rad_s2_pa=sheet.brake_nm_per_pa / inertia,
        supply_pa=sheet.air.supply_gauge_pa,
    )
