"""Aiming asks its predictor for the contacts and releases that it should, and takes the one that
hits: by a predictor whose every answer is laid down."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from meshpoint.controller.planning.gear_predictor import LastLook, Trajectory
from meshpoint.controller.planning.plan_kernels import TERMS
from meshpoint.controller.planning.strategies.base import ReleasePlan
from meshpoint.controller.planning.strategies.target_phase import TargetPhase
from meshpoint.controller.records import Vector
from meshpoint.controller.settings import Aim, ControllerSettings
from meshpoint.gearbox import load_sheet

SHEET = load_sheet("truck12")
SETTINGS = replace(ControllerSettings(), aim=Aim(0.0))
WINDOW, TIMING = SETTINGS.window, SETTINGS.timing
PITCH = SHEET.dog.pitch_rad
MISS = PITCH / 2.0
NOW_US, EARLIEST_US, DELAY_US = 10_000, 30_000, 45_000
FIRST_US = float(EARLIEST_US + DELAY_US)
SETTLE_US = 1e6 * (
    SHEET.brake.valve_delay_s + WINDOW.aim_time_constants * SHEET.brake.time_constant_s
)
ALLOWED = WINDOW.contact_high_rad_s - WINDOW.contact_low_rad_s
STEP_US = 1_000.0
FALL = 0.07 * ALLOWED * 20.0
"""By so much the slip falls in 20 ms where a step of a millisecond is as long as it may be."""
REFERENCE_VARIANCE = math.radians(0.1) ** 2


class Laid:
    """A predictor whose answers are laid down, one after another; what it is asked is noted."""

    delay_us, delay_sd_s, i_gear = DELAY_US, 1e-4, 0.8
    model = SimpleNamespace(brake_rad_s2_pa=2e-3)

    def __init__(self, *hits: int, fall: float = FALL) -> None:
        self.hits, self.fall = list(hits), fall
        self.asked: list[tuple[Any, ...]] = []
        self.slip, self.estimated, self.moved = 0.0, 0.0, 0.0
        self.roots: list[int] = []
        self.courses: list[int | None] = []

    def steady_slip_rad_s(self, time_us: float, release_us: int) -> float:
        self.asked.append(("steady", time_us, release_us))
        return 50.0 - self.fall * (time_us - EARLIEST_US) / 20_000.0

    def slip_rad_s(self, time_us: float) -> float:
        self.asked.append(("slip", time_us))
        return self.slip

    def trajectory(
        self, first_us: float, step_us: float, count: int, release_us: int | None = None
    ) -> Trajectory:
        """All contacts miss but one, and that one is where it was aimed at."""
        self.asked.append(("trajectory", first_us, step_us, count, release_us))
        phase = np.full(count, MISS)
        if self.hits:
            phase[self.hits.pop(0)] = 0.0
        else:
            phase[:] = self.moved * ((release_us or 0) - EARLIEST_US) / 500.0
        return Trajectory(first_us, step_us, phase, np.zeros(count))

    def trajectories(self, releases: range, firsts: list[float], step: float, count: int) -> Vector:
        self.asked.append(("trajectories", releases, firsts, step, count))
        found = np.zeros((len(releases), 2, count))
        found[:, 0] = MISS
        for row, hit in zip(found, self.courses, strict=True):
            if hit is not None:
                row[0, hit] = 0.0
        return found

    def variances(
        self, first_us: float, step_us: float, count: int, release_us: int | None = None
    ) -> Vector:
        self.asked.append(("variances", first_us, step_us, count, release_us))
        return np.zeros(count)

    def told_variances(
        self, first_us: float, step_us: float, count: int, now_us: int, look: LastLook
    ) -> Vector:
        self.asked.append(("told", first_us, step_us, count, now_us, look))
        return np.zeros(count)

    def estimate_variance(self, time_us: float) -> float:
        self.asked.append(("estimate", time_us))
        return self.estimated

    def release_time_us(self, earliest: int, latest: int, slip: float, settle_us: float) -> int:
        self.asked.append(("release", earliest, latest, slip, settle_us))
        return self.roots.pop(0)

    def of(self, kind: str) -> list[tuple[Any, ...]]:
        return [each[1:] for each in self.asked if each[0] == kind]


def aiming(settings: ControllerSettings = SETTINGS) -> Any:
    return TargetPhase(SHEET, settings)


def test_a_firing_is_looked_for_in_600_ms_and_then_a_twentieth_of_a_step_apart() -> None:
    """Around the best coarse contact, a step to either side."""
    laid = Laid(7, 13)
    found = aiming().contact(laid, NOW_US, EARLIEST_US)
    around_us = FIRST_US + 6 * STEP_US
    coarse, fine = laid.of("trajectory")
    assert coarse == (FIRST_US, pytest.approx(STEP_US), pytest.approx(600, abs=1), None)
    assert fine == (pytest.approx(around_us), pytest.approx(STEP_US / 20.0), 41, None)
    assert found == round(around_us + 13 * 50.0)
    assert laid.of("slip") == [(pytest.approx(around_us + 13 * 50.0),)]
    valve_us = round(1e6 * SHEET.sleeve.valve_delay_s)
    look = LastLook(DELAY_US - valve_us + 3_000, TIMING.tick_us)
    assert laid.of("told") == [(*each[:3], NOW_US, look) for each in (coarse, fine)]
    assert aiming().aims is True


def test_around_the_first_contact_nothing_is_looked_at_before_it() -> None:
    laid = Laid(0, 0)
    assert aiming().contact(laid, NOW_US, EARLIEST_US) == FIRST_US
    assert laid.of("trajectory")[1][0] == FIRST_US
    laid = Laid(1, 40)
    assert aiming().contact(laid, NOW_US, EARLIEST_US) == round(FIRST_US + 2 * STEP_US)


@pytest.mark.parametrize(("over", "fires"), [(0.0, True), (1e-9, False)])
def test_of_a_gear_that_is_too_fast_at_its_best_contact_nothing_is_fired(
    over: float, fires: bool
) -> None:
    laid = Laid(7, 13)
    laid.slip = WINDOW.contact_high_rad_s + over
    assert (aiming().contact(laid, NOW_US, EARLIEST_US) is not None) is fires


@pytest.mark.parametrize("release_us", [EARLIEST_US, EARLIEST_US + 20_000])
def test_a_step_is_as_long_as_the_slip_needs_for_seven_hundredths_of_its_window(
    release_us: int,
) -> None:
    """At the rate at which it falls in 20 ms once the brake's pressure has gone."""
    laid = Laid()
    step_us, count = aiming()._steps(laid, release_us)
    assert step_us == pytest.approx(STEP_US)
    assert count == pytest.approx(300, abs=1)
    after_us = release_us + SETTLE_US
    assert laid.of("steady") == [
        (pytest.approx(after_us), release_us),
        (pytest.approx(after_us + 20_000.0), release_us),
    ]
    assert aiming()._steps(Laid(fall=2.0 * FALL), release_us)[0] == pytest.approx(STEP_US / 2.0)


def test_a_step_moves_the_phase_by_four_hundredths_of_a_pitch_and_ends_with_the_time() -> None:
    """Where nothing takes the slip away; two milliseconds at most, a fifth of one at least."""
    for high in (3.5, 60.0, 0.5):
        window = replace(WINDOW, contact_high_rad_s=high, contact_low_rad_s=-1.0)
        made = aiming(replace(SETTINGS, window=window))
        for fall in (0.0, -1.0):
            step_us, count = made._steps(Laid(fall=fall), EARLIEST_US)
            assert step_us == pytest.approx(min(max(0.04e6 * PITCH / high, 200.0), 2_000.0))
            assert count == math.ceil(300_000.0 / step_us)
    assert 200.0 < 0.04e6 * PITCH / 3.5 < 2_000.0


@pytest.mark.parametrize(
    ("moved", "reach_us"),
    [(PITCH / 10.0, 5_000.0), (-PITCH / 10.0, 5_000.0), (PITCH / 40.0, 20_000.0),
     (0.0, 40_000.0), (PITCH / 81.0, 40_000.0), (PITCH * 1.1, 500.0)],
)  # fmt: skip
def test_a_release_half_a_millisecond_later_shows_how_far_one_reaches(
    moved: float, reach_us: float
) -> None:
    laid = Laid()
    laid.moved = moved
    release_us = EARLIEST_US + 7_000
    assert aiming()._reach_us(laid, release_us) == pytest.approx(reach_us)
    contact_us = release_us + round(SETTLE_US) + 20_000
    assert laid.of("trajectory") == [
        (contact_us, 2_000.0, 1, release_us), (contact_us, 2_000.0, 1, release_us + 500),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("reach_us", "expected"),
    [(14_000.0, range(93_000, 109_801, 1_200)), (500.0, range(99_750, 100_351, 43)),
     (5.0, range(99_998, 100_005, 1)), (196_000.0, range(30_000, 237_201, 16_800))],
)  # fmt: skip
def test_releases_reach_half_a_pitch_back_and_seven_tenths_ahead_in_fourteen_steps(
    reach_us: float, expected: range
) -> None:
    made = aiming()
    made._reach_us = lambda *_: reach_us
    assert made._releases(Laid(), EARLIEST_US, 100_000) == expected


class Release:
    """An aiming whose steps are laid down: releases by a thousand microseconds, and their costs."""

    def __init__(self, costs: list[float], step_us: int = 1_000) -> None:
        self.made, self.costs = aiming(), costs
        self.asked: list[range] = []
        self.plans: list[ReleasePlan] = []
        self.made._releases = lambda _p, _e, release_us: range(
            release_us - 2 * step_us, release_us + 2 * step_us + 1, step_us
        )
        self.made._reach_us = lambda *_: 10_000.0
        self.made._best_release = self.best

    def best(self, _p: object, now: int, earliest: int, releases: range) -> Any:
        assert (now, earliest) == (NOW_US, EARLIEST_US)
        self.asked.append(releases)
        self.plans.append(ReleasePlan(releases[0], releases[0] + DELAY_US))
        return self.plans[-1], (self.costs.pop(0) if self.costs else 0.0)


ROOTS = [50_000, 60_000, 70_000, 90_000]


@pytest.mark.parametrize(("costs", "best"), [
    ([3.0, 1.0, 2.0, 1.0], 1), ([1.0, 1.0, 2.0, 3.0], 0), ([4.0, 3.0, 2.0, 1.0], 3),
])  # fmt: skip
def test_of_four_coasts_the_cheapest_is_looked_at_more_closely(
    costs: list[float], best: int
) -> None:
    """90, 60, 30 and 0 ms of coasting leave the slip aimed at; around the best release a fifth of
    a step apart, or 15 % of a gap."""
    laid, case = Laid(), Release(costs)
    laid.roots = list(ROOTS)
    assert case.made.release(laid, NOW_US, EARLIEST_US) is case.plans[-1]
    slip, latest_us = WINDOW.aim_slip_rad_s, EARLIEST_US + 1_000_000
    assert laid.of("release") == [
        (EARLIEST_US, latest_us, slip, pytest.approx(SETTLE_US + coast_us))
        for coast_us in (90_000, 60_000, 30_000, 0)
    ]
    *coarse, close = case.asked
    assert coarse == [range(root - 2_000, root + 2_001, 1_000) for root in ROOTS]
    release_us = ROOTS[best] - 2_000
    gap_us = 0.15 * SHEET.dog.backlash_rad / PITCH * 10_000.0
    step_us = round(min(200.0, gap_us))
    assert close == range(max(EARLIEST_US, release_us - 1_000), release_us + 1_001, step_us)


def test_where_a_pitch_is_soon_passed_a_close_step_is_15_per_cent_of_a_gap() -> None:
    laid, case = Laid(), Release([1.0, 2.0, 3.0, 4.0])
    laid.roots = list(ROOTS)
    case.made._reach_us = lambda *_: 3_000.0
    case.made.release(laid, NOW_US, EARLIEST_US)
    assert case.asked[-1].step == round(0.15 * SHEET.dog.backlash_rad / PITCH * 3_000.0) < 200


def test_the_flanks_take_the_energy_of_the_layshaft_at_the_slip() -> None:
    """J (slip / i)^2 / 2, where J is what the brake's torque over its deceleration tells."""
    terms = aiming()._terms(Laid()).view(TERMS)[0]
    inertia = SHEET.brake_nm_per_pa / 2e-3
    energy_j = 0.5 * inertia * (3.0 / 0.8) ** 2
    paid_s = SETTINGS.prices.energy_s_per_j * energy_j
    assert terms.energy_s3_rad2 * 3.0**2 == pytest.approx(paid_s)
    assert terms.overlap_s * SHEET.sleeve.contact_speed_m_s == pytest.approx(
        SHEET.dog.most_overlap_m
    )
    assert aiming().fire_slip_rad_s == WINDOW.contact_high_rad_s


def test_around_a_release_nothing_is_sooner_than_the_earliest_nor_steps_of_nothing() -> None:
    laid, case = Laid(), Release([1.0, 2.0, 2.0, 2.0])
    laid.roots = [32_500, 40_000, 40_000, 40_000]
    case.made.release(laid, NOW_US, EARLIEST_US)
    assert case.asked[-1][0] == EARLIEST_US
    laid, case = Laid(), Release([1.0, 2.0, 2.0, 2.0], step_us=2)
    laid.roots = list(ROOTS)
    case.made.release(laid, NOW_US, EARLIEST_US)
    assert case.asked[-1] == range(ROOTS[0] - 6, ROOTS[0] - 1, 1)


@pytest.mark.parametrize(("ahead_us", "is_far"), [(50_000, False), (50_001, True)])
def test_a_release_over_50_ms_ahead_is_not_aimed(ahead_us: int, is_far: bool) -> None:
    """If it is so with the longest coast; once one was looked at the others are, too."""
    laid, case = Laid(), Release([1.0, 2.0, 3.0, 4.0])
    far_us = EARLIEST_US + ahead_us
    laid.roots = [far_us, 500_000, 500_000, 500_000]
    plan = case.made.release(laid, NOW_US, EARLIEST_US)
    assert (not case.asked) is is_far
    if is_far:
        assert plan == ReleasePlan(far_us, far_us + round(SETTLE_US + 90_000.0))


RELEASES = range(60_000, 90_001, 10_000)


def test_a_sleeve_meets_its_gear_ten_milliseconds_after_a_release_or_as_it_can() -> None:
    laid = Laid()
    laid.courses = [None, None, 4, None]
    plan, _ = aiming()._best_release(laid, NOW_US, EARLIEST_US, RELEASES)
    ((releases, firsts, step_us, count),) = laid.of("trajectories")
    assert releases == RELEASES
    assert firsts == [75_000.0, 80_000.0, 90_000.0, 100_000.0]
    assert (step_us, count) == (pytest.approx(STEP_US), pytest.approx(300, abs=1))
    assert plan == ReleasePlan(80_000, round(90_000.0 + 4 * STEP_US))
    assert laid.of("steady")[0] == (pytest.approx(60_000 + SETTLE_US), 60_000)
    before = round((75_000.0 - NOW_US - DELAY_US + CALLED_US) / step_us)
    assert laid.of("variances") == [(NOW_US + DELAY_US, step_us, before + count, 60_000)]
    assert laid.of("estimate") == [(75_000.0,)]


def test_of_releases_that_all_hit_the_soonest_contact_costs_its_time() -> None:
    """A hit that is known for sure costs as long as it takes; where the phase is spread, a miss
    costs more than that."""
    laid = Laid()
    laid.courses = [60, 4, 4, 4]
    made = aiming()
    plan, cost = made._best_release(laid, NOW_US, EARLIEST_US, RELEASES)
    assert plan == ReleasePlan(70_000, round(80_000.0 + 4 * STEP_US))
    aim = SETTINGS.prices.aim_s * REFERENCE_VARIANCE / (SHEET.dog.backlash_rad / 2.0) ** 2
    assert cost == pytest.approx((80_000.0 + 4 * STEP_US - NOW_US) * 1e-6 + aim, rel=1e-3)


CALLED_US = (
    (1_000 * TIMING.lead_ms + round(1e6 * SHEET.sleeve.valve_delay_s) - 2_000)
    // TIMING.tick_us * TIMING.tick_us
)  # fmt: skip


@pytest.mark.parametrize("first_us", [40_000.0, 55_000.0, 105_000.0])
def test_what_is_left_of_a_spread_is_what_the_last_call_back_will_know(first_us: float) -> None:
    """As long after the step that now could fire as the first contact is, and as the sleeve can be
    called back; the learned reference's own 0.1 degrees are in both."""
    laid = Laid()
    laid.estimated = 4e-6
    course = Trajectory(first_us, STEP_US, np.zeros(30), np.zeros(30))
    spread, settled = aiming()._spread_at_release(laid, course, NOW_US, 70_000)
    firing_us = float(NOW_US + DELAY_US)
    before = round((max(0.0, first_us - firing_us) + CALLED_US) / STEP_US)
    assert laid.of("variances") == [(firing_us, STEP_US, before + 30, 70_000)]
    assert laid.of("estimate") == [(first_us,)]
    assert spread == pytest.approx(math.sqrt(4e-6 + REFERENCE_VARIANCE))
    assert settled == pytest.approx(np.full(30, REFERENCE_VARIANCE))


def test_the_first_of_what_was_settled_is_of_the_first_contact() -> None:
    laid: Any = Laid()
    laid.variances = lambda _first, _step, count, _release: np.arange(float(count))
    course = Trajectory(75_000.0, STEP_US, np.zeros(5), np.zeros(5))
    _, settled = aiming()._spread_at_release(laid, course, NOW_US, 70_000)
    first = (20_000.0 + CALLED_US) / STEP_US
    assert settled == pytest.approx(first + np.arange(5) + REFERENCE_VARIANCE)


@pytest.mark.parametrize(
    ("contact_us", "on_way", "again", "goes_back"),
    [(int(FIRST_US), 0, 0, False), (int(FIRST_US) + 1, 0, 0, True),
     (int(FIRST_US) - 1, 0, 0, False), (int(FIRST_US) + 3_001, 0, 3, True),
     (int(FIRST_US) + 2_999, 0, 3, False)],
)  # fmt: skip
def test_a_sleeve_goes_back_for_a_hit_that_is_sooner_and_only_then(
    contact_us: int, on_way: int, again: int, goes_back: bool
) -> None:
    """Nothing else tells the two apart; of two that cost the same the one on its way is better."""
    laid = Laid(on_way, again)
    assert aiming().is_to_go_back(laid, NOW_US, contact_us, EARLIEST_US) is goes_back
    own, later = laid.of("trajectory")
    ((known_us, _, *one),) = laid.of("variances")
    assert (own[0], *own[2:]) == (known_us, *one) == (contact_us, 1, None)
    assert later == (FIRST_US, pytest.approx(STEP_US), pytest.approx(600, abs=1), None)


def test_a_later_contact_is_taken_to_be_known_as_well_as_the_one_on_its_way() -> None:
    """With 3 degrees of doubt neither is a sure hit: a later one is no better, whatever is said."""
    laid: Any = Laid(0, 0)
    laid.variances = lambda _first, _step, count: np.full(count, math.radians(3.0) ** 2)
    contact_us = int(FIRST_US) - 1
    assert not aiming().is_to_go_back(laid, NOW_US, contact_us, EARLIEST_US)
