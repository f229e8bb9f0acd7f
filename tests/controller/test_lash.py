"""The driveline in its backlash: the model against SciPy, a cloud of particles against a known
truth, and whether what it promises is so."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from meshpoint.controller.estimate.lash import (
    SEEN_SDS,
    Lash,
    LashStart,
    StartWatch,
    VehicleTrajectory,
)
from meshpoint.controller.estimate.lash_cloud import (
    BacklashParticleFilter,
    spread,
)
from meshpoint.controller.estimate.loaded_driveline import DrivelineMotion
from meshpoint.controller.estimate.main_tracker import (
    AHEAD_US,
    MainTracker,
    ModelSelector,
    Prediction,
)
from meshpoint.controller.measure.wheel_edges import EdgeBatch
from meshpoint.controller.models.backlash import (
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
    LashModel,
    LashTrajectory,
    move,
    move_often,
)
from meshpoint.controller.settings.filters import CrossingFilterTuning
from meshpoint.controller.settings.learned import SwingRecord
from meshpoint.gearbox import Range
from meshpoint.gearbox.driveline import Axle, Driveline
from meshpoint.kernels.records import Vector

AXLE, RATIO, EDGE_RAD = Axle(), 0.27, math.pi / 45.0
BACKLASH = Driveline()
HALF_GAP_RAD = math.radians(0.95)
MODEL = LashModel(wheels_share=0.25, tyre_per_s=4.0, fading_per_s=17.0)


def a_driveline(slip: float = 2.0) -> Vector:
    """One driveline, (ROWS, 1), on its way between the flanks."""
    x = np.zeros((ROWS, 1))
    x[SPEED], x[WHEELS], x[VEHICLE], x[WAY] = 60.0 + slip, 60.0, 60.0, 0.01
    x[DRAG], x[HILL], x[STIFF], x[LOSS], x[HALF], x[TYRE_STIFF] = 6.0, 1.5, 4800.0, 0.1, 0.06, 5500
    return x


def rates(x: Vector) -> Vector:
    """The equations of the driveline as the textbooks have them, apart from the kernels."""
    twist, rate = x[WAY] - x[HALF], x[SPEED] - x[WHEELS]
    side, beyond = math.copysign(1.0, twist), abs(twist) - x[HALF]
    torque = 0.0
    if beyond > 0.0:
        torque = side * max(0.0, x[STIFF] * beyond * (1.0 + x[LOSS] * side * rate))
    found = np.zeros(ROWS)
    found[ANGLE], found[SPEED], found[WAY] = x[SPEED], -x[DRAG] - torque, rate
    slack = MODEL.fading_per_s * MODEL.tyre_per_s / x[TYRE_STIFF]
    found[TYRE] = (x[WHEELS] - x[VEHICLE] - MODEL.fading_per_s * x[TYRE]) / (1.0 + slack)
    traction = x[TYRE_STIFF] * x[TYRE] + MODEL.tyre_per_s * found[TYRE]
    found[WHEELS] = MODEL.wheels_share * torque - traction
    found[VEHICLE] = x[HILL]
    return found


def trajectory_of(x: Vector, model: LashModel, step_s: float, count: int) -> Vector:
    """Angles of one driveline at equal steps of time."""
    x, angles = x.copy(), np.empty(count)
    for k in range(count):
        angles[k] = x[ANGLE, 0]
        move(x, step_s, model)
    return angles


@pytest.mark.parametrize("slip", [2.0, -5.0])
def test_flanks_are_met_and_left_as_by_scipy(slip: float) -> None:
    """0.3 s of rattling, against DOP853 in steps that no flank escapes."""
    times = 2.5e-3 * np.arange(121)
    start = a_driveline(slip)
    whole = solve_ivp(
        lambda _t, x: rates(x), (0.0, 0.3), start[:, 0], method="DOP853", t_eval=times,
        rtol=1e-9, atol=1e-11, max_step=5e-4,
    ).y  # fmt: skip
    found = trajectory_of(start, MODEL, 2.5e-3, 121)
    assert np.abs(found - whole[ANGLE]).max() < 1.7e-3  # 0.1 deg, a tenth of half a gap
    assert (whole[WAY] < -1e-4).any() and (whole[WAY] > 0.03).any()


def test_flanks_push_and_never_pull() -> None:
    """A shaft that is torn off a flank faster than it would go by itself."""
    x = a_driveline()
    x[WAY] = -0.001
    for rate in np.linspace(-30.0, 30.0, 13):
        x[SPEED] = 60.0 + rate
        before = x.copy()
        move(x, 1e-4, MODEL)
        assert x[SPEED, 0] - before[SPEED, 0] >= -1e-4 * x[DRAG, 0] * (1.0 + 1e-9)
        x = before


def test_a_driveline_that_falls_hard_onto_a_flank_stays_there() -> None:
    """A shaft far from the vehicle's speed, as after a wheel's edges were lost: the stiffest flank
    with the most loss takes it up, and its trajectory ahead stays one of numbers."""
    x = a_driveline(-45.0)
    x[STIFF], x[LOSS], x[HALF], x[WAY] = 42_000.0, 2.1, 0.0235, 0.0064
    found = np.empty((2, 49, 1))
    move_often(x, 2.5e-3, MODEL._replace(wheels_share=0.05), found)
    assert np.isfinite(found).all()
    assert np.abs(found[1] - 60.0).max() < 46.0


def test_drivelines_that_move_at_once_move_as_each_by_itself() -> None:
    """To the bit: of many, of some and of one, in one call and in several."""
    crowd = np.concatenate([a_driveline(slip) for slip in np.linspace(-5.0, 5.0, 37)], axis=1)
    alone, found = [crowd[:, k : k + 1].copy() for k in range(37)], np.empty((2, 5, 37))
    move_often(crowd, 2.5e-3, MODEL, found)
    for k, x in enumerate(alone):
        for at in range(5):
            assert found[:, at, k].tolist() == [x[ANGLE, 0], x[SPEED, 0]]
            move(x, 2.5e-3, MODEL)
        assert x[:, 0].tolist() == crowd[:, k].tolist()


def test_the_spread_of_a_driveline_is_that_of_the_matrix_exponential() -> None:
    """Angle, speed and drag over 60 ms in one step and in sixty; white noise of the speed alone."""
    p = np.diag((1e-6, 0.04, 0.25))
    many = p.copy()
    for _ in range(60):
        many = spread(many, 1e-3, 0.5)
    assert spread(p, 60e-3, 0.5)[:2, :2] == pytest.approx(many[:2, :2], rel=0.02)


class Truth:
    """A driveline drawn from what the cloud may start from, and its edges."""

    def __init__(self, lash: Lash, seed: int, tooth_rad: float) -> None:
        rng = np.random.default_rng(seed)
        first = lash.cloud(LashStart(0.0, 0.0, 60.0, 60.0))
        x = first[:, [int(rng.integers(first.shape[1]))]]
        x[SPEED] = 60.0 + 1.5 * rng.standard_normal()
        self.step_s, count = 1e-3, 420
        self.angle = trajectory_of(x, lash.model(60.0), self.step_s, count)
        passed = EDGE_RAD / 2.0 * np.arange(1, int(self.angle[-1] / EDGE_RAD * 2.0))
        times = np.interp(passed, self.angle, 1e6 * self.step_s * np.arange(count))
        self.edges = np.array((times, passed + tooth_rad * rng.standard_normal(times.size)))

    def angle_at(self, time_us: float) -> float:
        times = 1e6 * self.step_s * np.arange(self.angle.size)
        return float(np.interp(time_us, times, self.angle))


def a_lash() -> Lash:
    return Lash(AXLE, BACKLASH.backlash_rad, BACKLASH.backlash_factor, RATIO)


def test_a_promised_probability_is_kept() -> None:
    """16 drivelines drawn as the cloud takes them, without chance: 45 ms ahead the truth is within
    half a gap at least as often as promised, and where much is promised nearly always."""
    tooth_rad, promised, kept = 2e-3, [], []
    for seed in range(16):
        lash = a_lash()
        truth, cloud = Truth(lash, seed, tooth_rad), None
        cloud = BacklashParticleFilter(lash, LashStart(0.0, 0.0, 60.0, 60.0), 1e-6)
        for until_us in (100e3, 160e3, 220e3):
            cloud.take(truth.edges[:, truth.edges[0] <= until_us], tooth_rad)
            trajectory = cloud.trajectory(HALF_GAP_RAD)
            assert trajectory is not None
            wait_s = (until_us + AHEAD_US - cloud.time_us) * 1e-6
            off = trajectory.ahead(wait_s)[0] - truth.angle_at(until_us + AHEAD_US)
            sd = trajectory.theta_sd_ahead(wait_s)
            promised.append(math.erf(HALF_GAP_RAD / (math.sqrt(2.0) * sd)))
            kept.append(abs(off) < HALF_GAP_RAD)
    sure = np.array(kept)[np.array(promised) > 0.8]
    assert np.mean(kept) > np.mean(promised) - 0.1
    assert np.mean(kept) > 0.55
    assert sure.size > 8
    assert sure.mean() > 0.85


def test_a_cloud_that_has_lost_the_driveline_finds_it_again() -> None:
    """It begins with a vehicle that is far faster than what the sheet leaves open."""
    tooth_rad, off = 5e-4, []
    for seed in range(8):
        lash = a_lash()
        truth = Truth(lash, seed, tooth_rad)
        sure = np.diag((0.05, 0.01))
        start = LashStart(0.0, 0.0, 60.0, 66.0, vehicle_root=sure)
        cloud = BacklashParticleFilter(lash, start, 1e-6)
        cloud.take(truth.edges[:, truth.edges[0] <= 300e3], tooth_rad)
        off.append(abs(cloud.mean(ANGLE) - truth.angle_at(cloud.time_us)))
    assert np.median(off) < HALF_GAP_RAD


def test_a_cloud_that_begins_anew_keeps_the_vehicle_that_was_found_in_gear() -> None:
    """The shaft springs out of its gear at 75 rad/s and is seen to turn at 60, as the vehicle was
    found to go."""
    lash = a_lash()
    mean = RATIO * np.array((0.0, 60.0, 0.0, 60.0, 0.0))
    behind = DrivelineMotion(
        mean, np.diag((0.01, 0.1, 1e-3, 0.1, 0.1)), RATIO * lash.known.half.value
    )
    passed = EDGE_RAD / 2.0 * np.arange(1, 80)
    cloud = BacklashParticleFilter(lash, LashStart(0.0, 0.0, 75.0, 75.0, behind=behind), 1e-6)
    cloud.take(np.array((passed / 60e-6, passed)), 1e-3)
    assert cloud.mean(SPEED) == pytest.approx(60.0, abs=1.0)
    vehicle = cloud.vehicle
    assert vehicle.speed_rad_s == pytest.approx(60.0, abs=2.0)
    assert math.sqrt(vehicle.covariance[0, 0]) < 3.0


def test_what_a_window_tells_of_the_backlash_is_taken_over_in_part() -> None:
    lash = a_lash()
    before = lash.known.half
    half = 1.6 * before.value
    for slip in (3.0, -4.0, 3.5, -3.0):
        x = a_driveline(slip)
        x[HALF], x[STIFF], x[DRAG], x[HILL] = half, lash.known.stiff.value, 9.0, 0.0
        x[WAY] = half * (1.0 - math.copysign(0.98, slip))
        angle = trajectory_of(x, lash.model(60.0), 1e-3, 300)
        passed = EDGE_RAD / 2.0 * np.arange(1, int(angle[-1] / EDGE_RAD * 2.0))
        edges = np.array((np.interp(passed, angle, 1e3 * np.arange(300)), passed))
        cloud = BacklashParticleFilter(lash, LashStart(0.0, 0.0, float(x[SPEED, 0]), 60.0), 1e-6)
        cloud.take(edges, 1e-3)
        lash.learn(cloud.log_figure)
    reported = (lash.known.half.log - before.log) / math.log(1.6)
    assert 0.2 < reported < 1.6
    assert 0.3 * before.sd < lash.known.half.sd < before.sd
    assert len(SEEN_SDS) == 4


def test_what_is_not_a_number_leaves_no_trajectory() -> None:
    lash = a_lash()
    cloud = BacklashParticleFilter(lash, LashStart(0.0, 0.0, 60.0, 60.0), 1e-6)
    cloud.take(np.array([[1e3], [math.nan]]), 1e-3)
    assert not cloud.is_alive and cloud.trajectory(HALF_GAP_RAD) is None
    known = lash.known
    lash.learn(cloud.log_figure)
    assert lash.known == known


def test_the_same_edges_give_the_same_cloud() -> None:
    lash = a_lash()
    truth, trajectories = Truth(lash, 7, 2e-3), []
    for _ in range(2):
        cloud = BacklashParticleFilter(lash, LashStart(0.0, 0.0, 60.0, 60.0), 1e-6)
        cloud.take(truth.edges, 2e-3)
        trajectory = cloud.trajectory(HALF_GAP_RAD)
        assert trajectory is not None
        trajectories.append([*trajectory.ahead(0.05), trajectory.theta_sd_ahead(0.05)])
    assert trajectories[0] == trajectories[1]


def test_what_will_be_known_is_never_less() -> None:
    lash = a_lash()
    truth = Truth(lash, 3, 2e-3)
    cloud = BacklashParticleFilter(lash, LashStart(0.0, 0.0, 60.0, 60.0), 1e-6)
    cloud.take(truth.edges[:, truth.edges[0] < 80e3], 2e-3)
    trajectory = cloud.trajectory(HALF_GAP_RAD)
    assert trajectory is not None
    found = trajectory.outlook(0.045, 0.01, 12)
    assert found[0] == pytest.approx(trajectory.theta_sd_ahead(0.045) ** 2)
    assert (found <= found[0] * (1.0 + 1e-9)).all()


def test_a_backlash_that_was_believed_is_doubted_only_where_it_is_no_likelier_any_more() -> None:
    """Windows that speak for it a little less each do not take it back."""
    rivals = ModelSelector()
    edges = np.array([[0.0, AHEAD_US, 2.0 * AHEAD_US], [1.0, 1.0, 1.0]])
    near, fair, far = Prediction(1.0, 0.01), Prediction(1.0, 0.014), Prediction(1.2, 0.05)
    believed = []
    for swing, lash in [(far, near)] * 3 + [(fair, near)] * 12 + [(near, far)] * 4:
        rivals.begin()
        for tick in range(4):
            rivals.predict(1e4 * tick, swing, lash)
        rivals.judge(edges, HALF_GAP_RAD)
        rivals.end()
        believed.append(rivals.lash_is_selected)
    assert believed[2:15] == [True] * 13
    assert not believed[-1]


@pytest.mark.parametrize(("twist_rad", "reported"), [(0.06, True), (0.01, False)])
def test_a_cloud_begins_where_the_driveline_was_found_in_gear(
    twist_rad: float, reported: bool
) -> None:
    """With a flank pressed on nine tenths of it are there; amid the backlash half of it is."""
    lash = Lash(AXLE, BACKLASH.backlash_rad, BACKLASH.backlash_factor, RATIO)
    half = lash.shafts.half_lash_rad
    mean, sds = np.array((twist_rad, 15.2, 0.004, 15.0, -0.5)), (0.002, 0.05, 1e-3, 0.02, 0.2)
    behind = DrivelineMotion(mean, np.diag(sds), half)
    start = LashStart(0.0, 0.0, 60.0, 60.0, behind=behind)
    x = lash.cloud(start)
    for row, k in ((WHEELS, 1), (TYRE, 2), (VEHICLE, 3), (HILL, 4)):
        assert x[row].mean() * RATIO == pytest.approx(mean[k], abs=0.1 * sds[k])
        assert x[row].std() * RATIO == pytest.approx(sds[k], rel=0.1)
    # The shafts' twist beyond their flank is theirs, whatever the backlash turns out to be.
    twist = (x[WAY] - x[HALF]) * RATIO
    if reported:
        beyond = twist - x[HALF] * RATIO
        found = np.abs(beyond - (twist_rad - half)) < 3.0 * sds[0]
        assert 0.88 < found.mean() < 0.97
    else:
        found = np.abs(twist / (x[HALF] * RATIO) - twist_rad / half) < 3.0 * sds[0] / half
        assert 0.5 < found.mean() < 0.75


def started(watch: StartWatch, since_us: float, ratio: float) -> LashStart:
    """A window in neutral, the main shaft at 61 rad/s."""
    lash = Lash(AXLE, BACKLASH.backlash_rad, BACKLASH.backlash_factor, ratio)
    later = 1e3 * np.arange(1, 20)
    watch.released(since_us)
    start = watch.take_out(np.array((since_us + later, 24.0 + 61e-6 * later)), lash)
    assert start is not None
    assert (start.angle_rad, start.speed_rad_s) == pytest.approx((24.0, 61.0))
    return start


def test_a_window_soon_after_another_starts_from_how_the_vehicle_went_in_that() -> None:
    """Within 0.4 s; later, and at first, the vehicle is as fast as the shaft comes out."""
    watch = StartWatch()
    for since_us, vehicle_rad_s in ((400e3, 61.0), (600e3, 58.6), (800e3, 61.0), (1200e3, 61.0)):
        start = started(watch, since_us, 1.0)
        assert start.vehicle_rad_s == pytest.approx(vehicle_rad_s)
        if since_us != 600e3:
            watch.take_vehicle(VehicleTrajectory(500e3, 59.0, -4.0, np.diag((0.01, 1.0))))


def test_after_the_range_the_vehicle_goes_on_as_before_it() -> None:
    """Known at the propeller shaft: the main shaft turns otherwise, and swings."""
    watch = StartWatch()
    before = VehicleTrajectory(500e3, 59.0, -4.0, np.diag((0.01, 1.0)))
    watch.take_vehicle(before.through(1.0))
    start = started(watch, 600e3, RATIO)
    assert start.vehicle_rad_s == pytest.approx(58.6 / RATIO)
    assert start.hill_rad_s2 == pytest.approx(-4.0 / RATIO)
    assert start.vehicle_root is not None
    assert start.vehicle_root[0, 0] > math.sqrt(0.01) / RATIO


def test_a_shaft_that_was_struck_may_lie_as_far_beyond_a_flank_as_it_swings() -> None:
    """A synchroniser lets go of it pressed on a flank, or half a swing later: known is how fast it
    is against the vehicle then, not where."""
    lash = Lash(AXLE, BACKLASH.backlash_rad, BACKLASH.backlash_factor, RATIO)
    sds = np.diag((0.3, 1.0))
    for off_rad_s in (0.0, 7.0):
        x = lash.cloud(LashStart(0.0, 0.0, 220.0 - off_rad_s, 220.0, 0.0, sds))
        beyond = (np.abs(x[WAY] - x[HALF]) - x[HALF]) * np.sqrt(x[STIFF])
        assert np.quantile(beyond, 0.9) > 0.6 * math.hypot(off_rad_s, 5.0)
        assert x[WHEELS].std() > 2.0 * AXLE.wheels_start_rad_s


def test_a_first_cloud_lies_anywhere_in_the_backlash() -> None:
    lash = Lash(AXLE, BACKLASH.backlash_rad, BACKLASH.backlash_factor, RATIO)
    anywhere = lash.cloud(LashStart(0.0, 0.0, 60.0, 60.0))
    share = anywhere[WAY] / anywhere[HALF]
    assert np.histogram(share, 4, (-0.15, 2.15))[0] == pytest.approx(625, abs=20)


def believing_in_backlash() -> MainTracker:
    main = MainTracker(CrossingFilterTuning(), 45, range_ratios=(RATIO, 1.0))
    record = SwingRecord(
        5, 120.0, 0.01, 0.05, 0.3, 1.0, 1.0, 0.1, 1.0, 0.1, 1.0, 1.0, 0.3, True, 0.06, 0.3,
    )  # fmt: skip
    main.restore(Range.LOW, record)
    return main


def turn(main: MainTracker, first: int, last: int) -> None:
    for number in range(first, last, 10):
        edges = np.arange(number, number + 10)
        angle = EDGE_RAD / 2.0 * edges
        main.edges(EdgeBatch(angle / 60e-6, angle, edges // 2, edges % 2))


def test_a_cloud_of_before_is_not_asked_once_the_speed_was_lost() -> None:
    """Missing edges in neutral; when the shaft is seen again a gear may be in."""
    main = believing_in_backlash()
    turn(main, 0, 100)
    main.set_free(True, Range.LOW, [], main.newest_us)
    turn(main, 100, 160)
    free = main.at(main.newest_us)
    assert free is not None and isinstance(free.swing, LashTrajectory)
    main.lose_speed()
    turn(main, 160, 260)
    seen = main.at(main.newest_us)
    assert seen is not None and not isinstance(seen.swing, LashTrajectory)


def test_what_a_window_in_neutral_has_shown_of_the_backlash_is_kept_at_its_end() -> None:
    main = believing_in_backlash()
    turn(main, 0, 100)
    main.set_free(True, Range.LOW, [], main.newest_us)
    turn(main, 100, 160)
    before = main.record(Range.LOW)
    main.set_free(False, None, [])
    after = main.record(Range.LOW)
    assert before is not None and after is not None
    assert before.half_lash_rad == pytest.approx(0.06)
    assert after.half_lash_rad != before.half_lash_rad
    assert after.half_lash_sd < before.half_lash_sd
