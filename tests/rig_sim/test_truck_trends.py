"""The signs of the published trends of dog-clutch engagement, and the delays of all gears.

Probability of a first engagement without a flank's impact rises with teeth (at equal backlash
angle), axial speed and backlash, and falls with slip and overlap (Aljawabrah and Lovas); it falls
again at very low slip, where faces stick (Boka 2010). Shape, not numbers.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from truck_bench import SHEET, TRIALS, limit_sheet, limit_values

from meshpoint.gearbox.gears import MAIN_GEARS
from meshpoint.rig_sim.parts.cylinder import Cylinder, travel
from meshpoint.rig_sim.settings import Profile
from meshpoint.rig_sim.truck.as_built import as_built_sheet, draw_as_built, linear, nominal
from meshpoint.rig_sim.truck.delays import TruckDelays
from meshpoint.rig_sim.truck.trials import Trials
from meshpoint.units import DEG, RPM

BACKLASH = 3.0 * DEG


def clean_share(
    slip_rpm: float,
    teeth: int = 24,
    backlash_rad: float = BACKLASH,
    speed_m_s: float = 0.25,
    overlap_mm: float = 1.0,
) -> float:
    sheet = limit_sheet(teeth, backlash_rad * teeth / (360.0 * DEG))
    sheet = replace(sheet, sleeve=replace(sheet.sleeve, speed_m_s=speed_m_s))
    trials = Trials(sheet, limit_values(dog__overlap_mm=overlap_mm))
    half = trials.pitch_rad / 2.0
    phases = np.linspace(-half, half, TRIALS // 2, endpoint=False).tolist()
    return sum(trials.engage(phase, slip_rpm * RPM, 2e5).clean for phase in phases) / len(phases)


def test_teeth_axial_speed_and_backlash_help_slip_and_overlap_harm() -> None:
    reference = clean_share(40.0)
    assert clean_share(40.0, teeth=36) > reference
    assert clean_share(40.0, speed_m_s=0.5) > reference
    assert clean_share(40.0, backlash_rad=1.3 * BACKLASH) > reference
    assert clean_share(80.0) < reference
    assert clean_share(40.0, overlap_mm=2.0) < reference


def test_very_low_slip_is_worse_again_because_faces_stick() -> None:
    trials = Trials(limit_sheet(), limit_values(dog__face_friction=0.1, dog__overlap_mm=1.0))
    half = trials.pitch_rad / 2.0
    phases = np.linspace(-half, half, TRIALS // 2, endpoint=False).tolist()

    def engaged(slip_rpm: float) -> int:
        return sum(trials.engage(phase, slip_rpm * RPM).locked is not None for phase in phases)

    assert engaged(3.0) < engaged(8.0) < engaged(15.0)


def test_a_fast_gear_strikes_harder_and_a_chamfer_lets_a_tooth_in_sooner() -> None:
    trials = Trials(limit_sheet(), limit_values())
    soft, hard = trials.engage(0.0, 10.0 * RPM), trials.engage(0.0, 40.0 * RPM)
    assert soft.locked is not None
    assert hard.locked is not None
    ratio = hard.locked.tally.impact_j / soft.locked.tally.impact_j
    assert ratio == pytest.approx(16.0, rel=1e-6)
    chamfered = Trials(limit_sheet(), limit_values(dog__chamfer_mm=0.5))
    waits = []
    for each in (trials, chamfered):
        outcome = each.engage(4.0 * DEG, 20.0 * RPM)
        assert outcome.passed is not None
        waits.append(outcome.passed.time_us - outcome.contact.time_us)
    assert waits[0] - waits[1] == pytest.approx(0.5 / 75.0 / (20.0 * RPM) * 1e6, rel=1e-6)


def test_delays_of_all_gears_are_45_ms_within_5() -> None:
    drawn = []
    for seed in range(60):
        built = draw_as_built(seed, {"oil.temperature_c": 80.0}, Profile.CLEAN)
        sheet = as_built_sheet(SHEET, built)
        delays = TruckDelays(np.random.default_rng(seed), sheet, built)
        supply = sheet.air.supply_gauge_pa
        drawn += [delays.draw_gear_s(gear, supply) for gear in MAIN_GEARS for _ in range(20)]
    ms = 1e3 * np.array(drawn)
    assert ms.min() > 40.0
    assert ms.max() < 50.0
    assert ms.mean() == pytest.approx(45.0, abs=0.3)
    counts, _ = np.histogram(ms, bins=(40, 42, 44, 46, 48, 50))
    assert counts[2] == max(counts)  # one hump, in the middle
    assert counts[0] < counts[1] < counts[2] > counts[3] > counts[4]


def test_linear_delays_are_those_of_the_thesis_preset() -> None:
    built = draw_as_built(1, linear(), Profile.CLEAN)
    delays = TruckDelays(np.random.default_rng(4), SHEET, built)
    drawn = [delays.draw_gear_s(MAIN_GEARS[1], SHEET.air.supply_gauge_pa) for _ in range(2000)]
    assert np.mean(drawn) == pytest.approx(0.045, abs=2e-4)
    assert np.abs(np.array(drawn) - 0.045).max() <= 0.005


def test_less_pressure_and_cold_oil_make_a_sleeve_slower() -> None:
    def delay(supply_pa: float, oil_c: float) -> float:
        values = nominal() | {"sleeve.noise_sd_ms": 0.0, "oil.temperature_c": oil_c}
        built = draw_as_built(1, values, Profile.CLEAN)
        delays = TruckDelays(np.random.default_rng(4), SHEET, built)
        return delays.draw_gear_s(MAIN_GEARS[0], supply_pa)

    valve_s = SHEET.sleeve.valve_delay_s
    assert delay(8e5, 80.0) == pytest.approx(SHEET.sleeve.delay_s)
    assert (delay(4e5, 80.0) - valve_s) / (delay(8e5, 80.0) - valve_s) == pytest.approx(2.0**0.54)
    assert delay(8e5, 0.0) > delay(8e5, 80.0)


def test_the_cylinder_s_travel_goes_with_pressure_to_the_power_of_about_minus_a_half() -> None:
    cylinder = Cylinder(18e-4, 15e-6, 2e-8, 4.0, 80.0, 0.0, 12e-3)
    times = {bar: travel(cylinder, bar * 1e5, 1e5, 5e-3) for bar in (6.0, 9.0, 12.0)}
    power = np.log(times[12.0].time_s / times[6.0].time_s) / np.log(2.0)
    assert -0.75 < power < -0.35
    assert times[9.0].force_n > 0.0
    assert times[9.0].samples_m[-1] == pytest.approx(5e-3)
    stiff = travel(cylinder._replace(friction_n=300.0), 9e5, 1e5, 5e-3)
    assert 1e-3 < stiff.time_s - times[9.0].time_s < 15e-3
    assert travel(cylinder._replace(friction_n=5000.0), 9e5, 1e5, 5e-3).time_s == float("inf")


def test_a_tooth_that_stops_on_the_chamfer_it_has_left_by_is_blocked() -> None:
    values = limit_values(dog__face_friction=0.1, dog__chamfer_mm=0.1, dog__overlap_mm=1.0)
    trials = Trials(limit_sheet(), values)
    just_out = trials.backlash_rad / 2.0 + 0.3 * 0.1e-3 / 0.075
    outcome = trials.engage(just_out, 1.0 * RPM, 1e6)
    assert outcome.blocked
    assert not outcome.in_gap
