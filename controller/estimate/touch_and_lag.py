"""Touch pressure of the brake's pads and lag of its sensor, which are learned together.

A brake whose torque ends sooner than its measured pressure says has pads that touch late, or a
sensor that is late: one shift hardly says which. Learned one after the other, the first to be
fitted takes the whole difference and is believed. So both are carried with their covariance, as an
extended Kalman filter whose steps are shifts.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from meshpoint.kernels.records import Vector

MOST_TOUCH_PA: Final = 1.0e5
MOST_LAG_S: Final = 20e-3
PROBE: Final = np.array([0.1e5, 1.5e-3])
"""Distance of the probes about a guess, touch (Pa) and lag (s)."""
MOST_STEP: Final = np.array([0.25e5, 3e-3])
"""Beyond that a paraboloid through probes is not believed."""
DRIFT_SD: Final = np.array([0.01e5, 0.1e-3])
"""Standard deviation of the change from shift to shift."""
CAUTION: Final = 2.0
"""Factor on the estimate's standard deviations, for other errors of the model."""
MOST_ROUNDS: Final = 3


class TouchAndLag(NamedTuple):
    """What is known: mean (2,) of touch (Pa, gauge) and lag (s), covariance (2, 2)."""

    mean: Vector
    covariance: Vector

    @property
    def sd(self) -> Vector:
        """Standard deviations (2,)."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))


def uncorrelated(touch: tuple[float, float], lag: tuple[float, float]) -> TouchAndLag:
    """Of values and standard deviations alone."""
    means, sds = zip(touch, lag, strict=True)
    return TouchAndLag(np.array(means), np.diag(sds) ** 2)


def best_of(deviance: Callable[[float, float], float], known: TouchAndLag) -> TouchAndLag:
    """What is known after a shift in which `deviance(touch_pa, lag_s)` is the sum of normalised
    innovation squares, so minus twice a log-likelihood: the minimum of the paraboloid through six
    probes and of what was known, by Gauss and Newton. While the minimum lies further away than the
    probes are to be believed, values move towards it and their covariance stays."""
    prior = known.covariance + np.diag(np.where(np.diag(known.covariance) > 0.0, DRIFT_SD**2, 0.0))
    at, left = known.mean, prior
    for _ in range(MOST_ROUNDS):
        centre = np.maximum(at, [PROBE[0], 0.0])
        gradient, curvature = _paraboloid(deviance, centre)
        if not (np.isfinite(gradient).all() and np.isfinite(curvature).all()):
            break
        slope, upright = gradient / (2.0 * CAUTION**2), _upright(curvature) / (2.0 * CAUTION**2)
        # (P^-1 + A) d = P^-1 (m - c) - b, times P: a figure that is known for certain has no P^-1.
        weight = np.eye(2) + prior @ upright
        step = np.linalg.solve(weight, known.mean - centre - prior @ slope)
        share = min(1.0, float(np.min(MOST_STEP / np.maximum(np.abs(step), 1e-12))))
        at = np.clip(centre + share * step, 0.0, [MOST_TOUCH_PA, MOST_LAG_S])
        if share == 1.0:
            left = np.linalg.solve(weight, prior)
            break
    return TouchAndLag(at, (left + left.T) / 2.0)


def _paraboloid(deviance: Callable[[float, float], float], at: Vector) -> tuple[Vector, Vector]:
    """Gradient (2,) and second derivatives (2, 2) by differences."""
    touch_pa, lag_s = at.tolist()
    probe_pa, probe_s = PROBE.tolist()
    middle = deviance(touch_pa, lag_s)
    more_pa, less_pa = deviance(touch_pa + probe_pa, lag_s), deviance(touch_pa - probe_pa, lag_s)
    more_s, less_s = deviance(touch_pa, lag_s + probe_s), deviance(touch_pa, lag_s - probe_s)
    both = deviance(touch_pa + probe_pa, lag_s + probe_s)
    gradient = np.array([more_pa - less_pa, more_s - less_s]) / (2.0 * PROBE)
    mixed = (both - more_pa - more_s + middle) / (probe_pa * probe_s)
    bend_pa = (more_pa - 2.0 * middle + less_pa) / probe_pa**2
    bend_s = (more_s - 2.0 * middle + less_s) / probe_s**2
    return gradient, np.array([[bend_pa, mixed], [mixed, bend_s]])


def _upright(curvature: Vector) -> Vector:
    """The nearest curvature that is none downwards: a saddle says nothing along its fall."""
    scaled = curvature * np.outer(PROBE, PROBE)
    values, vectors = np.linalg.eigh(scaled)
    upright: Vector = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return upright / np.outer(PROBE, PROBE)
