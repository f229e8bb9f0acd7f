"""The release's search in one kernel against the same trajectory by trajectory."""

from __future__ import annotations

import math

import numpy as np
from test_strategy import DELAY_US, GEAR, MAIN, MOTION, RATIO, VALVE_US, learned

from meshpoint.controller.models.layshaft import BrakeInput, LayshaftState
from meshpoint.controller.plan.gear_predictor import GearPredictor
from meshpoint.controller.plan.target_phase import CONTACT_SERIES, TERMS, best_trajectory, cheapest
from meshpoint.kernels.records import filled

RELEASES_US = (-5_000, 1_000, 12_000, 30_001, 55_500)
FIRSTS_US = (60_000.0, 60_000.0, 61_000.0, 75_000.0, 90_000.0)


def predictor() -> GearPredictor:
    """With a brake that is on, has been, and is to be released; valves that react off and on at
    different times."""
    brake = BrakeInput(VALVE_US)
    brake.set_delays(VALVE_US, VALVE_US + 3_000)
    for time_us, on in ((-300_000, True), (-200_000, False), (-4_000, True), (40_000, False)):
        brake.schedule(time_us, on, time_us)
    layshaft = LayshaftState(0.0, 1.0, (MAIN.omega_rad_s + 3.0) / RATIO, 2e5, 1e-3, 0.05, 1e3)
    return GearPredictor(
        GEAR,
        RATIO,
        layshaft,
        MAIN,
        brake,
        MOTION,
        learned(0.2),
        DELAY_US,
        1e-3,
        DELAY_US - 12_000,
        0.3,
    )


def test_the_trajectories_after_several_releases_are_those_after_each() -> None:
    predicted = predictor()
    found = predicted.trajectories(RELEASES_US, FIRSTS_US, 1_700.0, 40)
    for release_us, first_us, (phase, slip) in zip(RELEASES_US, FIRSTS_US, found, strict=True):
        alone = predicted.trajectory(first_us, 1_700.0, 40, release_us)
        assert phase.tolist() == alone.phase_rad.tolist()
        assert slip.tolist() == alone.slip_rad_s.tolist()


def test_the_best_trajectory_is_the_first_of_the_least_cost() -> None:
    found = predictor().trajectories(RELEASES_US, FIRSTS_US, 1_700.0, 40)
    found = np.concatenate((found, found))
    waits_s = np.tile(1e-6 * np.array(FIRSTS_US), 2)
    variance = np.linspace(1e-6, 1e-4, 40)
    terms = filled(
        TERMS, pitch_rad=0.13, half_gap_rad=0.013, target_rad=0.0, overlap_s=2e-3, delay_sd_s=1e-3,
        miss_s=0.2, block_s=0.1, block_slip_rad_s=1.0, energy_s3_rad2=1e-3, aim_s=1e-3,
        slip_low_rad_s=-1.0, slip_high_rad_s=50.0,
    )  # fmt: skip
    least, expected = math.inf, (0, 0)
    for r, wait_s in enumerate(waits_s.tolist()):
        contacts = filled(CONTACT_SERIES, wait_s=wait_s, step_s=1.7e-3)
        index, cost = cheapest(*found[r], variance, contacts, terms)
        if cost < least:
            least, expected = cost, (r, index)
    contacts = filled(CONTACT_SERIES, wait_s=0.0, step_s=1.7e-3)
    best = best_trajectory(found, variance, waits_s, contacts, terms, 0.0)
    assert best == expected
    assert expected[0] < len(RELEASES_US)
