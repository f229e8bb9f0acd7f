"""What contacts teach of a sleeve's delay and a phase's drift, by the textbook's formulas."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from test_strategy import GEAR, MAIN, SHEET, predictor_at

from meshpoint.controller.calibration.learned import DriftRecord, DriftRecords, SleeveRecord
from meshpoint.controller.motion.swing import ShaftState
from meshpoint.controller.planning.phase_drift import PhaseDrifts
from meshpoint.controller.planning.sleeve_delay import SleeveDelays
from meshpoint.gearbox import MainGear, Split

SECOND, THIRD = MainGear.SECOND, MainGear.THIRD
SLEEVE = SHEET.sleeve
MS = 1e-3
WEIGHT, SCATTER_WEIGHT = 0.5, 4.0
"""Those of the data sheet beside contacts: of its mean half of one, of its scatter four."""


def posterior(delays_s: list[float]) -> tuple[float, float, float, float]:
    """Mean, weight, squares and their weight of a normal law whose mean and variance are unknown,
    after these samples: by their mean and their own sum of squares, not one after another."""
    own = np.array(delays_s)
    count, mean = own.size, float(own.mean())
    after = (WEIGHT * SLEEVE.delay_s + count * mean) / (WEIGHT + count)
    squares = SCATTER_WEIGHT * (0.6 * SLEEVE.delay_sd_s) ** 2
    squares += float(np.sum((own - mean) ** 2))
    squares += WEIGHT * count / (WEIGHT + count) * (mean - SLEEVE.delay_s) ** 2
    return after, WEIGHT + count, squares, SCATTER_WEIGHT + count


def taught(*errors_ms: float) -> SleeveDelays:
    delays = SleeveDelays(SHEET)
    for error_ms in errors_ms:
        delays.learn(SECOND, 1e6 * (SLEEVE.delay_s + MS * error_ms))
    return delays


ERRORS_MS = (2.0, -1.0, 3.5, 0.5, -2.5, 1.0)


@pytest.mark.parametrize("count", [1, 2, 6])
def test_contacts_and_the_data_sheet_make_a_law_of_unknown_mean_and_scatter(count: int) -> None:
    delays = taught(*ERRORS_MS[:count])
    mean, weight, squares, freedom = posterior([SLEEVE.delay_s + MS * e for e in ERRORS_MS[:count]])
    assert delays.delay_us(SECOND) == pytest.approx(1e6 * mean, abs=0.51)
    scatter = squares / freedom
    assert delays.delay_sd_s(SECOND) == pytest.approx(math.sqrt(scatter + scatter / weight))
    assert delays.scatter_samples(SECOND) == freedom
    assert delays.samples(SECOND) == count
    record = delays.records().second
    assert record is not None
    assert (record.delay_s, record.samples) == (pytest.approx(mean), weight)
    assert (record.scatter_s, record.scatter_samples) == (
        pytest.approx(math.sqrt(scatter)),
        freedom,
    )
    assert delays.records().third is None


def test_before_any_contact_the_next_is_as_far_off_as_the_data_sheet_says_twice_over() -> None:
    """Its scatter in one gear is 60 % of what the sheet says, and the mean is known by half a
    sample: sqrt(1 + 2) times as much."""
    delays = taught()
    assert delays.delay_sd_s(THIRD) == pytest.approx(math.sqrt(3.0) * 0.6 * SLEEVE.delay_sd_s)
    assert delays.scatter_samples(THIRD) == 4.0


def test_what_weighs_more_than_sixty_contacts_fades_by_as_much_as_comes_in() -> None:
    """The sixtieth brings the weight to 60.5: all is multiplied by 60 / 60.5. The next one by
    60 / 61."""
    rng = np.random.default_rng(4)
    errors = [float(each) for each in rng.normal(0.0, 1.5, 61)]
    delays = taught(*errors[:59])
    mean, weight, squares, freedom = posterior([SLEEVE.delay_s + MS * each for each in errors[:59]])
    assert delays.samples(SECOND) == 59
    assert delays.scatter_samples(SECOND) == freedom == 63.0
    for error_ms, whole in zip(errors[59:], (60.5, 61.0), strict=True):
        off = SLEEVE.delay_s + MS * error_ms - mean
        delays.learn(SECOND, 1e6 * (SLEEVE.delay_s + MS * error_ms))
        mean = (weight * mean + mean + off) / (weight + 1.0)
        squares = (squares + weight / (weight + 1.0) * off**2) * 60.0 / whole
        freedom = (freedom + 1.0) * 60.0 / whole
        weight = 60.0
        assert delays.delay_us(SECOND) == pytest.approx(1e6 * mean, abs=0.51)
        assert delays.scatter_samples(SECOND) == pytest.approx(freedom)
        expected = squares / freedom * (1.0 + 1.0 / 60.0)
        assert delays.delay_sd_s(SECOND) == pytest.approx(math.sqrt(expected))


def test_a_restored_law_that_weighs_exactly_sixty_does_not_fade_before_the_next() -> None:
    delays = SleeveDelays(SHEET)
    kept = SleeveRecord(SLEEVE.delay_s, 59.0, MS, 63.0)
    delays.restore(type(delays.records())(second=kept))
    delays.learn(SECOND, 1e6 * SLEEVE.delay_s)
    assert delays.scatter_samples(SECOND) == 64.0
    assert delays.samples(SECOND) == round(59.5)


@pytest.mark.parametrize(
    ("error_ms", "count"), [(19.5, 1), (-19.5, 1), (20.5, 0), (-20.5, 0), (24.0, 0)]
)
def test_a_contact_over_20_ms_off_is_of_something_else(error_ms: float, count: int) -> None:
    assert taught(error_ms).samples(SECOND) == count


@pytest.mark.parametrize(
    ("supply_share", "slower"), [(1.0, 1.0), (0.81, 1.0 / 0.9), (0.25, 2.0), (0.0, 10.0**0.5)]
)
def test_the_way_takes_as_long_as_one_over_the_root_of_the_air_and_ever_some_is_left(
    supply_share: float, slower: float
) -> None:
    """A tenth of the sheet's pressure at least: nothing ever takes for ever."""
    delays = taught()
    delays.supply_pa = supply_share * SHEET.air.supply_gauge_pa
    way_s = SLEEVE.delay_s - SLEEVE.valve_delay_s
    expected_us = 1e6 * (SLEEVE.valve_delay_s + way_s * slower)
    assert delays.delay_us(SECOND) == pytest.approx(expected_us, abs=0.51)
    delays.learn(SECOND, expected_us + 3_000.0 * slower)
    delays.supply_pa = SHEET.air.supply_gauge_pa
    assert delays.delay_us(SECOND) == pytest.approx(1e6 * SLEEVE.delay_s + 2_000.0, abs=0.51)


def test_what_is_taken_up_again_is_what_was_kept() -> None:
    delays, again = taught(*ERRORS_MS), SleeveDelays(SHEET)
    again.restore(delays.records())
    again.learn(SECOND, 1e6 * SLEEVE.delay_s + 4_000.0)
    delays.learn(SECOND, 1e6 * SLEEVE.delay_s + 4_000.0)
    assert again.delay_sd_s(SECOND) == pytest.approx(delays.delay_sd_s(SECOND), rel=1e-12)
    assert again.delay_us(SECOND) == delays.delay_us(SECOND)
    assert again.records().third is None


DRAG_NM = 0.5
FIRST_SD = SHEET.main_mesh(GEAR).ratio * DRAG_NM / SHEET.inertia_kgm2(Split.HIGH) * SLEEVE.delay_s
"""What half a newton metre changes of the gear's slip while a sleeve is on its way."""
WALK = 0.01


def drifted(*contacts: tuple[float, float]) -> PhaseDrifts:
    """Contacts that measured a drift, each with the variance that the filters claim for it."""
    drifts = PhaseDrifts(SHEET, DRAG_NM)
    for drift, variance in contacts:
        drifts._add(drifts._learned[GEAR], drift, variance)
    return drifts


def kept(drifts: PhaseDrifts) -> DriftRecord:
    record = drifts.records().of(GEAR)
    assert record is not None
    return record


def test_the_first_contact_is_weighed_against_drag_that_is_not_known() -> None:
    """The variance before: that of the drag and a walk's; two contacts are Bayes' law for one
    unknown that walks, the scatter as claimed at first: four contacts' worth of it, and the first
    adds its surprise as a fifth."""
    prior, variance, drift = FIRST_SD**2 + WALK**2, 2e-3, 0.05
    record = kept(drifted((drift, variance)))
    precision = 1.0 / prior + 1.0 / variance
    assert record.slip_rad_s == pytest.approx(drift / variance / precision)
    assert record.slip_sd_rad_s == pytest.approx(precision**-0.5)
    squares = (4.0 + drift**2 / (prior + variance)) / 5.0
    assert record.spread_share == pytest.approx(math.sqrt(squares))
    assert record.samples == 5.0
    twice = kept(drifted((drift, variance), (-0.02, variance)))
    before, noise = record.slip_sd_rad_s**2 + WALK**2, squares * variance
    precision = 1.0 / before + 1.0 / noise
    mean = (record.slip_rad_s / before - 0.02 / noise) / precision
    assert twice.slip_rad_s == pytest.approx(mean)
    assert twice.slip_sd_rad_s == pytest.approx(precision**-0.5)
    off = -0.02 - record.slip_rad_s
    again = (5.0 * squares + squares * off**2 / (before + noise)) / 6.0
    assert twice.spread_share == pytest.approx(math.sqrt(again))
    assert twice.samples == 6.0


@pytest.mark.parametrize(
    ("drift", "is_learned"), [(0.59, True), (-0.59, True), (0.61, False), (-0.61, False)]
)
def test_a_drift_of_more_than_six_rpm_is_an_error_of_something_else(
    drift: float, is_learned: bool
) -> None:
    records = drifted((drift, 1e-3)).records()
    assert (records != DriftRecords()) is is_learned


@pytest.mark.parametrize("contact", [(math.nan, 1e-3), (0.1, math.nan), (0.1, math.inf)])
def test_what_is_no_number_teaches_nothing(contact: tuple[float, float]) -> None:
    assert drifted(contact).records() == DriftRecords()


@pytest.mark.parametrize(("passed_us", "is_learned"), [(19_000, False), (21_000, True)])
def test_a_drift_takes_20_ms_to_show(passed_us: int, is_learned: bool) -> None:
    """From the time of the main shaft's state on, of which the firing was decided."""
    drifts = PhaseDrifts(SHEET, DRAG_NM)
    fired = replace(predictor_at(18.0), main=MAIN._replace(time_us=7_000.0))
    contact_us = 7_000 + passed_us
    drifts.learn(fired, fired, contact_us)
    assert (drifts.records() != DriftRecords()) is is_learned


def test_where_the_main_shaft_may_have_met_a_flank_no_drift_is_learned() -> None:
    class Cloudy(ShaftState):
        is_by_cloud = True

    drifts, fired = PhaseDrifts(SHEET, DRAG_NM), predictor_at(18.0)
    drifts.learn(replace(fired, main=Cloudy(*MAIN)), fired, 60_000.0)
    assert drifts.records() == DriftRecords()
    drifts.learn(fired, fired, 60_000.0)
    assert drifts.records() != DriftRecords()


def test_a_drift_kept_too_certain_still_walks_and_a_share_kept_is_taken_up_with_its_weight() -> (
    None
):
    drifts = PhaseDrifts(SHEET, DRAG_NM)
    drifts.restore(DriftRecords(second=DriftRecord(0.04, 0.0, 0.5, 12.0)))
    assert GEAR is MainGear.SECOND
    assert drifts.rad_s(GEAR) == 0.04
    assert drifts.spread_share(GEAR) == pytest.approx(0.5)
    variance = 4e-4
    drifts._add(drifts._learned[GEAR], 0.07, variance)
    noise = 0.25 * variance
    assert drifts.rad_s(GEAR) == pytest.approx(0.04 + 0.03 * WALK**2 / (WALK**2 + noise))
    squares = 12.0 * 0.25 + 0.25 * 0.03**2 / (WALK**2 + noise)
    assert drifts.spread_share(GEAR) == pytest.approx(math.sqrt(squares / 13.0))
    assert drifts.rad_s(MainGear.FIRST) == 0.0
    assert drifts.spread_share(MainGear.FIRST) == 1.0


def test_steady_phases_never_count_as_steadier_than_three_tenths() -> None:
    drifts = PhaseDrifts(SHEET, DRAG_NM)
    drifts.restore(DriftRecords(second=DriftRecord(0.0, 0.01, 0.29, 30.0)))
    assert drifts.spread_share(GEAR) == 0.3
    assert kept(drifts).spread_share == pytest.approx(0.29)
