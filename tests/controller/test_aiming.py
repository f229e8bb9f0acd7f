"""The aim against a search by brute force: no contact within reach costs less than the chosen."""

from __future__ import annotations

import math

import normal_law
import numpy as np
import pytest
from test_strategy import (
    DELAY_US,
    EARLIEST_US,
    HALF_GAP,
    NOW_US,
    PITCH,
    RATIO,
    SHEET,
    VALVE_US,
    learned,
    predictor_at,
    truth,
)

from meshpoint.controller.models.layshaft import BrakeInput
from meshpoint.controller.plan.gear_predictor import GearPredictor
from meshpoint.controller.plan.target_phase import OUTSIDE, OUTSIDE_S, TargetPhase
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.gearbox import Split

SETTINGS = ControllerSettings()
WINDOW, PRICES = SETTINGS.window, SETTINGS.prices
REFERENCE_SD = math.radians(0.1)


def cost_of(predictor: GearPredictor, contact_us: float, variance: float) -> float:
    """The price of a contact in seconds, as docs/strategy.md has it."""
    trajectory = predictor.trajectory(contact_us, 1.0, 1)
    phase, slip = float(trajectory.phase_rad[0]), float(trajectory.slip_rad_s[0])
    moved = slip * SHEET.dog.most_overlap_m / predictor.contact_speed_m_s
    centre = SETTINGS.aim.target_rad(SHEET.dog.backlash_rad) - moved / 2.0
    off = math.remainder(phase - centre, PITCH)
    sd = math.sqrt(variance + (slip * predictor.delay_sd_s) ** 2)
    low, high = (-HALF_GAP, HALF_GAP - moved) if moved > 0.0 else (-HALF_GAP - moved, HALF_GAP)
    flanks = normal_law.cdf([low, high], centre + off, sd)
    hit = float(flanks[1] - flanks[0]) if high > low else 0.0
    may_block = min(1.0, PRICES.block_slip_rad_s / max(abs(slip), 1e-9))
    energy_j = 0.5 * SHEET.inertia_kgm2(Split.HIGH) * (slip / RATIO) ** 2
    outside = max(WINDOW.contact_low_rad_s - slip, slip - WINDOW.contact_high_rad_s)
    price = (contact_us - NOW_US) * 1e-6
    price += (1.0 - hit) * (PRICES.miss_s + PRICES.block_s * may_block)
    price += PRICES.energy_s_per_j * energy_j + PRICES.aim_s * (off / HALF_GAP) ** 2
    return price + (OUTSIDE_S + OUTSIDE * outside if outside > 0.0 else 0.0)


@pytest.mark.parametrize("slip_rpm", [60.0, 30.0, 12.0, -3.0])
@pytest.mark.parametrize("at_zero", [0.0, 0.3 * PITCH, 0.7 * PITCH])
def test_no_contact_within_reach_costs_less_than_the_one_that_is_chosen(
    slip_rpm: float, at_zero: float
) -> None:
    """All contacts of the next 0.3 s are priced by themselves, half a millisecond apart. Of two
    gaps that cost the same within 3 ms either may be chosen."""
    predictor = predictor_at(slip_rpm, references=learned(at_zero))
    chosen_us = TargetPhase(SHEET, SETTINGS).contact(predictor, NOW_US, EARLIEST_US)
    first_us = EARLIEST_US + DELAY_US
    assert chosen_us is not None
    assert chosen_us >= first_us
    times = np.arange(first_us, first_us + 300_000.0, 500.0)
    variances = predictor.variances(first_us, 500.0, times.size) + REFERENCE_SD**2
    priced = [cost_of(predictor, t, v) for t, v in zip(times.tolist(), variances, strict=True)]
    own = float(np.interp(chosen_us, times, variances))
    assert cost_of(predictor, chosen_us, own) <= min(priced) + 3e-3


def test_a_release_that_is_far_ahead_yet_is_not_aimed() -> None:
    """50 ms after the earliest it is planned again anyway; it leaves the slip asked for as the
    brake's air has gone."""
    brake = BrakeInput(VALVE_US)
    brake.schedule(-400_000, True, -400_000)
    gauge_pa = SHEET.air.supply_gauge_pa
    predictor = predictor_at(900.0, gauge_pa, brake=brake, references=learned(0.0))
    far = TargetPhase(SHEET, SETTINGS).release(predictor, NOW_US, EARLIEST_US)
    assert far.release_us > EARLIEST_US + 50_000
    faded_s = WINDOW.aim_time_constants * SHEET.brake.time_constant_s
    assert far.contact_us - far.release_us == pytest.approx(VALVE_US + 1e6 * faded_s, abs=1)
    _, (slip,) = truth(predictor, np.array([float(far.contact_us)]),
                       (-math.inf, far.release_us + VALVE_US))  # fmt: skip
    assert slip == pytest.approx(WINDOW.aim_slip_rad_s, abs=0.01)
