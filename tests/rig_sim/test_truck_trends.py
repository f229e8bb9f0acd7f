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

from benchmarks.studies.trials import Trials
from meshpoint.gearbox.gears import MAIN_GEARS
from meshpoint.rig_sim.settings import Profile
from meshpoint.rig_sim.truck.as_built import draw_as_built, linear
from meshpoint.rig_sim.truck.delays import TruckDelays
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


def strokes_ms(seed: int, **fixed: float) -> list[float]:
    """Strokes of all gears from neutral, from the coil to contact, drawn as ever, ms."""
    values = {name.replace("__", "."): value for name, value in fixed.items()}
    found = []
    for gear in MAIN_GEARS:
        trials = Trials(SHEET, {"oil.temperature_c": 80.0} | values, gear, seed)
        for _ in range(5):
            fired_us = trials.plant.time_us
            contact_us = trials.engage(0.0, 0.0, 1e5).contact.time_us
            found.append(1e-3 * (contact_us - fired_us))
    return found


@pytest.mark.check
def test_delays_of_all_gears_are_45_ms_within_5() -> None:
    ms = np.array([stroke for seed in range(20) for stroke in strokes_ms(seed)])
    assert ms.min() > 39.5  # 2 ms of the gear's, 3 of chance, and the tank's own pressure
    assert ms.max() < 50.5
    assert ms.mean() == pytest.approx(45.0, abs=0.5)
    counts, _ = np.histogram(ms, bins=(39, 42, 44, 46, 48, 51))
    assert counts[2] == max(counts)  # one hump, in the middle


def test_linear_delays_are_those_of_the_thesis_preset() -> None:
    built = draw_as_built(1, linear(), Profile.CLEAN)
    delays = TruckDelays(np.random.default_rng(4), SHEET, built)
    drawn = [delays.draw_gear_s(MAIN_GEARS[1]) for _ in range(2000)]
    assert np.mean(drawn) == pytest.approx(0.045, abs=2e-4)
    assert np.abs(np.array(drawn) - 0.045).max() <= 0.005


def test_less_pressure_and_cold_oil_make_a_sleeve_slower() -> None:
    def delay_ms(**changed: float) -> float:
        still = {"sleeve__noise_sd_ms": 0.0, "air__supply_offset_bar": 0.0}
        return strokes_ms(1, **(still | changed))[0]

    assert delay_ms(air__supply_offset_bar=-3.0) > delay_ms() + 3.0
    assert delay_ms(oil__temperature_c=-20.0) > delay_ms() + 1.0


def test_a_tooth_that_stops_on_the_chamfer_it_has_left_by_is_blocked() -> None:
    values = limit_values(dog__face_friction=0.1, dog__chamfer_mm=0.1, dog__overlap_mm=1.0)
    trials = Trials(limit_sheet(), values)
    just_out = trials.backlash_rad / 2.0 + 0.3 * 0.1e-3 / 0.075
    outcome = trials.engage(just_out, 1.0 * RPM, 1e6)
    assert outcome.blocked
    assert not outcome.in_gap
