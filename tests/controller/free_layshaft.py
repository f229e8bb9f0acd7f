"""A free layshaft as the equations at the head of `controller/models/layshaft_kernels.py` have it,
written apart from the controller's kernels: many runs at once, Runge-Kutta steps of 0.1 ms, the
white noises as kicks between the steps, and the edges that a wheel's sensor would give."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from meshpoint.gearbox import GearboxSheet, Split
from meshpoint.units import US

STEP_S = 1e-4
KNOTS_PA = (0.0, 2e5, 5e5)
"""Where the three segments of each direction begin."""
EMPTYING = ((18.0, 0.0), (12.0, -1.2e6), (10.0, -2.2e6))
FILLING = ((8.0, 1.28e7), (14.0, 1.4e7), (21.0, 1.75e7))
"""(b, r) of each segment: p' = r - b p, without a jump from one segment to the next."""
LAW = (EMPTYING, FILLING)


def law_array(law: tuple = LAW, knots_pa: tuple = KNOTS_PA) -> np.ndarray:
    """The pressure law as the controller writes it down, (2, 6, 3)."""
    written = np.full((2, 6, 3), np.inf)
    written[:, :, 1:] = 1.0, 0.0
    for u, segments in enumerate(law):
        for i, (b, r) in enumerate(segments):
            written[u, i] = -np.inf if i == 0 else knots_pa[i], b, r
    return written


def flow_pa_s(u: int, pressure: np.ndarray, law: tuple = LAW, knots_pa: tuple = KNOTS_PA) -> object:
    """p' of the law."""
    segment = np.searchsorted(np.array(knots_pa[1:]), pressure, side="right")
    b, r = np.array(law[u]).T
    return r[segment] - b[segment] * pressure


@dataclass(frozen=True)
class World:
    """Constants in SI units; noises as densities' square roots."""

    a: float
    g: float
    rate_d: float
    walk_d: float
    walk_p: float
    walk_gain: float
    walk_drag: float
    edge_s: float
    tooth_rad: float
    pressure_pa: float
    half_pitch_rad: float

    @staticmethod
    def of(sheet: GearboxSheet, tuning: object) -> World:
        """The data sheet's layshaft with the noises that the filter is given."""
        inertia, t = sheet.inertia_kgm2(Split.HIGH), tuning
        sigma = t.torque_disturbance_nm / inertia
        return World(
            a=sheet.shafts.friction_nms / inertia,
            g=sheet.brake.max_torque_nm / sheet.air.supply_gauge_pa / inertia,
            rate_d=1.0 / t.disturbance_s,
            walk_d=sigma * np.sqrt(2.0 / t.disturbance_s),
            walk_p=t.pressure_walk_pa,
            walk_gain=t.gain_walk,
            walk_drag=t.drag_walk_nm / inertia,
            edge_s=t.edge_time_s,
            tooth_rad=t.tooth_error_rad,
            pressure_pa=t.pressure_sd_pa,
            half_pitch_rad=np.pi / sheet.wheels.layshaft.teeth,
        )


@dataclass(frozen=True)
class Runs:
    """What happened, and what the sensors say of it."""

    state: np.ndarray
    """(n, runs, 6) on the grid of STEP_S."""
    edges: list
    """Of each run: times in us, nominal angles, numbers in half pitches."""
    pressures: list
    """Of each run: times in us, Pa."""


def drive(
    world: World, start: np.ndarray, switches: tuple, seconds: float, rng: np.random.Generator,
    wheel_rad: np.ndarray | None = None,
) -> Runs:  # fmt: skip
    """Runs from each state of `start` (runs, 6) on, with the brake switched at these times.

    Each edge is out of place by a normal error of its own, or by its tooth's in `wheel_rad`."""
    steps, count = round(seconds / STEP_S), start.shape[0]
    kick = np.sqrt(STEP_S) * np.array(
        [0.0, 0.0, world.walk_p, world.walk_d, world.walk_gain, world.walk_drag]
    )
    state = np.empty((steps + 1, count, 6))
    state[0] = start
    for k in range(steps):
        past = [u for t, u in zip(*switches, strict=True) if t * US <= (k + 0.5) * STEP_S]
        u = int(past[-1]) if past else 0
        noise = kick * rng.standard_normal((count, 6))
        state[k + 1] = _runge_kutta(world, state[k] + 0.5 * noise, u) + 0.5 * noise
    return Runs(
        state,
        [edges_of(world, state[:, i], rng, wheel_rad) for i in range(count)],
        [_pressures(world, state[:, i], rng) for i in range(count)],
    )


def _runge_kutta(world: World, x: np.ndarray, u: int) -> np.ndarray:
    def slope(y: np.ndarray) -> np.ndarray:
        theta_, omega, p, d, gain, drag = y.T
        still = np.zeros_like(theta_)
        turning = -world.a * omega - world.g * gain * p + d + drag
        return np.stack([omega, turning, flow_pa_s(u, p), -world.rate_d * d, still, still], axis=1)

    k1 = slope(x)
    k2 = slope(x + 0.5 * STEP_S * k1)
    k3 = slope(x + 0.5 * STEP_S * k2)
    k4 = slope(x + STEP_S * k3)
    return x + STEP_S / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)


def edges_of(
    world: World, state: np.ndarray, rng: np.random.Generator, wheel_rad: np.ndarray | None = None
) -> tuple:
    """Times in us, nominal angles and numbers of a wheel's edges; state (n, 2 or more)."""
    theta = state[:, 0]
    number = np.arange(
        int(theta[0] / world.half_pitch_rad) + 2, int(theta[-1] / world.half_pitch_rad) - 1
    )
    nominal = world.half_pitch_rad * number
    if wheel_rad is None:
        angle = nominal + world.tooth_rad * rng.standard_normal(number.size)
    else:
        angle = nominal + wheel_rad[number % wheel_rad.size]
    at = np.searchsorted(theta, angle) - 1
    omega, next_omega, rest = state[at, 1], state[at + 1, 1], angle - theta[at]
    bend = 0.5 * (next_omega - omega) / STEP_S
    since = rest / omega
    for _ in range(3):  # theta between grid points is a parabola to 1e-9 rad
        since = rest / (omega + bend * since)
    time_us = (at * STEP_S + since + world.edge_s * rng.standard_normal(number.size)) / US
    order = np.argsort(time_us)
    return time_us[order], nominal[order], number[order]


def _pressures(world: World, state: np.ndarray, rng: np.random.Generator) -> tuple:
    at = np.arange(50, state.shape[0], 100)
    return at * STEP_S / US, state[at, 2] + world.pressure_pa * rng.standard_normal(at.size)
