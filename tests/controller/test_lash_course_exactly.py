"""The course by a cloud of drivelines, at its ends and limits, on drivelines that turn freely
(`test_lash_course`)."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from test_lash_course import (
    HALF_GAP_RAD,
    MODEL,
    course_of,
    deviation_within_a_gap,
    turning,
    variance_after,
)

from meshpoint.controller.motion import lash_course
from meshpoint.controller.motion.lash_course import LEAST_SD_RAD, Chance, LashCourse
from meshpoint.controller.motion.lash_motion import DRAG
from meshpoint.controller.records import Vector

END_S = 0.12
"""48 steps of 2.5 ms."""
STILL = Chance(0.0, 0.03)


def alike(spread: Vector, half_gap_rad: float = HALF_GAP_RAD, chance: Chance = STILL) -> LashCourse:
    """Three drivelines at one angle and speed."""
    return LashCourse(turning([61.0] * 3), MODEL, (spread, chance), half_gap_rad)


TERMS = [((0, 0), lambda t: 1.0), ((0, 1), lambda t: 2.0 * t), ((1, 1), lambda t: t * t),
         ((0, 2), lambda t: -t * t), ((1, 2), lambda t: -t * t * t),
         ((2, 2), lambda t: 0.25 * t**4)]  # fmt: skip


@pytest.mark.parametrize(("place", "by"), TERMS, ids=lambda term: str(term)[:6])
@pytest.mark.parametrize("wait_s", [0.025, 0.1, END_S])
def test_each_number_of_the_covariance_grows_into_the_angle_by_its_own_power(
    place: tuple[int, int], by: Any, wait_s: float
) -> None:
    """Of angle + speed t - drag t^2 / 2: one number at a time, of a size to be felt then."""
    variance = (0.7 * HALF_GAP_RAD) ** 2
    spread = np.zeros((3, 3))
    spread[place] = spread[place[::-1]] = variance / by(wait_s)
    sd = math.sqrt(variance + LEAST_SD_RAD**2)
    assert alike(spread).theta_sd_ahead(wait_s) == pytest.approx(sd, rel=1e-3)


def test_an_angle_is_never_known_better_than_bearings_let_it_be() -> None:
    """Where the terms come to less than nothing, too."""
    pulled = np.zeros((3, 3))
    for pulls in (0.0, -1e-3):
        pulled[0, 1] = pulled[1, 0] = pulls
        sd = alike(pulled, 2.0 * LEAST_SD_RAD).theta_sd_ahead(0.05)
        assert sd == pytest.approx(LEAST_SD_RAD, rel=1e-3)


def test_an_angle_of_which_next_to_nothing_is_known_is_told_as_off_by_a_hundred_half_gaps() -> None:
    sd = alike(np.diag((1e6, 0.0, 0.0))).theta_sd_ahead(0.0)
    assert sd == pytest.approx(100.0 * HALF_GAP_RAD)


def test_a_course_ends_after_120_ms_and_goes_on_at_its_last_speed() -> None:
    x = turning([61.0] * 3)
    x[DRAG] = 20.0
    course = LashCourse(x, MODEL, (np.zeros((3, 3)), STILL), HALF_GAP_RAD)
    last = 61.0 - 20.0 * END_S
    end = 61.0 * END_S - 10.0 * END_S**2
    assert course.ahead(END_S) == pytest.approx((end, last))
    assert course.ahead(END_S + 0.03) == pytest.approx((end + 0.03 * last, last))
    assert course.ahead(0.05) == pytest.approx((61.0 * 0.05 - 10.0 * 0.0025, 60.0))


def test_the_sure_are_as_sure_as_they_say_unless_they_were_off_before() -> None:
    """Without a word of doubt it is one."""
    spread = np.diag((1e-4, 0.0, 0.0))
    x = turning([61.0] * 3)
    plain = LashCourse(x.copy(), MODEL, (spread, STILL), HALF_GAP_RAD).theta_sd_ahead(0.0)
    once = LashCourse(x.copy(), MODEL, (spread, STILL), HALF_GAP_RAD, 1.0).theta_sd_ahead(0.0)
    assert plain == once


def test_those_are_together_who_share_a_gap() -> None:
    """Two near each other, a third 2.2 half gaps from the first: it is the two's angle."""
    near = [0.0, 0.1 * HALF_GAP_RAD, 2.2 * HALF_GAP_RAD]
    assert course_of(turning([60.0] * 3, near)).ahead(0.0)[0] == pytest.approx(0.05 * HALF_GAP_RAD)


def test_only_what_is_asked_for_is_worked_out_and_that_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Two steps for a time between them, one at the end; of a course whole what is left is not
    asked for again. Each row of angles is put beyond the row before, by a gap at least."""
    counts: list[int] = []
    real = lash_course._fullest

    def counting(angle: Vector, apart: Vector, span_rad: float) -> Any:
        counts.append(angle.shape[0])
        assert span_rad == pytest.approx(2.0 * HALF_GAP_RAD)
        line = angle + apart
        assert (line[1:].min(axis=1) > line[:-1].max(axis=1) + span_rad).all()
        return real(angle, apart, span_rad)

    monkeypatch.setattr(lash_course, "_fullest", counting)
    course = course_of(turning([60.0, 60.2, 60.4]))
    course.ahead(0.011)
    course.ahead(0.012)
    course.theta_sd_ahead(0.0105)
    assert counts == [2]
    course.theta_sd_ahead(0.031)
    course.ahead(END_S)
    course.theta_sd_ahead(1.0)
    assert counts == [2, 2, 1]
    found = np.empty((2, 4))
    course.course(0.0, 0.01, found)
    course.course(0.02, 0.01, found)
    course.ahead(0.07)
    assert counts == [2, 2, 1, 49]


def told(spread: Vector) -> float:
    return float(spread[0, 0]) + LEAST_SD_RAD**2


def shares_of_two(apart_then: list[float], near: list[bool], spread: Vector) -> Vector:
    """Of two drivelines: how probable it is then to be near the real one, by edges that told how
    far they were apart."""
    found = []
    for apart, is_near in zip(apart_then, near, strict=True):
        other = math.exp(-0.25 * apart**2 / told(spread))
        found.append(1.0 if is_near else 1.0 / (1.0 + other))
    return np.array(found)


def outlook_of_two(
    now: float, apart: list[float], near: list[bool], spread: Vector, ahead_s: float
) -> list[float]:
    """Variances of a normal law that lies in the gap with the same probability; none grows."""
    in_gap = math.erf(HALF_GAP_RAD / math.sqrt(2.0 * variance_after(ahead_s, spread)))
    shares = in_gap * shares_of_two(apart, near, spread)
    variances = [deviation_within_a_gap(share) ** 2 for share in shares]
    return [now * min(1.0, each / variances[0]) for each in variances]


WIDE = np.diag((2e-5, 0.012, 0.0))


@pytest.mark.parametrize("horizon_s", [0.2, 0.125, 0.122])
def test_beyond_the_end_of_the_course_drivelines_are_as_far_apart_as_there(
    horizon_s: float,
) -> None:
    course = course_of(turning([60.0, 61.2]), WIDE)
    now = course.theta_sd_ahead(horizon_s) ** 2
    expected = outlook_of_two(now, [1.2 * 5e-3 * k for k in range(8)], [False] * 8, WIDE, END_S)
    assert course.outlook(horizon_s, 5e-3, 8) == pytest.approx(expected, rel=2e-3)


def test_ticks_beyond_the_end_tell_no_more_than_the_last_one_before_it() -> None:
    """Ticks of 20 ms: the seventh, after 120 ms, is the last. Two drivelines 1.2 half gaps apart,
    and ever further: what tells them apart grows slowly."""
    spread, x = np.diag((2e-5, 0.0, 0.0)), turning([60.0, 60.048], [0.0, 1.2 * HALF_GAP_RAD])
    course = course_of(x, spread)
    apart = [1.2 * HALF_GAP_RAD + 0.048 * min(0.02 * k, END_S) for k in range(8)]
    now = course.theta_sd_ahead(0.045) ** 2
    expected = outlook_of_two(now, apart, [False] * 8, spread, 0.045)
    found = course.outlook(0.045, 0.02, 8)
    assert found == pytest.approx(expected, rel=1e-2)
    assert found[7] == found[6] < found[5]


def test_nothing_is_found_out_of_drivelines_that_stay_in_one_gap() -> None:
    course = course_of(turning([60.0, 60.048]), np.diag((2e-5, 0.0, 0.0)))
    now = course.theta_sd_ahead(0.045) ** 2
    assert course.outlook(0.045, 0.02, 8).tolist() == pytest.approx([now] * 8)


def test_what_is_predicted_never_gets_less_sure_by_waiting() -> None:
    """Together now, and so still near each other at the first prediction; apart at the next ones.
    Told apart by 12 mrad a tick, they are not as sure again: nothing more is promised."""
    course = course_of(turning([60.0, 61.2]), WIDE)
    found = course.outlook(5e-3, 0.01, 8)
    now = course.theta_sd_ahead(5e-3) ** 2
    near = [1.2 * (0.01 * k + 5e-3) < HALF_GAP_RAD for k in range(8)]
    assert near[:2] == [True, False]
    apart = [1.2 * 0.01 * k for k in range(8)]
    expected = outlook_of_two(now, apart, near, WIDE, 5e-3)
    assert found == pytest.approx(expected, rel=2e-3)
    assert found.tolist() == pytest.approx([now] * 8)


def test_what_will_be_known_is_worked_out_by_sixty_of_many_drivelines() -> None:
    """Of 240 each fourth: were these alike, the others would not be asked."""
    speeds = [60.0 if k % 4 == 0 else 61.2 for k in range(240)]
    course = course_of(turning(speeds), np.diag((2e-5, 0.0, 0.0)))
    found = course.outlook(0.045, 5e-3, 8)
    assert found.tolist() == pytest.approx([course.theta_sd_ahead(0.045) ** 2] * 8)


@pytest.mark.parametrize(
    ("many", "each", "asked"), [(119, 2, False), (120, 2, True), (179, 2, True), (179, 3, False),
                                (180, 3, True), (239, 4, False)],
)  # fmt: skip
def test_at_least_sixty_drivelines_are_asked_evenly(many: int, each: int, asked: bool) -> None:
    """Whether only each second, third or fourth is asked shows where all of these are alike."""
    speeds = [60.0 if k % each == 0 else 61.2 for k in range(many)]
    found = course_of(turning(speeds), np.diag((2e-5, 0.0, 0.0))).outlook(0.045, 5e-3, 8)
    assert bool(found[7] == pytest.approx(found[0])) is asked


def test_the_first_eight_ticks_tell_ever_more_and_those_after_them_no_more() -> None:
    course = course_of(turning([60.0, 60.6]), np.diag((2e-4, 0.0, 0.0)))
    found = course.outlook(0.06, 5e-3, 11)
    assert (np.diff(found[:8]) < 0.0).all()
    assert found[8:].tolist() == [found[7]] * 3
    assert math.degrees(LEAST_SD_RAD) == pytest.approx(0.1)


Fullest = Callable[[Vector, Vector, float], Any]
BOTH: list[Fullest] = [lash_course._fullest_at_once, lash_course._fullest_by_kernel]


@pytest.mark.parametrize("fullest", BOTH)
def test_of_drivelines_that_are_all_alone_the_one_in_the_middle_is_taken(fullest: Fullest) -> None:
    """In the order of their angles."""
    angle = np.array([[4.0, 0.0, 2.0], [6.0, 2.0, 4.0]])
    order, first, most = fullest(angle, np.array([[0.0], [9.0]]), 1.0)
    assert order.tolist() == [[1, 2, 0]] * 2
    assert (first.tolist(), most.tolist()) == ([1, 1], [1, 1])


@pytest.mark.parametrize("fullest", BOTH)
def test_a_span_holds_what_lies_at_its_very_end(fullest: Fullest) -> None:
    angle = np.array([[0.0, 0.25, 0.5, 2.0], [2.0, 0.25, 0.5, 0.0]])
    order, first, most = fullest(angle, np.array([[0.0], [8.0]]), 0.5)
    assert order.tolist() == [[0, 1, 2, 3], [3, 1, 2, 0]]
    assert (first.tolist(), most.tolist()) == ([0, 0], [3, 3])


@pytest.mark.parametrize("fullest", BOTH)
def test_of_equal_angles_the_first_driveline_comes_first(fullest: Fullest) -> None:
    """Also where they came the other way round at the step before."""
    angle = np.array([[2.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, 1.0, 1.0], [0.0, 1.0, 2.0]])
    order, _, _ = fullest(angle, 9.0 * np.arange(4.0)[:, np.newaxis], 0.5)
    assert order.tolist() == [[2, 1, 0], [2, 0, 1], [0, 1, 2], [0, 1, 2]]
