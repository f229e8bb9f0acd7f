"""The driveline while a gear is in mesh, against equations written down here once more and solved
by SciPy, and against trucks that are simulated with them."""

from __future__ import annotations

import copy
import math
from typing import NamedTuple

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.linalg import expm

from meshpoint.controller.estimate.loaded_driveline import (
    LEAST_S,
    DrivelineMotion,
    Load,
    LoadedDriveline,
    Shafts,
)
from meshpoint.controller.estimate.loaded_kernels import (
    GEAR_SPEED,
    HILL,
    LOADED_MODEL,
    LOADED_STATES,
    TWIST,
    TYRE,
    VEHICLE,
    VEHICLE_INVERSE,
    WHEELS,
    WRONG,
    beyond_flanks,
    loaded_ahead,
)
from meshpoint.controller.models.twist import CREEP as TWIST_CREEP
from meshpoint.controller.models.twist import TYRE as TWIST_TYRE
from meshpoint.gearbox import load_sheet
from meshpoint.gearbox.gears import DRIVE_GEARS
from meshpoint.kernels.records import Vector, filled

SHEET = load_sheet("truck12")
AXLE = SHEET.axle
SHAFTS = Shafts(20e3, math.radians(1.0))
SHAFT_NMS = 10.0


class Truck(NamedTuple):
    """A driveline at the propeller shaft: gear side, shafts, wheels, tyres, vehicle."""

    geared_kgm2: float
    driving_nm: float
    vehicle_kgm2: float = 900.0
    hill_rad_s2: float = 0.0
    stiffness_nm_rad: float = SHAFTS.stiffness_nm_rad

    def rates(self, y: Vector, driving_nm: float, leap_rad: float = 0.0) -> list[float]:
        """Of theta_G, w_G, theta_G - theta_A, w_A, the tyres' twist and w_V."""
        _, gear, twist, wheels, tyre, vehicle = y
        twist += leap_rad
        half = SHAFTS.half_lash_rad
        beyond = twist - min(max(twist, -half), half)
        shafts = self.stiffness_nm_rad * beyond
        if beyond:
            shafts += SHAFT_NMS * (gear - wheels)
        fading = abs(vehicle) / AXLE.relaxation_rad
        held = 1.0 + fading * AXLE.tyre_nms / AXLE.tyre_nm_rad
        twisting = (wheels - vehicle - fading * tyre) / held
        traction = AXLE.tyre_nm_rad * tyre + AXLE.tyre_nms * twisting
        return [
            gear,
            (driving_nm - shafts) / self.geared_kgm2,
            gear - wheels,
            (shafts - traction) / AXLE.wheels_kgm2,
            twisting,
            traction / self.vehicle_kgm2 + self.hill_rad_s2,
        ]


def model_of(truck: Truck, noise: float = 0.0) -> Vector:
    return filled(
        LOADED_MODEL, geared_kgm2=truck.geared_kgm2, driving_nm=truck.driving_nm, tooth_rad=0.0,
        shaft_nm_rad=truck.stiffness_nm_rad, shaft_nms=SHAFT_NMS,
        half_lash_rad=SHAFTS.half_lash_rad, wheels_kgm2=AXLE.wheels_kgm2,
        tyre_nm_rad=AXLE.tyre_nm_rad, tyre_nms=AXLE.tyre_nms, relaxation_rad=AXLE.relaxation_rad,
        wrong_nm=noise, wrong_s=0.2, gear_rad2_s3=noise, wheels_rad2_s3=noise, hill_rad2_s5=noise,
        fading_s=noise,
    )  # fmt: skip


def state_of(truck: Truck) -> Vector:
    """On the flank of drive, with its wheels swinging."""
    x = np.zeros(LOADED_STATES)
    x[[GEAR_SPEED, WHEELS, VEHICLE]] = 20.0, 20.05, 19.97
    x[TWIST], x[TYRE] = SHAFTS.half_lash_rad + 0.03, 0.007
    x[HILL], x[VEHICLE_INVERSE] = truck.hill_rad_s2, 1.0 / truck.vehicle_kgm2
    return x


@pytest.mark.parametrize("seconds", [0.004, 0.05, 0.3])
def test_a_pressed_driveline_moves_as_its_equations_say(seconds: float) -> None:
    truck = Truck(geared_kgm2=300.0, driving_nm=450.0, hill_rad_s2=-0.4)
    x = state_of(truck)
    begun = x[[0, GEAR_SPEED, TWIST, WHEELS, TYRE, VEHICLE]]
    solved = solve_ivp(
        lambda _, y: truck.rates(y, truck.driving_nm), (0.0, seconds), begun, rtol=1e-10, atol=1e-12
    )
    loaded_ahead(x, np.zeros((LOADED_STATES, LOADED_STATES)), seconds, model_of(truck))
    found = x[[0, GEAR_SPEED, TWIST, WHEELS, TYRE, VEHICLE]]
    assert found == pytest.approx(solved.y[:, -1], rel=2e-5, abs=2e-6)


def test_what_is_not_known_moves_as_small_differences_do() -> None:
    """The covariance against the exponential of the equations' differences."""
    truck = Truck(geared_kgm2=300.0, driving_nm=450.0)
    x, seconds, tiny = state_of(truck), 0.02, 1e-6

    def rate(at: Vector) -> Vector:
        y = at[[0, GEAR_SPEED, TWIST, WHEELS, TYRE, VEHICLE]]
        other = truck._replace(vehicle_kgm2=1.0 / at[VEHICLE_INVERSE], hill_rad_s2=at[HILL])
        found = np.zeros(LOADED_STATES)
        found[[0, GEAR_SPEED, TWIST, WHEELS, TYRE, VEHICLE]] = other.rates(
            y, truck.driving_nm + at[WRONG]
        )
        found[WRONG] = -at[WRONG] / 0.2
        return found

    scales = np.maximum(np.abs(x), 1e-3) * tiny
    columns = [
        (rate(x + s * e) - rate(x - s * e)) / (2.0 * s)
        for s, e in zip(scales, np.eye(LOADED_STATES), strict=True)
    ]
    by = np.stack(columns, axis=1)
    sds = np.array((1e-3, 0.1, 1e-4, 0.1, 1e-3, 0.1, 0.5, 20.0, 2e-4))
    p = np.diag(sds**2)
    moved = expm(seconds * by) @ p @ expm(seconds * by).T
    loaded_ahead(x, p, seconds, model_of(truck))
    apart = np.abs(p - moved) / np.sqrt(np.outer(np.diag(moved), np.diag(moved)))
    assert apart.max() < 0.01


@pytest.mark.parametrize("angle", [-0.05, -0.017, 0.0, 0.01, 0.018, 0.04])
@pytest.mark.parametrize("sd", [1e-4, 3e-3, 0.05])
def test_backlash_of_an_angle_that_is_not_known_is_the_mean_over_where_it_may_be(
    angle: float, sd: float
) -> None:
    half = SHAFTS.half_lash_rad

    def weighed(at: float) -> float:
        beyond = at - min(max(at, -half), half)
        return beyond * math.exp(-0.5 * ((at - angle) / sd) ** 2) / (sd * math.sqrt(2.0 * math.pi))

    expected, _ = quad(weighed, angle - 9.0 * sd, angle + 9.0 * sd, points=(-half, half), limit=200)
    mean, slope = beyond_flanks(angle, sd, half)
    assert mean == pytest.approx(expected, abs=1e-7)
    aside = 1e-3 * sd
    rise = beyond_flanks(angle + aside, sd, half)[0] - beyond_flanks(angle - aside, sd, half)[0]
    assert slope == pytest.approx(rise / (2.0 * aside), abs=1e-4)


class Drive(NamedTuple):
    """A truck that is driven in a gear for a while: the edges of both shafts, and what is true."""

    steps: list[tuple[Vector, Vector, Load]]
    end_us: float
    true: Vector
    """Twist, wheels, tyre, vehicle and hill as the last edge comes."""


def driven(
    number: int, seed: int, leaps: bool = False, seconds: float = 1.6, climbs: bool = False
) -> Drive:
    """800 Nm are taken away in two steps; every 10 ms both shafts' edges of the last 10 ms are
    read, wrong by 0.03 degrees. leaps: the gear's tooth crosses its backlash to and fro; climbs: a
    hill takes all that the engine gives."""
    rng = np.random.default_rng(seed)
    gear = DRIVE_GEARS[number]
    behind, ratio = SHEET.range_mesh(gear.range_).ratio, SHEET.overall_ratio(gear)
    layshaft = ratio * SHEET.split_mesh(gear.split).ratio
    turned = SHEET.geared_kgm2(gear) + SHEET.engine.inertia_kgm2 * ratio**2
    turned += AXLE.propeller_kgm2 + AXLE.main_kgm2 / behind**2
    truck = Truck(turned, 0.0, rng.uniform(400.0, 1600.0), rng.uniform(-1.5, 1.5))
    drag_nm = layshaft * 7.0 + AXLE.pinion_nm + AXLE.loose_nm / behind
    if climbs:
        truck = truck._replace(hill_rad_s2=(drag_nm - ratio * 300.0) / truck.vehicle_kgm2)
    speed = 20.0 if number < 7 else 60.0

    def torque_nm(at: float) -> float:
        return 300.0 * (1.0 if at < 0.7 else 0.5 if at < 1.1 else 0.02)

    def leap_rad(at: float) -> float:
        return behind * SHEET.dog.backlash_rad * (leaps and 1.2 < at < 1.4)

    def rates(at: float, y: Vector) -> list[float]:
        return truck.rates(y, ratio * torque_nm(at) - drag_nm, leap_rad(at))

    shafts_nm = ratio * torque_nm(0.0) - drag_nm
    begun = [0.0, speed, SHAFTS.half_lash_rad + shafts_nm / truck.stiffness_nm_rad, speed,
             shafts_nm / AXLE.tyre_nm_rad, speed - speed / AXLE.relaxation_rad
             * shafts_nm / AXLE.tyre_nm_rad]  # fmt: skip
    solved = solve_ivp(rates, (0.0, seconds), begun, max_step=2e-3, dense_output=True)
    steps: list[tuple[Vector, Vector, Load]] = []
    share = behind * SHEET.main_mesh(gear.main).ratio
    for k in range(1, round(seconds / 0.01) + 1):
        both = []
        for scale, leap in ((share, 0.0), (behind, 1.0)):
            at = np.sort(rng.uniform(0.01 * (k - 1), 0.01 * k, 12))
            angle = solved.sol(at)[0] + leap * np.array([leap_rad(each) for each in at])
            wrong = rng.normal(0.0, math.radians(0.03), at.size)
            both.append(np.array((1e6 * at, angle / scale + wrong)))
        steps.append((both[0], both[1], Load(torque_nm(0.01 * k - 0.005), True, 7.0)))
    end_us = float(steps[-1][0][0, -1])
    y = solved.sol(1e-6 * end_us)
    true = np.array((y[2] + leap_rad(1e-6 * end_us), y[3], y[4], y[5], truck.hill_rad_s2))
    return Drive(steps, end_us, true)


def follow(drive: Drive, number: int) -> LoadedDriveline:
    loaded = LoadedDriveline(SHEET)
    for layshaft, main, load in drive.steps:
        loaded.take(DRIVE_GEARS[number], layshaft, main, load, SHAFTS)
    return loaded


def followed(drive: Drive, number: int) -> DrivelineMotion | None:
    return follow(drive, number).behind(drive.end_us)


@pytest.mark.check
@pytest.mark.parametrize("number", [1, 3, 5, 9])
def test_of_a_truck_that_was_driven_the_vehicle_is_known_and_how_well(number: int) -> None:
    squares, off = [], []
    for seed in range(12):
        drive = driven(number, seed)
        found = followed(drive, number)
        assert found is not None
        apart = found.mean - drive.true
        sds = np.sqrt(np.diag(found.root @ found.root.T))
        squares.append((apart / sds) ** 2)
        off.append(np.abs(apart))
    # Errors are what they are said to be, by no more than chance: 12 trucks.
    assert np.mean(squares, axis=0) == pytest.approx(np.zeros(5), abs=2.5)
    twist, _, _, vehicle, hill = np.median(off, axis=0)
    assert vehicle < 0.05 and hill < 0.5
    assert twist * SHAFTS.stiffness_nm_rad < 100.0


@pytest.mark.parametrize(
    "number", [5, *(pytest.param(each, marks=pytest.mark.check) for each in (1, 9))]
)
def test_what_shafts_and_tyres_carry_is_known_while_a_torque_is_taken_away(number: int) -> None:
    """After 0.9 s, between the two steps: the shafts swing by hundreds of Nm."""
    off = []
    for seed in range(8):
        drive = driven(number, seed, seconds=0.9)
        twist = follow(drive, number).twist(drive.end_us)
        assert twist is not None
        place, wheels, tyre, vehicle, _ = drive.true
        beyond = place - min(max(place, -SHAFTS.half_lash_rad), SHAFTS.half_lash_rad)
        shafts = twist.shafts_nm @ twist.state - SHAFTS.stiffness_nm_rad * beyond
        creep = twist.state[TWIST_CREEP] - (wheels - vehicle)
        off.append((shafts, AXLE.tyre_nm_rad * (twist.state[TWIST_TYRE] - tyre), creep))
    shafts_nm, tyres_nm, creep_rad_s = np.median(np.abs(off), axis=0)
    assert shafts_nm < 100.0 and tyres_nm < 100.0
    assert creep_rad_s < 0.05


@pytest.mark.parametrize("number", [14, 3, 7])
def test_on_a_hill_that_takes_all_that_the_engine_gives_the_hill_is_known(number: int) -> None:
    """6 trucks. Red before: it began with nothing in the shafts and on a level road; in gear 14 the
    vehicle was wrong by 1 rad/s, and of 3,900 Nm in the shafts 600 were missing."""
    for seed in range(6):
        drive = driven(number, seed, seconds=0.6, climbs=True)
        loaded = follow(drive, number)
        twist, behind = loaded.twist(drive.end_us), loaded.behind(drive.end_us)
        assert twist is not None and behind is not None
        carried_nm = SHAFTS.stiffness_nm_rad * (drive.true[0] - SHAFTS.half_lash_rad)
        assert twist.shafts_nm @ twist.state == pytest.approx(carried_nm, rel=0.04)
        assert behind.mean[3] == pytest.approx(drive.true[3], abs=0.02)
        assert abs(behind.mean[4] - drive.true[4]) < 2.0 * np.linalg.norm(behind.root[4])


def test_without_a_clutch_that_carries_there_is_nothing_to_take_away() -> None:
    drive = driven(5, 0)
    loaded = follow(drive, 5)
    layshaft, main, load = drive.steps[-1]
    late = np.array([[10e3], [0.0]])
    loaded.take(DRIVE_GEARS[5], layshaft + late, main + late, load._replace(carries=False), SHAFTS)
    assert loaded.twist(drive.end_us + 10e3) is None


def test_a_tooth_that_crosses_its_backlash_is_no_torque() -> None:
    drive = driven(5, 3, leaps=True)
    found = followed(drive, 5)
    assert found is not None
    assert found.mean[3] == pytest.approx(drive.true[3], abs=0.1)
    assert found.mean[0] == pytest.approx(drive.true[0], abs=0.01)


def test_nothing_is_said_of_a_gear_that_was_hardly_seen() -> None:
    few = driven(5, 0)
    short = few._replace(steps=few.steps[: round(LEAST_S / 0.01)])
    assert followed(short._replace(end_us=float(short.steps[-1][0][0, -1])), 5) is None


def test_a_gear_that_was_not_followed_for_long_enough_says_so() -> None:
    """Neither one that is not followed at all, nor one that is well known."""
    assert not LoadedDriveline(SHEET).is_early
    few = driven(5, 0)
    short = follow(few._replace(steps=few.steps[: round(LEAST_S / 0.01)]), 5)
    assert short.is_early
    assert not follow(few, 5).is_early
    short.lose()
    assert not short.is_early


def test_nothing_is_said_long_after_the_newest_edge_nor_of_a_time_before_it() -> None:
    drive = driven(5, 0)
    assert followed(drive._replace(end_us=drive.end_us + 150e3), 5) is None
    assert followed(drive._replace(end_us=drive.end_us - 50e3), 5) is None


def test_another_gear_and_lost_teeth_begin_anew() -> None:
    drive = driven(5, 0)
    loaded = LoadedDriveline(SHEET)
    for layshaft, main, load in drive.steps:
        loaded.take(DRIVE_GEARS[5], layshaft, main, load, SHAFTS)
    assert loaded.behind(drive.end_us) is not None
    loaded.take(DRIVE_GEARS[7], *drive.steps[-1], SHAFTS)
    assert loaded.behind(drive.end_us) is None
    for layshaft, main, load in drive.steps:
        loaded.take(DRIVE_GEARS[5], layshaft, main, load, SHAFTS)
    assert loaded.behind(drive.end_us) is not None
    loaded.lose()
    assert loaded.behind(drive.end_us) is None


def test_a_copy_goes_on_as_the_one_it_was_made_of() -> None:
    """Red before: a campaign's copies took the gear for another one and began anew."""
    drive = driven(5, 0)
    *before, (layshaft, main, load) = drive.steps
    loaded = follow(drive._replace(steps=before), 5)
    other = copy.deepcopy(loaded)
    for one in (loaded, other):
        one.take(DRIVE_GEARS[5], layshaft, main, load, SHAFTS)
    expected, found = loaded.behind(drive.end_us), other.behind(drive.end_us)
    assert expected is not None and found is not None
    assert (found.mean == expected.mean).all()


def test_edges_that_are_no_driveline_are_given_up() -> None:
    """Angles that leap about, and such as are no numbers."""
    drive = driven(5, 0)
    rng = np.random.default_rng(5)
    for wrong in (lambda: rng.normal(0.0, 3.0, 12), lambda: np.full(12, math.nan)):
        loaded = LoadedDriveline(SHEET)
        for layshaft, main, load in drive.steps:
            bent = layshaft.copy()
            bent[1] += wrong()
            loaded.take(DRIVE_GEARS[5], bent, main, load, SHAFTS)
        found = loaded.behind(drive.end_us)
        assert found is None or np.isfinite(found.mean).all()
        # The next gear is followed as ever.
        for layshaft, main, load in drive.steps:
            loaded.take(DRIVE_GEARS[3], layshaft, main, load, SHAFTS)
        assert loaded.behind(drive.end_us) is not None
