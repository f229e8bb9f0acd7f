"""The excitation of the estimation bound: a free layshaft, braked once, and its sensor wheel.

Linear by thesis 4.15, with a torque disturbance of short memory (an Ornstein-Uhlenbeck process),
and a wheel with pitch errors, eccentricity, duty bias and jitter. Stepped by the matrix exponential
of the whole system: nothing here is the controller's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.random import Generator
from scipy.linalg import expm

from meshpoint.gearbox.tables import count, quantity
from meshpoint.kernels.jit import compiled
from meshpoint.kernels.records import Integers, Vector
from meshpoint.units import DEG, RPM

SCENE_STEP_S: Final = 1e-4
LONGEST: Final = 70_000
"""Steps of a run, 7 s."""
THETA, OMEGA, PRESSURE, DISTURBANCE, INPUT = range(5)


@dataclass(frozen=True)
class Scene:
    """What is drawn for a shift, and the sensors."""

    inertia_kgm2: float = quantity("inertia_kgm2", 0.01, 10.0)
    friction_nms: float = quantity("friction_nms", 0.0, 5.0)
    time_constant_s: float = quantity("time_constant_ms", 1.0, 1000.0, 1e-3)
    brake_low_nm: float = quantity("brake_low_nm", 1.0, 1000.0)
    brake_high_nm: float = quantity("brake_high_nm", 1.0, 1000.0)
    from_low_rad_s: float = quantity("from_low_rpm", 10.0, 5000.0, RPM)
    from_high_rad_s: float = quantity("from_high_rpm", 10.0, 5000.0, RPM)
    to_low_rad_s: float = quantity("to_low_rpm", 10.0, 5000.0, RPM)
    to_high_rad_s: float = quantity("to_high_rpm", 10.0, 5000.0, RPM)
    supply_pa: float = quantity("supply_bar", 0.1, 20.0, 1e5)
    disturbance_nm: float = quantity("disturbance_nm", 0.0, 100.0)
    disturbance_s: float = quantity("disturbance_ms", 1.0, 1000.0, 1e-3)
    teeth: int = count("teeth", 8, 120)
    jitter_s: float = quantity("jitter_us", 0.0, 200.0, 1e-6)
    pitch_error_rad: float = quantity("pitch_error_deg", 0.0, 5.0, DEG)
    eccentricity_rad: float = quantity("eccentricity_deg", 0.0, 5.0, DEG)
    duty_bias_rad: float = quantity("duty_bias_deg", 0.0, 5.0, DEG)
    pressure_sd_pa: float = quantity("pressure_sd_bar", 0.0, 1.0, 1e5)
    before_s: float = quantity("before_ms", 1.0, 1000.0, 1e-3)
    """Free before the brake is switched on."""
    after_s: float = quantity("after_ms", 1.0, 1000.0, 1e-3)
    """Looked at after the brake was switched off."""
    wrong_share: float = quantity("as_built_percent", 0.0, 50.0, 0.01)
    """Standard deviation of gain, time constant and friction about what the estimators believe, as
    built."""


class SceneWheel(NamedTuple):
    """Errors of the 2 z edges, mean zero: rising edge of tooth k at 2 k, falling at 2 k + 1."""

    error_rad: Vector


class Parameters(NamedTuple):
    """Of the free layshaft: a, b, g of `meshpoint.controller.models.thesis`."""

    a: float
    b: float
    g: float


class SceneRun(NamedTuple):
    """A shift as it was: state on the grid of STEP_S, edges and pressure as sensors give them."""

    time_s: Vector
    state: Vector
    """(n, 4): angle, speed, pressure (gauge), disturbance (rad/s2)."""
    on_s: float
    off_s: float
    end_s: float
    parameters: Parameters
    edge_us: Vector
    """As captured: jitter, whole microseconds."""
    edge: Integers
    """Number of each edge, counted in half pitches."""
    pressure_us: Vector
    pressure_pa: Vector


def draw_wheel(scene: Scene, rng: Generator) -> SceneWheel:
    """A wheel."""
    edges = 2 * scene.teeth
    turn = 2.0 * np.pi * np.arange(edges) / edges
    error = scene.pitch_error_rad * rng.standard_normal(edges)
    error += math.sqrt(2.0) * scene.eccentricity_rad * np.sin(turn + rng.uniform(0.0, 2.0 * np.pi))
    error[1::2] += scene.duty_bias_rad
    return SceneWheel(error - error.mean())


def draw_run(scene: Scene, wheel: SceneWheel, parameters: Parameters, rng: Generator) -> SceneRun:
    """One shift: free, braked until the speed will end near the drawn one, free again."""
    start = rng.uniform(scene.from_low_rad_s, scene.from_high_rad_s)
    end = rng.uniform(scene.to_low_rad_s, scene.to_high_rad_s)
    free, kick = discrete(scene, parameters, SCENE_STEP_S)
    sigma = scene.disturbance_nm / scene.inertia_kgm2
    x = np.array([rng.uniform(0.0, 2.0 * np.pi), start, 0.0, sigma * rng.standard_normal(), 0.0])
    state = np.empty((LONGEST, 4))
    noise = rng.standard_normal(LONGEST)
    tail, after = parameters.g / parameters.b, round(scene.after_s / SCENE_STEP_S)
    on, on_s = round(scene.before_s / SCENE_STEP_S), scene.before_s
    off, count = _step_through(free, kick, noise, x, end, tail, on, after, scene.supply_pa, state)
    state, off_s = state[:count], off * SCENE_STEP_S
    time_s = SCENE_STEP_S * np.arange(count, dtype=np.float64)
    edge, edge_us = _edges(scene, wheel, time_s, state, rng)
    sample_us = np.arange(10_000.0, time_s[-1] * 1e6, 10_000.0)
    pressure = np.interp(sample_us * 1e-6, time_s, state[:, PRESSURE])
    pressure += scene.pressure_sd_pa * rng.standard_normal(pressure.size)
    return SceneRun(
        time_s,
        state,
        on_s,
        off_s,
        time_s[-1],
        parameters,
        edge_us,
        edge,
        sample_us,
        pressure,
    )


@compiled
def _step_through(
    free: Vector, kick: Vector, noise: Vector, x: Vector, end: float, tail: float, on: int,
    after: int, supply: float, state: Vector,
) -> tuple[int, int]:  # fmt: skip
    """Steps until `after` steps past the brake's release; state (n, 4) is written. Returns the step
    of the release and the number of steps."""
    off, k = -1, 0
    while k < state.shape[0] and (off < 0 or k < off + after):
        state[k] = x[:4]
        if off < 0 and k > on and x[1] - x[2] * tail <= end:
            off = k
        x[4] = supply if k >= on and off < 0 else 0.0
        x = free @ x + kick * noise[k]
        k += 1
    return off, k


def discrete(scene: Scene, parameters: Parameters, step_s: float) -> tuple[Vector, Vector]:
    """Transition (5, 5) over a step with the input held as a fifth state, and the random kick."""
    a, b, g = parameters
    rate = 1.0 / scene.disturbance_s
    flow = np.zeros((5, 5))
    flow[THETA, OMEGA] = 1.0
    flow[OMEGA, [OMEGA, PRESSURE, DISTURBANCE]] = -a, -g, 1.0
    flow[PRESSURE, [PRESSURE, INPUT]] = -b, b
    flow[DISTURBANCE, DISTURBANCE] = -rate
    sigma = scene.disturbance_nm / scene.inertia_kgm2
    kick = np.zeros(5)
    kick[DISTURBANCE] = sigma * math.sqrt(-math.expm1(-2.0 * rate * step_s))
    return np.asarray(expm(flow * step_s)), kick


def _edges(
    scene: Scene, wheel: SceneWheel, time_s: Vector, state: Vector, rng: Generator
) -> tuple[Integers, Vector]:
    """Numbers and captured times of all edges: crossings of a cubic between grid points."""
    half = np.pi / scene.teeth
    theta, omega = state[:, THETA], state[:, OMEGA]
    first, last = int(theta[0] / half) + 2, int(theta[-1] / half) - 1
    number = np.arange(first, last)
    angle = half * number + wheel.error_rad[number % wheel.error_rad.size]
    at = np.clip(np.searchsorted(theta, angle) - 1, 0, len(theta) - 2)
    share = (angle - theta[at]) / (theta[at + 1] - theta[at])
    for _ in range(4):
        rest = _cubic(share, theta[at], theta[at + 1], omega[at], omega[at + 1]) - angle
        share -= rest / (SCENE_STEP_S * (omega[at] + share * (omega[at + 1] - omega[at])))
    time = time_s[at] + SCENE_STEP_S * share + scene.jitter_s * rng.standard_normal(share.size)
    edge_us: Vector = np.round(time * 1e6)
    order = np.argsort(edge_us, kind="stable")
    return number[order], edge_us[order]


def _cubic(share: Vector, y0: Vector, y1: Vector, d0: Vector, d1: Vector) -> Vector:
    """Hermite's cubic over one grid step."""
    h = SCENE_STEP_S
    c2 = 3.0 * (y1 - y0) - h * (2.0 * d0 + d1)
    c3 = 2.0 * (y0 - y1) + h * (d0 + d1)
    found: Vector = y0 + share * (h * d0 + share * (c2 + share * c3))
    return found
