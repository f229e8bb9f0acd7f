"""The posterior Cramer-Rao bound of the excitation: what no estimator of its data can beat.

The system is linear, its noises are normal, and the bound's recursion is then that of the
covariance of the best estimator: it needs no data, only when edges and pressures came. Written with
the matrix exponential of the system and Van Loan's integral, apart from the controller's filter.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import expm

from benchmarks.studies.bound_scene import OMEGA, PRESSURE, THETA, Scene, SceneRun
from meshpoint.kernels.records import Vector

QUANTUM_VARIANCE_S2 = 1e-12 / 12.0
"""Of rounding to whole microseconds."""
BOUND_STATES = 4
BITS = 17
"""Times up to 0.13 s."""


class Limit(NamedTuple):
    """Least variances: of angle and speed at each asked time, of the angle some time ahead."""

    theta_rad2: Vector
    omega_rad2_s2: Vector
    ahead_rad2: Vector


def limit(
    scene: Scene, run: SceneRun, start: Vector, grid_us: Vector, batch_us: float, ahead_us: float
) -> Limit:
    """The bound at each time of `grid_us` from batches delivered every `batch_us`; start (4, 4) is
    the covariance at time 0."""
    flow = _Flow(scene, run)
    p, at_us, edge, sample = start.copy(), 0.0, 0, 0
    theta, omega, ahead = np.empty(grid_us.size), np.empty(grid_us.size), np.empty(grid_us.size)
    speed = np.interp(run.edge_us * 1e-6, run.time_s, run.state[:, OMEGA])
    for i, time_us in enumerate(grid_us):
        delivered_us = batch_us * (time_us // batch_us)
        while True:
            next_edge = run.edge_us[edge] if edge < run.edge_us.size else np.inf
            next_sample = run.pressure_us[sample] if sample < run.pressure_us.size else np.inf
            when_us = min(next_edge, next_sample)
            if when_us > delivered_us:
                break
            p, at_us = flow.spread(p, (when_us - at_us) * 1e-6), when_us
            if next_edge <= next_sample:
                variance = speed[edge] ** 2 * (scene.jitter_s**2 + QUANTUM_VARIANCE_S2)
                p, edge = _informed(p, THETA, variance), edge + 1
            else:
                p, sample = _informed(p, PRESSURE, scene.pressure_sd_pa**2), sample + 1
        now = flow.spread(p, (time_us - at_us) * 1e-6)
        theta[i], omega[i] = now[THETA, THETA], now[OMEGA, OMEGA]
        ahead[i] = flow.spread(p, (time_us + ahead_us - at_us) * 1e-6)[THETA, THETA]
    return Limit(theta, omega, ahead)


class _Flow:
    """Covariance over a time: whole microseconds, so put together of powers of two of them."""

    def __init__(self, scene: Scene, run: SceneRun) -> None:
        a, b, g = run.parameters
        rate = 1.0 / scene.disturbance_s
        self._flow = np.zeros((BOUND_STATES, BOUND_STATES))
        self._flow[THETA, OMEGA] = 1.0
        self._flow[OMEGA] = 0.0, -a, -g, 1.0
        self._flow[PRESSURE, PRESSURE] = -b
        self._flow[3, 3] = -rate
        sigma = scene.disturbance_nm / scene.inertia_kgm2
        self._drive = np.zeros((BOUND_STATES, BOUND_STATES))
        self._drive[3, 3] = 2.0 * sigma * sigma * rate
        self._over = [self._discrete(2.0**k * 1e-6) for k in range(BITS)]

    def spread(self, p: Vector, span_s: float) -> Vector:
        """F P F' + Q over a time."""
        span_us = round(span_s * 1e6)
        for k, (f, q) in enumerate(self._over):
            if span_us >> k & 1:
                p = f @ p @ f.T + q
        return p

    def _discrete(self, span_s: float) -> tuple[Vector, Vector]:
        """F and Q over a time, both by Van Loan's matrix exponential."""
        n = BOUND_STATES
        block = np.zeros((2 * n, 2 * n))
        block[:n, :n], block[:n, n:], block[n:, n:] = -self._flow, self._drive, self._flow.T
        whole = expm(block * span_s)
        f = whole[n:, n:].T
        return f, f @ whole[:n, n:]


def _informed(p: Vector, state: int, variance: float) -> Vector:
    """After a measurement of one state."""
    column = p[:, state]
    less: Vector = p - np.outer(column, column) / (p[state, state] + variance)
    return less
