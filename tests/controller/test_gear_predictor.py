"""Where two shafts that slow down steadily will be, and how well that will be known, on paper."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from test_strategy import GEAR, RATIO, SHEET, learned

from meshpoint.controller.estimate.reference import LEARNED_SD_RAD, PhaseReferences
from meshpoint.controller.models.layshaft import (
    BrakeInput,
    LayshaftState,
    MotionModel,
    first_order_law,
)
from meshpoint.controller.models.swing import ShaftState
from meshpoint.controller.plan.gear_predictor import GearPredictor

AT_ZERO, DELAY_SD_S = 0.03, 2e-3
LAYSHAFT = LayshaftState(1_000.0, 1.5, 100.0, 0.0, 4e-3, 0.25, drag_rad_s2=-30.0)
MAIN = ShaftState(3_000.0, 2.0, 64.0, 3e-3, 0.5, -5.0)
BRAKED_RAD_S2 = 1000.0
"""The brake's pressure comes at once."""
MODEL = MotionModel(np.array([0.0, 2e-3, 1.0]), first_order_law(1e5, 5e5), np.zeros(4))
ON_US, OFF_DELAY_US = 2_000, 1_000


def predictor(braked: bool = False) -> GearPredictor:
    """Of a gear whose phase is AT_ZERO where both angles are; braked from 2 ms on, for ever."""
    brake = BrakeInput(0)
    if braked:
        brake.set_delays(off_us=OFF_DELAY_US, on_us=500)
        brake.schedule(ON_US - 500, True, -1)
    return GearPredictor(GEAR, RATIO, LAYSHAFT, MAIN, brake, MODEL, learned(AT_ZERO), 45_000,
                         DELAY_SD_S, 33_000, 0.3)  # fmt: skip


def trajectory(time_us: float, release_us: float | None = None) -> tuple[float, float]:
    """Phase and slip; the brake acts until a while after its release, if at all."""
    t, t_main = (time_us - LAYSHAFT.time_us) * 1e-6, (time_us - MAIN.time_us) * 1e-6
    braked_s = 0.0 if release_us is None else (release_us + OFF_DELAY_US - ON_US) * 1e-6
    since_s = 0.0 if release_us is None else (time_us - release_us - OFF_DELAY_US) * 1e-6
    slowed = BRAKED_RAD_S2 * braked_s
    turned_back = slowed * (braked_s / 2.0 + since_s)
    layshaft = 1.5 + 100.0 * t - 15.0 * t**2 - turned_back
    main = 2.0 + 64.0 * t_main - 2.5 * t_main**2
    phase = RATIO * layshaft - main + AT_ZERO
    return phase, RATIO * (100.0 - 30.0 * t - slowed) - (64.0 - 5.0 * t_main)


@pytest.mark.parametrize("time_us", [3_000.0, 21_000.0, 81_000.0])
def test_phase_and_slip_are_those_of_two_shafts_that_slow_down_steadily(time_us: float) -> None:
    phase, slip = trajectory(time_us)
    assert predictor().phase_and_slip(time_us) == pytest.approx((phase, slip), abs=1e-9)
    assert predictor().slip_rad_s(time_us) == pytest.approx(slip, abs=1e-9)
    found = predictor().trajectory(time_us, 4_000.0, 3)
    expected = np.array([trajectory(time_us + 4_000.0 * k) for k in range(3)]).T
    assert np.array(found[2:]) == pytest.approx(expected, abs=1e-9)


def test_each_release_has_its_trajectory_from_its_own_time_on() -> None:
    releases_us, firsts_us = (9_000, 20_000, 30_000), (40e3, 40e3, 52e3)
    found = predictor(braked=True).trajectories(releases_us, firsts_us, 4_000.0, 2)
    for row, release_us, first_us in zip(found, releases_us, firsts_us, strict=True):
        for k in range(2):
            phase, slip = trajectory(first_us + 4_000.0 * k, release_us)
            assert row[0, k] == pytest.approx(phase, abs=1e-3)
            assert row[1, k] == pytest.approx(slip, abs=0.02)


def test_the_release_and_the_time_that_leave_a_slip_are_found() -> None:
    """A slip that cannot be left any more, or not yet, has the end of what is allowed."""
    braked, settle_us = predictor(braked=True), 50_000.0
    for release_us in (5_000, 13_000, 18_000):
        left = trajectory(release_us + settle_us, release_us)[1]
        found = braked.release_time_us(4_000, 20_000, left, settle_us)
        assert found == pytest.approx(release_us, abs=30)
    for release_us, end_us in ((3_000, 4_000), (21_000, 20_000)):
        left = trajectory(release_us + settle_us, release_us)[1]
        assert braked.release_time_us(4_000, 20_000, left, settle_us) == end_us
    for time_us, found_us in ((9_000, 9_000), (33_000, 33_000), (4_000, 5_000), (50_000, 40_000)):
        found = predictor().slip_falls_to_us(trajectory(time_us)[1], 5_000, 40_000)
        assert found == pytest.approx(found_us, abs=10)


@pytest.mark.parametrize("time_us", [3_000.0, 43_000.0])
def test_what_is_not_known_of_both_shafts_grows_with_time(time_us: float) -> None:
    """Variance of angle + speed t of each, errors of both going together where they are said to;
    and the sleeve's delay by the slip."""
    t, t_main = (time_us - LAYSHAFT.time_us) * 1e-6, (time_us - MAIN.time_us) * 1e-6
    together = np.diag([16e-6, 0.0625, 0.0, 0.0, 0.0, 0.0])
    together[0, 1] = together[1, 0] = -5e-4
    main = (3e-3) ** 2 + (0.5 * t_main) ** 2
    for covariance, cross in ((None, 0.0), (together, -5e-4)):
        made = replace(predictor(), layshaft=LAYSHAFT._replace(covariance=covariance))
        layshaft = (4e-3) ** 2 + 2.0 * t * cross + (0.25 * t) ** 2
        expected = RATIO**2 * layshaft + main
        assert made.estimate_variance(time_us) == pytest.approx(expected)
        delay = trajectory(time_us)[1] * DELAY_SD_S
        whole = math.hypot(math.sqrt(expected), delay, LEARNED_SD_RAD)
        assert made.phase_sd_rad(time_us) == pytest.approx(whole)
        assert made.variances(time_us, 1_000.0, 3) == pytest.approx(np.full(3, expected))


def test_what_is_not_known_of_the_phase_reference_adds_to_every_prediction() -> None:
    """Of a tooth that was seen at one flank alone it is which flank: more than half a gap."""
    references = PhaseReferences(SHEET)
    references.locked(GEAR, 0.0)
    for _ in range(30):
        references.measure(GEAR, 1.5, 2.0, 0.1 * SHEET.dog.backlash_rad)
    assert references.settle(GEAR)
    sure, unsure = predictor(), replace(predictor(), references=references)
    assert sure.reference_variance == pytest.approx(LEARNED_SD_RAD**2)
    added = unsure.phase_sd_rad(43_000.0) ** 2 - sure.phase_sd_rad(43_000.0) ** 2
    assert added == pytest.approx(references.sd_rad(GEAR) ** 2)
    assert math.sqrt(added) > 0.4 * SHEET.dog.backlash_rad
