"""The main shaft on a driveline that swings: seven states in closed form.

    theta' = omega                      omega' = alpha + q1'' + q2'' + white
    alpha' = white                      q_m''  = -w_m^2 q_m - 2 d_m q_m' + white,  m = 1, 2

theta and omega are angle and speed of the shaft itself. q_m is the part of its angle that swings in
mode m: against the wheels through propeller and half shafts (10 to 40 Hz), and with them on their
tyres (2 to 8 Hz). alpha is the vehicle's steady acceleration. A mode moves as a damped oscillator:
with c = cos(v D), s = sin(v D) / v, v^2 = w^2 - d^2 and e = e^(-d D) a step of D takes

    q to e ((c + d s) q + s q'),        q' to e (-w^2 s q + (c - d s) q')

and its noise of density N adds S - A S A' to its covariance, S = N / (4 d) diag(1/w^2, 1) being
that of a mode that has swung for ever.

A step of any length is exact. A driveline that rattles in its backlash moves otherwise
(`lash_motion`). Compiled by numba; with NUMBA_DISABLE_JIT=1 the same code runs as plain Python.
State is updated in place.
"""

from __future__ import annotations

import math
from typing import Annotated, Final

import numpy as np

from meshpoint.controller.motion.kernels import copy_on, measure
from meshpoint.kernels.jit import compiled, inlined, new_record, record_on
from meshpoint.kernels.records import WORD_BYTES, Over, Records, Vector, layout_of

MODES: Final = 2
SWING_STATES: Final = 3 + 2 * MODES
STEADY: Final = 2
FIRST_MODE: Final = 3
"""Rows of the covariance after angle and speed: the steady acceleration, then two a mode."""


class SwingState:
    """The seven states of a main shaft."""

    theta_rad: float
    omega_rad_s: float
    steady_rad_s2: float
    """The vehicle's acceleration, that of a shaft which does not swing."""
    modes: Annotated[Vector, MODES, 2]
    """Angle (rad) and speed (rad/s) by which the shaft swings in each mode."""
    x: Annotated[Vector, Over("theta_rad"), SWING_STATES]
    """All seven."""


class Mode:
    """One way in which the driveline swings."""

    natural_rad_s: float
    decay_per_s: float
    """Its swing fades by e^(-decay t); less than the natural frequency."""
    noise_rad2_s3: float
    """Density of the white noise that drives it."""


class SwingModel:
    """How the shaft is taken to move."""

    white_rad2_s3: float
    """Density of the white noise of the shaft's acceleration."""
    walk_rad2_s5: float
    """Density of that which drives the steady acceleration."""
    modes: Annotated[Records[Mode], MODES]


class SwingStep:
    """A step of the state: only the first two rows of its matrix and the modes' blocks."""

    theta_by: Annotated[Vector, SWING_STATES]
    omega_by: Annotated[Vector, SWING_STATES]
    blocks: Annotated[Vector, MODES, 4]
    """Of each mode: `e (c + d s), e s, -w^2 e s, e (c - d s)`."""
    noise: Annotated[Vector, MODES, 3]
    """Variances that each mode's noise has added: of its angle, of both, of its speed."""
    work: Annotated[Vector, SWING_STATES, SWING_STATES]


SWING_STATE: Final = layout_of(SwingState)
SWING_MODEL: Final = layout_of(SwingModel)
SWING_STEP: Final = layout_of(SwingStep)
SWING_MODEL_WORDS: Final = SWING_MODEL.itemsize // WORD_BYTES


@inlined
def swing_step(dt: float, model: SwingModel, step: SwingStep) -> None:
    """The matrix of a step of `dt` seconds and the modes' noise, into `step`."""
    theta_by, omega_by = step.theta_by, step.omega_by
    theta_by[0], theta_by[1], theta_by[STEADY] = 1.0, dt, 0.5 * dt * dt
    omega_by[0], omega_by[1], omega_by[STEADY] = 0.0, 1.0, dt
    for m in range(MODES):
        mode = model.modes[m]
        noise = mode.noise_rad2_s3
        w2, d = mode.natural_rad_s * mode.natural_rad_s, mode.decay_per_s
        v = math.sqrt(w2 - d * d)
        e = math.exp(-d * dt)
        c, s = e * math.cos(v * dt), e * math.sin(v * dt) / v
        qq, qr, rq, rr = c + d * s, s, -w2 * s, c - d * s
        spread_r = noise / (4.0 * d)
        spread_q = spread_r / w2
        step.noise[m, 0] = spread_q - qq * qq * spread_q - qr * qr * spread_r
        step.noise[m, 1] = -qq * rq * spread_q - qr * rr * spread_r
        step.noise[m, 2] = spread_r - rq * rq * spread_q - rr * rr * spread_r
        step.blocks[m, 0], step.blocks[m, 1] = qq, qr
        step.blocks[m, 2], step.blocks[m, 3] = rq, rr
        i = FIRST_MODE + 2 * m
        theta_by[i], theta_by[i + 1] = qq - 1.0, qr - dt
        omega_by[i], omega_by[i + 1] = rq, rr - 1.0


@inlined
def swing_on(state: SwingState, step: SwingStep) -> None:
    """Moves the state by a step, in place."""
    x, theta, omega = state.x, 0.0, 0.0
    for k in range(SWING_STATES):
        theta += step.theta_by[k] * x[k]
        omega += step.omega_by[k] * x[k]
    for m in range(MODES):
        i = FIRST_MODE + 2 * m
        q, r = x[i], x[i + 1]
        x[i] = step.blocks[m, 0] * q + step.blocks[m, 1] * r
        x[i + 1] = step.blocks[m, 2] * q + step.blocks[m, 3] * r
    x[0], x[1] = theta, omega


@inlined
def swing_spread(
    p: Vector, dt: float, step: SwingStep, model: SwingModel, noise_scale: float
) -> None:
    """Covariance prediction P = F P F' + Q, in place; p (7, 7), its upper half; noise_scale: what
    the noise of the shaft's acceleration is multiplied by."""
    work = step.work
    for j in range(SWING_STATES):
        for k in range(j):
            p[j, k] = p[k, j]
    # F P, row by row.
    for k in range(SWING_STATES):
        theta, omega = 0.0, 0.0
        for j in range(SWING_STATES):
            theta += step.theta_by[j] * p[j, k]
            omega += step.omega_by[j] * p[j, k]
        work[0, k], work[1, k], work[STEADY, k] = theta, omega, p[STEADY, k]
        for m in range(MODES):
            i = FIRST_MODE + 2 * m
            work[i, k] = step.blocks[m, 0] * p[i, k] + step.blocks[m, 1] * p[i + 1, k]
            work[i + 1, k] = step.blocks[m, 2] * p[i, k] + step.blocks[m, 3] * p[i + 1, k]
    # (F P) F', its upper half.
    for j in range(SWING_STATES):
        theta, omega = 0.0, 0.0
        for k in range(SWING_STATES):
            theta += work[j, k] * step.theta_by[k]
            omega += work[j, k] * step.omega_by[k]
        p[j, STEADY] = work[j, STEADY]
        for m in range(MODES):
            i = FIRST_MODE + 2 * m
            p[j, i] = work[j, i] * step.blocks[m, 0] + work[j, i + 1] * step.blocks[m, 1]
            p[j, i + 1] = work[j, i] * step.blocks[m, 2] + work[j, i + 1] * step.blocks[m, 3]
        if j <= 1:
            p[j, 1] = omega
        if j == 0:
            p[0, 0] = theta
    swing_noise(p, dt, step, model, noise_scale)


@inlined
def swing_noise(
    p: Vector, dt: float, step: SwingStep, model: SwingModel, noise_scale: float
) -> None:
    """Adds to the covariance what the noises have made over a step: a mode's angle and speed are
    part of those of the shaft."""
    white, walk = noise_scale * model.white_rad2_s3, model.walk_rad2_s5
    d2 = dt * dt
    p[0, 0] += white * d2 * dt / 3.0 + walk * d2 * d2 * dt / 20.0
    p[0, 1] += white * d2 / 2.0 + walk * d2 * d2 / 8.0
    p[1, 1] += white * dt + walk * d2 * dt / 3.0
    p[0, STEADY] += walk * d2 * dt / 6.0
    p[1, STEADY] += walk * d2 / 2.0
    p[STEADY, STEADY] += walk * dt
    for m in range(MODES):
        i = FIRST_MODE + 2 * m
        qq, qr, rr = step.noise[m, 0], step.noise[m, 1], step.noise[m, 2]
        p[0, 0] += qq
        p[0, 1] += qr
        p[1, 1] += rr
        p[0, i] += qq
        p[0, i + 1] += qr
        p[1, i] += qr
        p[1, i + 1] += rr
        p[i, i] += qq
        p[i, i + 1] += qr
        p[i + 1, i + 1] += rr


@compiled
def swing_ahead(x: Vector, p: Vector, dt: float, model: Vector) -> None:
    """State and covariance (7, 7) after `dt` seconds, in place. A step back moves the state alone:
    its spread there is no larger."""
    state, motion = record_on(x, SWING_STATE), record_on(model, SWING_MODEL)
    step = new_record(SWING_STEP)
    if dt < 0.0:
        swing_step(dt, motion, step)
        swing_on(state, step)
        return
    swing_through(state, p, dt, motion, step)
    for j in range(1, SWING_STATES):
        for k in range(j):
            p[j, k] = p[k, j]


@inlined
def swing_through(
    state: SwingState, p: Vector, dt: float, model: SwingModel, step: SwingStep
) -> None:
    """State and covariance, its upper half, after `dt` seconds, in place."""
    swing_step(dt, model, step)
    swing_on(state, step)
    swing_spread(p, dt, step, model, 1.0)


@compiled
def swing_trajectories(
    x: Vector, model: Vector, waits_s: Vector, step_s: float, found: Vector
) -> None:
    """Angle and speed at equal steps of time, the first after each of `waits_s` (m,), to found
    (m, 2, n)."""
    state, motion = new_record(SWING_STATE), record_on(model, SWING_MODEL)
    first, step = new_record(SWING_STEP), new_record(SWING_STEP)
    swing_step(step_s, motion, step)
    for m in range(found.shape[0]):
        copy_on(x, state.x)
        swing_step(waits_s[m], motion, first)
        for k in range(found.shape[2]):
            swing_on(state, first if k == 0 else step)
            found[m, 0, k], found[m, 1, k] = state.theta_rad, state.omega_rad_s


@compiled
def swing_outlook(x: Vector, p: Vector, model: Vector, edges: Vector, found: Vector) -> None:
    """Variances (rad2) of the angle predicted a horizon ahead: now, and after each further tick of
    edges, to found (n,).

    edges: the horizon (s), the tick (s), and the variance of an edge's angle times the time from
    edge to edge (rad2 s); p (7, 7)."""
    motion, step = record_on(model, SWING_MODEL), new_record(SWING_STEP)
    now, then = new_record(SWING_STATE), new_record(SWING_STATE)
    copy_on(x, now.x)
    spread, gain = p.copy(), np.empty(SWING_STATES)
    nothing = np.zeros(SWING_STATES)
    for k in range(found.shape[0]):
        copy_on(now.x, then.x)
        wider = spread.copy()
        swing_through(then, wider, edges[0], motion, step)
        found[k] = wider[0, 0]
        swing_through(now, spread, edges[1], motion, step)
        measure(nothing, spread, 0, 0.0, edges[2] / edges[1], gain)
