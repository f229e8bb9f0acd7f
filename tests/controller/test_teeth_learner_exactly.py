"""The equations of one window in which teeth are learned, and what a wheel keeps of its windows:
against the normal law of a few edges, and by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from meshpoint.controller.estimation import teeth as module
from meshpoint.controller.estimation.crossing_filter import NO_PRESSURES
from meshpoint.controller.estimation.teeth import Found, TeethLearner, WheelTeeth
from meshpoint.controller.estimation.tooth_match import PatternEquations, ToothPattern
from meshpoint.controller.motion.models import MotionModel, first_order_law
from meshpoint.controller.records import Vector
from meshpoint.controller.sensing.wheel_edges import EdgeBatch
from meshpoint.controller.settings import CrossingFilterTuning

TUNING = CrossingFilterTuning()
UNLEARNED = TUNING.tooth_error_rad
LAW = first_order_law(12.0, 6e5)
STILL = MotionModel(np.array([0.0, 0.0, 1.0]), LAW, np.zeros(4))
OFF = np.empty((2, 0))
RAD_S, ANGLE_RAD2 = 100.0, 4e-6
X = np.array([0.0, RAD_S, 0.0, 0.0, 1.0, 0.0])


def batch(times_us: list[float], off: list[float]) -> EdgeBatch:
    """Edges of a shaft at an even speed, off by so much."""
    times = np.array(times_us)
    angles = RAD_S * 1e-6 * times + np.array(off)
    return EdgeBatch(times, angles, np.zeros(times.size, np.int64), np.zeros(times.size, np.int64))


def begun(edges: int = 3) -> TeethLearner:
    """Of the shaft only the angle is not known."""
    learner = TeethLearner(TUNING, edges)
    learner.begin(0.0, X, np.diag((ANGLE_RAD2, *[0.0] * 5)))
    return learner


def law(edge_s: float, count: int) -> Vector:
    """Covariance of edges that share the shaft's angle: each has an error of time of its own."""
    found: Vector = np.full((count, count), ANGLE_RAD2) + (RAD_S * edge_s) ** 2 * np.eye(count)
    return found


def test_a_window_s_equations_are_those_of_the_normal_law_of_its_edges() -> None:
    """Normal matrix C^-1, right side -C^-1 y, squares y' C^-1 y, and the logarithm of C's
    determinant; C tells how edges go together. In parts as at once; late ones are left out."""
    off, learner = [2e-3, -1e-3, 5e-4], begun()
    learner.take(batch([1e3, 2e3], off[:2]), np.array([0, 1]), NO_PRESSURES, OFF, STILL)
    late = batch([1.5e3, 3e3], [9.0, off[2]])
    learner.take(late, np.array([0, 2]), NO_PRESSURES, OFF, STILL)
    c = law(TUNING.edge_time_s, 3)
    inverse, y = np.linalg.inv(c), np.array(off)
    found = learner.so_far()
    assert found.normal == pytest.approx(inverse, rel=1e-6)
    assert np.array_equal(found.normal, found.normal.T)
    assert found.right == pytest.approx(-inverse @ y, rel=1e-6)
    assert found.squares == pytest.approx(y @ inverse @ y, rel=1e-6)
    assert (found.edges, learner.edges) == (3.0, 3.0)
    assert learner.log_variance == pytest.approx(np.linalg.slogdet(c)[1])
    found.right[0] = 7.0
    assert learner.so_far().right[0] != 7.0


def test_a_window_begins_with_nothing_and_edges_as_sure_as_is_set() -> None:
    learner = begun(2)
    assert learner.running
    learner.take(batch([1e3], [2e-3]), np.array([1]), NO_PRESSURES, OFF, STILL)
    learner.set_edge_time(3e-5)
    learner.begin(500.0, X, np.diag((ANGLE_RAD2, *[0.0] * 5)))
    # At 0.5 ms the shaft is where it was at 0, so 0.05 rad behind.
    learner.take(batch([600.0], [-0.05 + 1e-3]), np.array([0]), NO_PRESSURES, OFF, STILL)
    variance = ANGLE_RAD2 + (RAD_S * 3e-5) ** 2
    found = learner.so_far()
    assert found.normal == pytest.approx(np.diag((1.0 / variance, 0.0)))
    assert found.right == pytest.approx((-1e-3 / variance, 0.0))
    assert (found.squares, found.edges) == pytest.approx((1e-6 / variance, 1.0))
    assert learner.log_variance == pytest.approx(math.log(variance))


def test_no_edge_of_a_window_is_refused() -> None:
    learner = begun(2)
    learner.take(batch([1e3, 2e3], [3.0, -3.0]), np.array([0, 1]), NO_PRESSURES, OFF, STILL)
    assert learner.edges == 2.0


def test_a_window_moves_by_the_model_it_was_given_last() -> None:
    """Friction of 9 1/s leaves of 100 rad/s in 10 ms a way of 100 / 9 (1 - e^-0.09) rad."""
    for after in (False, True):
        learner = begun(1)
        place = np.array([0])
        if after:
            learner.take(batch([], []), place[:0], NO_PRESSURES, OFF, STILL)
        braked = STILL.with_friction(9.0)
        for _ in range(2):  # the same object again
            learner.take(batch([], []), place[:0], NO_PRESSURES, OFF, braked)
        way = RAD_S / 9.0 * (1.0 - math.exp(-0.09))
        learner.take(batch([10e3], [way - 1.0]), place, NO_PRESSURES, OFF, braked)
        assert learner.so_far().squares == pytest.approx(0.0, abs=1e-6)
        assert learner.so_far().edges == 1.0
        # And all of a window at once, of a shaft that is not braked.
        learner.begin(0.0, X, np.diag((ANGLE_RAD2, *[0.0] * 5)))
        learner.take_all(np.array([[10e3], [1.0]]), place, STILL)
        assert learner.so_far().squares == pytest.approx(0.0, abs=1e-6)
        learner.begin(0.0, X, np.diag((ANGLE_RAD2, *[0.0] * 5)))
        learner.take(batch([10e3], [0.0]), place, NO_PRESSURES, OFF, STILL)
        assert learner.so_far().squares == pytest.approx(0.0, abs=1e-6)


def test_all_of_a_window_at_once_is_as_edge_after_edge() -> None:
    """Each in its place; late ones are left out here, too."""
    one, other = begun(), begun()
    edges = batch([1e3, 2e3, 3e3], [2e-3, -1e-3, 5e-4])
    place = np.array([2, 0, 1])
    one.take(edges, place, NO_PRESSURES, OFF, STILL)
    other.take_all(np.array((edges.time_us, edges.theta_rad)), place, STILL)
    for found in (one, other):
        found.take_all(np.array([[2e3, 4e3], [9.0, 0.4]]), np.array([1, 1]), STILL)
    assert other.so_far().normal == pytest.approx(one.so_far().normal)
    assert other.so_far().right == pytest.approx(one.so_far().right)
    assert (one.edges, other.edges) == (4.0, 4.0)


@pytest.mark.parametrize(("count", "told"), [(39, False), (40, True)])
def test_a_window_of_less_than_forty_edges_is_none(count: int, told: bool) -> None:
    learner = begun(2)
    learner._memory.nis[1] = count
    assert (learner.end() is not None) is told
    assert not learner.running
    assert learner.edges == 0.0
    learner._memory.nis[1] = 99.0
    assert learner.end() is None


# What a wheel of two teeth keeps of windows.
EDGES = 4


def window(weight: float, right: Vector, squares: float, count: float) -> PatternEquations:
    return PatternEquations(weight * np.eye(EDGES), right, squares, count)


NONE = np.zeros(EDGES)
SURE = 1e4 / UNLEARNED**2
"""Weight of edges that were seen to a hundredth of an unlearned tooth's error."""


@pytest.mark.parametrize(("misfit", "taken"), [(1.9, True), (2.1, False)])
def test_a_window_is_learned_where_its_residuals_are_no_more_than_twice_the_expected(
    misfit: float, taken: bool
) -> None:
    """With the errors that suit it best, of which three unlearned teeth's is a deviation."""
    teeth = WheelTeeth(2, TUNING)
    prior = 1.0 / (3.0 * UNLEARNED) ** 2
    right = np.array((1.0, -1.0, 0.5, -0.5)) * 30.0 / UNLEARNED
    explained = float(right @ right) / (2.0 * prior + prior)
    squares = misfit * 50.0 + explained
    teeth.take(window(2.0 * prior, right, squares, 50.0))
    assert teeth._seen == ((squares, 50.0) if taken else (0.0, 0.0))
    assert teeth.edges_seen == (50 if taken else 0)


def test_what_was_seen_is_the_sum_of_all_windows_until_the_teeth_are_forgotten() -> None:
    """An older window's equations count 99 of 100 against a newer one's."""
    teeth = WheelTeeth(2, TUNING)
    assert (teeth._seen, teeth.found) == ((0.0, 0.0), None)
    teeth._looked_at = 5.0
    right = np.array((1.0, -1.0, 2.0, -2.0))
    for squares, count in ((30.0, 40.0), (21.0, 45.0)):
        teeth.take(window(SURE, right, squares, count))
        assert teeth._looked_at == 0.0
    assert teeth._seen == (51.0, 85.0)
    assert teeth._normal == pytest.approx(1.99 * SURE * np.eye(EDGES))
    assert teeth._right == pytest.approx(1.99 * right)
    teeth.memory, teeth._looked_at = ToothPattern(NONE, 1.0, 9), 7.0
    teeth.found, teeth.learner.running = Found(1, 1.0), True
    teeth.forget()
    assert (teeth._seen, teeth._looked_at, teeth.edges_seen) == ((0.0, 0.0), 0.0, 0)
    assert not teeth._normal.any() and not teeth._right.any() and not teeth.error_rad.any()
    left = teeth.memory, teeth.found, teeth.learned, teeth.learner.running
    assert [bool(each) for each in left] == [False] * 4
    assert teeth.sd_rad == UNLEARNED


@pytest.mark.parametrize(("misfit", "strange"), [(2.9, False), (3.1, True)])
def test_teeth_are_another_wheel_s_where_they_leave_three_times_the_expected_residuals(
    misfit: float, strange: bool
) -> None:
    """And explain a window no better than no errors would."""
    teeth = WheelTeeth(2, TUNING)
    teeth.error_rad = np.array((1.0, -1.0, 0.0, 0.0)) * 0.1
    # e' N e is 2 * 0.01 * 500 = 10.
    seen = window(500.0, NONE, misfit * 50.0 - 10.0, 50.0)
    assert teeth._is_a_stranger_s(seen) is strange
    helped = window(500.0, np.array((51.0, -51.0, 0.0, 0.0)), misfit * 50.0 + 10.4, 50.0)
    assert teeth._misfit(helped) == pytest.approx(misfit)
    assert not teeth._is_a_stranger_s(helped)


def test_errors_have_no_mean_and_are_surer_than_unlearned_ones_by_a_fifth_at_least() -> None:
    """With a prior of three unlearned teeth's error: here the edges' own mean is seen as well."""
    teeth, errors = WheelTeeth(2, TUNING), UNLEARNED * np.array((1.0, 0.2, -0.4, 0.6))
    line = teeth.take(window(SURE, SURE * errors, SURE * float(errors @ errors), 60.0))
    shrunk = SURE / (SURE + 1.0 / 9.0 / UNLEARNED**2)
    assert teeth.error_rad == pytest.approx(shrunk * (errors - errors.mean()))
    sd = math.sqrt(0.75 / (SURE + 1.0 / 9.0 / UNLEARNED**2))
    assert teeth.sd_rad == pytest.approx(max(math.radians(0.003), sd))
    assert line == f"teeth learned to {math.degrees(teeth.sd_rad):.3f} deg"
    for weight, learned in ((1.16, False), (1.18, True)):
        # Less the mean, four edges have three quarters of their variance.
        teeth = WheelTeeth(2, TUNING)
        teeth.take(window((weight - 1.0 / 9.0) / UNLEARNED**2, NONE, 1.0, 60.0))
        assert teeth.learned is learned


def test_equations_that_have_no_solution_make_the_teeth_be_forgotten() -> None:
    teeth = WheelTeeth(2, TUNING)
    teeth._normal[:] = math.nan
    assert teeth.take(window(SURE, NONE, 1.0, 60.0)) == (
        "teeth forgotten: their equations have no solution"
    )
    assert not teeth._normal.any()
    assert teeth.edges_seen == 0


def test_a_window_that_ends_is_learned_from_and_none_where_it_was_too_short(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    teeth = WheelTeeth(2, TUNING)
    taken: list[PatternEquations] = []
    assert teeth.end_window() is None

    def take(each: PatternEquations) -> str:
        taken.append(each)
        return "said"

    monkeypatch.setattr(teeth, "take", take)
    for count, said in ((39.0, None), (40.0, "said")):
        teeth.learner.running, teeth.learner._memory.nis[1] = True, count
        assert teeth.end_window() == said
    assert [each.edges for each in taken] == [40.0]


@pytest.mark.parametrize("missing", [(), (1,)])
def test_a_remembered_pattern_is_compared_with_all_that_was_seen_and_the_running_window(
    missing: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """With errors of up to ten unlearned teeth's; where the drawing leaves teeth out, their numbers
    are its."""
    asked: list[tuple[object, ...]] = []
    monkeypatch.setattr(module, "compare", lambda *given: asked.append(given))
    teeth, memory = WheelTeeth(2, TUNING, missing), ToothPattern(NONE, 1.0, 9)
    teeth._normal[:], teeth._right[:], teeth._seen = 2.0, 3.0, (30.0, 40.0)
    running = window(5.0, np.full(EDGES, 7.0), 11.0, 13.0)
    teeth._verdict(memory, None)
    teeth._verdict(memory, running)
    for given, (normal, right, squares, edges) in zip(
        asked,
        ((np.full((4, 4), 2.0), 3.0, 30.0, 40.0),
         (np.full((4, 4), 2.0) + 5.0 * np.eye(4), 10.0, 41.0, 53.0)),
        strict=True,
    ):  # fmt: skip
        which, seen, most, numbered = given
        assert which is memory
        assert isinstance(seen, PatternEquations)
        assert seen.normal.tolist() == normal.tolist()
        assert seen.right.tolist() == [right] * EDGES
        assert (seen.squares, seen.edges) == (squares, edges)
        assert most == pytest.approx(10.0 * UNLEARNED)
        assert numbered is bool(missing)


def test_numbers_that_are_lost_before_teeth_were_learned_leave_no_pattern() -> None:
    teeth = WheelTeeth(2, TUNING)
    teeth.lose_numbers()
    assert teeth.memory is None
    teeth.learned = True
    teeth.lose_numbers()
    assert teeth.memory is not None


def test_edges_of_unlearned_teeth_stand_for_their_nominal_angles() -> None:
    teeth, edges = WheelTeeth(2, TUNING), batch([1e3, 2e3], [0.0, 1e-3])
    teeth.error_rad = np.ones(EDGES)
    found = teeth.edges(edges, np.array([0, 1]))
    assert found.tolist() == [edges.time_us.tolist(), edges.theta_rad.tolist()]
