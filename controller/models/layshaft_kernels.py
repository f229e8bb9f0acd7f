"""The layshaft's motion in closed form: six states, a pressure law, and their covariance.

    theta' = omega
    omega' = -a omega - g gamma p + d + s
    p'     = r_i - b_i p        (segment i of the pressure law, by p and by the valve's state)
    d'     = -b_d d + white     (torque of short memory: engine orders, meshes, oil)
    gamma' = white, s' = white  (brake gain; steady drag: both learned from shift to shift)

a = c/J, g = C_db/J of thesis 4.15. A pressure law of one segment a direction with b = 1/tau and
r = u K/tau is thesis 4.1; several segments follow a real valve (ISO 6358). With phi_x = (1 -
e^(-x D))/x, h = (e^(-aD) - e^(-bD))/(b - a), H = (phi_a - phi_b)/(b - a) and the integral R of
phi_a, a step of D adds to omega -g gamma (h p + r (phi_a - h)/b) and to theta -g gamma (H p +
r (R - H)/b); d and s enter with the same functions, b = b_d and b = 0.

The same kernels serve the main shaft, with g = 0. Compiled by numba; with NUMBA_DISABLE_JIT=1 the
same code runs as plain Python. State is updated in place.
"""

from __future__ import annotations

import math
from typing import Annotated, Final

import numpy as np

from meshpoint.kernels.jit import compiled, inlined, new_record, record_on
from meshpoint.kernels.records import Over, Records, Vector, layout_of
from meshpoint.units import US

STATES: Final = 6
THETA: Final = 0
OMEGA: Final = 1
PRESSURE: Final = 2
DISTURBANCE: Final = 3
GAIN: Final = 4
DRAG: Final = 5
"""Rows of the covariance: the fields of `MotionState` in their order."""
SEGMENTS: Final = 6
LONGEST_S: Final = 5e-3
"""Within this step the process noise of `spread_over` is good to 2 %."""


class MotionState:
    """The six states of a shaft."""

    theta_rad: float
    omega_rad_s: float
    pressure_pa: float
    """Brake pressure, gauge, above the touch."""
    disturbance_rad_s2: float
    """Acceleration by torques of short memory."""
    gain: float
    """Brake torque over that of the data sheet."""
    drag_rad_s2: float
    """Steady acceleration beside the viscous friction."""
    x: Annotated[Vector, Over("theta_rad"), STATES]
    """All six."""


class LawSegment:
    """A stretch of the pressure law: p' = r - b p."""

    above_pa: float
    """Its lowest pressure; infinite where it is not used."""
    b_per_s: float
    r_pa_s: float


class Model:
    """How a shaft is taken to move."""

    friction_per_s: float
    """`a`: viscous friction over inertia."""
    brake_rad_s2_pa: float
    """`g`: deceleration by the brake's pressure."""
    fading_per_s: float
    """`b_d`: rate at which a disturbance is forgotten."""
    law: Annotated[Records[LawSegment], 2, SEGMENTS]
    """[u, i]: the i-th segment with the valve off (u = 0) or on, rising in pressure."""
    disturbance_rad2_s5: float
    pressure_pa2_s: float
    gain_per_s: float
    drag_rad2_s5: float
    """Densities of the white noises that drive four of the states."""
    segments: Annotated[Vector, Over("law"), 2, SEGMENTS, 3]
    """The law as numbers."""


class MotionStep:
    """Derivatives of the state after a step by the state before; gain and drag stay."""

    theta_by: Annotated[Vector, STATES]
    omega_by: Annotated[Vector, STATES]
    pressure_left: float
    disturbance_left: float
    """By themselves alone."""


class Covariance:
    """Of the state."""

    p: Annotated[Vector, STATES, STATES]


STATE: Final = layout_of(MotionState)
COVARIANCE: Final = layout_of(Covariance)
MODEL: Final = layout_of(Model)
STEP: Final = layout_of(MotionStep)


@inlined
def segment(model: Model, u: int, pressure_pa: float) -> int:
    """Which segment of the law holds at a pressure."""
    i = 0
    while i + 1 < SEGMENTS and pressure_pa >= model.law[u, i + 1].above_pa:
        i += 1
    return i


@inlined
def longest_in_segment(model: Model, u: int, pressure_pa: float, dt: float) -> float:
    """How much of `dt` passes before the pressure leaves its segment."""
    i = segment(model, u, pressure_pa)
    b, r = model.law[u, i].b_per_s, model.law[u, i].r_pa_s
    after = pressure_pa * math.exp(-b * dt) - r * math.expm1(-b * dt) / b
    edge = 0.0
    if i + 1 < SEGMENTS and after >= model.law[u, i + 1].above_pa:
        edge = model.law[u, i + 1].above_pa
    elif i > 0 and after < model.law[u, i].above_pa:
        # A hair below, so that the next step begins in the lower segment.
        edge = model.law[u, i].above_pa - 1e-3
    else:
        return dt
    share = (edge - r / b) / (pressure_pa - r / b)
    if share <= 0.0:
        return dt
    return float(min(dt, max(1e-7, -math.log(share) / b)))


@inlined
def built_up(rate_per_s: float, dt: float) -> float:
    """The integral of exp(-rate t) over `dt`: of two rates' difference, it is theirs together, and
    they may be equal."""
    if rate_per_s == 0.0:
        return dt
    return -math.expm1(-rate_per_s * dt) / rate_per_s


@inlined
def transition(state: MotionState, dt: float, u: int, model: Model, step: MotionStep) -> None:
    """Moves the state on by `dt` seconds, in place; its derivatives are written to `step`."""
    i = segment(model, u, state.pressure_pa)
    a, g, b_d = model.friction_per_s, model.brake_rad_s2_pa, model.fading_per_s
    b, r = model.law[u, i].b_per_s, model.law[u, i].r_pa_s
    ax = a * dt
    if ax < 1e-3:
        phi_a = dt * (1.0 - ax * (0.5 - ax * (1.0 / 6.0 - ax / 24.0)))
        rest = dt * dt * (0.5 - ax * (1.0 / 6.0 - ax * (1.0 / 24.0 - ax / 120.0)))
    else:
        phi_a = -math.expm1(-ax) / a
        rest = (dt - phi_a) / a
    e_a = 1.0 - a * phi_a
    phi_b = -math.expm1(-b * dt) / b
    e_b = 1.0 - b * phi_b
    e_d = math.exp(-b_d * dt)
    h, h_d = e_a * built_up(b - a, dt), e_a * built_up(b_d - a, dt)
    big_h = (phi_a - h) / b
    omega, pressure, disturbance = state.omega_rad_s, state.pressure_pa, state.disturbance_rad_s2
    gain, drag = state.gain, state.drag_rad_s2
    theta_by, omega_by = step.theta_by, step.omega_by
    theta_by[OMEGA], omega_by[OMEGA] = phi_a, e_a
    theta_by[DISTURBANCE], omega_by[DISTURBANCE] = (phi_a - h_d) / b_d, h_d
    theta_by[GAIN] = -g * (big_h * pressure + r * (rest - big_h) / b)
    omega_by[GAIN] = -g * (h * pressure + r * (phi_a - h) / b)
    theta_by[PRESSURE], omega_by[PRESSURE] = -g * gain * big_h, -g * gain * h
    theta_by[DRAG], omega_by[DRAG] = rest, phi_a
    step.pressure_left, step.disturbance_left = e_b, e_d
    state.theta_rad += (
        phi_a * omega + theta_by[GAIN] * gain + theta_by[DISTURBANCE] * disturbance + rest * drag
    )
    state.omega_rad_s = (
        e_a * omega + omega_by[GAIN] * gain + omega_by[DISTURBANCE] * disturbance + phi_a * drag
    )
    state.pressure_pa = e_b * pressure + phi_b * r
    state.disturbance_rad_s2 *= e_d


@inlined
def spread_over(
    p: Vector, dt: float, step: MotionStep, model: Model, gain: float, noise_scale: float
) -> None:
    """Covariance prediction P = F P F' + Q, in place; p (6, 6), its upper half; step: that of
    `transition` over the same time; gain: that of the brake; noise_scale: what the noises of the
    accelerations are multiplied by.

    Q is Van Loan's integral with the fading of pressure and disturbance in it: with e = e^(-b dt)
    and phi = (1 - e) / b the variance phi (1 + e) / 2, that with omega phi^2 / 2, that of omega
    dt phi (phi + dt) / 6, and so on; standard deviations within 2 % up to 5 ms. Written out: a loop
    over six states costs twice as much."""
    theta_by, omega_by = step.theta_by, step.omega_by
    a1, a2, a3, a4, a5 = theta_by[1], theta_by[2], theta_by[3], theta_by[4], theta_by[5]
    b1, b2, b3, b4, b5 = omega_by[1], omega_by[2], omega_by[3], omega_by[4], omega_by[5]
    e_p, e_d = step.pressure_left, step.disturbance_left
    p01, p02, p03, p04, p05 = p[0, 1], p[0, 2], p[0, 3], p[0, 4], p[0, 5]
    p11, p12, p13, p14, p15 = p[1, 1], p[1, 2], p[1, 3], p[1, 4], p[1, 5]
    p22, p23, p24, p25 = p[2, 2], p[2, 3], p[2, 4], p[2, 5]
    p33, p34, p35, p44, p45, p55 = p[3, 3], p[3, 4], p[3, 5], p[4, 4], p[4, 5], p[5, 5]
    # Rows of F P: u for theta, v for omega.
    u0 = p[0, 0] + a1 * p01 + a2 * p02 + a3 * p03 + a4 * p04 + a5 * p05
    u1 = p01 + a1 * p11 + a2 * p12 + a3 * p13 + a4 * p14 + a5 * p15
    u2 = p02 + a1 * p12 + a2 * p22 + a3 * p23 + a4 * p24 + a5 * p25
    u3 = p03 + a1 * p13 + a2 * p23 + a3 * p33 + a4 * p34 + a5 * p35
    u4 = p04 + a1 * p14 + a2 * p24 + a3 * p34 + a4 * p44 + a5 * p45
    u5 = p05 + a1 * p15 + a2 * p25 + a3 * p35 + a4 * p45 + a5 * p55
    v1 = b1 * p11 + b2 * p12 + b3 * p13 + b4 * p14 + b5 * p15
    v2 = b1 * p12 + b2 * p22 + b3 * p23 + b4 * p24 + b5 * p25
    v3 = b1 * p13 + b2 * p23 + b3 * p33 + b4 * p34 + b5 * p35
    v4 = b1 * p14 + b2 * p24 + b3 * p34 + b4 * p44 + b5 * p45
    v5 = b1 * p15 + b2 * p25 + b3 * p35 + b4 * p45 + b5 * p55
    q_d, q_s = noise_scale * model.disturbance_rad2_s5, noise_scale * model.drag_rad2_s5
    q_p = model.pressure_pa2_s
    # What a kick at the step's start has made of theta (a2, a3, a5) and omega (b2, b3, b5) by its
    # end, integrated over the step; a kick of pressure fades to e_p, one of disturbance to e_d.
    theta = q_d * a3 * a3 + q_p * a2 * a2 + q_s * a5 * a5
    braked = model.brake_rad_s2_pa * gain * dt
    omega = q_d * b3 * (b3 + dt) + q_p * b2 * (b2 - braked) + q_s * b5 * (b5 + dt)
    phi_p, third = 0.5 * dt * (1.0 + e_p), 1.0 / 3.0
    p[0, 0] = u0 + a1 * u1 + a2 * u2 + a3 * u3 + a4 * u4 + a5 * u5 + 0.2 * dt * theta
    p[0, 1] = b1 * u1 + b2 * u2 + b3 * u3 + b4 * u4 + b5 * u5 + 0.5 * theta
    p[1, 1] = b1 * v1 + b2 * v2 + b3 * v3 + b4 * v4 + b5 * v5 + 0.5 * third * dt * omega
    p[0, 2] = u2 * e_p + q_p * a2 * phi_p * third
    p[1, 2] = v2 * e_p + q_p * b2 * phi_p * 0.5
    p[0, 3] = u3 * e_d + q_d * a3 * b3 * third
    p[1, 3] = v3 * e_d + q_d * b3 * b3 * 0.5
    p[0, 4], p[1, 4] = u4, v4
    p[0, 5], p[1, 5] = u5 + q_s * a5 * dt * third, v5 + q_s * b5 * dt * 0.5
    p[2, 2] = e_p * e_p * p22 + q_p * phi_p * (1.0 + e_p) * 0.5
    p[2, 3], p[2, 4], p[2, 5] = e_p * e_d * p23, e_p * p24, e_p * p25
    p[3, 3] = e_d * e_d * p33 + q_d * b3 * (1.0 + e_d) * 0.5
    p[3, 4], p[3, 5] = e_d * p34, e_d * p35
    p[4, 4] = p44 + model.gain_per_s * dt
    p[5, 5] = p55 + q_s * dt


@inlined
def measure(x: Vector, p: Vector, i: int, innovation: float, r: float, gain: Vector) -> float:
    """Measurement update with the i-th state measured, in place; p its upper half. Returns the
    innovation's variance; gain (a number a state) is written: the Kalman gain used."""
    s, states = p[i, i] + r, gain.shape[0]
    for j in range(states):
        gain[j] = (p[j, i] if j < i else p[i, j]) / s
    for j in range(states):
        x[j] += gain[j] * innovation
        g = gain[j] * s
        for k in range(j, states):
            p[j, k] -= g * gain[k]
    return float(s)


@inlined
def mirror(p: Vector, states: int) -> None:
    """The lower half from the upper one, in place."""
    for j in range(1, states):
        for k in range(j):
            p[j, k] = p[k, j]


@inlined
def input_at(t_us: float, switch_us: Vector) -> int:
    """How many switches lie at or before a time."""
    i = 0
    while i < switch_us.shape[0] and switch_us[i] <= t_us:
        i += 1
    return i


@inlined
def valve_after(i: int, switches: Vector, to_us: float) -> tuple[int, float]:
    """The valve's state after this many switches, and until when it holds, at most `to_us`."""
    until_us = to_us
    if i < switches.shape[1] and switches[0, i] < to_us:
        until_us = switches[0, i]
    return int(switches[1, i - 1]) if i > 0 else 0, until_us


@compiled
def travel(x: Vector, t_us: float, to_us: float, switches: Vector, model: Vector) -> None:
    """Moves a state from `t_us` to `to_us` through every brake switch and segment, in place.

    x: a `MotionState`; switches (2, n): rising times (us), and the valve's state u from
    each on, 0 before the first; model: a `Model`."""
    state, motion = record_on(x, STATE), record_on(model, MODEL)
    step = new_record(STEP)
    i = input_at(t_us, switches[0])
    while t_us < to_us:
        u, until_us = valve_after(i, switches, to_us)
        dt = (until_us - t_us) * US
        part = longest_in_segment(motion, u, state.pressure_pa, dt)
        transition(state, part, u, motion, step)
        if part < dt:
            t_us += part / US
        else:
            t_us = until_us
            i += 1
    if to_us < t_us:
        # A moment ago: nothing switched since, to the accuracy of a step back.
        u, _ = valve_after(i, switches, to_us)
        transition(state, (to_us - t_us) * US, u, motion, step)


@compiled
def forecast(
    x: Vector, p: Vector, t_us: float, to_us: float, switches: Vector, model: Vector
) -> None:
    """As `travel`, with the state's covariance p (6, 6)."""
    state, motion = record_on(x, STATE), record_on(model, MODEL)
    # The same kind of array as a filter's own, so that what works on it is compiled once.
    spread = record_on(p, COVARIANCE).p
    step = new_record(STEP)
    i = input_at(t_us, switches[0])
    while t_us < to_us:
        u, until_us = valve_after(i, switches, to_us)
        dt = (until_us - t_us) * US
        part = min(longest_in_segment(motion, u, state.pressure_pa, dt), LONGEST_S)
        transition(state, part, u, motion, step)
        spread_over(spread, part, step, motion, state.gain, 1.0)
        if part < dt:
            t_us += part / US
        else:
            t_us = until_us
            i += 1
    mirror(spread, STATES)


@inlined
def copy_on(source: Vector, target: Vector) -> None:
    """Copies an array onto one of the same length. To assign it to a slice would compile what
    numba says of two that differ: two seconds."""
    for k in range(source.shape[0]):
        target[k] = source[k]


@compiled
def settling(
    x: Vector, p: Vector, times: Vector, switches: Vector, model: Vector, found: Vector
) -> None:
    """Variances (rad2) of the angle predicted a horizon ahead: now, and after each further tick of
    edges, to found (n,). State and covariance p (6, 6) are moved.

    times: of the state, from a tick to the time that is predicted, and of a tick (us), and the
    variance of the angle that a tick's edges tell (rad2)."""
    time_us, horizon_us, tick_us, heard_rad2 = times[0], times[1], times[2], times[3]
    then, spread, gain = np.empty(STATES), np.empty((STATES, STATES)), np.empty(STATES)
    for tick in range(found.shape[0]):
        copy_on(x, then)
        for j in range(STATES):
            copy_on(p[j], spread[j])
        forecast(then, spread, time_us, time_us + horizon_us, switches, model)
        found[tick] = spread[THETA, THETA]
        if tick + 1 == found.shape[0]:
            break  # nobody asks what comes after the last
        forecast(x, p, time_us, time_us + tick_us, switches, model)
        for j in range(STATES):
            gain[j] = p[THETA, j] / (p[THETA, THETA] + heard_rad2)
        copy_on(p[THETA], then)
        for j in range(STATES):
            for k in range(STATES):
                p[j, k] -= gain[j] * then[k]
        time_us += tick_us
