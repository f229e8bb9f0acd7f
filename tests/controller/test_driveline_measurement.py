"""What is seen of a driveline that twists, while a gear is in mesh: by engine and vehicle whose
equations are solved in small steps."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest
from test_unloading import KNOWN, ROAD_NM, STEP_S, STIFFNESS, VEHICLE, TwoBodies

from meshpoint.controller.shift.driveline_measurement import (
    ENGINE_MEASUREMENTS,
    LEAST_MEASUREMENTS,
    LOADED_SHARE,
    DrivelineMeasurement,
)
from meshpoint.controller.shift.swing_fit import Known
from meshpoint.controller.shift.unloading import GearedBodies, Loaded, geared_bodies, unloading
from meshpoint.dbc.messages import ControllerState as State
from meshpoint.gearbox import load_sheet
from meshpoint.gearbox.gears import DRIVE_GEARS

SHEET = load_sheet("truck12")
REFERENCE_NM = SHEET.engine.reference_nm
TICK_US = round(1e6 * STEP_S)


class Seen:
    """A measurement at a driveline in gear 4, a step at a time."""

    def __init__(self, gear: int = 4) -> None:
        self.gear, self.now_us = gear, 3_000_000
        self.measurement = DrivelineMeasurement(SHEET)
        self.measurement.rings.measure = lambda *_: None  # type: ignore[method-assign]

    def step(self, speed: float | None, share: float | None, state: State = State.IN_GEAR) -> None:
        self.now_us += TICK_US
        snapshot: Any = SimpleNamespace(
            now_us=self.now_us,
            view=SimpleNamespace(gear_number=self.gear),
            engine_rad_s=speed,
            engine_torque_share=share,
            engine_torque_step=0.01,
        )
        self.measurement.measure(state, snapshot)


def bodies_of(gear: int, known: Known = KNOWN, drag_nm: float = 0.0) -> GearedBodies:
    return geared_bodies(SHEET, DRIVE_GEARS[gear], known, drag_nm)


@pytest.mark.parametrize("gear", sorted(DRIVE_GEARS))
def test_engine_and_gearbox_have_as_much_energy_at_the_propeller_shaft_as_by_themselves(
    gear: int,
) -> None:
    drive, propeller = DRIVE_GEARS[gear], 7.0
    main = propeller / SHEET.range_mesh(drive.range_).ratio
    layshaft = main / SHEET.main_mesh(drive.main).ratio
    engine = layshaft / SHEET.split_mesh(drive.split).ratio
    shafts = SHEET.shafts
    own_j = (SHEET.engine.inertia_kgm2 + shafts.input_inertia_kgm2) * engine**2
    own_j += shafts.layshaft_inertia_kgm2 * layshaft**2
    bodies = bodies_of(gear)
    assert bodies.engine_kgm2 * propeller**2 == pytest.approx(own_j)
    assert bodies.ratio * propeller == pytest.approx(engine)
    power_w = 3.0 * layshaft
    assert bodies_of(gear, drag_nm=3.0).drag_nm * propeller == pytest.approx(power_w)


@pytest.mark.parametrize("gear", [13, 4, 12])
def test_engine_and_vehicle_swing_with_the_period_of_the_two_on_their_shafts(gear: int) -> None:
    bodies = bodies_of(gear)
    body, speeds = TwoBodies(bodies, STIFFNESS, VEHICLE), []
    for _ in range(400):
        speeds.append(body.first - body.second)
        body.run(0.0)
    turns = [k for k in range(1, 400) if speeds[k - 1] < 0.0 <= speeds[k]]
    period_s = STEP_S * (turns[-1] - turns[0]) / (len(turns) - 1)
    assert 2e-6 * bodies.half_period_us == pytest.approx(period_s, rel=0.05)


def test_the_shafts_carry_what_turns_the_vehicle_and_what_the_road_takes() -> None:
    """By the engine's side: its torque less what it needs for its own speed."""
    bodies, body = bodies_of(4), TwoBodies(bodies_of(4), STIFFNESS, VEHICLE)
    body.second = body.first
    torque_nm = 1.3 * ROAD_NM / bodies.ratio
    body.shafts_nm = 1.2 * ROAD_NM
    before = body.first
    body.run(torque_nm)
    acceleration = (body.first - before) / STEP_S
    assert bodies.shafts_nm(torque_nm, acceleration) == pytest.approx(1.2 * ROAD_NM, rel=0.02)
    vehicle = (1.2 * ROAD_NM - ROAD_NM) / VEHICLE
    coasting = bodies.coasting_rad_s2(torque_nm, vehicle + (acceleration - vehicle))
    expected = acceleration - bodies.shafts_nm(torque_nm, acceleration) / VEHICLE
    assert coasting == pytest.approx(expected)


@pytest.mark.parametrize("rise_rad_s2", [-30.0, 0.0, 45.0])
def test_the_engines_acceleration_is_that_of_its_last_50_ms(rise_rad_s2: float) -> None:
    seen = Seen()
    for k in range(30):
        seen.step(100.0 + 10.0 * k, 0.3)
        assert (seen.measurement.engine_rad_s2 == 0.0) is (k < ENGINE_MEASUREMENTS), (
            "the first finds the gear"
        )
    for k in range(ENGINE_MEASUREMENTS):
        seen.step(150.0 + rise_rad_s2 * STEP_S * k, 0.3)
    assert seen.measurement.engine_rad_s2 == pytest.approx(rise_rad_s2)


def test_another_gear_another_state_or_a_silent_engine_are_not_looked_at_together() -> None:
    """What was seen in a gear says nothing of another, and nothing is seen in neutral."""
    for change in ("gear", "state"):
        seen = Seen()
        for _ in range(40):
            seen.step(100.0, 0.3)
        assert seen.measurement.mean_share(200_000.0) == pytest.approx(0.3)
        seen.step(100.0, 0.3, State.CLUTCH_OPENING)
        assert seen.measurement.mean_share(200_000.0) is not None, "the ramp belongs to the gear"
        if change == "gear":
            seen.gear = 5
            seen.step(100.0, 0.3)
        else:
            seen.step(100.0, 0.3, State.DISENGAGING)
        assert seen.measurement.mean_share(200_000.0) is None
        assert seen.measurement.engine_rad_s2 == 0.0
    seen = Seen()
    for _ in range(LEAST_MEASUREMENTS + 5):
        seen.step(None, 0.3)
    assert seen.measurement.mean_share(200_000.0) is None


def test_the_mean_torque_is_that_of_the_last_period_alone() -> None:
    seen = Seen()
    for k in range(60):
        seen.step(100.0, 0.1 if k < 40 else 0.5)
    assert seen.measurement.mean_share(150_000.0) == pytest.approx(0.5)
    assert seen.measurement.mean_share(1e6 * STEP_S * 39.0) == pytest.approx(0.3)


def test_the_flank_is_reported_where_the_torque_is_some_times_its_error() -> None:
    """And it is as certain as what is left and what cannot be determined allow."""
    measurement = DrivelineMeasurement(SHEET)
    for pulled, sign in ((300.0, 1.0), (-300.0, -1.0)):
        measurement.press(pulled, 100.0, 40.0)
        assert measurement.pressed_nm == pytest.approx(sign * math.hypot(100.0, 40.0))
        measurement.press(pulled, 160.0, 40.0)
        assert measurement.pressed_nm == 0.0


def test_the_torques_error_is_of_its_steps_and_of_the_engines_inertia() -> None:
    """Even within half a step, and within the sheet's tolerance."""
    measurement, engine = DrivelineMeasurement(SHEET), SHEET.engine
    measurement.torque_step = 0.01
    read = 0.005 * REFERENCE_NM / math.sqrt(3.0)
    assert measurement.torque_sd_nm(0.0) == pytest.approx(read)
    own = engine.inertia_tolerance * engine.inertia_kgm2 * 50.0 / math.sqrt(3.0)
    assert measurement.torque_sd_nm(50.0) == pytest.approx(math.hypot(read, own))


def test_a_vehicle_may_have_been_loaded_since_but_is_never_known_less_than_at_first() -> None:
    least, most = SHEET.driveline.vehicle_kgm2
    measurement = DrivelineMeasurement(SHEET)
    even_sd = (1.0 / least - 1.0 / most) / math.sqrt(12.0)
    assert measurement.known.vehicle_sd == pytest.approx(even_sd)
    assert measurement.known.vehicle_inverse == pytest.approx(0.5 * (1.0 / least + 1.0 / most))
    tolerance = SHEET.driveline.stiffness_tolerance / math.sqrt(3.0)
    assert measurement.known.stiffness_sd == pytest.approx(tolerance)
    measurement.loaded()
    assert measurement.known.vehicle_sd == pytest.approx(even_sd)
    assert measurement.known.stiffness_sd == pytest.approx(tolerance)
    measurement.learned = Known(15_000.0, 0.04, 1.0 / 900.0, 0.1 * even_sd)
    measurement.loaded()
    assert measurement.known.vehicle_sd == pytest.approx(math.hypot(0.1, LOADED_SHARE) * even_sd)
    assert measurement.known.stiffness_sd == pytest.approx(math.hypot(0.04, 0.05))
    assert measurement.known.stiffness_nm_rad == 15_000.0
    assert measurement.known.vehicle_inverse == 1.0 / 900.0


def ridden(gear: int, stiffness: float, vehicle: float) -> Seen:
    """A second of even torque, then half of it away."""
    bodies = bodies_of(gear)
    seen, body = Seen(gear), TwoBodies(bodies, stiffness, vehicle)
    torque_nm = ROAD_NM / bodies.ratio
    for k in range(200):
        share = torque_nm * (1.0 if k < 100 else 0.5) / REFERENCE_NM
        seen.step(body.run(share * REFERENCE_NM) * bodies.ratio, share)
    return seen


@pytest.mark.parametrize(("stiffness", "vehicle"), [(13e3, 1300.0), (19e3, 700.0)])
def test_what_was_seen_of_a_swing_tells_shafts_and_vehicle(
    stiffness: float, vehicle: float
) -> None:
    """And what the shafts carried before it, with the torque of then."""
    bodies = bodies_of(1)
    seen = ridden(1, stiffness, vehicle)
    fitted = seen.measurement.fit(bodies, 0.0)
    assert fitted is not None
    found, torque_nm = fitted
    assert torque_nm == pytest.approx(ROAD_NM / bodies.ratio, rel=1e-6)
    assert found.acceleration_rad_s2 == pytest.approx(0.0, abs=0.02)
    assert found.known.stiffness_nm_rad == pytest.approx(stiffness, rel=0.1)
    assert 1.0 / found.known.vehicle_inverse == pytest.approx(vehicle, rel=0.1)
    assert found.known.vehicle_sd < 0.5 * seen.measurement.known.vehicle_sd
    assert seen.measurement.fit(bodies, seen.now_us - (LEAST_MEASUREMENTS - 2) * TICK_US) is None


def test_no_swing_makes_shafts_or_vehicle_other_than_the_sheet_allows() -> None:
    driveline = SHEET.driveline
    least, most = driveline.vehicle_kgm2
    share = driveline.stiffness_tolerance
    for stiffness, vehicle in ((3e4, 900.0), (8e3, 900.0), (16e3, 0.3 * least), (16e3, 4.0 * most)):
        fitted = ridden(1, stiffness, vehicle).measurement.fit(bodies_of(1), 0.0)
        assert fitted is not None
        known = fitted[0].known
        ratio = known.stiffness_nm_rad / driveline.stiffness_nm_rad
        assert 1.0 - share - 1e-9 <= ratio <= 1.0 + share + 1e-9
        assert 1.0 / most * (1.0 - 1e-9) <= known.vehicle_inverse <= 1.0 / least * (1.0 + 1e-9)


def test_a_torque_follows_what_is_asked_for_within_the_step_in_which_it_is_reported() -> None:
    """It is reported in whole per cent; between two of them it goes as the engine's lag has it."""

    def reported() -> Seen:
        seen = Seen()
        for _ in range(LEAST_MEASUREMENTS):
            seen.step(100.0, 0.30, State.CLUTCH_OPENING)
        return seen

    seen = reported()
    seen.measurement.ask(0.20)
    shares = []
    for _ in range(3):
        seen.step(100.0, 0.30, State.CLUTCH_OPENING)
        shares.append(seen.measurement.mean_share(0.0))
    assert shares == [pytest.approx(0.295)] * 3
    seen.step(100.0, 0.28, State.CLUTCH_OPENING)
    follows = 1.0 - math.exp(-STEP_S / SHEET.engine.lag_s)
    assert seen.measurement.mean_share(0.0) == pytest.approx(0.295 + (0.20 - 0.295) * follows)
    fine = reported()
    fine.measurement.ask(0.298)
    fine.step(100.0, 0.30, State.CLUTCH_OPENING)
    assert fine.measurement.mean_share(0.0) == pytest.approx(0.30 - 0.002 * follows)


def test_what_nothing_was_seen_of_is_known_as_well_as_before() -> None:
    """An engine at an even speed and an even torque swings nowhere."""
    bodies = bodies_of(1)
    seen = Seen(1)
    for _ in range(150):
        seen.step(11.0 * bodies.ratio, ROAD_NM / bodies.ratio / REFERENCE_NM)
    fitted = seen.measurement.fit(bodies, 0.0)
    assert fitted is not None
    known, before = fitted[0].known, seen.measurement.known
    assert known.stiffness_nm_rad == pytest.approx(before.stiffness_nm_rad, rel=0.05)
    assert known.stiffness_sd == pytest.approx(before.stiffness_sd, rel=0.15)
    assert fitted[0].acceleration_rad_s2 == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("gear", [13, 1, 4, 8, 12])
@pytest.mark.parametrize("pulled", [1_500.0, -700.0])
def test_the_last_ramp_is_the_shortest_that_leaves_little_and_each_takes_all_away(
    gear: int, pulled: float
) -> None:
    bodies = bodies_of(gear)
    found = unloading(SHEET, bodies, Loaded(pulled / bodies.ratio, pulled, -0.2, 7.2), 500)
    swings = math.sin(0.5 * math.pi * min(bodies.tolerance, 1.0))
    away = abs(pulled) + bodies.ratio * 7.2
    for number, ramp in enumerate(found):
        assert sum(ramp.shares) == pytest.approx(1.0)
        assert len(ramp.shares) == number + 1
        harmless = away * swings**number <= bodies.harmless_nm
        assert harmless is (ramp is found[-1]) or number == 2
        left_nm = (bodies.engine_kgm2 * -0.2 + bodies.drag_nm) / bodies.ratio
        assert ramp.left_nm == pytest.approx(left_nm)
        # The last step fades with the engine's lag, until as much is left as is harmless.
        last_nm = ramp.shares[-1] * away * math.exp(-1e-6 * ramp.settle_us / SHEET.engine.lag_s)
        assert last_nm == pytest.approx(min(ramp.shares[-1] * away, bodies.harmless_nm), rel=1e-6)
