"""What one measurement says to a cloud of particles, against the textbook: each driveline is a
Kalman filter of angle and speed, and weighs as likely as the measurement was by it
(Rao-Blackwellised particle filter; Doucet, de Freitas, Murphy and Russell 2000). Moments by scipy
and numpy alone; how a driveline moves is held against scipy in test_lash.py."""

from __future__ import annotations

import normal_law
import numpy as np
import pytest
from scipy.linalg import expm
from test_lash import a_lash

from meshpoint.controller.estimate.lash import Lash, LashStart
from meshpoint.controller.estimate.lash_cloud import BacklashParticleFilter
from meshpoint.controller.models.backlash import ANGLE, SPEED, VEHICLE, WAY, move
from meshpoint.kernels.records import Vector

START = LashStart(0.0, 0.0, 60.0, 60.0)
TOOTH_RAD, EDGE_TIME_S = 2e-3, 1e-5
FIRST_SDS = (0.05, 2.0, 0.5)
"""Of angle (rad), speed (rad/s) and drag (rad/s2) in each driveline when a gear comes out."""
DRAG_CHANGE_RAD2_S5 = 4.0
EDGES_US = 200.0
"""Edges of a measurement, from one to the next: within 4 ms they are taken together."""


def spread(seconds: float, lash: Lash) -> Vector:
    """Covariance after some time: matrix exponential, and van Loan's integral of the noise."""
    a = np.array(((0.0, 1.0, 0.0), (0.0, 0.0, -1.0), (0.0, 0.0, 0.0)))
    noise = np.diag((0.0, lash.chance.rad2_s3, DRAG_CHANGE_RAD2_S5))
    both = expm(np.block([[-a, noise], [np.zeros((3, 3)), a.T]]) * seconds)
    f = both[3:, 3:].T
    return np.asarray(f @ np.diag(np.square(FIRST_SDS)) @ f.T + f @ both[:3, 3:])


@pytest.mark.parametrize("edges", [1, 4])
@pytest.mark.parametrize("off_rad", [-0.15, 0.0, 0.1])
@pytest.mark.parametrize("seconds", [0.004, 0.02])
def test_one_look_corrects_and_weighs_each_driveline_as_the_textbook_has_it(
    seconds: float, off_rad: float, edges: int
) -> None:
    lash = a_lash()
    x, cloud = lash.cloud(START), BacklashParticleFilter(lash, START, EDGE_TIME_S)
    move(x, seconds, lash.model(START.speed_rad_s))
    seen_rad = float(x[ANGLE].mean()) + off_rad
    times = 1e6 * seconds + EDGES_US * (np.arange(edges) - 0.5 * (edges - 1))
    cloud.take(np.array((times, np.full(edges, seen_rad))), TOOTH_RAD)

    p = spread(seconds, lash)
    speed = float(x[SPEED, 0])
    reported = (TOOTH_RAD**2 + (speed * EDGE_TIME_S) ** 2) / edges
    sd = np.sqrt(p[0, 0] + reported)
    off = seen_rad - x[ANGLE]
    likely = normal_law.pdf(off, sd=sd)
    weights = likely / likely.sum()
    assert cloud.weights == pytest.approx(weights, rel=1e-3, abs=1e-9)
    angle_sd, speed_sd = np.sqrt(np.diag(p))[:2]
    for row, gain, scale in (
        (ANGLE, p[0, 0], angle_sd), (WAY, p[0, 0], angle_sd), (SPEED, p[1, 0], speed_sd),
        (VEHICLE, 0.0, speed_sd),
    ):  # fmt: skip
        corrected = x[row] + gain / sd**2 * off
        assert cloud.mean(row) == pytest.approx(weights @ corrected, abs=1e-5 * scale)
    reported_of_vehicle = np.cov(x[VEHICLE], aweights=weights, ddof=0)
    assert cloud.vehicle.covariance[0, 0] >= reported_of_vehicle * (1.0 - 1e-6)
