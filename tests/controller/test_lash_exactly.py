"""The cloud of drivelines in its parts: each against an independent calculation."""

from __future__ import annotations

import math
from collections.abc import Callable
from statistics import NormalDist

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from meshpoint.controller.estimation.halton import normal
from meshpoint.controller.estimation.lash import (
    DRIVELINES,
    LEAST_DRAG,
    LEAST_SHARE_SD,
    SEEN_SDS,
    Lash,
    LashStart,
)
from meshpoint.controller.estimation.lash_cloud import (
    DOUBT_KEPT,
    DRAG_CHANGE,
    FIRST_DRAG,
    FIRST_OMEGA,
    LOOK_US,
    MOST_OFF,
    RECENT,
    LashCloud,
    correct,
    spread,
)
from meshpoint.controller.estimation.lash_rivals import LUCK, LashRivals, Prediction
from meshpoint.controller.motion.lash_motion import (
    ANGLE,
    DRAG,
    HALF,
    HILL,
    LOSS,
    ROWS,
    SPEED,
    STIFF,
    TYRE,
    TYRE_STIFF,
    VEHICLE,
    WAY,
    WHEELS,
)
from meshpoint.controller.records import Vector
from meshpoint.gearbox.driveline import Axle

AXLE, RATIO, BACKLASH_RAD, FACTOR = Axle(), 0.27, math.radians(2.0), 2.0
SIDE = AXLE.main_kgm2 + AXLE.propeller_kgm2 * RATIO**2
"""Inertia that turns with the main shaft."""
SDS = (0.3, 8.0)
"""What is not known of the vehicle's speed and acceleration."""


def a_lash() -> Lash:
    return Lash(AXLE, BACKLASH_RAD, FACTOR, RATIO)


def test_a_driveline_s_figures_are_the_sheet_s_as_felt_at_the_main_shaft() -> None:
    """A torque at the propeller shaft is i times that at the main shaft, an angle 1 / i of it."""
    lash = a_lash()
    prior = lash.prior
    assert math.exp(prior.stiff_log) == pytest.approx(AXLE.shaft_nm_rad * RATIO**2 / SIDE)
    assert math.exp(prior.loss_log) == pytest.approx(AXLE.flank_loss_s_rad * RATIO)
    assert math.exp(prior.half_log) == pytest.approx(BACKLASH_RAD / 2.0 / RATIO)
    drag_nm = AXLE.pinion_nm * RATIO + AXLE.loose_nm
    assert math.exp(prior.drag_log) == pytest.approx(drag_nm / SIDE)
    # An even law between two limits has their half distance over the root of 3.
    sds = (AXLE.shaft_tolerance, math.log(AXLE.flank_loss_factor),
           math.log(FACTOR) / 3**0.5, AXLE.pinion_tolerance / 3**0.5)  # fmt: skip
    assert prior[1::2] == pytest.approx(sds)
    assert lash.shafts.stiffness_nm_rad == pytest.approx(AXLE.shaft_nm_rad)
    assert lash.shafts.half_lash_rad == pytest.approx(BACKLASH_RAD / 2.0)
    model = lash.model(-60.0)
    assert model.wheels_share == pytest.approx(SIDE / (AXLE.wheels_kgm2 * RATIO**2))
    assert model.tyre_per_s == pytest.approx(AXLE.tyre_nms / AXLE.wheels_kgm2)
    assert model.fading_per_s == pytest.approx(60.0 * RATIO / AXLE.relaxation_rad)
    chance_nm = math.hypot(AXLE.main_chance_nm, RATIO * AXLE.propeller_chance_nm)
    sigma_rad_s2 = chance_nm / SIDE
    assert lash.chance.memory_s == AXLE.chance_s
    assert lash.chance.rad2_s3 == pytest.approx(2.0 * sigma_rad_s2**2 * AXLE.chance_s)
    sds = (AXLE.vehicle_start_rad_s, AXLE.vehicle_rad_s2 / RATIO)
    assert lash.vehicle_sds == pytest.approx(sds)


def test_a_first_cloud_holds_what_is_not_known_each_with_numbers_of_its_own() -> None:
    """Two quantities that shared a row of numbers would always be off together."""
    lash = a_lash()
    x = lash.cloud(LashStart(0.0, 3.0, 61.0, 60.0, -2.0))
    assert (x[ANGLE] == 3.0).all()
    assert (x[SPEED] == 61.0).all()
    known, tyre = lash.prior, AXLE.tyre_nm_rad / AXLE.wheels_kgm2
    for row, own, log, sd in (
        (HALF, 0, known.half_log, known.half_sd),
        (STIFF, 6, known.stiff_log, known.stiff_sd),
        (LOSS, 7, known.loss_log, known.loss_sd),
        (TYRE_STIFF, 9, math.log(tyre), AXLE.tyre_tolerance),
    ):
        numbers = (np.log(x[row]) - log) / sd
        assert numbers == pytest.approx(normal(DRIVELINES)[own])
    drag = np.exp(known.drag_log + known.drag_sd * normal(DRIVELINES)[8])
    assert x[DRAG] == pytest.approx(np.maximum(drag, LEAST_DRAG))
    speed_sd, hill_sd = lash.vehicle_sds
    assert (x[VEHICLE] - 60.0) / speed_sd == pytest.approx(normal(DRIVELINES)[2])
    assert (x[HILL] + 2.0) / hill_sd == pytest.approx(normal(DRIVELINES)[3])
    off = (x[WHEELS] - x[VEHICLE]) / AXLE.wheels_start_rad_s
    assert off == pytest.approx(normal(DRIVELINES)[4])
    # A tyre that swings at its own frequency is as far wound up as its speed over that.
    wound = x[TYRE] * math.sqrt(tyre) / AXLE.wheels_start_rad_s
    assert wound == pytest.approx(normal(DRIVELINES)[5])
    root = np.array(((0.2, 0.0), (1.0, 3.0)))
    x = lash.cloud(LashStart(0.0, 0.0, 60.0, 60.0, 0.0, root))
    assert np.cov(x[VEHICLE], x[HILL]) == pytest.approx(root @ root.T, rel=0.03)


@pytest.mark.parametrize("pressed_nm", [300.0, -150.0])
def test_shafts_and_tyres_are_wound_up_by_the_torque_that_was_left(pressed_nm: float) -> None:
    """A torque M twists the shafts by M / k, felt i times at the main shaft, and the tyres by
    M / c: both over the whole torque are the same torque."""
    lash = a_lash()
    x = lash.cloud(LashStart(0.0, 0.0, 60.0, 60.0, pressed_nm=pressed_nm))
    free = lash.cloud(LashStart(0.0, 0.0, 60.0, 60.0))
    side = math.copysign(1.0, pressed_nm)
    beyond = side * (x[WAY] - x[HALF]) - x[HALF]
    tyre = side * (x[TYRE] - free[TYRE]) * x[TYRE_STIFF] / (SIDE / AXLE.wheels_kgm2 / RATIO**2)
    on = tyre > 0.0
    assert on.mean() == pytest.approx(0.6, abs=3e-3)
    by_shafts_nm = beyond[on] * x[STIFF][on] * SIDE / RATIO
    by_tyres_nm = tyre[on] * SIDE / RATIO
    assert by_shafts_nm == pytest.approx(by_tyres_nm, rel=1e-6, abs=1e-6)
    assert by_shafts_nm.mean() == pytest.approx(abs(pressed_nm), rel=0.01)
    assert by_shafts_nm.std() == pytest.approx(abs(pressed_nm), rel=0.02), "exponential"
    rest = (x[WAY] / x[HALF])[~on]
    assert (rest.min(), rest.max()) == pytest.approx((-0.15, 2.15), abs=0.01)
    assert np.median(rest) == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("seconds", [0.004, 0.03])
def test_what_is_not_known_of_angle_speed_and_drag_grows_as_lyapunov_has_it(
    seconds: float,
) -> None:
    """dP/dt = A P + P A' + Q, integrated by SciPy; drag's own change moves nothing within a
    look."""
    p = np.array(((4e-4, 3e-4, -2e-4), (3e-4, 0.5, 0.1), (-2e-4, 0.1, 0.3)))
    a = np.array(((0.0, 1.0, 0.0), (0.0, 0.0, -1.0), (0.0, 0.0, 0.0)))
    q = np.diag((0.0, 0.8, 0.0))

    def rate(_: float, flat: Vector) -> Vector:
        whole = flat.reshape(3, 3)
        return np.ravel(a @ whole + whole @ a.T + q)

    end = solve_ivp(rate, (0.0, seconds), p.ravel(), rtol=1e-10, atol=1e-14).y[:, -1]
    expected = end.reshape(3, 3) + np.diag((0.0, 0.0, DRAG_CHANGE * seconds))
    assert spread(p, seconds, 0.8) == pytest.approx(expected, rel=1e-6, abs=1e-12)


def test_a_driveline_is_corrected_as_by_kalman_and_weighed_by_huber_s_law() -> None:
    """Beyond four deviations the logarithm goes on in a straight line, and the correction stays."""
    assert MOST_OFF == 4.0
    off = np.array((-0.09, -0.041, -0.01, 0.0, 0.02, 0.039, 0.041, 0.2))
    variance, gain = 1e-4, np.array((0.6, 3.0, 20.0))
    x = np.arange(1.0, ROWS * off.size + 1.0).reshape(ROWS, off.size)
    x[DRAG] = 1.0
    before, logs = x.copy(), np.full(off.size, -0.5)
    correct(x, logs, off, gain, variance)
    sd = math.sqrt(variance)
    for i, way in enumerate(off):
        sds = abs(way) / sd
        if sds <= MOST_OFF:
            lost = sds**2 / 2.0
        else:
            lost = MOST_OFF**2 / 2.0 + MOST_OFF * (sds - MOST_OFF)
        assert logs[i] == pytest.approx(-0.5 - lost)
        near = math.copysign(min(sds, MOST_OFF) * sd, way)
        for row, share in ((ANGLE, gain[0]), (WAY, gain[0]), (SPEED, gain[1])):
            assert x[row, i] == pytest.approx(before[row, i] + share * near)
        assert x[DRAG, i] == pytest.approx(max(1.0 - gain[2] * near, LEAST_DRAG))
    moved = {ANGLE, WAY, SPEED, DRAG}
    for row in set(range(ROWS)) - moved:
        assert x[row].tolist() == before[row].tolist()


def a_cloud(lash: Lash | None = None) -> LashCloud:
    return LashCloud(lash or a_lash(), LashStart(0.0, 0.0, 60.0, 60.0), 1e-6)


def test_a_cloud_drawn_anew_has_the_means_and_the_spread_of_the_weighed_one() -> None:
    """Drawing by weight keeps mean and variance, and what the kernel adds was taken away before.
    What a filter estimates in each driveline gets no kernel."""
    cloud = a_cloud()
    x = cloud._x
    lean = np.exp(-0.5 * ((np.log(x[HALF]) - cloud._lash.prior.half_log) / 0.2 - 0.5) ** 2)
    weights = lean / lean.sum()
    before = x.copy()
    cloud._draw(weights)
    assert (cloud._logs == 0.0).all()
    assert cloud.weights == pytest.approx(1.0 / DRIVELINES)
    for row, law in ((WAY, None), (WHEELS, None), (TYRE, None), (VEHICLE, None), (HILL, None),
                     (STIFF, np.log), (LOSS, np.log), (HALF, np.log),
                     (TYRE_STIFF, np.log)):  # fmt: skip
        old, new = (before[row], cloud._x[row]) if law is None else (
            law(before[row]), law(cloud._x[row]))  # fmt: skip
        mean = weights @ old
        sd = math.sqrt(weights @ (old - mean) ** 2)
        assert new.mean() == pytest.approx(mean, abs=0.05 * sd)
        assert new.std() == pytest.approx(sd, rel=0.05)
        assert np.unique(new).size == DRIVELINES, "two of one driveline part"
    assert set(cloud._x[DRAG]) <= set(before[DRAG])
    shown = np.corrcoef([cloud._x[row] for row in (WAY, WHEELS, TYRE, VEHICLE, HILL)])
    whole = np.cov([before[row] for row in (WAY, WHEELS, TYRE, VEHICLE, HILL)], aweights=weights)
    parts = whole / np.sqrt(np.outer(np.diag(whole), np.diag(whole)))
    assert shown == pytest.approx(parts, abs=0.12)


def test_what_is_added_to_a_cloud_is_another_each_time_it_is_drawn() -> None:
    even = np.full(DRIVELINES, 1.0 / DRIVELINES)
    cloud = a_cloud()
    added = []
    for _ in range(3):
        before = cloud._x[HILL].copy()
        cloud._draw(even)
        added.append((cloud._x[HILL] - before) / before.std())
    assert added[0].std() == pytest.approx(math.hypot(0.4, 1.0 - math.sqrt(1.0 - 0.4**2)), rel=0.1)
    for one, other in ((0, 1), (1, 2), (0, 2)):
        assert abs(np.corrcoef(added[one], added[other])[0, 1]) < 0.3


def test_a_look_weighs_and_corrects_by_how_far_off_it_was() -> None:
    """All drivelines alike but one: the covariance goes as in Kalman's filter, and how much the
    cloud is doubted as its misses, an old one less."""
    cloud = a_cloud()
    cloud._p = np.diag((1e-4, 0.04, 0.01))
    cloud._x[HILL] = cloud._x[VEHICLE] = cloud._x[WHEELS] = 60.0
    p = spread(cloud._p, 0.01, cloud._chance.rad2_s3)
    whole = p[0, 0] + 2e-5
    shift = 0.004
    ahead = a_cloud()
    ahead._x = cloud._x.copy()
    ahead._p = np.diag((1e-4, 0.04, 0.01))
    ahead._look(0.01, 0.0, 1e30)
    expected = float(ahead._x[ANGLE].mean())
    off = expected + shift - ahead._x[ANGLE]
    cloud._look(0.01, expected + shift, 2e-5)
    gain = p[:, 0] / whole
    assert cloud._p == pytest.approx(p - np.outer(gain, gain) * whole)
    square = off.mean() ** 2 / (off.var() + whole)
    assert cloud._doubt == pytest.approx(DOUBT_KEPT + (1.0 - DOUBT_KEPT) * square, rel=1e-6)


def test_edges_are_taken_in_groups_each_as_sure_as_its_edges_together() -> None:
    """Their mean time and mean angle; those of before are left out."""
    cloud, looks = a_cloud(), []
    cloud._look = lambda *seen: looks.append(seen)  # type: ignore[method-assign]
    times = np.array((-1.0, 0.0, 100.0, 200.0, 300.0, LOOK_US + 150.0, LOOK_US + 250.0))
    cloud.take(np.array((times, times * 6e-5)), 2e-3)
    variance = (2e-3) ** 2 + (60.0 * 1e-6) ** 2
    assert [seen[0] for seen in looks] == pytest.approx([200e-6, LOOK_US * 1e-6])
    assert [seen[1] for seen in looks] == pytest.approx([200.0 * 6e-5, (LOOK_US + 200.0) * 6e-5])
    assert [seen[2] for seen in looks] == pytest.approx([variance / 3.0, variance / 2.0])
    assert cloud.time_us == LOOK_US + 200.0
    cloud.take(np.array([[LOOK_US + 200.0], [1.0]]), 2e-3)
    assert len(looks) == 2


def test_a_cloud_that_is_lost_begins_anew_from_a_line_through_its_newest_looks() -> None:
    """The vehicle has gone on uphill meanwhile; where in the backlash it lies nobody knows."""
    start = LashStart(0.0, 0.0, 60.0, 60.0, -2.0, pressed_nm=300.0)
    cloud, begun = LashCloud(a_lash(), start, 1e-6), []
    cloud._begin = begun.append  # type: ignore[method-assign]
    cloud._look = lambda *_: None  # type: ignore[method-assign]
    cloud._doubt = 9.01
    times = LOOK_US * np.arange(1.0, RECENT + 1.0)
    for k in range(RECENT):
        assert not begun
        cloud.take(np.array([[times[k]], [1.0 + 58e-6 * times[k]]]), 1e-3)
    (anew,) = begun
    assert anew.time_us == times[-1]
    assert anew.angle_rad == pytest.approx(1.0 + 58e-6 * times[-1])
    assert anew.speed_rad_s == pytest.approx(58.0)
    assert anew.vehicle_rad_s == pytest.approx(60.0 - 2.0 * times[-1] * 1e-6)
    assert (anew.hill_rad_s2, anew.pressed_nm, anew.behind) == (-2.0, 0.0, None)
    fresh = a_cloud()
    assert fresh._p == pytest.approx(np.diag((0.05**2, FIRST_OMEGA**2, FIRST_DRAG**2)))
    assert fresh._doubt == 1.0


def test_a_cloud_is_alive_while_all_of_it_are_numbers() -> None:
    for name in ("_x", "_logs"):
        cloud = a_cloud()
        assert cloud.is_alive
        getattr(cloud, name).flat[-1] = math.nan
        assert not cloud.is_alive
        assert cloud.course(math.radians(1.0)) is None


def figures_at(logs: dict[int, float], sds: dict[int, float]) -> LashCloud:
    cloud = a_cloud()
    seen: Callable[[int], tuple[float, float]] = lambda row: (logs[row], sds[row])  # noqa: E731
    cloud.log_figure = seen  # type: ignore[method-assign]
    return cloud


@settings(deadline=None, max_examples=10)
@given(st.floats(-0.5, 0.5), st.floats(0.01, 1.0), st.sampled_from([0, 1, 2, 3]))
def test_figures_are_learned_as_bayes_has_it_and_stay_in_what_the_sheet_leaves_open(
    by: float, sd: float, k: int
) -> None:
    lash, rows = a_lash(), (STIFF, LOSS, HALF, DRAG)
    logs = {row: lash.prior[2 * j] + (by if j == k else 0.0) for j, row in enumerate(rows)}
    lash.learn(figures_at(logs, dict.fromkeys(rows, sd)).log_figure)
    middle, most = lash.prior[2 * k : 2 * k + 2]
    seen_sd = max(sd, SEEN_SDS[k])
    sure = 1.0 / (most**-2 + seen_sd**-2)
    expected = sure * (middle / most**2 + logs[rows[k]] / seen_sd**2)
    expected = min(max(expected, middle - 2.0 * most), middle + 2.0 * most)
    assert lash.known[2 * k] == pytest.approx(expected)
    assert lash.known[2 * k + 1] == pytest.approx(max(math.sqrt(sure), LEAST_SHARE_SD * most))
    for far in (-9.0, 9.0):
        logs[rows[k]] = middle + far
        for _ in range(15):
            lash.learn(figures_at(logs, dict.fromkeys(rows, sd)).log_figure)
        side = math.copysign(2.0 * most, far)
        assert lash.known[2 * k] == pytest.approx(middle + side)


def test_a_backlash_that_was_learned_before_is_taken_up_no_surer_than_it_may_be() -> None:
    for sd, kept in ((1e-3, 0.5), (0.7, 0.7), (9.0, 1.0)):
        lash = a_lash()
        most = lash.prior.half_sd
        lash.restore(0.05, sd * most)
        assert math.exp(lash.known.half_log) == pytest.approx(0.05)
        assert lash.known.half_sd == pytest.approx(kept * most)
        assert lash.known._replace(half_log=0.0, half_sd=0.0) == lash.prior._replace(
            half_log=0.0, half_sd=0.0
        )


def test_means_and_deviations_of_a_figure_are_those_of_its_logarithm_by_weight() -> None:
    cloud = a_cloud()
    cloud._logs = np.linspace(-3.0, 0.0, DRIVELINES)
    cloud._weights = None
    weights = np.exp(cloud._logs) / np.exp(cloud._logs).sum()
    mean = float(np.average(np.log(cloud._x[STIFF]), weights=weights))
    variance = float(np.average((np.log(cloud._x[STIFF]) - mean) ** 2, weights=weights))
    assert cloud.log_figure(STIFF) == pytest.approx((mean, math.sqrt(variance)))
    assert cloud.mean(STIFF) == pytest.approx(np.average(cloud._x[STIFF], weights=weights))


def test_rivals_see_the_angle_between_a_step_s_last_edge_and_the_next_step_s_first() -> None:
    """A prediction's time lies between two steps: the angle there is on the line between edges."""
    sure, unsure = Prediction(0.0, 0.01), Prediction(0.0, 0.03)
    found = []
    for parts in (((0, 3), (3, 6)), ((0, 4), (4, 6)), ((0, 6),)):
        times = np.array((0.0, 9e3, 30e3, 40e3, 60e3, 70e3))
        angles = np.array((5.0, 3.0, 0.04, 0.03, -0.05, 0.2))
        rivals = LashRivals()
        rivals.begin()
        rivals.predict(0.0, unsure, sure)
        for first, end in parts:
            rivals.judge(np.array((times, angles))[:, first:end], 0.02)
        found.append(rivals._window)
    at = 0.03 + (45.0 - 40.0) / 20.0 * (-0.05 - 0.03)

    def given_(sd: float) -> float:
        law = NormalDist(0.0, sd)
        return LUCK + (1.0 - LUCK) * (law.cdf(at + 0.02) - law.cdf(at - 0.02))

    expected = 2.0 * math.log(given_(0.01) / given_(0.03))
    assert found == pytest.approx([expected] * 3)
