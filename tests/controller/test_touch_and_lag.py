"""Touch pressure and sensor lag are learned together, by a deviance that may have a long
valley."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from meshpoint.controller.estimate.brake_model import (
    CAUTION,
    DRIFT_SD,
    MOST_ROUNDS,
    MOST_STEP,
    TOUCH_PROBE,
    best_of,
    uncorrelated,
)

FIRST = uncorrelated((0.2e5, 0.15e5), (2e-3, 3e-3))


def bowl(middle: np.ndarray, curvature: np.ndarray) -> Callable[[float, float], float]:
    def deviance(touch_pa: float, lag_s: float) -> float:
        off = np.array([touch_pa, lag_s]) - middle
        return float(300.0 + 0.5 * off @ curvature @ off)

    return deviance


@given(
    touch_pa=st.floats(0.1e5, 0.4e5),
    lag_s=st.floats(0.5e-3, 4e-3),
    sharp=st.tuples(st.floats(0.1, 50.0), st.floats(0.1, 50.0)),
    tilt=st.floats(-0.95, 0.95),
)
def test_a_paraboloid_and_what_was_known_have_the_minimum_of_their_sum(
    touch_pa: float, lag_s: float, sharp: tuple[float, float], tilt: float
) -> None:
    """Bayes' rule for normal laws; the deviance's information is divided by the square of
    caution."""
    scale = np.sqrt(sharp) / TOUCH_PROBE
    curvature = np.outer(scale, scale) * [[1.0, tilt], [tilt, 1.0]]
    middle = np.array([touch_pa, lag_s])
    found = best_of(bowl(middle, curvature), FIRST)
    prior = np.linalg.inv(FIRST.covariance + np.diag(DRIFT_SD**2))
    reported = curvature / (2.0 * CAUTION**2)
    wanted = np.linalg.solve(prior + reported, prior @ FIRST.mean + reported @ middle)
    # What would be a negative lag or touch is none.
    assert found.mean == pytest.approx(np.maximum(wanted, 0.0), rel=1e-3, abs=1e-6)
    assert found.covariance == pytest.approx(np.linalg.inv(prior + reported), rel=1e-3)


def test_along_a_valley_nothing_is_learned_and_both_figures_stay_tied() -> None:
    """Touch + 0.1 bar a millisecond of lag is learned alone: its spread falls, no other does."""
    across = np.array([1.0 / 0.1e5, 1.0 / 1e-3])
    curvature = 50.0 * np.outer(across, across)
    found = best_of(bowl(np.array([0.3e5, 1e-3]), curvature), FIRST)
    along = np.array([0.1e5, -1e-3])
    weights = np.linalg.inv(FIRST.covariance)
    sd_across = np.sqrt(across @ found.covariance @ across)
    assert sd_across < 0.15 * np.sqrt(across @ FIRST.covariance @ across)
    conditional = along @ weights @ along
    assert along @ np.linalg.inv(found.covariance) @ along == pytest.approx(conditional, rel=0.02)
    correlation = found.covariance[0, 1] / np.prod(found.sd)
    assert correlation < -0.9


def test_a_lag_that_is_known_for_certain_stays_and_the_touch_is_still_reported() -> None:
    known = uncorrelated((0.2e5, 0.15e5), (0.0, 0.0))
    found = best_of(bowl(np.array([0.3e5, 3e-3]), np.diag(400.0 / TOUCH_PROBE**2)), known)
    assert (found.mean[1], found.sd[1]) == (0.0, 0.0)
    assert found.mean[0] == pytest.approx(0.3e5, rel=0.02)


def test_a_saddle_tells_nothing_along_its_fall() -> None:
    curvature = np.diag([100.0, -100.0] / TOUCH_PROBE**2)
    found = best_of(bowl(np.array([0.3e5, 2e-3]), curvature), FIRST)
    assert found.sd[1] == pytest.approx(np.hypot(3e-3, DRIFT_SD[1]))
    assert found.sd[0] < 0.05e5


def test_a_minimum_far_off_is_gone_towards_and_not_believed() -> None:
    far = np.array([0.2e5, 19e-3])
    found = best_of(bowl(far, np.diag(1e4 / TOUCH_PROBE**2)), FIRST)
    assert 2e-3 < found.mean[1] <= 2e-3 + MOST_ROUNDS * MOST_STEP[1] + 1e-9
    assert found.sd[1] > 3e-3


def test_a_deviance_that_is_no_number_leaves_what_was_known() -> None:
    found = best_of(lambda touch_pa, lag_s: float("nan"), FIRST)
    assert found.mean == pytest.approx(FIRST.mean)
    assert (found.sd >= FIRST.sd).all()
