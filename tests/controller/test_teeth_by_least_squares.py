"""What is learned of a wheel's teeth from windows of free motion, against least squares; when it is
used, doubted, forgotten and found again."""

from __future__ import annotations

import math

import numpy as np
import pytest

from meshpoint.controller.estimate.teeth import (
    LEAST_SD_RAD,
    UNLIKE_MODEL,
    PatternEquations,
    ToothPattern,
    WheelTeeth,
    turned,
)
from meshpoint.controller.measure.wheel_edges import EdgeBatch
from meshpoint.controller.settings.filters import CrossingFilterTuning
from meshpoint.kernels.records import Vector

TEETH, EDGES = 12, 24
TUNING = CrossingFilterTuning()
UNLEARNED_RAD = TUNING.tooth_error_rad
MEASUREMENT_RAD = 0.1 * UNLEARNED_RAD
"""Of one measurement at an edge."""


def pattern(seed: int) -> Vector:
    errors = UNLEARNED_RAD * np.random.default_rng(seed).standard_normal(EDGES)
    return np.asarray(errors - errors.mean())


def window(
    errors: Vector, measurements: float | Vector = 20.0, squares_share: float = 1.0
) -> PatternEquations:
    """Measurements at each edge, the wheel's mean not to be seen in them; squared residuals about
    these errors as many times the expected as is said."""
    weights = np.broadcast_to(np.asarray(measurements, float), errors.size) / MEASUREMENT_RAD**2
    normal = np.diag(weights) - np.outer(weights, weights) / weights.sum()
    right, count = normal @ errors, float(weights.sum() * MEASUREMENT_RAD**2)
    return PatternEquations(normal, right, squares_share * count + float(errors @ right), count)


def least_squares(*windows: PatternEquations) -> tuple[Vector, float, float]:
    """Errors, their mean and largest deviation; with a weak prior, the mean taken as none, and each
    window counting 99 of 100 of the next."""
    normal, right = np.zeros((EDGES, EDGES)), np.zeros(EDGES)
    for each in windows:
        normal, right = 0.99 * normal + each.normal, 0.99 * right + each.right
    covariance = np.linalg.inv(normal + (3.0 * UNLEARNED_RAD) ** -2 * np.eye(EDGES))
    centred = np.eye(EDGES) - 1.0 / EDGES
    variances = np.diag(centred @ covariance @ centred)
    return centred @ covariance @ right, math.sqrt(variances.mean()), math.sqrt(variances.max())


def a_wheel(*windows: PatternEquations) -> WheelTeeth:
    teeth = WheelTeeth(TEETH, TUNING)
    for each in windows:
        teeth.take(each)
    return teeth


def test_teeth_are_those_of_least_squares_over_all_windows_the_old_counting_a_little_less() -> None:
    measurements = np.linspace(1.0, 8.0, EDGES)
    windows = [window(pattern(1), measurements), window(pattern(1) + 1e-2 * pattern(2),
    measurements[::-1]),
               window(pattern(1), 2.0)]  # fmt: skip
    teeth = a_wheel(*windows)
    errors, sd_rad, _ = least_squares(*windows)
    assert teeth.learned
    assert teeth.error_rad == pytest.approx(errors, abs=1e-9)
    assert teeth.sd_rad == pytest.approx(sd_rad)
    assert teeth.edges_seen == sum(int(each.edges) for each in windows)
    assert a_wheel(window(pattern(1), 1e6)).sd_rad == LEAST_SD_RAD


@pytest.mark.parametrize(("share", "used"), [(0.97, False), (1.03, True)])
def test_teeth_are_used_once_the_least_sure_is_surer_than_an_unlearned_one_by_a_fifth(
    share: float, used: bool
) -> None:
    measurements = np.full(EDGES, 40.0)
    measurements[5] = 0.04
    for _ in range(60):
        measurements[5] *= (
            least_squares(window(pattern(1), measurements))[2] / (0.8 * UNLEARNED_RAD)
        ) ** 2
    measurements[5] *= share
    teeth = WheelTeeth(TEETH, TUNING)
    line = teeth.take(window(pattern(1), measurements))
    assert teeth.learned is used
    assert (f"teeth learned to {math.degrees(teeth.sd_rad):.3f} deg" == line) is used
    assert teeth.error_rad.any() == used


@pytest.mark.parametrize(
    ("missing", "unseen", "learned"),
    [((3, 7), (6, 7, 14, 15), True), ((3,), (6, 7, 14, 15), False), ((3, 7), (6, 16), False)],
)
def test_teeth_that_the_drawing_leaves_out_need_not_be_seen(
    missing: tuple[int, ...], unseen: tuple[int, ...], learned: bool
) -> None:
    measurements = np.full(90, 30.0)
    measurements[list(unseen)] = 0.0
    teeth = WheelTeeth(45, TUNING, missing)
    teeth.take(window(np.zeros(90), measurements))
    assert teeth.learned is learned


@pytest.mark.parametrize(("share", "taken"), [(0.97, True), (1.03, False)])
def test_a_window_that_no_teeth_explain_teaches_nothing(share: float, taken: bool) -> None:
    """The shaft did not move as its model has it: residuals above twice their expectation."""
    assert a_wheel(window(pattern(1), 30.0, share * UNLIKE_MODEL)).learned is taken


def test_a_window_whose_equations_are_no_numbers_teaches_nothing() -> None:
    broken = window(pattern(1))
    broken.normal[3, 3] = math.nan
    assert a_wheel(broken).edges_seen == 0


def test_teeth_that_two_windows_in_a_row_deny_are_forgotten() -> None:
    """One alone teaches nothing and is said; one that agrees in between makes good for it."""
    teeth, stranger = a_wheel(*[window(pattern(1))] * 3), window(-pattern(1))
    known, seen = teeth.error_rad.copy(), teeth.edges_seen
    assert "do not agree" in str(teeth.take(stranger))
    assert (teeth.error_rad.tolist(), teeth.edges_seen) == (known.tolist(), seen)
    teeth.take(window(pattern(1)))
    assert "do not agree" in str(teeth.take(stranger))
    assert "forgotten" in str(teeth.take(stranger))
    assert (teeth.learned, teeth.sd_rad, teeth.edges_seen) == (False, UNLEARNED_RAD, 0)
    teeth.take(stranger)
    assert teeth.error_rad == pytest.approx(least_squares(stranger)[0], abs=1e-9)


def test_teeth_that_explain_a_window_badly_but_better_than_none_are_learned_on() -> None:
    teeth = a_wheel(*[window(pattern(1))] * 3)
    seen, half = teeth.edges_seen, window(0.62 * pattern(1))
    assert teeth.take(half) is None
    assert teeth.edges_seen == seen + int(half.edges)


def test_numbers_that_are_lost_leave_the_pattern_and_it_is_found_again() -> None:
    """Its measurements then count as if they had been in the present numbering."""
    teeth = a_wheel(*[window(pattern(1))] * 3)
    errors = teeth.error_rad.copy()
    teeth.lose_numbers()
    assert not teeth.learned
    memory, again = teeth.memory, window(turned(pattern(1), 5), 6.0)
    assert memory is not None
    assert memory.error_rad.tolist() == errors.tolist()
    teeth.take(again)
    assert teeth.found is not None and teeth.found.teeth == 5
    normal = again.normal + (memory.weight + (3.0 * UNLEARNED_RAD) ** -2) * np.eye(EDGES)
    expected = np.linalg.solve(normal, again.right + memory.weight * turned(errors, 5))
    assert teeth.error_rad == pytest.approx(expected - expected.mean(), abs=1e-9)
    assert teeth.memory is None


@pytest.mark.parametrize(
    ("remembered", "seen", "said"),
    [(pattern(1), pattern(5), ["do not agree", "not those that were remembered"]),
     # Of a wheel like an ideal one every turn fits.
     (np.zeros(EDGES), np.zeros(EDGES), ["learned", "None", "cannot be distinguished"])],
)  # fmt: skip
def test_a_remembered_pattern_that_is_not_recognised_is_dropped(
    remembered: Vector, seen: Vector, said: list[str]
) -> None:
    """Another wheel's after two windows, one that cannot be distinguished from itself turned after
    three."""
    teeth = WheelTeeth(TEETH, TUNING)
    teeth.memory = ToothPattern(remembered, MEASUREMENT_RAD / 10.0, 500)
    for each in said:
        assert teeth.memory is not None
        assert each in str(teeth.take(window(seen)))
    assert teeth.memory is None
    assert teeth.learned, "its own errors are known meanwhile"


def test_each_edge_gets_the_error_of_its_place_once_these_are_known() -> None:
    """Edge 2 k is the rising one of tooth k, 2 k + 1 its falling one; teeth are counted on."""
    teeth, tooth, falling = (
        WheelTeeth(TEETH, TUNING),
        np.array((0, 0, 11, 30)),
        np.array((0, 1, 1, 1)),
    )
    batch = EdgeBatch(np.arange(4.0), 0.1 * np.arange(4.0), tooth, falling)
    place = teeth.place(batch)
    assert place.tolist() == [0, 1, 23, 13]
    assert teeth.edges(batch, place)[1].tolist() == batch.theta_rad.tolist()
    teeth.take(window(pattern(1)))
    found = teeth.edges(batch, place)
    assert found[0].tolist() == batch.time_us.tolist()
    assert found[1] == pytest.approx(batch.theta_rad + teeth.error_rad[place])
