"""The driveline's equations moved on in time: the exponential of a matrix is that of scipy."""

import numpy as np
import pytest

from meshpoint.controller.models.twist import ENGINE, STATES, Twist, TwistFigures, exponential

TRUCK = TwistFigures(
    ratio=3.7, geared_kgm2=25.0, released_kgm2=4.0, constant_nm=-60.0, shaft_nm_rad=7e4,
    shaft_nms=90.0, wheels_kgm2=30.0, tyre_nm_rad=9e4, tyre_nms=300.0, fading=12.0,
    vehicle_inverse=1 / 9000, hill_rad_s2=0.2, lag_s=0.08,
)  # fmt: skip


@pytest.mark.parametrize("seconds", [0.001, 0.02, 0.4])
def test_two_steps_move_a_driveline_as_one_does(seconds: float) -> None:
    twist = Twist(TRUCK, np.zeros(STATES))
    half, whole = twist.within(seconds / 2), twist.within(seconds)
    assert half @ half == pytest.approx(whole, rel=1e-9, abs=1e-9)
    assert whole[ENGINE, ENGINE] == pytest.approx(np.exp(-seconds / TRUCK.lag_s), rel=1e-11)


@pytest.mark.parametrize("norm", [1e-9, 0.49, 0.5, 30.0, 3000.0])
def test_matrices_of_any_size_have_the_exponential_of_scipy(norm: float) -> None:
    from scipy.linalg import expm

    drawn = np.random.default_rng(1).normal(size=(7, 7))
    damped = drawn - drawn.T - np.eye(7)  # as a driveline: it swings and dies away
    matrix = norm / np.abs(damped).sum(axis=0).max() * damped
    assert exponential(matrix) == pytest.approx(expm(matrix), rel=1e-9, abs=1e-12)


def test_nothing_moves_in_no_time() -> None:
    assert np.array_equal(exponential(np.zeros((3, 3))), np.eye(3))
