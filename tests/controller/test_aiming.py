"""Aiming in its parts: steps, releases and costs against what they are for, by other ways."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm
from test_strategy import (
    DELAY_US,
    EARLIEST_US,
    HALF_GAP,
    MAIN,
    NOW_US,
    PITCH,
    RATIO,
    SHEET,
    VALVE_US,
    learned,
    predictor_at,
    truth,
)

from meshpoint.controller.motion.brake_input import BrakeInput
from meshpoint.controller.planning.gear_predictor import GearPredictor
from meshpoint.controller.planning.plan_kernels import OUTSIDE, OUTSIDE_S, TERMS
from meshpoint.controller.planning.strategies.target_phase import TargetPhase
from meshpoint.controller.records import Vector
from meshpoint.controller.settings import Aim, ControllerSettings, Window
from meshpoint.gearbox import GearboxSheet, Split
from meshpoint.units import RPM

SETTINGS = ControllerSettings()
WINDOW, PRICES = SETTINGS.window, SETTINGS.prices
REFERENCE_SD = math.radians(0.1)


def strategy(settings: ControllerSettings = SETTINGS, sheet: GearboxSheet = SHEET) -> Any:
    return TargetPhase(sheet, settings)


def braked(slip_rpm: float, at_zero: float = 0.0) -> GearPredictor:
    """A layshaft whose brake has been on for long."""
    brake = BrakeInput(VALVE_US)
    brake.schedule(-400_000, True, -400_000)
    gauge_pa = SHEET.air.supply_gauge_pa
    return predictor_at(slip_rpm, gauge_pa, brake=brake, references=learned(at_zero))


def cost_of(
    predictor: GearPredictor, contact_us: float, variance: float, shift_rad: float = 0.0,
    release_us: int | None = None,
) -> float:  # fmt: skip
    """The price of a contact in seconds, as docs/strategy.md has it."""
    course = predictor.trajectory(contact_us, 1.0, 1, release_us)
    phase, slip = float(course.phase_rad[0]) + shift_rad, float(course.slip_rad_s[0])
    overlap_s = SHEET.dog.most_overlap_m / SHEET.sleeve.contact_speed_m_s
    moved = slip * overlap_s
    centre = SETTINGS.aim.target_rad(SHEET.dog.backlash_rad) - moved / 2.0
    off = math.remainder(phase - centre, PITCH)
    at = centre + off
    sd = math.sqrt(variance + (slip * predictor.delay_sd_s) ** 2)
    low, high = (-HALF_GAP, HALF_GAP - moved) if moved > 0.0 else (-HALF_GAP - moved, HALF_GAP)
    hit = float(norm.cdf(high, at, sd) - norm.cdf(low, at, sd)) if high > low else 0.0
    may_block = min(1.0, PRICES.block_slip_rad_s / max(abs(slip), 1e-9))
    inertia = SHEET.inertia_kgm2(Split.HIGH)
    energy_j = 0.5 * inertia * (slip / RATIO) ** 2
    outside = max(WINDOW.contact_low_rad_s - slip, slip - WINDOW.contact_high_rad_s)
    price = (contact_us - NOW_US) * 1e-6 + (1.0 - hit) * (
        PRICES.miss_s + PRICES.block_s * may_block
    )
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
    chosen_us = strategy().contact(predictor, NOW_US, EARLIEST_US)
    first_us = EARLIEST_US + DELAY_US
    assert chosen_us >= first_us
    times = np.arange(first_us, first_us + 300_000.0, 500.0)
    variances = predictor.variances(first_us, 500.0, times.size) + REFERENCE_SD**2
    priced = [cost_of(predictor, t, v) for t, v in zip(times.tolist(), variances, strict=True)]
    own = float(np.interp(chosen_us, times, variances))
    assert cost_of(predictor, chosen_us, own) <= min(priced) + 3e-3


def test_steps_are_as_long_as_slip_and_phase_allow() -> None:
    """In one the phase moves by no more than 4 % of a pitch at the most slip allowed, and the slip
    by no more than 7 % of what is allowed; together they reach 0.3 s."""
    predictor = braked(120.0)
    for window in (WINDOW, Window(contact_high_rad_s=0.9, contact_low_rad_s=0.0)):
        aiming = strategy(replace(SETTINGS, window=window))
        step_us, count = aiming._steps(predictor, EARLIEST_US)
        after_us = EARLIEST_US + aiming._settle_us
        _, slips = truth(predictor, np.array([after_us, after_us + 20e3]),
                         (-math.inf, EARLIEST_US + VALVE_US))  # fmt: skip
        fall_rad_s2 = (slips[0] - slips[1]) / 20e-3
        allowed = window.contact_high_rad_s - window.contact_low_rad_s
        by_slip_us = 0.07 * allowed / fall_rad_s2 * 1e6
        by_phase_us = 0.04 * PITCH / window.contact_high_rad_s * 1e6
        assert step_us == pytest.approx(max(200.0, min(2_000.0, by_slip_us, by_phase_us)), rel=1e-3)
        assert (count - 1) * step_us < 300_000.0 <= count * step_us


def test_steps_are_never_shorter_than_a_fifth_of_a_millisecond_nor_longer_than_two() -> None:
    predictor = braked(120.0)
    wide = replace(SETTINGS, window=Window(contact_high_rad_s=1.0, contact_low_rad_s=-60.0))
    assert strategy(wide)._steps(predictor, EARLIEST_US)[0] == 2_000.0
    narrow = replace(SETTINGS, window=Window(contact_high_rad_s=60.0, contact_low_rad_s=0.0))
    assert strategy(narrow)._steps(predictor, EARLIEST_US)[0] == 200.0


@pytest.mark.parametrize("slip_rpm", [250.0, 400.0])
def test_a_release_later_by_its_reach_moves_the_phase_at_contact_by_a_pitch(
    slip_rpm: float,
) -> None:
    """A braked gear is slower by a t for a release that is later by t, for all the time up to the
    contact: where that is long against t, the phase goes in proportion."""
    predictor, release_us = braked(slip_rpm), EARLIEST_US + 10_000
    aiming = strategy()
    reach_us = aiming._reach_us(predictor, release_us)
    contact_us = release_us + round(aiming._settle_us) + 20_000
    tenth = round(reach_us / 10.0)
    phases = [truth(predictor, np.array([float(contact_us)]), (-math.inf, at + VALVE_US))[0][0]
              for at in (release_us, release_us + tenth)]  # fmt: skip
    assert abs(phases[1] - phases[0]) / tenth * reach_us == pytest.approx(PITCH, rel=0.02)
    releases = aiming._releases(predictor, EARLIEST_US, release_us + 90_000)
    assert releases[0] == release_us + 90_000 - round(0.5 * reach_us)
    span_us = 1.2 * reach_us
    assert releases.step == pytest.approx(span_us / 14.0, abs=0.5)
    assert releases[-1] == pytest.approx(release_us + 90_000 + 0.7 * reach_us, abs=releases.step)
    assert len(releases) == pytest.approx(15, abs=1)
    soon = aiming._releases(predictor, EARLIEST_US, EARLIEST_US + 1)
    assert soon[0] == EARLIEST_US


def test_the_reach_of_a_release_stays_between_half_a_millisecond_and_forty() -> None:
    """Without a brake a release moves nothing; with fine teeth it would be nearly nothing."""
    assert strategy()._reach_us(predictor_at(20.0), EARLIEST_US) == 40_000.0
    fine = replace(SHEET, dog=replace(SHEET.dog, teeth=9_000))
    assert strategy(sheet=fine)._reach_us(braked(400.0), EARLIEST_US) == 500.0


@pytest.mark.parametrize("at_zero", [0.0, 0.4 * PITCH])
def test_around_the_best_release_of_all_coasts_it_is_looked_at_more_closely(at_zero: float) -> None:
    """On both sides, as far as the next release that was looked at, in steps of a fifth of what is
    between them or of less: 15 % of a gap. The least price of all looks is what is chosen."""
    aiming, predictor, looks = strategy(), braked(230.0, at_zero), []
    own = aiming._best_release

    def noted(predictor: GearPredictor, now_us: int, earliest_us: int, releases: range) -> Any:
        looks.append((releases, *own(predictor, now_us, earliest_us, releases)))
        return looks[-1][1:]

    aiming._best_release = noted
    chosen = aiming.release(predictor, NOW_US, EARLIEST_US)
    *coarse, (close, plan, _) = looks
    assert len(coarse) == 4
    assert plan is chosen
    releases, best, _ = min(coarse, key=lambda each: each[2])
    assert close[0] == max(EARLIEST_US, best.release_us - releases.step)
    assert close[-1] == pytest.approx(best.release_us + releases.step, abs=close.step)
    reach_us = aiming._reach_us(predictor, best.release_us)
    gap_us = 0.15 * 2.0 * HALF_GAP / PITCH * reach_us
    assert close.step == pytest.approx(min(releases.step / 5.0, gap_us), abs=0.5)
    slip, coasts = WINDOW.aim_slip_rad_s, (90e3, 60e3, 30e3, 0.0)
    for (releases, _, _), coast_us in zip(coarse, coasts, strict=True):
        settle_us = aiming._settle_us + coast_us
        unaimed_us = predictor.release_time_us(EARLIEST_US, EARLIEST_US + 10**6, slip, settle_us)
        assert releases == aiming._releases(predictor, EARLIEST_US, unaimed_us)


def test_a_release_that_is_far_ahead_yet_is_not_aimed() -> None:
    """50 ms after the earliest it is planned again anyway; it leaves the slip asked for after the
    longest coast."""
    aiming, predictor = strategy(), braked(900.0)
    far = aiming.release(predictor, NOW_US, EARLIEST_US)
    assert far.release_us > EARLIEST_US + 50_000
    settle_us = aiming._settle_us + 90_000
    assert far.contact_us == far.release_us + round(settle_us)
    _, (slip,) = truth(predictor, np.array([far.release_us + settle_us]),
                       (-math.inf, far.release_us + VALVE_US))  # fmt: skip
    assert slip == pytest.approx(WINDOW.aim_slip_rad_s, abs=0.01)


def test_of_a_release_the_contact_is_after_the_brake_has_been_let_go() -> None:
    """A sleeve may be fired before, but only so long that it meets its gear 10 ms after."""
    aiming, predictor = strategy(), braked(230.0)
    for release_us in (EARLIEST_US, EARLIEST_US + 30_000, EARLIEST_US + 80_000):
        fixed = range(release_us, release_us + 1)
        plan, cost = aiming._best_release(predictor, NOW_US, EARLIEST_US, fixed)
        first_us = max(EARLIEST_US + DELAY_US, release_us + 10_000)
        step_us, count = aiming._steps(predictor, release_us)
        steps = (plan.contact_us - first_us) / step_us
        assert steps == pytest.approx(round(steps), abs=1.0 / step_us)
        assert 0 <= round(steps) < count
        times = first_us + step_us * np.arange(count)
        spread = math.sqrt(predictor.estimate_variance(first_us) + REFERENCE_SD**2)
        firing_us = float(NOW_US + DELAY_US)
        before = max(0, round((first_us - firing_us) / step_us))
        known = predictor.variances(firing_us, step_us, before + count, release_us)[before:]
        known = known + REFERENCE_SD**2

        def least(
            shift: float, times: Vector = times, known: Vector = known, at: int = release_us
        ) -> float:
            pairs = zip(times.tolist(), known, strict=True)
            return min(cost_of(predictor, t, v, shift, at) for t, v in pairs)

        # Gauss and Hermite: the mean over a normal law from three of its points.
        wide = math.sqrt(3.0) * spread
        mean = 2.0 / 3.0 * least(0.0) + (least(wide) + least(-wide)) / 6.0
        assert cost == pytest.approx(mean, abs=2e-5)


def test_a_sleeve_on_its_way_goes_back_for_any_contact_that_costs_less() -> None:
    """Its own price by itself, against the least of all later ones, known as well as it."""
    aiming, verdicts = strategy(), set()
    again_us = EARLIEST_US + 20_000
    for at_zero in np.linspace(0.0, PITCH, 9, endpoint=False):
        predictor = predictor_at(25.0, references=learned(float(at_zero)))
        contact_us = NOW_US + 40_000
        variance = float(predictor.variances(contact_us, 1.0, 1)[0]) + REFERENCE_SD**2
        stays = cost_of(predictor, contact_us, variance)
        step_us, count = aiming._steps(predictor, again_us)
        later = again_us + DELAY_US + step_us * np.arange(count)
        least = min(cost_of(predictor, t, variance) for t in later.tolist())
        verdict = aiming.is_to_go_back(predictor, NOW_US, contact_us, again_us)
        assert verdict is (least < stays)
        verdicts.add(verdict)
    assert verdicts == {True, False}


@pytest.mark.parametrize("share", [0.0, 0.3])
def test_what_a_contact_is_priced_by_is_what_settings_and_sheet_say(share: float) -> None:
    predictor = predictor_at(20.0)
    terms = strategy(replace(SETTINGS, aim=Aim(share)))._terms(predictor).view(TERMS)[0]
    dog = SHEET.dog
    assert terms.pitch_rad == dog.pitch_rad
    assert terms.half_gap_rad == pytest.approx(dog.backlash_rad / 2.0)
    assert terms.target_rad == pytest.approx(share * dog.backlash_rad / 2.0)
    assert terms.overlap_s == pytest.approx(dog.most_overlap_m / SHEET.sleeve.contact_speed_m_s)
    assert terms.delay_sd_s == predictor.delay_sd_s
    assert (terms.miss_s, terms.block_s) == (PRICES.miss_s, PRICES.block_s)
    assert terms.block_slip_rad_s == PRICES.block_slip_rad_s
    assert terms.aim_s == PRICES.aim_s
    assert terms.slip_low_rad_s == WINDOW.contact_low_rad_s
    assert terms.slip_high_rad_s == WINDOW.contact_high_rad_s
    assert strategy().fire_slip_rad_s == WINDOW.contact_high_rad_s
    assert MAIN.omega_rad_s > 50.0 * RPM
