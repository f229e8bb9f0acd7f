"""The torque ramp of a driveline that twists: engine and vehicle at rest against each other after
it, and what is learned of them from it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from meshpoint.controller.shift.swing_fit import EngineTrajectory, Known, fit_swing
from meshpoint.controller.shift.unloading import (
    SHAPES,
    GearedBodies,
    Loaded,
    Unloading,
    geared_bodies,
    unloading,
)
from meshpoint.gearbox import load_sheet
from meshpoint.gearbox.gears import DRIVE_GEARS

SHEET = load_sheet("truck12")
STEP_S = 0.01
PARTS = 10
STIFFNESS, VEHICLE = 16_000.0, 900.0
KNOWN = Known(STIFFNESS, 0.17, 1.0 / VEHICLE, 3e-4)
READ_NM = 7.2
"""Error of a torque that is reported in whole per cent."""
ROAD_NM = 1_500.0


def bodies_of(gear: int, known: Known = KNOWN) -> GearedBodies:
    return geared_bodies(SHEET, DRIVE_GEARS[gear], known)


class TwoBodies:
    """The equations, in small steps: engine and gearbox, shafts, vehicle on a slope."""

    def __init__(self, bodies: GearedBodies, stiffness: float, vehicle: float) -> None:
        self.engine, self.stiffness, self.vehicle = bodies.engine_kgm2, stiffness, vehicle
        self.ratio = bodies.ratio
        self.first = self.second = 11.0
        self.shafts_nm = ROAD_NM

    def run(self, torque_nm: float) -> float:
        """One step with a torque at the crankshaft; the engine's speed at the propeller shaft
        before it."""
        before, step_s = self.first, STEP_S / PARTS
        for _ in range(PARTS):
            self.first += (self.ratio * torque_nm - self.shafts_nm) / self.engine * step_s
            self.second += (self.shafts_nm - ROAD_NM) / self.vehicle * step_s
            self.shafts_nm += self.stiffness * (self.first - self.second) * step_s
        return before


def ramps(gear: int) -> list[Unloading]:
    bodies = bodies_of(gear)
    coasting = -ROAD_NM / VEHICLE
    return unloading(SHEET, bodies, Loaded(ROAD_NM / bodies.ratio, ROAD_NM, coasting, READ_NM), 0)


def left_swinging_nm(ramp: Unloading, stiffness: float) -> float:
    """How far the shafts' torque swings about its rest in the second after the last step."""
    body, most, now_us = TwoBodies(ramp.bodies, stiffness, VEHICLE), 0.0, 0
    while now_us < ramp.step_us + 1e6:
        if now_us >= ramp.next_us:
            ramp = ramp._replace(taken=ramp.taken + 1, step_us=float(now_us))
        body.run(ramp.torque_nm)
        now_us += round(STEP_S * 1e6)
        if ramp.next_us == math.inf:
            most = max(most, abs(body.shafts_nm - rest_nm(ramp)))
    return most


def rest_nm(ramp: Unloading) -> float:
    """What the shafts carry at last: what slows the gearbox down with the vehicle."""
    bodies = ramp.bodies
    pull_nm = bodies.ratio * ramp.left_nm
    together = (pull_nm - ROAD_NM) / (bodies.engine_kgm2 + VEHICLE)
    return pull_nm - bodies.engine_kgm2 * together


@pytest.mark.parametrize("gear", [13, 1, 4, 8])
def test_the_torque_leaves_the_shafts_with_it(gear: int) -> None:
    """Taken away at once it stays in them; in a quarter, a half and a quarter little is left, even
    where the stiffness is off by 30 %."""
    calm = ramps(gear)[-1]
    assert calm.shares == SHAPES[-1]
    at_once = calm._replace(shares=SHAPES[0])
    assert left_swinging_nm(at_once, STIFFNESS) > 0.8 * ROAD_NM
    assert left_swinging_nm(calm, STIFFNESS) < 0.1 * ROAD_NM
    for share in (0.7, 1.3):
        assert left_swinging_nm(calm, share * STIFFNESS) < 0.2 * ROAD_NM


@pytest.mark.parametrize("gear", [13, 4, 12])
def test_at_rest_the_shafts_carry_nothing(gear: int) -> None:
    """The engine gives what turns it and the gearbox along with the vehicle."""
    ramp = ramps(gear)[-1]
    ratio, coasting = ramp.bodies.ratio, -ROAD_NM / VEHICLE
    assert ramp.left_nm == pytest.approx(ramp.bodies.engine_kgm2 * coasting / ratio)
    assert abs(rest_nm(ramp)) < 1e-6 * ROAD_NM
    dragged = geared_bodies(SHEET, DRIVE_GEARS[gear], ramp.bodies.known, 6.0)
    layshaft = ratio * SHEET.split_mesh(DRIVE_GEARS[gear].split).ratio
    more = dragged.coasting_nm(coasting) - ramp.bodies.coasting_nm(coasting)
    assert more == pytest.approx(6.0 * layshaft / ratio)
    assert dragged.shafts_nm(10.0, 0.5) == pytest.approx(
        ramp.bodies.shafts_nm(10.0, 0.5) - 6.0 * layshaft
    )


def test_what_cannot_be_reported_from_none_is_left() -> None:
    bodies = bodies_of(1)
    (ramp,) = unloading(SHEET, bodies, Loaded(4.0, 100.0, -0.1, READ_NM), 0)
    assert (ramp.torque_nm, ramp.over_us) == (4.0, 0)


@pytest.mark.parametrize("gear", [13, 4, 8, 12])
def test_what_is_left_throws_the_main_shaft_off_slowly(gear: int) -> None:
    """As a spring of the shafts' stiffness throws main and propeller shaft: they turn by a
    third of the gap's width while a sleeve is on its way."""
    main, axle = SHEET.range_mesh(DRIVE_GEARS[gear].range_).ratio, SHEET.axle
    turned_kgm2 = axle.propeller_kgm2 + axle.main_kgm2 / main**2
    stiffness = SHEET.driveline.stiffness_nm_rad
    twist_rad, speed_rad_s, step_s = bodies_of(gear).harmless_nm / stiffness, 0.0, 1e-6
    while twist_rad > 0.0:
        speed_rad_s += stiffness * twist_rad / turned_kgm2 * step_s
        twist_rad -= speed_rad_s * step_s
    turns_rad = speed_rad_s / main * SHEET.sleeve.delay_s
    assert turns_rad == pytest.approx(SHEET.dog.backlash_rad / 3.0, rel=1e-3)


def test_a_gear_that_swings_fast_is_left_sooner() -> None:
    slow, fast = ramps(13)[-1], ramps(12)[-1]
    assert slow.over_us > 900_000
    assert fast.over_us < 400_000


@pytest.mark.parametrize(("stiffness", "vehicle"), [(12e3, 1500.0), (16e3, 500.0), (20e3, 900.0)])
def test_a_ramp_tells_shafts_and_vehicle(stiffness: float, vehicle: float) -> None:
    """From the engine's speed with an error of 0.1 rad/s: stiffness and inertia within 10 %."""
    ramp = ramps(1)[-1]
    body = TwoBodies(ramp.bodies, stiffness, vehicle)
    errors = np.random.default_rng(5).normal(0.0, 0.1 / body.ratio, 200)
    torque = [ROAD_NM / body.ratio] * 100
    for share in (0.25, 0.75):
        torque += [ramp.own_nm * (1.0 - 1.3 * share)] * 50
    omega = np.array([body.run(nm) for nm in torque]) + errors
    trajectory = EngineTrajectory(STEP_S * np.arange(200.0), omega, body.ratio * np.array(torque))
    found, acceleration = fit_swing(trajectory, body.ratio, body.engine, KNOWN)
    assert found.stiffness_nm_rad == pytest.approx(stiffness, rel=0.1)
    assert 1.0 / found.vehicle_inverse == pytest.approx(vehicle, rel=0.1)
    assert acceleration == pytest.approx(0.0, abs=0.03)
    assert found.stiffness_sd < 0.5 * KNOWN.stiffness_sd


HARMLESS_NM, ENGINE_KGM2 = 100.0, 400.0


def a_third_unknown() -> GearedBodies:
    """Their frequency is known within a third: half the share of the stiffness, an even law's end
    being sqrt 3 deviations away."""
    known = Known(STIFFNESS, 2.0 / 3.0 / math.sqrt(3.0), 1.0 / VEHICLE, 0.0)
    return GearedBodies(2.0, ENGINE_KGM2, known, HARMLESS_NM)


@pytest.mark.parametrize(
    ("pulled", "error", "count"),
    [(100.0, 0.0, 1), (101.0, 0.0, 2), (-199.0, 0.0, 2), (201.0, 0.0, 3), (4_000.0, 0.0, 3),
     (205.0, 50.0, 3), (99.0, 0.0, 0), (199.0, 50.0, 0)],
)  # fmt: skip
def test_each_step_more_leaves_half_of_the_swing_until_it_is_harmless(
    pulled: float, error: float, count: int
) -> None:
    """sin(pi / 6), in three steps at most. What is harmless, or within twice its error of none, is
    left as it is; else as much may be to take away as its error leaves open."""
    bodies = a_third_unknown()
    assert bodies.tolerance == pytest.approx(1.0 / 3.0)
    found = unloading(SHEET, bodies, Loaded(70.0, pulled, -0.5, error), 900)
    if count == 0:
        (only,) = found
        assert (only.torque_nm, only.left_nm, only.over_us) == (70.0, 70.0, 900.0)
        return
    assert [each.shares for each in found] == list(SHAPES[:count])
