"""What a cloud of drivelines starts from: the vehicle's course, and the edges behind a gear's
coming out. Each against an independent calculation."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from meshpoint.controller.estimation.lash import VehicleCourse
from meshpoint.controller.estimation.lash_start import (
    BROAD,
    CHANGE_S,
    EDGE_RAD,
    FIRST_EDGES,
    FIT_US,
    KEPT_US,
    LEAST_FIT_US,
    SWING_S,
    SWINGS_RAD,
    StartWatch,
    vehicle_course,
)
from meshpoint.controller.records import Vector

SDS = (0.3, 8.0)
"""What is not known of the vehicle's speed and acceleration."""


def posterior_by_conditioning(
    waits: Vector, angles: Vector, sds: tuple[float, float]
) -> tuple[Vector, Vector]:
    """Speed and hill at time 0: angles, speed and hill as one normal law for each strength of the
    swing, conditioned on the angles; strengths weighed by how likely they make these."""
    line = np.polyfit(waits, angles, 1)
    off = angles - np.polyval(line, waits)
    basis = np.stack([np.ones_like(waits), waits, waits**2 / 2.0, waits**3 / 6.0], axis=1)
    prior = np.diag((BROAD, BROAD * sds[0], sds[1], sds[1] / CHANGE_S)) ** 2
    lags = np.abs(np.subtract.outer(waits, waits)) * math.sqrt(3.0) / SWING_S
    picked = np.zeros((2, 4))
    picked[0, 1] = picked[1, 2] = 1.0
    chances, means, spreads = [], [], []
    for strength in SWINGS_RAD:
        swing = strength**2 * (1.0 + lags) * np.exp(-lags)
        seen = basis @ prior @ basis.T + swing + EDGE_RAD**2 * np.eye(waits.size)
        both = picked @ prior @ basis.T
        means.append(both @ np.linalg.solve(seen, off))
        spreads.append(picked @ prior @ picked.T - both @ np.linalg.solve(seen, both.T))
        chances.append(multivariate_normal(cov=seen, allow_singular=True).logpdf(off))
    weights = np.exp(np.array(chances) - max(chances))
    weights /= weights.sum()
    mean = sum(w * m for w, m in zip(weights, means, strict=True))
    covariance = sum(
        w * (s + np.outer(m - mean, m - mean))
        for w, m, s in zip(weights, means, spreads, strict=True)
    )
    return mean + np.array((line[0], 0.0)), covariance + np.diag((sds[0] ** 2, 0.0))


@pytest.mark.parametrize("swing_rad", [0.0, 0.02])
def test_the_vehicle_s_course_is_what_conditioning_on_the_angles_gives(swing_rad: float) -> None:
    waits = np.arange(-0.3, 0.0, 0.012)
    angles = 5.0 + 60.0 * waits - 3.0 * waits**2 + swing_rad * np.sin(40.0 * waits)
    angles += 1e-3 * np.random.default_rng(3).standard_normal(waits.size)
    found, covariance = vehicle_course(waits, angles, SDS)
    expected, spread_ = posterior_by_conditioning(waits, angles, SDS)
    assert found == pytest.approx(expected, rel=1e-5, abs=1e-4)
    assert covariance == pytest.approx(spread_, rel=1e-3, abs=1e-5)


def in_gear(watch: StartWatch, from_us: float, to_us: float, rad_s: float = 60.0) -> None:
    for time_us in np.arange(from_us, to_us + 1.0, 10e3):
        watch.take_in_gear(np.array([[time_us], [time_us * rad_s * 1e-6]]))


def out(from_us: float, count: int = FIRST_EDGES, rad_s: float = 61.0) -> Vector:
    times = from_us + 1e3 * np.arange(1.0, count + 1.0)
    return np.array((times, rad_s * 1e-6 * times))


def test_a_start_waits_for_its_first_edges_behind_the_gear_s_coming_out() -> None:
    """Edges of before do not count; in parts as at once; a line through them gives the start."""
    watch = StartWatch()
    watch.released(100e3, 40.0)
    edges = np.concatenate((out(90e3, 10), out(100e3)), axis=1)
    assert watch.take_out(edges[:, :-1], SDS) is None
    assert watch.waiting.shape == (2, FIRST_EDGES - 1)
    start = watch.take_out(edges[:, -1:], SDS)
    assert start is not None
    assert (start.time_us, start.pressed_nm) == (100e3, 40.0)
    assert (start.angle_rad, start.speed_rad_s) == pytest.approx((6.1, 61.0))
    assert start.vehicle_rad_s == start.speed_rad_s
    assert start.vehicle_root is None
    watch.released(200e3)
    assert watch.waiting.size == 0


@pytest.mark.parametrize(("told_us", "used"), [(KEPT_US - 1.0, True), (KEPT_US, False)])
def test_a_vehicle_s_speed_from_the_last_window_holds_for_a_while(
    told_us: float, used: bool
) -> None:
    watch = StartWatch()
    watch.take_vehicle(VehicleCourse(1e6 - told_us, 55.0, 0.0, np.diag((0.04, 1.0))))
    watch.released(1e6)
    start = watch.take_out(out(1e6), SDS)
    assert start is not None
    assert (start.vehicle_rad_s == 55.0) is used
    watch.released(1e6)
    again = watch.take_out(out(1e6), SDS)
    assert again is not None
    assert again.vehicle_rad_s == pytest.approx(61.0), "it is told once"


@pytest.mark.parametrize("hill_rad_s2", [-5.0, 0.0, 6.0])
def test_a_vehicle_goes_on_uphill_or_down_between_two_windows(hill_rad_s2: float) -> None:
    """As the first window has told, and less surely: of the speed what the acceleration leaves
    open, and what shafts never tell; of the acceleration a tenth of what hills may make of it."""
    watch = StartWatch()
    told = np.array(((0.04, 0.01), (0.01, 1.0)))
    watch.take_vehicle(VehicleCourse(0.7e6, 55.0, hill_rad_s2, told))
    watch.released(1e6)
    start = watch.take_out(out(1e6), SDS)
    assert start is not None
    assert start.vehicle_rad_s == pytest.approx(55.0 + 0.3 * hill_rad_s2)
    assert start.hill_rad_s2 == hill_rad_s2
    expected = np.array(((0.04 + 0.6 * 0.01 + 0.09 + 0.3**2, 0.01 + 0.3), (0.31, 1.0 + 0.8**2)))
    assert start.vehicle_root is not None
    assert start.vehicle_root @ start.vehicle_root.T == pytest.approx(expected)


@pytest.mark.parametrize("spread", [np.zeros((2, 2)), np.full((2, 2), 0.5)])
def test_a_vehicle_that_all_drivelines_agree_on_is_taken_over(spread: Vector) -> None:
    watch = StartWatch()
    watch.take_vehicle(VehicleCourse(0.9e6, 55.0, 1.0, spread))
    watch.released(1e6)
    start = watch.take_out(out(1e6), SDS)
    assert start is not None and start.vehicle_rad_s == pytest.approx(55.1)


@pytest.mark.parametrize(
    "vehicle",
    [
        VehicleCourse(0.9e6, math.inf, 0.0, np.eye(2)),
        VehicleCourse(0.9e6, 55.0, math.nan, np.eye(2)),
        VehicleCourse(0.9e6, 55.0, 0.0, np.full((2, 2), math.inf)),
    ],
)
def test_a_vehicle_that_is_no_number_is_not_taken_over(vehicle: VehicleCourse) -> None:
    watch = StartWatch()
    watch.take_vehicle(vehicle)
    watch.released(1e6)
    start = watch.take_out(out(1e6), SDS)
    assert start is not None
    assert (start.vehicle_rad_s, start.vehicle_root) == (start.speed_rad_s, None)


@pytest.mark.parametrize(("since_us", "told"), [(LEAST_FIT_US, True), (LEAST_FIT_US - 10e3, False)])
def test_a_vehicle_that_was_seen_in_gear_for_long_enough_is_known_from_there(
    since_us: float, told: bool
) -> None:
    """What was seen there after the gear had come out is no gear's."""
    watch = StartWatch()
    in_gear(watch, 1e6 - since_us, 1e6)
    in_gear(watch, 1e6 + 10e3, 1e6 + 30e3, 70.0)
    watch.released(1e6)
    start = watch.take_out(out(1e6), SDS)
    assert start is not None
    assert (start.vehicle_root is not None) is told
    assert start.vehicle_rad_s == pytest.approx(60.0 if told else 61.0, abs=0.1)
    if told:
        waits = np.arange(-since_us, 1.0, 10e3) * 1e-6
        _, covariance = vehicle_course(waits, 60.0 + 60.0 * waits, SDS)
        assert start.vehicle_root @ start.vehicle_root.T == pytest.approx(covariance, rel=1e-6)


def test_only_the_newest_time_in_gear_counts_and_none_before_edges_were_lost() -> None:
    watch = StartWatch()
    in_gear(watch, 0.0, 700e3, 20.0)
    in_gear(watch, 710e3, 1_010e3)
    assert len(watch._in_gear) == round(FIT_US / 10e3) + 1
    assert watch._in_gear[0][0] == 710e3
    watch.take_vehicle(VehicleCourse(1_000e3, 50.0, 0.0, np.eye(2)))
    watch.lose()
    watch.released(1_010e3)
    start = watch.take_out(out(1_010e3), SDS)
    assert start is not None
    assert start.vehicle_root is None
    assert start.vehicle_rad_s == pytest.approx(61.0)
