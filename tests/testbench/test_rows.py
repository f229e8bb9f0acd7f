"""Rows of shifts from what controller and truth say on the bus."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console

from meshpoint.dbc.messages import (
    Engagement,
    EngagementEvent,
    FaultCode,
    MainGear,
    PhaseReference,
    ReferenceEngagement,
    ReferenceSource,
    ShiftOutcome,
    ShiftResult,
    Strategy,
)
from meshpoint.gearbox import load_sheet
from meshpoint.results.output import rows_table
from meshpoint.results.road_speed import span_us
from meshpoint.results.rows import RowCollector, ShiftRow, summarise
from meshpoint.units import DEG, RPM

SHEET = load_sheet("thesis")
FIRE_US = (1 << 32) - 20_000
"""The contact comes after the clock's wrap."""


def contact(
    phase_deg: float,
    event: EngagementEvent = EngagementEvent.GAP_CONTACT,
    gear: MainGear = MainGear.SECOND,
    at_us: int = 25_500,
) -> ReferenceEngagement:
    return ReferenceEngagement(at_us, event, gear, phase_deg * DEG, 18.0 * RPM)


def outcome(**changed: object) -> ShiftOutcome:
    """8 -> 10, aimed, engaged after 600 ms."""
    return ShiftOutcome(
        from_gear=8,
        to_gear=10,
        strategy=Strategy.TARGET_PHASE,
        reference=PhaseReference.KNOWN,
        result=ShiftResult.ENGAGED,
        attempts=1,
        request_time_us=(1 << 32) - 500_000,
        fire_time_us=FIRE_US,
        end_time_us=100_000,
        predicted_contact_time_us=26_000,
        predicted_phase_rad=0.01 * DEG,
        predicted_phase_sd_rad=0.3 * DEG,
        reference_source=ReferenceSource.MEASURED,
    )._replace(**changed)


def rows_of(
    *messages: ReferenceEngagement | ShiftOutcome, target_deg: float = 0.0
) -> list[ShiftRow]:
    collector = RowCollector(SHEET, target_deg * DEG)
    for message in messages:
        collector.take(message)
    return collector.rows


def shown(**changed: object) -> str:
    out = Console(width=80, record=True)
    out.print(rows_table("demo", rows_of(contact(-0.5), outcome(**changed))))
    return out.export_text()


def test_the_table_of_rows_fits_a_terminal_of_80_columns() -> None:
    usual = shown(from_gear=12, to_gear=10)
    for said in ("12", "target_phase", "600", "+18.0", "-0.50", "-6.7", "gap", "engaged"):
        assert said in usual
    longest = shown(
        strategy=Strategy.SPEED_WINDOW_ANTICIPATING, result=ShiftResult.ENDED_BETWEEN_GEARS
    )
    assert "…" not in usual + longest


def test_a_row_is_the_outcome_beside_the_truth() -> None:
    """Across the wrap of the 32-bit clock: 600 ms long, 45.5 ms from activation to contact."""
    (row,) = rows_of(contact(-0.5), outcome())
    assert (row.from_, row.to, row.strategy, row.result) == (8, 10, "target_phase", "engaged")
    assert row.duration_ms == pytest.approx(600.0)
    assert row.delay_ms == pytest.approx(45.5)
    assert row.phase_error_deg == pytest.approx(-0.5)
    assert row.phase_error_pct_of_pitch == pytest.approx(-100 * 0.5 / 7.5)
    assert row.slip_rpm == pytest.approx(18.0)
    assert (row.contact, row.reference) == ("gap", "known")


def test_the_first_contact_of_the_gear_it_went_for_counts() -> None:
    """Not the contacts of the way back into the old gear, nor a second one after a retry."""
    tooth, first = EngagementEvent.TOOTH_CONTACT, MainGear.FIRST
    (row,) = rows_of(
        contact(1.0, gear=MainGear.SECOND),
        contact(0.0, EngagementEvent.READY, first),
        contact(0.2, gear=first),
        contact(-3.0, tooth),
        contact(0.1),
        outcome(),
    )
    assert (row.contact, row.phase_error_deg) == ("tooth", pytest.approx(-3.0))


def test_a_shift_without_contact_has_no_phase_error() -> None:
    (row,) = rows_of(outcome(result=ShiftResult.ENDED_IN_NEUTRAL, fault=FaultCode.ENGAGE_FAILED))
    assert row.contact is None
    assert row.phase_error_deg is row.phase_error_pct_of_pitch is row.slip_rpm is None
    assert row.result == "ended_in_neutral"


def test_a_row_says_how_often_its_sleeve_was_aborted_and_where_it_then_stood() -> None:
    (row,) = rows_of(contact(0.3), outcome(aborts=2, halt_position_m=3.4e-3))
    assert (row.aborts, row.halt_mm) == (2, pytest.approx(3.4))
    (row,) = rows_of(contact(0.3), outcome())
    assert (row.aborts, row.halt_mm) == (0, None)


def test_a_contact_before_the_firing_that_is_told_has_no_delay() -> None:
    """A sleeve that was aborted and not stopped in time came to the teeth; the firing that the
    outcome tells is the one after it."""
    before = outcome(aborts=1, fire_time_us=outcome().fire_time_us + 200_000)
    (row,) = rows_of(contact(-0.5), before)
    assert row.contact == "gap"
    assert row.delay_ms is None


def test_an_outcome_without_a_firing_has_no_delay_and_one_without_a_plan_no_prediction() -> None:
    """A delay of 4,377 ms was said: the sensors' clock at contact. And a phase of 0.0 degrees."""
    (row,) = rows_of(contact(-0.5), outcome(fire_time_us=0))
    assert row.delay_ms is None
    (row,) = rows_of(contact(-0.5), outcome(predicted_contact_time_us=0, predicted_phase_rad=0.0))
    assert (row.predicted_phase_deg, row.predicted_phase_sd_deg) == (None, None)
    assert row.delay_ms == pytest.approx(45.5)


def test_a_splitter_alone_has_a_slip_and_no_error_of_an_aim() -> None:
    (row,) = rows_of(contact(-0.5, gear=MainGear.NEUTRAL), outcome(engagement=Engagement.SPLITTER))
    assert (row.contact, row.phase_error_deg) == ("gap", None)
    assert row.slip_rpm == pytest.approx(18.0)


@pytest.mark.parametrize("changed", [{"attempts": 2}, {"fire_time_us": 200_000}])
def test_no_contact_is_put_beside_the_prediction_of_another_firing(changed: dict[str, int]) -> None:
    """The first firing's contact is the truth's, the last one's prediction the outcome's."""
    (row,) = rows_of(contact(-0.9, EngagementEvent.TOOTH_CONTACT), outcome(**changed))
    assert (row.predicted_phase_deg, row.predicted_phase_sd_deg, row.delay_ms) == (None, None, None)
    (row,) = rows_of(contact(-0.9), outcome())
    assert row.predicted_phase_deg == pytest.approx(0.01)


def test_the_table_of_rows_and_the_summary_count_aborts() -> None:
    line = shown(aborts=7).splitlines()[-1].split()
    assert line[-2:] == ["1/7", "engaged"]
    assert shown().splitlines()[-1].split()[-2:] == ["1", "engaged"]
    rows = rows_of(outcome(aborts=3), outcome(), outcome(aborts=1))
    summary = summarise("target_phase", rows)
    assert (summary.aborted, summary.aborts) == (2, 4)


def test_a_contact_belongs_to_one_shift() -> None:
    first, second = rows_of(contact(0.3), outcome(), outcome())
    assert first.contact == "gap"
    assert second.contact is None


def test_a_refused_request_is_no_shift() -> None:
    assert rows_of(contact(0.3), outcome(result=ShiftResult.REFUSED)) == []


def test_of_a_refused_request_the_reason_is_kept() -> None:
    collector = RowCollector(SHEET)
    refused = outcome(result=ShiftResult.REFUSED, fault=FaultCode.INPUT_OVERSPEED)
    for message in (refused, contact(0.3), outcome()):
        collector.take(message)
    assert collector.refusals == ["input_overspeed"]
    assert [row.result for row in collector.rows] == ["engaged"]


@settings(deadline=None)
@given(phase_deg=st.floats(-3.75, 3.75), target_deg=st.floats(-0.7, 0.7))
def test_the_error_is_from_the_target_and_within_half_a_pitch(
    phase_deg: float, target_deg: float
) -> None:
    (row,) = rows_of(contact(phase_deg), outcome(), target_deg=target_deg)
    assert row.phase_error_deg is not None
    assert -3.75 - 1e-9 <= row.phase_error_deg <= 3.75 + 1e-9
    assert abs(math.remainder(row.phase_error_deg - (phase_deg - target_deg), 7.5)) < 1e-9


@settings(deadline=None)
@given(start=st.integers(0, (1 << 32) - 1), span=st.integers(-(1 << 31), (1 << 31) - 1))
def test_spans_of_the_32_bit_clock_have_a_sign(start: int, span: int) -> None:
    assert span_us((start + span) & 0xFFFF_FFFF, start) == span


def test_the_summary_counts_hits_where_it_could_aim() -> None:
    """Of four shifts one was blind, two of the three aimed ones hit, one failed."""
    tooth = EngagementEvent.TOOTH_CONTACT
    rows = rows_of(
        contact(-3.0, tooth),
        outcome(reference=PhaseReference.UNKNOWN, strategy=Strategy.SPEED_WINDOW),
        contact(0.3),
        outcome(),
        contact(-0.4),
        outcome(end_time_us=300_000, reference_source=ReferenceSource.NARROWED),
        contact(1.0, tooth),
        outcome(result=ShiftResult.ENDED_IN_NEUTRAL, end_time_us=900_000),
    )
    summary = summarise("target_phase", rows)
    assert (summary.shifts, summary.known, summary.engaged) == (4, 3, 3)
    assert summary.reference_sources == {"measured": 2, "restored": 0, "narrowed": 1}
    assert (summary.gap, summary.gap_known) == (2, 2)
    assert summary.gap_rate == pytest.approx(2 / 3)
    assert summary.mean_duration_ms == pytest.approx((600 + 600 + 800) / 3)
    assert summary.phase_error_rms_deg == pytest.approx(math.sqrt((0.09 + 0.16 + 1.0) / 3))
    assert summarise("speed_window", rows).gap_rate == pytest.approx(2 / 4)


def test_no_shift_is_no_figure() -> None:
    summary = summarise("target_phase", [])
    assert summary.gap_rate is summary.mean_duration_ms is summary.phase_error_rms_deg is None


def test_what_all_attempts_have_cost_is_in_the_row() -> None:
    given_up = contact(3.0, EngagementEvent.GIVEN_UP, at_us=60_000)._replace(
        face_time_us=34_000, blocked=True, impact_energy_j=41.31
    )  # of the gear before: nothing has locked here
    locked = contact(0.75, EngagementEvent.LOCKED, at_us=160_000)._replace(
        impact_energy_j=1.25, face_time_us=6_000, ratchets=2
    )
    other = contact(0.0, EngagementEvent.LOCKED, MainGear.FIRST)._replace(impact_energy_j=9.0)
    (row,) = rows_of(
        other, contact(3.0, EngagementEvent.TOOTH_CONTACT), given_up, locked, outcome(attempts=2)
    )
    assert (row.impact_j, row.face_ms, row.ratchets, row.blocked) == (1.25, 40.0, 2, 1)


def test_time_on_the_face_comes_from_the_events_where_there_is_no_tally() -> None:
    (row,) = rows_of(
        contact(3.0, EngagementEvent.TOOTH_CONTACT, at_us=25_500),
        contact(-0.75, EngagementEvent.TOOTH_PASSED, at_us=37_500),
        contact(0.75, EngagementEvent.LOCKED, at_us=45_000),
        outcome(),
    )
    assert row.face_ms == 12.0


def struck(
    impact_j: float, at_us: int, event: EngagementEvent = EngagementEvent.LOCKED
) -> ReferenceEngagement:
    """The flanks of gear 10 meet, or part: the shift of `outcome` has ended at 100,000 us."""
    return contact(0.75, event, at_us=at_us)._replace(impact_energy_j=impact_j, ratchets=1)


def test_a_gear_that_locks_after_its_shift_has_ended_counts_with_all_it_cost() -> None:
    """The position sensor has measured the sleeve in; the tooth meets its flank 20 ms later."""
    rows = rows_of(contact(0.1), outcome(), struck(1.25, 120_000), struck(9.0, 130_000))
    (row,) = rows
    assert (row.impact_j, row.ratchets, row.impact_complete) == (1.25, 1, True)


def test_the_way_back_of_the_bench_into_the_same_gear_is_no_impact_of_the_shift() -> None:
    """10 -> 12 begins in the gear that 8 -> 10 has engaged: the bench pulls it out and puts it in
    again, and gear and sleeve had not locked before that."""
    released = struck(0.0, 300_000, EngagementEvent.RELEASED)
    back = contact(0.0, at_us=320_000), struck(16.7, 330_000)
    (row,) = rows_of(contact(0.1), outcome(), released, *back)
    assert (row.impact_j, row.impact_complete) == (0.0, False)
    (row,) = rows_of(contact(0.1), outcome(), contact(0.0, EngagementEvent.READY), *back)
    assert (row.impact_j, row.impact_complete) == (0.0, False)


@pytest.mark.parametrize(("after_us", "impact_j"), [(400_000, 1.25), (400_001, 0.0)])
def test_a_row_waits_400_ms_for_its_gear_to_lock_and_says_where_that_was_not_enough(
    after_us: int, impact_j: float
) -> None:
    (row,) = rows_of(contact(0.1), outcome(), struck(1.25, 100_000 + after_us))
    assert (row.impact_j, row.impact_complete) == (impact_j, impact_j > 0.0)


def test_what_the_next_shift_costs_is_not_the_last_ones() -> None:
    first, second = rows_of(
        contact(0.1), outcome(), contact(0.1, gear=MainGear.THIRD),
        struck(2.0, 200_000)._replace(gear=MainGear.THIRD), outcome(from_gear=10, to_gear=12),
    )  # fmt: skip
    assert (first.impact_j, first.impact_complete) == (0.0, False)
    assert (second.impact_j, second.impact_complete) == (2.0, True)


def test_a_sleeve_that_is_back_or_never_met_its_gear_has_nothing_to_wait_for() -> None:
    back = contact(3.0, EngagementEvent.GIVEN_UP, at_us=60_000)
    failed = outcome(result=ShiftResult.ENDED_IN_NEUTRAL)
    for row in (*rows_of(contact(3.0), back, failed), *rows_of(outcome())):
        assert row.impact_complete


def split_event(
    event: EngagementEvent, at_us: int, slip_rpm: float = -50.0, energy_j: float = 0.0
) -> ReferenceEngagement:
    """Of a splitter with dog teeth: the gear is neutral, the drive gear says its step."""
    return ReferenceEngagement(
        at_us, event, MainGear.NEUTRAL, 1.0 * DEG, slip_rpm * RPM, 2, energy_j
    )


def test_of_a_splitter_with_dog_teeth_its_own_contact_counts_where_it_alone_changes() -> None:
    """And its strike where the main gear changes, too; its sleeve is the one that turns faster."""
    met = split_event(EngagementEvent.TOOTH_CONTACT, 25_500)
    locked = split_event(EngagementEvent.LOCKED, 60_000, energy_j=1.5)
    brake = ReferenceEngagement(61_000, EngagementEvent.BRAKE_EMPTIES, MainGear.NEUTRAL, 0.0, 0.0)
    alone_ = outcome(engagement=Engagement.SPLITTER)
    (alone,) = rows_of(met, locked, brake, alone_)
    assert alone.engagement == "splitter"
    assert (alone.contact, alone.impact_j, alone.outside_window) == ("tooth", 1.5, 0)
    assert alone.slip_rpm == pytest.approx(-50.0)
    (both,) = rows_of(met, locked, contact(0.1), outcome(from_gear=11))
    assert both.engagement == "main_gear"
    assert (both.contact, both.impact_j) == ("gap", 1.5)
    fast = split_event(EngagementEvent.TOOTH_CONTACT, 25_500, slip_rpm=80.0)
    assert rows_of(fast, locked, alone_)[0].outside_window == 1
