"""The main shaft on a driveline that swings: five states in closed form.

    theta' = omega                      omega' = alpha + q'' + white
    alpha' = white                      q''    = -w^2 q - 2 d q' + white

theta and omega are angle and speed of the shaft itself. q is the part of its angle that swings
against the wheels through propeller and half shafts (10 to 40 Hz). alpha is the vehicle's steady
acceleration. The swing is a damped oscillator: with c = cos(v D), s = sin(v D) / v,
v^2 = w^2 - d^2 and e = e^(-d D) a step of D takes

    q to e ((c + d s) q + s q'),        q' to e (-w^2 s q + (c - d s) q')

and its noise of density N adds S - A S A' to its covariance, S = N / (4 d) diag(1/w^2, 1) being
that of one that has swung for ever.

A step of any length is exact. A driveline that rattles in its backlash moves otherwise
(`backlash`). Compiled by numba; with NUMBA_DISABLE_JIT=1 the same code runs as plain Python.
State is updated in place.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Final, NamedTuple

import numpy as np

from meshpoint.controller.models.backlash import LashTrajectory
from meshpoint.controller.models.layshaft_kernels import copy_on, measure, mirror
from meshpoint.kernels.jit import compiled, inlined, new_record, record_on
from meshpoint.kernels.records import Over, RecordMemory, Vector, layout_of
from meshpoint.units import US

SWING_STATES: Final = 5
STEADY, SWING, RATE = 2, 3, 4
"""Rows of the covariance after angle and speed: the steady acceleration, then the swing's angle and
speed."""

OUTLOOK_US: Final = 10_000.0
"""What will be known is worked out at steps of this, in which some edges come."""


class SwingState:
    """The five states of a main shaft."""

    theta_rad: float
    omega_rad_s: float
    steady_rad_s2: float
    """The vehicle's acceleration, that of a shaft which does not swing."""
    swing_rad: float
    swing_rad_s: float
    """Angle and speed by which the shaft swings."""
    x: Annotated[Vector, Over("theta_rad"), SWING_STATES]
    """All five."""


class SwingModel:
    """How the shaft is taken to move."""

    white_rad2_s3: float
    """Density of the white noise of the shaft's acceleration."""
    walk_rad2_s5: float
    """Density of that which drives the steady acceleration."""
    natural_rad_s: float
    decay_per_s: float
    """The swing fades by e^(-decay t); less than the natural frequency."""
    noise_rad2_s3: float
    """Density of the white noise that drives the swing."""


class SwingStep:
    """A step of the state: only the first two rows of its matrix and the swing's block."""

    theta_by: Annotated[Vector, SWING_STATES]
    omega_by: Annotated[Vector, SWING_STATES]
    block: Annotated[Vector, 4]
    """`e (c + d s), e s, -w^2 e s, e (c - d s)`."""
    noise: Annotated[Vector, 3]
    """Variances that the swing's noise has added: of its angle, of both, of its speed."""
    work: Annotated[Vector, SWING_STATES, SWING_STATES]


SWING_STATE: Final = layout_of(SwingState)
SWING_MODEL: Final = layout_of(SwingModel)
SWING_STEP: Final = layout_of(SwingStep)


@inlined
def swing_step(dt: float, model: SwingModel, step: SwingStep) -> None:
    """The matrix of a step of `dt` seconds and the swing's noise, into `step`."""
    theta_by, omega_by, block = step.theta_by, step.omega_by, step.block
    noise, d = model.noise_rad2_s3, model.decay_per_s
    w2 = model.natural_rad_s * model.natural_rad_s
    v = math.sqrt(w2 - d * d)
    e = math.exp(-d * dt)
    c, s = e * math.cos(v * dt), e * math.sin(v * dt) / v
    qq, qr, rq, rr = c + d * s, s, -w2 * s, c - d * s
    block[0], block[1], block[2], block[3] = qq, qr, rq, rr
    theta_by[0], theta_by[1], theta_by[STEADY] = 1.0, dt, 0.5 * dt * dt
    omega_by[0], omega_by[1], omega_by[STEADY] = 0.0, 1.0, dt
    theta_by[SWING], theta_by[RATE] = qq - 1.0, qr - dt
    omega_by[SWING], omega_by[RATE] = rq, rr - 1.0
    spread_r = noise / (4.0 * d)
    spread_q = spread_r / w2
    step.noise[0] = spread_q - qq * qq * spread_q - qr * qr * spread_r
    step.noise[1] = -qq * rq * spread_q - qr * rr * spread_r
    step.noise[2] = spread_r - rq * rq * spread_q - rr * rr * spread_r


@inlined
def swing_on(state: SwingState, step: SwingStep) -> None:
    """Moves the state by a step, in place."""
    x, theta, omega, block = state.x, 0.0, 0.0, step.block
    for k in range(SWING_STATES):
        theta += step.theta_by[k] * x[k]
        omega += step.omega_by[k] * x[k]
    q, r = x[SWING], x[RATE]
    x[SWING] = block[0] * q + block[1] * r
    x[RATE] = block[2] * q + block[3] * r
    x[0], x[1] = theta, omega


@inlined
def swing_spread(
    p: Vector, dt: float, step: SwingStep, model: SwingModel, noise_scale: float
) -> None:
    """Covariance prediction P = F P F' + Q, in place; p (5, 5), its upper half; noise_scale: what
    the noise of the shaft's acceleration is multiplied by."""
    work, block = step.work, step.block
    mirror(p, SWING_STATES)
    # F P, row by row.
    for k in range(SWING_STATES):
        theta, omega = 0.0, 0.0
        for j in range(SWING_STATES):
            theta += step.theta_by[j] * p[j, k]
            omega += step.omega_by[j] * p[j, k]
        work[0, k], work[1, k], work[STEADY, k] = theta, omega, p[STEADY, k]
        work[SWING, k] = block[0] * p[SWING, k] + block[1] * p[RATE, k]
        work[RATE, k] = block[2] * p[SWING, k] + block[3] * p[RATE, k]
    # (F P) F', its upper half.
    for j in range(SWING_STATES):
        theta, omega = 0.0, 0.0
        for k in range(SWING_STATES):
            theta += work[j, k] * step.theta_by[k]
            omega += work[j, k] * step.omega_by[k]
        p[j, STEADY] = work[j, STEADY]
        p[j, SWING] = work[j, SWING] * block[0] + work[j, RATE] * block[1]
        p[j, RATE] = work[j, SWING] * block[2] + work[j, RATE] * block[3]
        if j <= 1:
            p[j, 1] = omega
        if j == 0:
            p[0, 0] = theta
    swing_noise(p, dt, step, model, noise_scale)


@inlined
def swing_noise(
    p: Vector, dt: float, step: SwingStep, model: SwingModel, noise_scale: float
) -> None:
    """Adds to the covariance what the noises have made over a step: the swing's angle and speed are
    part of those of the shaft."""
    white, walk = noise_scale * model.white_rad2_s3, model.walk_rad2_s5
    qq, qr, rr = step.noise[0], step.noise[1], step.noise[2]
    d2 = dt * dt
    p[0, 0] += white * d2 * dt / 3.0 + walk * d2 * d2 * dt / 20.0 + qq
    p[0, 1] += white * d2 / 2.0 + walk * d2 * d2 / 8.0 + qr
    p[1, 1] += white * dt + walk * d2 * dt / 3.0 + rr
    p[0, STEADY] += walk * d2 * dt / 6.0
    p[1, STEADY] += walk * d2 / 2.0
    p[STEADY, STEADY] += walk * dt
    p[0, SWING] += qq
    p[0, RATE] += qr
    p[1, SWING] += qr
    p[1, RATE] += rr
    p[SWING, SWING] += qq
    p[SWING, RATE] += qr
    p[RATE, RATE] += rr


@compiled
def swing_ahead(x: Vector, p: Vector, dt: float, model: Vector) -> None:
    """State and covariance (5, 5) after `dt` seconds, in place. A step back moves the state alone:
    its spread there is no larger."""
    state, motion = record_on(x, SWING_STATE), record_on(model, SWING_MODEL)
    step = new_record(SWING_STEP)
    if dt < 0.0:
        swing_step(dt, motion, step)
        swing_on(state, step)
        return
    swing_through(state, p, dt, motion, step)
    mirror(p, SWING_STATES)


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
    edge to edge (rad2 s); p (5, 5)."""
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


def ticks_over(step_us: float, count: int) -> int:
    """Ticks of `OUTLOOK_US` that this many steps of time lie between."""
    return 2 + int(step_us * max(1, count - 1) // OUTLOOK_US)


def between_ticks(found: Vector, step_us: float, count: int) -> Vector:
    """Values at equal steps of time from those at ticks of `OUTLOOK_US`; the last one holds on."""
    times_us = OUTLOOK_US * np.arange(found.size)
    return np.asarray(np.interp(step_us * np.arange(count), times_us, found))


class SwingRates(NamedTuple):
    """How the driveline swings; as in `SwingModel`."""

    natural_rad_s: float
    decay_per_s: float
    noise_rad2_s3: float


class SwingMotion(RecordMemory):
    """A `SwingModel`. It is not changed once it is made."""

    def __init__(self, white_rad2_s3: float, walk_rad2_s5: float, rates: SwingRates) -> None:
        super().__init__(SWING_MODEL)
        self.flat[:] = [white_rad2_s3, walk_rad2_s5, *rates]


class Swing(NamedTuple):
    """State and covariance of a main shaft that swings, and the model that they move by."""

    x: Vector
    p: Vector
    model: SwingMotion
    edge_rad2_s: float = 1e-6
    """Variance of an edge's angle times the time from edge to edge."""

    @property
    def speed_rad_s(self) -> float:
        """The part of the shaft's speed with which it swings."""
        return self.x.item(RATE)

    def ahead(self, wait_s: float) -> tuple[float, float]:
        """Angle and speed after a time."""
        found = np.empty((1, 2, 1))
        swing_trajectories(self.x, self.model.flat, np.array([wait_s]), 0.0, found)
        return found.item(0), found.item(1)

    def spread_ahead(self, wait_s: float) -> tuple[Vector, Vector]:
        """State and covariance after a time."""
        x, p = self.x.copy(), self.p.copy()
        swing_ahead(x, p, wait_s, self.model.flat)
        return x, p

    def theta_sd_ahead(self, wait_s: float) -> float:
        """Standard deviation of the angle after a time."""
        variance = self.spread_ahead(wait_s)[1].item(0, 0)
        return math.sqrt(variance) if variance > 0.0 else 0.0

    def outlook(self, horizon_s: float, tick_s: float, count: int) -> Vector:
        """Variances (rad2) of the angle predicted `horizon_s` ahead, now and after each further
        tick of edges."""
        found = np.empty(count)
        edges = np.array([horizon_s, tick_s, self.edge_rad2_s])
        swing_outlook(self.x, self.p, self.model.flat, edges, found)
        return found

    def trajectories(self, waits_s: Vector, step_s: float, found: Vector) -> None:
        """Angle and speed at equal steps of time, the first after each of `waits_s` (m,), to found
        (m, 2, n)."""
        swing_trajectories(self.x, self.model.flat, waits_s, step_s, found)


class ShaftState(NamedTuple):
    """Angle and speed at a time, with standard deviations."""

    time_us: float
    theta_rad: float
    omega_rad_s: float
    theta_sd_rad: float
    omega_sd_rad_s: float
    acceleration_rad_s2: float = 0.0
    """Without its swing. Zero where it is not estimated: speed held (4.16)."""
    swing: Swing | LashTrajectory | None = None
    """How it swings, where the estimator knows that."""

    def theta_at(self, time_us: float) -> float:
        """The angle at another time: the swing goes on; without one, acceleration held."""
        dt = (time_us - self.time_us) * US
        if self.swing is not None:
            return self.swing.ahead(dt)[0]
        return self.theta_rad + dt * (self.omega_rad_s + 0.5 * dt * self.acceleration_rad_s2)

    def omega_at(self, time_us: float) -> float:
        """The speed at another time: the swing goes on; without one, acceleration held."""
        dt = (time_us - self.time_us) * US
        if self.swing is not None:
            return self.swing.ahead(dt)[1]
        return self.omega_rad_s + dt * self.acceleration_rad_s2

    def steady_omega_at(self, time_us: float) -> float:
        """The speed at another time of a shaft that does not swing: that of the vehicle."""
        dt = (time_us - self.time_us) * US
        omega = self.omega_rad_s + dt * self.acceleration_rad_s2
        return omega if self.swing is None else omega - self.swing.speed_rad_s

    def theta_sd_at(self, time_us: float) -> float:
        """Standard deviation of the angle at another time."""
        dt = (time_us - self.time_us) * US
        if self.swing is not None:
            return self.swing.theta_sd_ahead(dt)
        return math.hypot(self.theta_sd_rad, self.omega_sd_rad_s * dt)

    def variances(self, first_us: float, step_us: float, count: int) -> Vector:
        """Variances (rad2) of the angle at equal steps of time, each as predicted by what will be
        known as long before it as now is before the first."""
        horizon_s = max(0.0, (first_us - self.time_us) * US)
        if self.swing is None:
            return np.full(count, self.theta_sd_at(first_us) ** 2)
        found = self.swing.outlook(horizon_s, OUTLOOK_US * US, ticks_over(step_us, count))
        return between_ticks(found, step_us, count)

    def trajectories(self, firsts_us: Sequence[float], step_us: float, count: int) -> Vector:
        """Angle and speed (m, 2, count) at equal steps of time, from each of m times on."""
        found, waits_us = np.empty((len(firsts_us), 2, count)), np.array(firsts_us) - self.time_us
        if self.swing is not None:
            self.swing.trajectories(waits_us * US, step_us * US, found)
            return found
        dt = (waits_us[:, np.newaxis] + step_us * np.arange(count)) * US
        speed, half = self.omega_rad_s, 0.5 * dt * self.acceleration_rad_s2
        found[:, 1] = speed + dt * self.acceleration_rad_s2
        found[:, 0] = self.theta_rad + dt * (speed + half)
        return found
