"""The cloud of drivelines: its start from what was seen in gear, its looks, and how it is drawn
anew. Each against an independent calculation."""

from __future__ import annotations

import math

import numpy as np
import pytest

from meshpoint.controller.estimation.cloud_redraw import drawn_anew
from meshpoint.controller.estimation.halton import normal, scattered_twice
from meshpoint.controller.estimation.lash import (
    Lash,
    LashStart,
)
from meshpoint.controller.estimation.lash_cloud import (
    LashCloud,
    correct,
    spread,
)
from meshpoint.controller.estimation.loaded_driveline import BehindState
from meshpoint.controller.motion.lash_course import LashCourse
from meshpoint.controller.motion.lash_motion import (
    ANGLE,
    DRAG,
    HALF,
    HILL,
    LOSS,
    SPEED,
    STIFF,
    TYRE,
    VEHICLE,
    WAY,
    WHEELS,
    move,
)
from meshpoint.controller.records import Vector
from meshpoint.gearbox.driveline import Axle

AXLE, RATIO, COUNT = Axle(), 0.27, 2500
START = LashStart(0.0, 0.0, 60.0, 60.0)
GOLDEN_SHARES = (np.arange(COUNT) * (math.sqrt(5.0) - 1.0) / 2.0) % 1.0


def a_lash() -> Lash:
    return Lash(AXLE, math.radians(2.0), 2.0, RATIO)


def a_cloud(start: LashStart = START) -> LashCloud:
    return LashCloud(a_lash(), start, 1e-6)


def seen_in_gear(twist: float, half: float = 0.02, sd: float = 0.0) -> BehindState:
    """A driveline whose twist is known to within a deviation; the rest of it well."""
    root = np.diag((0.0, 0.3, 4e-3, 0.2, 0.5)) + np.tril(np.full((5, 5), 1e-3), -1)
    root[0] = np.array((0.6, 0.8, 0.0, 0.0, 0.0)) * sd
    return BehindState(np.array((twist, 20.0, 0.01, 19.0, -0.7)), root, half)


def test_a_cloud_that_was_seen_in_gear_has_wheels_tyres_vehicle_and_hill_from_there() -> None:
    """Their means and how they go together, as felt at the main shaft; nothing of how wide the
    backlash is goes with them."""
    behind = seen_in_gear(0.0, sd=2e-3)
    lash = a_lash()
    x = lash.cloud(START._replace(behind=behind))
    rows = x[[WHEELS, TYRE, VEHICLE, HILL]]
    expected = (behind.root @ behind.root.T)[1:, 1:] / RATIO**2
    sds = np.sqrt(np.diag(expected))
    assert rows.mean(axis=1) == pytest.approx(behind.mean[1:] / RATIO, abs=0.01 * sds.max())
    assert np.cov(rows) / np.outer(sds, sds) == pytest.approx(
        expected / np.outer(sds, sds), abs=0.03
    )
    exact = (behind.mean[:, None] + behind.root @ normal(COUNT)[1:6])[1:] / RATIO
    assert rows == pytest.approx(exact)
    apart = np.corrcoef(np.concatenate((rows, np.log(x[[HALF]]))))[-1, :-1]
    assert np.abs(apart).max() < 0.05


@pytest.mark.parametrize(
    ("twist", "share"), [(0.03, 0.9), (-0.03, 0.9), (0.01, 0.5), (-0.02, 0.5), (0.0, 0.5)]
)
def test_a_twist_that_was_found_lies_in_each_driveline_s_backlash_at_the_same_share(
    twist: float, share: float
) -> None:
    """What is beyond a flank is beyond it by as much, at the main shaft. Nine tenths lie there if a
    flank was surely pressed on, one half otherwise, spread evenly; the others lie anywhere."""
    half, lash = 0.02, a_lash()
    x = lash.cloud(START._replace(behind=seen_in_gear(twist, half)))
    free = lash.cloud(START)
    within, beyond = min(max(twist, -half), half), 0.0
    beyond = twist - within
    found = (x[WAY] - x[HALF] * (1.0 + within / half)) * RATIO
    there = share > GOLDEN_SHARES
    assert found[there] == pytest.approx(beyond, abs=1e-12)
    assert x[WAY][~there].tolist() == free[WAY][~there].tolist()
    assert there.mean() == pytest.approx(share, abs=1e-3)


@pytest.mark.parametrize(("sds", "told"), [(1.9, False), (2.1, True), (2.4, True)])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_flank_was_pressed_on_where_the_twist_is_two_deviations_beyond_it(
    sds: float, told: bool, side: float
) -> None:
    lash = a_lash()
    x = lash.cloud(START._replace(behind=seen_in_gear(side * (0.02 + sds * 3e-3), sd=3e-3)))
    moved = x[WAY] != lash.cloud(START)[WAY]
    assert moved.mean() == pytest.approx(0.9 if told else 0.5, abs=1e-3)


def test_where_in_its_backlash_a_driveline_lies_goes_with_nothing_else_of_it() -> None:
    for pressed_nm in (0.0, 200.0):
        x = a_lash().cloud(START._replace(pressed_nm=pressed_nm))
        place = x[WAY] / x[HALF]
        for numbers in normal(COUNT)[[0, 2, 3, 4, 5, 6, 7, 8, 9]]:
            near = np.abs(place - np.median(place)) < 1.2
            assert abs(np.corrcoef(place[near], numbers[near])[0, 1]) < 0.06


def test_the_first_spread_and_its_growth_are_these() -> None:
    """0.05 rad, 2 rad/s, 0.5 rad/s2; drag changes by 4 rad2/s5 and is 0.5 rad/s2 at least. There
    are 2500 drivelines, 240 of them are followed ahead, and hills are none where none are told."""
    cloud = a_cloud()
    assert cloud._p.tolist() == np.diag((0.05**2, 2.0**2, 0.5**2)).tolist()
    assert spread(np.zeros((3, 3)), 0.25, 0.0)[2, 2] == 1.0
    assert cloud._x.shape[1] == COUNT
    course = cloud.course(0.02)
    assert isinstance(course, LashCourse)
    assert course._angle.shape[1] == 240
    assert START.hill_rad_s2 == 0.0
    x, logs = cloud._x[:, :20].copy(), np.zeros(20)
    correct(x, logs, np.full(20, 1e-2), np.array((0.0, 0.0, 1e6)), 1e-4)
    assert (x[DRAG] == 0.5).all()
    low = Lash(Axle(pinion_nm=0.0, loose_nm=0.01), math.radians(2.0), 2.0, RATIO)
    assert low.cloud(START)[DRAG].min() == 0.5


def test_a_look_moves_the_cloud_then_weighs_and_corrects_it() -> None:
    cloud, other = a_cloud(), a_cloud()
    cloud._p = np.diag((1e-4, 0.04, 0.01))
    before = cloud._logs = np.linspace(-3.0, -2.0, COUNT)
    other._logs = before.copy()
    move(other._x, 0.01, other._model)
    p = spread(cloud._p, 0.01, cloud._chance.rad2_s3)
    whole = float(p[0, 0]) + 3e-3
    off = 0.62 - other._x[ANGLE]
    weights = np.exp(before) / np.exp(before).sum()
    assert cloud.weights == pytest.approx(weights)
    cloud._doubt = 3.0
    cloud._look(0.01, 0.62, 3e-3)
    correct(other._x, other._logs, off, p[:, 0] / whole, whole)
    assert cloud._x == pytest.approx(other._x, abs=1e-12)
    assert cloud._logs == pytest.approx(other._logs)
    weighed = np.exp(other._logs) / np.exp(other._logs).sum()
    assert cloud.weights == pytest.approx(weighed)
    mean = float(weights @ off)
    square = mean**2 / (float(weights @ (off - mean) ** 2) + whole)
    assert cloud._doubt == pytest.approx(0.9 * 3.0 + 0.1 * square)


@pytest.mark.parametrize(("left", "drawn"), [(624, True), (626, False), (700, False), (400, True)])
def test_a_cloud_is_drawn_anew_when_less_than_a_quarter_of_it_carries_the_weight(
    left: int, drawn: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As many as would weigh the same together: one over the sum of squared weights."""
    seen: list[Vector] = []
    cloud = a_cloud()
    monkeypatch.setattr(cloud, "_draw", seen.append)
    cloud._logs[left:] = -1e9
    cloud._look(1e-3, 0.06, 1e12)
    assert bool(seen) is drawn
    if drawn:
        even = np.where(np.arange(COUNT) < left, 1.0 / left, 0.0)
        assert seen[0] == pytest.approx(even)


def test_what_a_cloud_drawn_anew_is_spread_by_are_its_numbers_from_another_place_on() -> None:
    """841 places further each time, a row of numbers for each quantity: none goes with another."""
    cloud = a_cloud()
    even = np.full(COUNT, 1.0 / COUNT)
    for times in (1, 2, 3):
        before = cloud._x.copy()
        cloud._draw(even)
        numbers = np.roll(scattered_twice(COUNT)[:9, :COUNT], 841 * times, axis=1)
        assert cloud._x == pytest.approx(drawn_anew(before, even, numbers))
        assert not cloud._logs.any()


@pytest.mark.parametrize("row", [WHEELS, TYRE, HILL])
def test_a_cloud_that_is_lost_is_not_drawn_anew(row: int) -> None:
    """There is no telling how its drivelines go together; it is found lost when it is asked."""
    cloud = a_cloud()
    cloud._x[row, 0] = np.nan
    cloud._logs[1:] = -1e9
    cloud._look(1e-3, 0.06, 1e12)
    assert cloud.course(0.01) is None


def test_weights_are_shares_however_small_all_probabilities_have_become() -> None:
    cloud = a_cloud()
    cloud._logs = np.where(np.arange(COUNT) < 2, -2000.0, -9000.0)
    cloud._logs[1] += math.log(3.0)
    assert cloud.weights[:2] == pytest.approx((0.25, 0.75))
    assert not cloud.weights[2:].any()
    assert cloud.mean(STIFF) == pytest.approx(0.25 * cloud._x[STIFF, 0] + 0.75 * cloud._x[STIFF, 1])


def test_edges_are_looked_at_by_four_milliseconds_and_as_sure_as_their_times_at_its_speed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The first driveline's speed tells how far the shaft turns within an edge's error of time."""
    cloud = LashCloud(a_lash(), START._replace(time_us=50.0), 1e-5)
    seen: list[tuple[float, ...]] = []
    monkeypatch.setattr(cloud, "_look", lambda *given: seen.append(given))
    cloud._x[SPEED, 1:] = 1e3
    times = np.array((100.0, 2100.0, 4000.0, 4099.0, 4101.0, 5000.0, 8101.0))
    cloud.take(np.array((times, 60e-6 * times)), 2e-3)
    variance = 2e-3**2 + (60.0 * 1e-5) ** 2
    assert [each[2] for each in seen] == pytest.approx([variance / 4.0, variance / 2.0, variance])
    means = [times[:4].mean(), times[4:6].mean(), times[6]]
    waits = np.diff([50.0, *means]) * 1e-6
    assert [each[0] for each in seen] == pytest.approx(waits.tolist())


@pytest.mark.parametrize(("doubt", "begins"), [(8.9, False), (9.1, True)])
def test_a_cloud_begins_anew_where_it_is_doubted_by_three_deviations_and_has_four_looks(
    doubt: float, begins: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The vehicle has gone on uphill since the cloud's start, not since the clock's."""
    start = START._replace(time_us=2e6, hill_rad_s2=-2.0, pressed_nm=80.0)
    cloud = a_cloud(start._replace(behind=seen_in_gear(0.0)))
    begun: list[LashStart] = []
    monkeypatch.setattr(cloud, "_begin", begun.append)
    monkeypatch.setattr(cloud, "_look", lambda *_: None)
    cloud._doubt = doubt
    times = 2e6 + 10e3 * np.arange(1.0, 5.0)
    angles = 1.0 + 58e-6 * times + np.array((0.0, 1e-3, -2e-3, 3e-3))
    for k in range(4):
        assert not begun
        cloud.take(np.array([[times[k]], [angles[k]]]), 1e-3)
    assert len(begun) == int(begins)
    if begins:
        slope = np.polyfit(times - times[3], angles, 1)
        assert begun[0].vehicle_rad_s == pytest.approx(60.0 - 2.0 * 0.04)
        assert begun[0].angle_rad == pytest.approx(slope[1])
        assert begun[0].speed_rad_s == pytest.approx(1e6 * slope[0])
        assert (begun[0].pressed_nm, begun[0].behind) == (0.0, None)
        # Either the shaft swings by 1.92 rad/s, or that is how wrong the vehicle's speed was.
        speed_sd, hill_sd = a_lash().vehicle_sds
        off = 1e6 * slope[0] - begun[0].vehicle_rad_s
        assert begun[0].vehicle_root == pytest.approx(np.diag((math.hypot(speed_sd, off), hill_sd)))


@pytest.mark.parametrize(("doubt", "wider"), [(0.5, 1.0), (4.0, 4.0)])
def test_a_cloud_tells_how_the_vehicle_goes_by_weight_and_as_unsure_as_it_is_doubted(
    doubt: float, wider: float
) -> None:
    cloud = a_cloud(START._replace(time_us=3e6))
    cloud._doubt = doubt
    cloud._logs = cloud._x[VEHICLE] - 60.0
    weights = np.exp(cloud._logs) / np.exp(cloud._logs).sum()
    vehicle = cloud.vehicle
    rows = cloud._x[[VEHICLE, HILL]]
    mean = rows @ weights
    off = rows - mean[:, None]
    assert vehicle.time_us == 3e6
    assert vehicle[1:3] == pytest.approx(mean)
    assert vehicle.covariance == pytest.approx(wider * (off * weights) @ off.T)


def test_a_window_s_figures_count_as_no_surer_than_these(monkeypatch: pytest.MonkeyPatch) -> None:
    """0.2 for stiffness, 0.25 for backlash, 0.5 for loss and drag: a half of each comes from the
    window where the sheet leaves open as much. And a figure without a number teaches nothing."""
    cloud, rows = a_cloud(), (STIFF, LOSS, HALF, DRAG)
    for k, seen_sd in enumerate((0.2, 0.5, 0.25, 0.5)):
        lash = a_lash()
        lash.known = lash.known._replace(**{lash.known._fields[2 * k + 1]: seen_sd})
        logs = dict(zip(rows, lash.prior[::2], strict=True))
        logs[rows[k]] += 0.02
        told = {row: (log, 1e-3) for row, log in logs.items()}
        monkeypatch.setattr(cloud, "log_figure", told.get)
        lash.learn(cloud.log_figure)
        assert lash.known[2 * k] - lash.prior[2 * k] == pytest.approx(0.01)
    for figures in ((math.nan, 0.1), (1.0, math.nan), (math.inf, 0.1)):
        lash = a_lash()
        before = lash.known
        monkeypatch.setattr(cloud, "log_figure", dict.fromkeys(rows, figures).get)
        lash.learn(cloud.log_figure)
        assert lash.known == before


def test_a_cloud_that_is_lost_has_no_figures_and_no_course() -> None:
    cloud = a_cloud()
    cloud._logs[3] = math.nan
    log, sd = cloud.log_figure(STIFF)
    assert math.isnan(log) and math.isnan(sd)
    assert cloud.course(0.02) is None


@pytest.mark.parametrize(("doubt", "told"), [(0.3, 1.0), (1.1, 1.1**0.5), (4.0, 2.0)])
def test_a_course_is_told_as_unsure_as_the_cloud_is_doubted(doubt: float, told: float) -> None:
    """By the root of the mean square, and never surer than the cloud. It follows drivelines by
    their weights, with the spread that is one driveline's own."""
    cloud = a_cloud()
    cloud._doubt = doubt
    cloud._logs = np.where(np.arange(COUNT) % 2 == 0, 0.0, -1e3)
    cloud._x[HILL, 1::2], cloud._x[HILL, ::2] = 1e9, -1.5
    course = cloud.course(0.02)
    assert course is not None
    assert course._doubt == pytest.approx(told)
    assert course.hill_rad_s2 == pytest.approx(-1.5)
    assert (course._p is cloud._p, course._half_gap_rad) == (True, 0.02)
    assert course._chance == a_lash().chance
