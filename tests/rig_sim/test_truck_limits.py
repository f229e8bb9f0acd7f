"""The truck's dog teeth against limits in closed form, numbered 1 to 8 (docs/gearbox.md)."""

from __future__ import annotations

import math

import numpy as np
import pytest
from truck_bench import GEAR, SHEET, TRIALS, limit_sheet, limit_values, run, share, world

from benchmarks.studies.trials import Trials
from meshpoint.dbc.messages import EngagementEvent
from meshpoint.gearbox.sheet import load_sheet
from meshpoint.rig_sim.truck import layout as at
from meshpoint.units import DEG, RPM

PITCH = 15.0 * DEG
BACKLASH = 3.0 * DEG
OVERLAP_M, SPEED_M_S = 1e-3, 0.25


def phases(seed: int) -> list[float]:
    rng = np.random.default_rng(seed)
    return rng.uniform(-PITCH / 2.0, PITCH / 2.0, TRIALS).tolist()


def test_limits_1_and_2_tooth_meets_tooth_by_its_share_and_slides_off_in_time() -> None:
    trials = Trials(limit_sheet(), limit_values())
    slip = 20.0 * RPM
    hits, waited = 0, []
    for phase in phases(1):
        outcome = trials.engage(phase, slip)
        if outcome.contact.event is not EngagementEvent.TOOTH_CONTACT:
            continue
        hits += 1
        unwrapped = outcome.contact.phase_rad % PITCH
        expected_s = (PITCH - BACKLASH / 2.0 - unwrapped) / slip
        assert outcome.passed is not None
        slid_s = (outcome.passed.time_us - outcome.contact.time_us) * 1e-6
        assert slid_s == pytest.approx(expected_s, abs=1e-7)
        waited.append(slid_s)
    assert abs(share(hits, TRIALS, 0.8)) < 3.0
    mean_s = (PITCH - BACKLASH) / (2.0 * slip)
    spread_s = (PITCH - BACKLASH) / slip / math.sqrt(12.0 * len(waited))
    assert abs(sum(waited) / len(waited) - mean_s) < 3.0 * spread_s


@pytest.mark.parametrize(("slip_rpm", "expected"), [(5.0, 0.270), (10.0, 0.479), (15.0, 0.828)])
def test_limit_3_friction_at_the_face_blocks_what_is_too_slow(
    slip_rpm: float, expected: float
) -> None:
    trials = Trials(limit_sheet(), limit_values(dog__face_friction=0.1))
    slip = slip_rpm * RPM
    alpha = 0.1 * 1000.0 * 0.075 / 1.0
    closed = 0.2 + min(0.8, slip**2 / (2.0 * alpha * PITCH))
    assert closed == pytest.approx(expected, abs=5e-4)
    outcomes = [trials.engage(phase, slip) for phase in phases(int(slip_rpm))]
    # one that gets in with hardly any slip left may take its time to the flank
    assert all(outcome.blocked or outcome.in_gap for outcome in outcomes)
    entered = sum(not outcome.blocked for outcome in outcomes)
    assert abs(share(entered, TRIALS, closed)) < 3.0


def test_limit_3_above_16_9_rpm_nothing_is_blocked() -> None:
    trials = Trials(limit_sheet(), limit_values(dog__face_friction=0.1))
    certain = math.sqrt(2.0 * 7.5 * (PITCH - BACKLASH))
    assert certain / RPM == pytest.approx(16.9, abs=0.05)
    worst = BACKLASH / 2.0 + 1e-6  # just past the gap: the whole tooth to slide over
    assert trials.engage(worst, certain * 1.001).locked is not None
    assert trials.engage(worst, certain * 0.999).blocked


def test_limit_4_from_rest_a_millimetre_takes_2_45_ms_and_above_204_rpm_it_ratchets() -> None:
    entry_s = math.sqrt(2.0 * OVERLAP_M * 3.0 / 1000.0)
    assert entry_s == pytest.approx(2.45e-3, abs=5e-6)
    # 1 kN at the sheet's supply: once its chamber is full no entry from the face is faster
    values = limit_values(
        sleeve__model=1,
        sleeve__area_cm2=1e4 * 1000.0 / SHEET.air.supply_gauge_pa,
        sleeve__dead_volume_cm3=400.0,
        sleeve__damping_nsm=0.0,
        sleeve__neutral_detent_n=0.0,
        sleeve__end_detent_n=0.0,
        dog__overlap_mm=1.0,
    )
    trials = Trials(limit_sheet(), values)
    limit = BACKLASH / entry_s
    assert limit / RPM == pytest.approx(204.0, abs=0.2)
    below = trials.engage(PITCH / 2.0 - 1e-3, limit * 0.99)
    above = trials.engage(PITCH / 2.0 - 1e-3, limit * 1.001, patience_us=400_000.0)
    assert below.locked is not None
    assert above.locked is None
    assert trials.engagement.tally(next(iter(trials.engagement.sleeves))).ratchets > 5


@pytest.mark.parametrize(
    ("slip_rpm", "expected"),
    [(5.0, 0.192), (20.0, 0.168), (50.0, 0.12), (100.0, 0.04), (150.0, 0.0)],
)
def test_limit_5_the_first_pass_is_free_of_impact_while_the_gap_is_wide_enough(
    slip_rpm: float, expected: float
) -> None:
    trials = Trials(limit_sheet(), limit_values(dog__overlap_mm=1.0))
    slip = slip_rpm * RPM
    closed = max(0.0, BACKLASH - slip * OVERLAP_M / SPEED_M_S) / PITCH
    assert closed == pytest.approx(expected, abs=1e-3)
    # 300 ms after the valve a clean first pass is long over: what ratchets needs no waiting for
    clean = sum(trials.engage(phase, slip, 3e5).clean for phase in phases(50 + int(slip_rpm)))
    assert abs(share(clean, TRIALS, closed)) < 3.0


@pytest.mark.parametrize(
    ("slip_rpm", "expected"), [(10.0, 1.000), (20.0, 0.997), (50.0, 0.735), (100.0, 0.155)]
)
def test_limit_6_aimed_at_the_shifted_centre_the_error_decides(
    slip_rpm: float, expected: float
) -> None:
    trials = Trials(limit_sheet(), limit_values(dog__overlap_mm=1.0))
    slip = slip_rpm * RPM
    on_the_way = slip * OVERLAP_M / SPEED_M_S
    spread = math.hypot(slip * 2.5e-3, 0.3 * DEG)
    closed = math.erf((BACKLASH - on_the_way) / (2.0 * math.sqrt(2.0) * spread))
    assert closed == pytest.approx(expected, abs=2e-3)
    rng = np.random.default_rng(int(slip_rpm))
    aimed = rng.normal(-on_the_way / 2.0, spread, TRIALS)
    aimed = aimed[np.abs(aimed) < PITCH / 2.0]
    clean = sum(trials.engage(phase, slip).clean for phase in aimed.tolist())
    assert abs(share(clean, TRIALS, closed)) < 3.0


@pytest.mark.parametrize("restitution", [0.0, 0.3, 0.6])
def test_limit_7_a_flank_takes_the_energy_and_gives_back_the_slip(restitution: float) -> None:
    trials = Trials(limit_sheet(), limit_values(dog__restitution=restitution, dog__free_play=1))
    slip = 30.0 * RPM
    outcome = trials.engage(0.0, slip)
    assert outcome.locked is not None
    loss = 0.5 * slip**2 * (1.0 - restitution**2)
    assert outcome.locked.tally.impact_j == pytest.approx(loss, rel=1e-9)
    assert outcome.slip_after_rad_s == pytest.approx(-restitution * slip, abs=1e-9)


def test_limit_8_the_brake_follows_its_closed_curve() -> None:
    truck = world(limit_values(), limit_sheet())
    plant, sheet = truck.plant, truck.sheet
    plant.coast()
    omega = plant.layshaft_rad_s
    plant.set_brake(1.0)
    rate = sheet.brake.max_torque_nm / sheet.inertia_kgm2(plant.shafts.split)
    tau = sheet.brake.time_constant_s
    for now_us in range(10_000, 210_000, 10_000):
        run(truck, now_us)
        s = now_us * 1e-6
        expected = omega - rate * (s - tau * (1.0 - math.exp(-s / tau)))
        assert plant.layshaft_rad_s == pytest.approx(expected, abs=1e-6)
        turns, rest_rad = plant.angle(at.LAYSHAFT)
        assert turns * 2.0 * math.pi + rest_rad > 0.0


def test_the_sheet_of_the_limits_has_their_numbers() -> None:
    trials = Trials(limit_sheet(), limit_values())
    assert trials.pitch_rad == pytest.approx(PITCH)
    assert trials.backlash_rad == pytest.approx(BACKLASH)
    ratio = load_sheet("thesis").main_mesh(GEAR).ratio
    chain = trials.plant.chain
    trials.plant.y.speed_rad_s[at.LAYSHAFT] += 1.0
    slip = chain.slip_rad_s(at.MAIN_BOX, ratio)
    equivalent_kgm2 = 2.0 * chain.impact(at.MAIN_BOX, ratio, 0.0) / slip**2
    assert equivalent_kgm2 == pytest.approx(1.0)


def test_a_face_rubs_with_the_force_that_the_air_presses_with_as_it_rises() -> None:
    values = limit_values(
        sleeve__model=1,
        sleeve__damping_nsm=1200.0,
        sleeve__neutral_detent_n=0.0,
        sleeve__end_detent_n=0.0,
        dog__face_friction=0.1,
    )
    trials = Trials(limit_sheet(), values)
    truck = trials.world
    outcome = trials.engage(BACKLASH, 40.0 * RPM, patience_us=46_000.0)
    assert outcome.contact.event is EngagementEvent.TOOTH_CONTACT
    truck.later(0.0, lambda: None)  # trials have gone on without the world's own queue
    area_m2, seen = 1e-4 * truck.built["sleeve.area_cm2"], []
    for now_us in range(50_000, 62_000, 2000):
        run(truck, now_us)
        time_us = truck.plant.time_us
        low_pa, high_pa = sorted(truck.truth.axis(trials.sleeve, time_us).pressures_pa)
        seen.append((1e-6 * time_us, (high_pa - low_pa) * area_m2, truck.plant.slip_rad_s(GEAR)))
    times_s, forces_n, slips_rad_s = np.array(seen).T
    assert times_s[-1] - times_s[0] == pytest.approx(0.010)
    assert forces_n[-1] > forces_n[0] + 80.0
    # 0.1 is the friction, 75 mm the radius, 1 kgm2 the inertia at the gear
    expected_rad_s = 0.1 * 0.075 * np.trapezoid(forces_n, times_s)
    assert slips_rad_s[0] - slips_rad_s[-1] == pytest.approx(expected_rad_s, rel=2e-3)
