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
from typing import Final

import numpy as np
from numpy.typing import NDArray

from meshpoint.controller.jit import compiled, inlined

Vector = NDArray[np.float64]

STATES: Final = 6
THETA: Final = 0
OMEGA: Final = 1
PRESSURE: Final = 2
DISTURBANCE: Final = 3
GAIN: Final = 4
DRAG: Final = 5
"""Indices into the state."""

RATE_A: Final = 0
BRAKE_G: Final = 1
RATE_D: Final = 2
"""Indices into the motion vector [a, g, b_d]."""

LAW_ABOVE: Final = 0
LAW_B: Final = 1
LAW_R: Final = 2
SEGMENTS: Final = 6
"""law[u, i] = (lowest pressure of the segment, b, r), rising; unused ones begin at infinity."""

Q_DISTURBANCE: Final = 0
Q_PRESSURE: Final = 1
Q_GAIN: Final = 2
Q_DRAG: Final = 3
"""Indices into the noise vector: densities of the white noises that drive the four states."""

US: Final = 1e-6
LONGEST_S: Final = 5e-3
"""Within this step the process noise of `spread_over` is good to 2 %."""
CLOSE: Final = 1e-6


@inlined
def segment(law: Vector, u: int, pressure: float) -> int:
    """Which segment of the law holds at a pressure."""
    i = 0
    while i + 1 < SEGMENTS and pressure >= law[u, i + 1, LAW_ABOVE]:
        i += 1
    return i


@inlined
def longest_in_segment(law: Vector, u: int, pressure: float, dt: float) -> float:
    """How much of `dt` passes before the pressure leaves its segment."""
    i = segment(law, u, pressure)
    b, r = law[u, i, LAW_B], law[u, i, LAW_R]
    after = pressure * math.exp(-b * dt) - r * math.expm1(-b * dt) / b
    edge = 0.0
    if i + 1 < SEGMENTS and after >= law[u, i + 1, LAW_ABOVE]:
        edge = law[u, i + 1, LAW_ABOVE]
    elif i > 0 and after < law[u, i, LAW_ABOVE]:
        # A hair below, so that the next step begins in the lower segment.
        edge = law[u, i, LAW_ABOVE] - 1e-3
    else:
        return dt
    share = (edge - r / b) / (pressure - r / b)
    if share <= 0.0:
        return dt
    return float(min(dt, max(1e-7, -math.log(share) / b)))


@inlined
def transition(x: Vector, dt: float, u: int, motion: Vector, law: Vector, f: Vector) -> None:
    """Derivatives of the state after `dt` by the state now, f (2, 6) for theta and omega and
    f[2, 2..3] for pressure and disturbance; moves the state there, in place.

    f has shape (3, 6); the rows of pressure, disturbance, gain and drag are diagonal."""
    i = segment(law, u, x[PRESSURE])
    a, g, b_d = motion[RATE_A], motion[BRAKE_G], motion[RATE_D]
    b, r = law[u, i, LAW_B], law[u, i, LAW_R]
    if abs(b - a) < CLOSE * (abs(b) + a):
        # Equal rates are a removable singularity; a part in a million of tau is below any data.
        b = a + 2.0 * CLOSE * (abs(b) + a)
    if abs(b_d - a) < CLOSE * (b_d + a):
        b_d = a + 2.0 * CLOSE * (b_d + a)
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
    phi_d = -math.expm1(-b_d * dt) / b_d
    e_d = 1.0 - b_d * phi_d
    h, big_h = (e_a - e_b) / (b - a), (phi_a - phi_b) / (b - a)
    f[0, 1], f[1, 1] = phi_a, e_a
    f[0, 3], f[1, 3] = (phi_a - phi_d) / (b_d - a), (e_a - e_d) / (b_d - a)
    f[0, 4] = -g * (big_h * x[2] + r * (rest - big_h) / b)
    f[1, 4] = -g * (h * x[2] + r * (phi_a - h) / b)
    f[0, 2], f[1, 2] = -g * x[4] * big_h, -g * x[4] * h
    f[0, 5], f[1, 5] = rest, phi_a
    f[2, 2], f[2, 3] = e_b, e_d
    x[0] += phi_a * x[1] + f[0, 4] * x[4] + f[0, 3] * x[3] + rest * x[5]
    x[1] = e_a * x[1] + f[1, 4] * x[4] + f[1, 3] * x[3] + phi_a * x[5]
    x[2] = e_b * x[2] + phi_b * r
    x[3] *= e_d


@inlined
def spread_over(p: Vector, dt: float, f: Vector, motion: Vector, noise: Vector, x: Vector) -> None:
    """Covariance prediction P = F P F' + Q, in place; p (6, 6), its upper half; f of `transition`.

    Q is Van Loan's integral with the fading of pressure and disturbance in it: with e = e^(-b dt)
    and phi = (1 - e) / b the variance phi (1 + e) / 2, that with omega phi^2 / 2, that of omega
    dt phi (phi + dt) / 6, and so on; standard deviations within 2 % up to 5 ms. Written out: a loop
    over six states costs twice as much."""
    a1, a2, a3, a4, a5 = f[0, 1], f[0, 2], f[0, 3], f[0, 4], f[0, 5]
    b1, b2, b3, b4, b5 = f[1, 1], f[1, 2], f[1, 3], f[1, 4], f[1, 5]
    e_p, e_d = f[2, 2], f[2, 3]
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
    q_d, q_p, q_s = noise[Q_DISTURBANCE], noise[Q_PRESSURE], noise[Q_DRAG]
    # What a kick at the step's start has made of theta (a2, a3, a5) and omega (b2, b3, b5) by its
    # end, integrated over the step; a kick of pressure fades to e_p, one of disturbance to e_d.
    theta = q_d * a3 * a3 + q_p * a2 * a2 + q_s * a5 * a5
    braked = motion[BRAKE_G] * x[GAIN] * dt
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
    p[4, 4] = p44 + noise[Q_GAIN] * dt
    p[5, 5] = p55 + q_s * dt


@inlined
def measure(x: Vector, p: Vector, i: int, innovation: float, r: float, gain: Vector) -> float:
    """Measurement update with the i-th state measured, in place; p its upper half. Returns the
    innovation's variance; gain (6,) is written: the Kalman gain used."""
    s = p[i, i] + r
    for j in range(STATES):
        gain[j] = (p[j, i] if j < i else p[i, j]) / s
    for j in range(STATES):
        x[j] += gain[j] * innovation
        g = gain[j] * s
        for k in range(j, STATES):
            p[j, k] -= g * gain[k]
    return float(s)


@inlined
def mirror(p: Vector) -> None:
    """The lower half from the upper one, in place."""
    for j in range(1, STATES):
        for k in range(j):
            p[j, k] = p[k, j]


@inlined
def input_at(t_us: float, switch_us: Vector) -> int:
    """How many switches lie at or before a time."""
    i = 0
    while i < switch_us.shape[0] and switch_us[i] <= t_us:
        i += 1
    return i


@compiled
def travel(
    x: Vector, t_us: float, to_us: float, switch_us: Vector, switch_u: Vector,
    motion: Vector, law: Vector,
) -> None:  # fmt: skip
    """Moves the state from `t_us` to `to_us` through every brake switch and segment, in place.

    switch_us must rise; switch_u[i] holds from switch_us[i] on; before the first one u = 0."""
    f = np.zeros((3, STATES))
    i = input_at(t_us, switch_us)
    while t_us < to_us:
        u = int(switch_u[i - 1]) if i > 0 else 0
        until_us = to_us
        if i < switch_us.shape[0] and switch_us[i] < to_us:
            until_us = switch_us[i]
        dt = (until_us - t_us) * US
        part = longest_in_segment(law, u, x[PRESSURE], dt)
        transition(x, part, u, motion, law, f)
        if part < dt:
            t_us += part / US
        else:
            t_us = until_us
            i += 1
    if to_us < t_us:
        # A moment ago: nothing switched since, to the accuracy of a step back.
        u = int(switch_u[i - 1]) if i > 0 else 0
        transition(x, (to_us - t_us) * US, u, motion, law, f)


@compiled
def forecast(
    x: Vector, p: Vector, t_us: float, to_us: float, switch_us: Vector, switch_u: Vector,
    motion: Vector, law: Vector, noise: Vector,
) -> None:  # fmt: skip
    """As `travel`, the covariance with it."""
    f = np.zeros((3, STATES))
    i = input_at(t_us, switch_us)
    while t_us < to_us:
        u = int(switch_u[i - 1]) if i > 0 else 0
        until_us = to_us
        if i < switch_us.shape[0] and switch_us[i] < to_us:
            until_us = switch_us[i]
        dt = (until_us - t_us) * US
        part = min(longest_in_segment(law, u, x[PRESSURE], dt), LONGEST_S)
        transition(x, part, u, motion, law, f)
        spread_over(p, part, f, motion, noise, x)
        if part < dt:
            t_us += part / US
        else:
            t_us = until_us
            i += 1
    mirror(p)
