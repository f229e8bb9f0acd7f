"""The trajectory of a shaft by a cloud of particles, where it can be worked out on paper:
drivelines that turn amid a wide backlash, which nothing slows down."""

from __future__ import annotations

import math
from statistics import NormalDist

import numpy as np
import pytest

from meshpoint.controller.models.backlash import (
    ANGLE,
    DRAG,
    HALF,
    HILL,
    LEAST_SD_RAD,
    MOST_SURE,
    MOST_TICKS,
    ROWS,
    SPEED,
    STEP_S,
    STEPS,
    STIFF,
    TYRE_STIFF,
    VEHICLE,
    WAY,
    WHEELS,
    Chance,
    LashModel,
    LashTrajectory,
)
from meshpoint.kernels.records import Vector

MODEL = LashModel(wheels_share=0.25, tyre_per_s=4.0, fading_per_s=17.0)
HALF_GAP_RAD = math.radians(0.95)
SPREAD: Vector = np.array(((4e-6, 2e-5, -1e-5), (2e-5, 0.01, 0.02), (-1e-5, 0.02, 0.3)))
"""Of angle, speed and drag."""
CHANCE = Chance(0.8, 0.03)


def turning(speeds: list[float], angles: list[float] | None = None) -> Vector:
    """Drivelines with these speeds, a second's way from the next flank."""
    x = np.zeros((ROWS, len(speeds)))
    x[SPEED], x[ANGLE] = speeds, 0.0 if angles is None else angles
    x[WHEELS] = x[VEHICLE] = 60.0
    x[HALF] = x[WAY] = 100.0
    x[STIFF], x[TYRE_STIFF] = 4800.0, 5500.0
    return x


def trajectory_of(x: Vector, spread: Vector = SPREAD, nis: float = 1.0) -> LashTrajectory:
    return LashTrajectory(x, MODEL, (spread, CHANCE), HALF_GAP_RAD, nis)


def variance_after(seconds: float, spread: Vector = SPREAD) -> float:
    """Of angle + speed t - drag t^2 / 2, and of chance."""
    by = np.array((1.0, seconds, -(seconds**2) / 2.0))
    return float(by @ spread @ by) + variance_by_chance(seconds) + LEAST_SD_RAD**2


def variance_by_chance(seconds: float) -> float:
    """What accelerations that last for a while make of an angle: their covariance, summed."""
    at = np.linspace(0.0, seconds, 801)
    left = seconds - at
    together = np.exp(-np.abs(at[:, np.newaxis] - at) / CHANCE.memory_s)
    variance = CHANCE.rad2_s3 / (2.0 * CHANCE.memory_s)
    summed = np.trapezoid(np.trapezoid(np.outer(left, left) * together, at, axis=0), at)
    return float(variance * summed)


@pytest.mark.parametrize("seconds", [1e-3, 0.02, 0.1, 1.0])
def test_chance_is_white_over_long_times_and_steady_over_short_ones(seconds: float) -> None:
    found = float(CHANCE.theta_rad2(np.array(seconds)))
    assert found == pytest.approx(variance_by_chance(seconds), rel=2e-3)
    white = CHANCE.rad2_s3 * seconds**3 / 3.0
    steady = CHANCE.rad2_s3 / (2.0 * CHANCE.memory_s) * seconds**4 / 4.0
    assert found < min(white, steady) * (1.0 + 1e-6)


def deviation_within_a_gap(share: float) -> float:
    """Of the normal law of which this share lies within half a gap."""
    return HALF_GAP_RAD / NormalDist().inv_cdf(0.5 + 0.5 * share)


@pytest.mark.parametrize("wait_s", [0.0, 0.02, 0.045, 0.1])
def test_drivelines_that_are_alike_turn_on_and_are_as_sure_as_each_of_them(wait_s: float) -> None:
    trajectory = trajectory_of(turning([61.0] * 5))
    assert trajectory.ahead(wait_s) == pytest.approx((61.0 * wait_s, 61.0), abs=1e-9)
    surest = deviation_within_a_gap(MOST_SURE)
    expected = max(surest, math.sqrt(variance_after(wait_s)))
    assert trajectory.theta_sd_ahead(wait_s) == pytest.approx(expected, rel=5e-3)


def test_where_the_figures_would_make_an_angle_surer_than_bearings_let_it_be_it_is_not() -> None:
    """Speed and drag that are thought to make good for each other."""
    pulled = np.zeros((3, 3))
    pulled[0, 1] = pulled[1, 0] = -1e-3
    trajectory = LashTrajectory(
        turning([60.0] * 3), MODEL, (pulled, Chance(0.0, 0.03)), 4.0 * LEAST_SD_RAD
    )
    assert trajectory.theta_sd_ahead(0.05) >= LEAST_SD_RAD


@pytest.mark.parametrize("wait_s", [0.0, 0.045, 1.0])
def test_one_driveline_in_twenty_is_faster_than_the_speed_said_for_that_share(
    wait_s: float,
) -> None:
    """Nineteen of twenty turn amid their backlash, at 60.00 to 60.95 rad/s."""
    trajectory = trajectory_of(turning([60.0 + 0.05 * k for k in range(20)] + [90.0]))
    assert trajectory.fastest_ahead(wait_s, 0.05) == pytest.approx(60.95, abs=1e-6)
    assert trajectory.fastest_ahead(wait_s, 0.0) == pytest.approx(90.0, abs=1e-6)
    assert trajectory.fastest_ahead(wait_s, 0.5) == pytest.approx(60.5, abs=1e-6)


def test_a_trajectory_goes_on_at_its_speed_before_its_begin_and_behind_its_end() -> None:
    trajectory, end_s = trajectory_of(turning([61.0] * 3)), STEP_S * (STEPS - 1)
    assert trajectory.ahead(-0.01) == pytest.approx((-0.61, 61.0), abs=1e-9)
    assert trajectory.ahead(end_s + 0.05) == pytest.approx((61.0 * (end_s + 0.05), 61.0), abs=1e-9)
    assert trajectory.theta_sd_ahead(-1.0) == trajectory.theta_sd_ahead(0.0)
    assert trajectory.theta_sd_ahead(1.0) == trajectory.theta_sd_ahead(end_s)


def test_seen_from_later_it_is_the_same_trajectory() -> None:
    """Also from later than later; the first one stays as it was."""
    first = trajectory_of(turning([60.0, 60.2, 60.4, 65.0]))
    later = first.after(0.01).after(0.015)
    for wait_s in (-0.02, 0.0, 0.03, 0.2):
        assert later.ahead(wait_s) == pytest.approx(first.ahead(wait_s + 0.025))
        assert later.theta_sd_ahead(wait_s) == pytest.approx(first.theta_sd_ahead(wait_s + 0.025))
    assert first.since_s == 0.0
    found, alone = np.empty((1, 2, 9)), first.after(0.025)
    later.trajectories(np.array([0.004]), 0.003, found)
    for k in range(9):
        assert found[0, :, k] == pytest.approx(alone.ahead(0.004 + 0.003 * k))


def test_the_angle_is_that_of_the_drivelines_most_of_which_share_a_gap() -> None:
    """Three together and one beyond a whole gap: it is the three's, with three fourths of what
    they would be sure of."""
    near = HALF_GAP_RAD * np.array((0.5, 0.1, 0.0))
    trajectory = trajectory_of(turning([61.0, 62.0, 63.0, 61.0], [*near, -2.1 * HALF_GAP_RAD]))
    angle, speed = trajectory.ahead(0.0)
    assert (angle, speed) == pytest.approx((near.mean(), 62.0))
    width = math.sqrt(2.0 * (near.var() + variance_after(0.0)))
    sure = 0.75 * math.erf(HALF_GAP_RAD / width)
    assert trajectory.theta_sd_ahead(0.0) == pytest.approx(deviation_within_a_gap(sure), rel=5e-3)


def test_of_groups_as_large_the_one_in_the_middle_counts() -> None:
    three = [-3.0 * HALF_GAP_RAD, 0.0, 3.0 * HALF_GAP_RAD]
    assert trajectory_of(turning([60.0] * 3, three)).ahead(0.0)[0] == pytest.approx(0.0)


def test_a_cloud_that_was_off_by_twice_what_it_said_says_twice_as_much() -> None:
    x = turning([60.0, 60.1, 60.5])
    once, twice = trajectory_of(x.copy()), trajectory_of(x.copy(), nis=2.0)
    for wait_s in (0.0, 0.03, 0.07):
        assert twice.theta_sd_ahead(wait_s) == pytest.approx(2.0 * once.theta_sd_ahead(wait_s))
        assert twice.ahead(wait_s) == once.ahead(wait_s)


def test_what_is_told_of_the_speed_is_the_cloud_s() -> None:
    """How fast the shaft turns against the vehicle, how sure that is, and what the hill does."""
    x = turning([61.0, 63.0])
    x[HILL] = 1.0, 2.0
    trajectory = trajectory_of(x)
    assert trajectory.speed_rad_s == pytest.approx(62.0 - 60.0)
    assert trajectory.speed_sd_rad_s == pytest.approx(math.sqrt(1.0 + SPREAD[1, 1]))
    assert trajectory.hill_rad_s2 == pytest.approx(1.5)


def test_nothing_is_found_out_by_waiting_where_all_drivelines_are_alike() -> None:
    trajectory = trajectory_of(turning([60.0] * 8))
    expected = [trajectory.theta_sd_ahead(0.045) ** 2] * 12
    assert trajectory.outlook(0.045, 0.01, 12).tolist() == pytest.approx(expected)


@pytest.mark.parametrize("many", [8, 240])
@pytest.mark.parametrize("tick_s", [2.5e-3, 5e-3])
def test_which_of_two_drivelines_it_is_shows_as_they_part(many: int, tick_s: float) -> None:
    """Edges tell two angles d apart, each known to s: the wrong one's weight is exp(-d^2/4s^2).
    When the sleeve arrives they are more than a gap apart, so being right is being in the gap."""
    spread = np.diag((2e-5, 0.0, 0.0))
    reported = spread[0, 0] + LEAST_SD_RAD**2
    trajectory = trajectory_of(turning([60.0] * (many // 2) + [61.2] * (many // 2)), spread)
    horizon_s = 0.045
    in_gap = math.erf(HALF_GAP_RAD / math.sqrt(2.0 * variance_after(horizon_s, spread)))
    found = trajectory.outlook(horizon_s, tick_s, MOST_TICKS + 2)
    apart = 1.2 * tick_s * np.arange(MOST_TICKS)
    shares = in_gap / (1.0 + np.exp(-0.25 * apart**2 / reported))
    variances = np.array([deviation_within_a_gap(share) for share in shares]) ** 2
    expected = found[0] * variances / variances[0]
    assert found[:MOST_TICKS] == pytest.approx(expected, rel=2e-2)
    assert found[MOST_TICKS:].tolist() == [found[MOST_TICKS - 1]] * 2
    assert found[0] == pytest.approx(trajectory.theta_sd_ahead(horizon_s) ** 2)


def test_two_that_come_together_again_are_told_apart_by_how_far_they_were_apart() -> None:
    """One is thrown ahead of the other and comes back after 15 ms: they were farthest apart at
    7.5 ms, and what was seen then stays known."""
    x = turning([60.0, 66.0])
    x[DRAG, 1] = 800.0
    outlook = trajectory_of(x, np.diag((2e-5, 0.0, 0.0))).outlook(0.07, 2.5e-3, MOST_TICKS)
    assert outlook[3:] == pytest.approx([outlook[3]] * (MOST_TICKS - 3))
    assert outlook[3] < outlook[2] < outlook[1] < outlook[0]


def scattered() -> Vector:
    """Drivelines that meet flanks at different times, some of them twice."""
    rng = np.random.default_rng(7)
    x = turning(rng.normal(62.0, 1.5, 240).tolist(), rng.normal(0.0, 0.03, 240).tolist())
    x[HALF], x[WAY] = 0.03, rng.uniform(0.0, 0.06, 240)
    x[:, 100:140] = x[:, 60:100]
    return x


def test_a_step_asked_for_alone_is_that_of_the_whole_trajectory_to_the_bit() -> None:
    whole = trajectory_of(scattered(), nis=1.3)
    found = np.empty((1, 2, 2 * STEPS))
    whole.trajectories(np.array([-STEP_S]), 0.7 * STEP_S, found)
    for k, (angle, speed) in enumerate(found[0].T.tolist()):
        alone, wait_s = trajectory_of(scattered(), nis=1.3), -STEP_S + 0.7 * STEP_S * k
        assert alone.ahead(wait_s) == (angle, speed)
        again = trajectory_of(scattered(), nis=1.3)
        assert again.theta_sd_ahead(wait_s) == whole.theta_sd_ahead(wait_s)


def test_the_mean_and_its_deviation_are_those_of_the_fullest_gap_by_plain_counting() -> None:
    """Each driveline asked how many lie within a gap above it; of those with most the middle one.
    With drivelines that turn freely all angles are known on paper."""
    rng = np.random.default_rng(3)
    speeds = rng.normal(62.0, 1.5, 240).tolist()
    trajectory = trajectory_of(turning(speeds))
    for step in (6, 12, 20, STEPS - 1):
        wait_s = step * STEP_S
        angles = sorted(speed * wait_s for speed in speeds)
        held = [[b for b in angles if 0.0 <= b - a <= 2.0 * HALF_GAP_RAD] for a in angles]
        most = max(map(len, held))
        fullest = [each for each in held if len(each) == most]
        group = np.array(fullest[len(fullest) // 2])
        width = math.sqrt(2.0 * (float(group.var()) + variance_after(wait_s)))
        share = most / len(angles) * math.erf(HALF_GAP_RAD / width)
        angle, speed = trajectory.ahead(wait_s)
        assert angle == pytest.approx(float(group.mean()), abs=1e-9)
        assert speed == pytest.approx(angle / wait_s)
        sure = deviation_within_a_gap(min(share, MOST_SURE))
        assert trajectory.theta_sd_ahead(wait_s) == pytest.approx(sure, rel=5e-3)
