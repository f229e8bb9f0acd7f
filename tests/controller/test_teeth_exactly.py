"""What is learned of a wheel's teeth from windows of free motion, against least squares; when it is
used, doubted and forgotten."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from meshpoint.controller.estimation.teeth import (
    DISAGREES,
    LEAST_EDGES,
    LEAST_SD_RAD,
    UNLIKE_MODEL,
    WheelTeeth,
)
from meshpoint.controller.estimation.tooth_match import PatternEquations, ToothPattern, turned
from meshpoint.controller.records import Vector
from meshpoint.controller.sensing.wheel_edges import EdgeBatch
from meshpoint.controller.settings import CrossingFilterTuning

TEETH, EDGES = 12, 24
TUNING = CrossingFilterTuning()
UNLEARNED_RAD = TUNING.tooth_error_rad
LOOK_RAD = 0.1 * UNLEARNED_RAD
"""Of one look at an edge."""


def pattern(seed: int, share: float = 1.0) -> Vector:
    errors = share * UNLEARNED_RAD * np.random.default_rng(seed).standard_normal(EDGES)
    return np.asarray(errors - errors.mean())


def window(
    errors: Vector, looks: float | Vector = 20.0, squares_share: float = 1.0,
) -> PatternEquations:  # fmt: skip
    """Looks at each edge, the wheel's mean not to be seen in them; squared residuals about these
    errors as many times the expected as is said."""
    weights = np.broadcast_to(np.asarray(looks, float), EDGES) / LOOK_RAD**2
    normal = np.diag(weights) - np.outer(weights, weights) / weights.sum()
    right = normal @ errors
    count = float(np.sum(looks) if np.ndim(looks) else EDGES * float(looks))
    return PatternEquations(normal, right, squares_share * count + float(errors @ right), count)


def learned_from(*windows: PatternEquations, forget: float = 0.99) -> tuple[Vector, float, float]:
    """Errors, and their mean and largest deviation, by least squares with a weak prior: the mean of
    all is taken as none."""
    normal, right = np.zeros((EDGES, EDGES)), np.zeros(EDGES)
    for each in windows:
        normal, right = forget * normal + each.normal, forget * right + each.right
    covariance = np.linalg.inv(normal + (3.0 * UNLEARNED_RAD) ** -2 * np.eye(EDGES))
    centred = np.eye(EDGES) - 1.0 / EDGES
    variances = np.diag(centred @ covariance @ centred)
    return (centred @ covariance @ right, math.sqrt(variances.mean()), math.sqrt(variances.max()))


def a_wheel(*windows: PatternEquations, missing: tuple[int, ...] = ()) -> WheelTeeth:
    teeth = WheelTeeth(TEETH, TUNING, missing)
    for each in windows:
        teeth.take(each)
    return teeth


def test_teeth_are_those_of_least_squares_over_all_windows_the_old_counting_a_little_less() -> None:
    looks = np.linspace(1.0, 8.0, EDGES)
    windows = [window(pattern(1), looks), window(pattern(1) + 1e-2 * pattern(2), looks[::-1]),
               window(pattern(1), 2.0)]  # fmt: skip
    teeth = a_wheel(*windows)
    errors, sd_rad, _ = learned_from(*windows)
    assert teeth.learned
    assert teeth.error_rad == pytest.approx(errors, abs=1e-9)
    assert teeth.sd_rad == pytest.approx(sd_rad)
    assert teeth.edges_seen == sum(int(each.edges) for each in windows)
    assert teeth.count == TEETH


def test_a_prior_of_three_teeth_s_errors_holds_an_edge_that_was_hardly_seen() -> None:
    """One look in a hundred windows' prior: then the weak prior shows."""
    faint = PatternEquations(1e-3 * window(pattern(1)).normal, 1e-3 * window(pattern(1)).right,
                             100.0, 100.0)  # fmt: skip
    teeth = a_wheel()
    teeth._normal, teeth._right = faint.normal.copy(), faint.right.copy()
    strong = window(pattern(3), 1.2)
    teeth.take(strong)
    assert teeth.error_rad == pytest.approx(learned_from(faint, strong)[0], abs=1e-10)


@pytest.mark.parametrize(("share", "used"), [(0.97, False), (1.03, True)])
def test_teeth_are_used_once_the_least_sure_is_surer_than_an_unlearned_one_by_a_fifth(
    share: float, used: bool
) -> None:
    looks = np.full(EDGES, 40.0)
    looks[5] = 0.04
    for _ in range(60):
        worst = learned_from(window(pattern(1), looks))[2]
        looks[5] *= (worst / (0.8 * UNLEARNED_RAD)) ** 2
    looks[5] *= share
    teeth = WheelTeeth(TEETH, TUNING)
    line = teeth.take(window(pattern(1), looks))
    assert teeth.learned is used
    assert (line is not None and "teeth learned to" in line) is used
    assert teeth.error_rad.any() == used
    if used:
        assert f"{math.degrees(teeth.sd_rad):.3f} deg" in str(line)
        assert teeth.take(window(pattern(1))) is None, "it is said once"
    else:
        assert teeth.sd_rad == UNLEARNED_RAD


def test_teeth_are_never_known_better_than_by_three_thousandths_of_a_degree() -> None:
    teeth = a_wheel(window(pattern(1), 1e6))
    assert teeth.sd_rad == LEAST_SD_RAD == math.radians(0.003)


@pytest.mark.parametrize(
    ("missing", "unseen", "learned"),
    [((3, 7), (), True), ((), (), False), ((3,), (), False), ((3, 7), (16,), False)],
)
def test_teeth_that_the_drawing_leaves_out_need_not_be_seen(
    missing: tuple[int, ...], unseen: tuple[int, ...], learned: bool
) -> None:
    """Of 45, teeth 3 and 7: edges 6, 7, 14 and 15. Any other edge that was not seen is waited
    for."""
    weights = np.full(90, 30.0 / LOOK_RAD**2)
    weights[[6, 7, 14, 15, *unseen]] = 0.0
    normal = np.diag(weights) - np.outer(weights, weights) / weights.sum()
    teeth = WheelTeeth(45, TUNING, missing)
    teeth.take(PatternEquations(normal, np.zeros(90), 2_500.0, 2_500.0))
    assert teeth.learned is learned


@pytest.mark.parametrize(("share", "taken"), [(0.97, True), (1.03, False)])
def test_a_window_that_no_teeth_explain_teaches_nothing(share: float, taken: bool) -> None:
    """The shaft did not move as its model has it: residuals above twice their expectation, whatever
    the errors."""
    teeth = a_wheel(window(pattern(1), 30.0, share * UNLIKE_MODEL))
    assert teeth.learned is taken
    assert (teeth.edges_seen > 0) is taken


def test_a_window_whose_equations_are_no_numbers_teaches_nothing() -> None:
    broken = window(pattern(1))
    broken.normal[3, 3] = math.nan
    assert a_wheel(broken).edges_seen == 0


def off_by(share: float) -> PatternEquations:
    """A window of another wheel, with errors that raise the misfit to this share of the limit."""
    base, other = pattern(1), pattern(2, 0.5)
    weight = window(base).normal
    edges = window(base).edges
    size = math.sqrt((share * DISAGREES - 1.0) * edges / float(other @ weight @ other))
    return window(base + size * other)


def test_teeth_that_two_windows_in_a_row_deny_are_forgotten() -> None:
    """One alone teaches nothing and is said; one that agrees in between makes good for it."""
    teeth = a_wheel(*[window(pattern(1))] * 3)
    known = teeth.error_rad.copy()
    # A wheel without errors would explain this one worse: it is not quite another wheel.
    assert teeth.take(off_by(0.97)) is None
    teeth = a_wheel(*[window(pattern(1))] * 3)
    stranger = window(-pattern(1))
    seen = teeth.edges_seen
    assert "do not agree" in str(teeth.take(stranger))
    assert teeth.error_rad.tolist() == known.tolist()
    assert teeth.edges_seen == seen
    teeth.take(window(pattern(1)))
    assert "do not agree" in str(teeth.take(stranger))
    assert "forgotten" in str(teeth.take(stranger))
    assert not teeth.learned
    assert not teeth.error_rad.any()
    assert (teeth.sd_rad, teeth.edges_seen) == (UNLEARNED_RAD, 0)
    assert "learned" in str(teeth.take(stranger))
    assert teeth.error_rad == pytest.approx(learned_from(stranger)[0], abs=1e-9)


def test_teeth_that_explain_a_window_badly_but_better_than_none_are_learned_on() -> None:
    teeth = a_wheel(*[window(pattern(1))] * 3)
    half = window(0.62 * pattern(1))
    assert teeth._misfit(half) > DISAGREES
    assert teeth._misfit(half) < half.squares / half.edges
    seen = teeth.edges_seen
    assert teeth.take(half) is None
    assert teeth.edges_seen == seen + int(half.edges)


def test_numbers_that_are_lost_leave_the_pattern_and_it_is_found_again() -> None:
    """With its margin; its looks then count as if they had been in the present numbering."""
    teeth = a_wheel(*[window(pattern(1))] * 3)
    errors, sd_rad, edges = teeth.error_rad.copy(), teeth.sd_rad, teeth.edges_seen
    teeth.learner.running = True
    teeth.lose_numbers()
    assert not teeth.learned
    assert not teeth.learner.running
    memory = teeth.memory
    assert memory is not None
    assert memory.error_rad.tolist() == errors.tolist()
    assert (memory.sd_rad, memory.edges) == (sd_rad, edges)
    again = window(turned(pattern(1), 5), 6.0)
    teeth.take(again)
    assert teeth.memory is None
    assert teeth.found is not None
    assert teeth.found.teeth == 5
    assert teeth.found.margin > 30.0
    assert teeth.edges_seen == edges + int(again.edges)
    normal = again.normal + (memory.weight + (3.0 * UNLEARNED_RAD) ** -2) * np.eye(EDGES)
    right = again.right + memory.weight * turned(errors, 5)
    expected = np.linalg.solve(normal, right)
    assert teeth.error_rad == pytest.approx(expected - expected.mean(), abs=1e-9)
    teeth.forget()
    assert teeth.found is None
    assert teeth.memory is None


def remembering(errors: Vector) -> WheelTeeth:
    teeth = WheelTeeth(TEETH, TUNING)
    teeth.memory = ToothPattern(errors, LOOK_RAD / 10.0, 500)
    return teeth


def test_a_remembered_pattern_of_another_wheel_is_dropped_after_two_windows() -> None:
    teeth = remembering(pattern(1))
    assert "do not agree with those that were remembered" in str(teeth.take(window(pattern(5))))
    assert teeth.memory is not None
    assert "not those that were remembered" in str(teeth.take(window(pattern(5))))
    assert teeth.memory is None
    assert teeth.learned, "its own errors are known meanwhile"


def test_a_pattern_that_cannot_be_told_from_itself_turned_is_dropped_after_three_windows() -> None:
    """Of a wheel like an ideal one every turn fits. It counts from when its own teeth are known."""
    teeth, said = remembering(np.zeros(EDGES)), []
    faint = np.full(EDGES, 6.0)
    faint[3] = 1e-3
    for looks in (faint, 8.0, 8.0, 8.0):
        said.append(teeth.take(window(np.zeros(EDGES), looks)))
    assert said[0] is None
    assert "teeth learned" in str(said[1])
    assert said[2] is None
    assert "cannot be told apart" in str(said[3])
    assert teeth.memory is None


class Running:
    """A window that runs, of which so many edges have been seen."""

    running = True

    def __init__(self, seen: PatternEquations) -> None:
        self.seen, self.asked = seen, 0

    @property
    def edges(self) -> float:
        return self.seen.edges

    def so_far(self) -> PatternEquations:
        self.asked += 1
        return self.seen


def test_a_running_window_is_compared_once_a_turn_of_the_wheel() -> None:
    """With all that was seen before; at two turns in all it is enough."""
    teeth = remembering(pattern(1))
    turn: Any = Running(window(turned(pattern(1), 3), 1.0)._replace(edges=EDGES - 1.0))
    teeth.learner = turn
    assert not teeth.look()
    assert turn.asked == 0
    turn.seen = turn.seen._replace(edges=float(EDGES))
    assert not teeth.look(), "less than two turns tell nothing"
    turn.seen = turn.seen._replace(edges=2.0 * EDGES - 1.0)
    assert not teeth.look()
    assert turn.asked == 1
    turn.seen = window(turned(pattern(1), 3), 2.0)
    assert teeth.look()
    assert teeth.found is not None
    assert teeth.found.teeth == 3
    assert teeth.learned
    assert not teeth.look(), "there is nothing left to be found"
    earlier = remembering(pattern(1))
    earlier._normal, earlier._right = (window(turned(pattern(1), 3), 1.0)[k] for k in (0, 1))  # type: ignore[assignment]
    earlier._seen = (window(turned(pattern(1), 3), 1.0).squares, float(EDGES))
    last: Any = Running(window(turned(pattern(1), 3), 1.0))
    earlier.learner = last
    assert earlier.look(), "a turn before and one now"


def test_a_short_window_is_none_and_one_that_has_ended_runs_no_more() -> None:
    for edges, kept in ((LEAST_EDGES - 1, False), (LEAST_EDGES, True)):
        teeth = WheelTeeth(TEETH, TUNING)
        learner: Any = teeth.learner
        learner._memory = SimpleNamespace(nis=np.array((7.0, float(edges))))
        assert learner.edges == 0.0
        assert learner.end() is None
        learner.running = True
        assert learner.edges == edges
        ended = learner.end()
        assert (ended is not None) is kept
        assert not learner.running
        if ended is not None:
            assert (ended.squares, ended.edges) == (7.0, edges)


def test_each_edge_gets_the_error_of_its_place_once_these_are_known() -> None:
    """Edge 2 k is the rising one of tooth k, 2 k + 1 its falling one; teeth are counted on."""
    teeth = a_wheel(*[window(pattern(1))] * 3)
    tooth, falling = np.array((0, 0, 11, 12, 30)), np.array((0, 1, 1, 0, 1))
    batch = EdgeBatch(np.arange(5.0), 0.1 * np.arange(5.0), tooth, falling)
    place = teeth.place(batch)
    assert place.tolist() == [0, 1, 23, 0, 13]
    found = teeth.edges(batch, place)
    assert found[0].tolist() == batch.time_us.tolist()
    assert found[1] == pytest.approx(batch.theta_rad + teeth.error_rad[[0, 1, 23, 0, 13]])
    other = EdgeBatch(np.arange(2.0), np.zeros(2), np.array((4, 5)), np.array((0, 0)))
    assert teeth.place(other).tolist() == [8, 10]
