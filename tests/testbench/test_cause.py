"""Why a shift missed its gap: the parts of the error are those that were put in, and add up."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from meshpoint.bench.setup import Setup
from meshpoint.bench.simulate import simulate
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.messages import FaultCode, PhaseReference, ShiftOutcome, ShiftResult, Strategy
from meshpoint.gearbox import MainGear, load_sheet
from meshpoint.report.beliefs import STEP_US, Belief, Beliefs
from meshpoint.report.cause import cause
from meshpoint.report.collect import Firing, ReportCollector, ReportShift
from meshpoint.report.page import page
from meshpoint.report.run import Report, ReportRun
from meshpoint.results.rows import ShiftRow
from meshpoint.rig_sim.settings import Preset
from meshpoint.units import DEG

SHEET = load_sheet("truck12")
RATIO = SHEET.main_mesh(MainGear.SECOND).ratio
PITCH_DEG, GAP_DEG = 7.5, 1.5
CONTACT_MS, BEFORE_MS, SLIP_RPM = 400.0, 60.0, 10.0
MAIN_RPM = 900.0
TIMES_MS = np.arange(300.0, 421.0)


def row(**changed: object) -> ShiftRow:
    """8 -> 10 by phase control, met a tooth."""
    values: dict[str, object] = {
        "from_": 8, "to": 10, "strategy": "target_phase", "reference": "known",
        "result": "engaged", "duration_ms": 450.0, "pitch_deg": PITCH_DEG, "contact": "tooth",
        "attempts": 1, "request_us": 0, "contact_us": 400_000, "end_us": 450_000,
        "predicted_phase_deg": 0.0, "predicted_phase_sd_deg": 0.5, "slip_rpm": SLIP_RPM,
    }  # fmt: skip
    return ShiftRow(**values | changed)  # type: ignore[arg-type]


def belief(phase_deg: float, layshaft_rpm: float = 0.0, main_rpm: float = 0.0) -> Belief:
    """Both shafts at constant speed from 340 ms on; rpm: beside those of `shift`, at the sleeve."""
    at_ms = np.arange(0.0, 140.0, STEP_US / 1000)
    gear, main = MAIN_RPM + SLIP_RPM + layshaft_rpm, MAIN_RPM + main_rpm
    ways = (0.006 * rpm * at_ms * DEG for rpm in (gear, main))
    return Belief(BEFORE_MS * 1000, phase_deg * DEG, *ways)


def shift(
    off_deg: float,
    believed: Belief | None,
    predicted_ms: float = CONTACT_MS,
    struck_rpm: float = 0.0,
    **changed: object,
) -> ReportShift:
    """Met `off_deg` from the middle at 400 ms; the main shaft gets `struck_rpm` 20 ms before."""
    main = np.where(TIMES_MS > CONTACT_MS - 20.0, MAIN_RPM + struck_rpm, MAIN_RPM)
    gear = np.full(TIMES_MS.size, MAIN_RPM + SLIP_RPM)
    slip = gear - main
    way = np.concatenate(([0.0], np.cumsum(0.5 * (slip[1:] + slip[:-1])))) * 0.006
    phase = way - np.interp(CONTACT_MS, TIMES_MS, way) + off_deg
    wrapped = [math.remainder(value, PITCH_DEG) for value in phase]
    every = slice(None, None, 10)
    series = {
        "layshaft_rpm": (TIMES_MS.tolist(), (gear / RATIO).tolist()),
        "main_rpm": (TIMES_MS.tolist(), main.tolist()),
        "phase_second_deg": (TIMES_MS.tolist()[every], wrapped[every]),
    }
    outcome = ShiftOutcome(
        from_gear=8, to_gear=10, result=ShiftResult.ENGAGED, strategy=Strategy.TARGET_PHASE,
        reference=PhaseReference.KNOWN,
    )  # fmt: skip
    fired = Firing(340.0, 350.0, predicted_ms, 0.0, 0.5, SLIP_RPM, believed)
    made = row(phase_error_deg=off_deg) if not changed else row(phase_error_deg=off_deg, **changed)
    return ReportShift(made, outcome, 0.0, series, (fired,))


def parts(sentence: str | None) -> dict[str, float]:
    """Degrees by the names of the parts; the whole as `off`."""
    assert sentence is not None
    whole = re.search(r": ([-+][\d.]+) deg off, of which (.*)", sentence)
    assert whole is not None
    told = re.sub(r"\([^)]*\)", "", whole[2]).rstrip(". ").split(", ")
    found = {name: float(deg) for name, deg in (part.strip().rsplit(" ", 1) for part in told)}
    return {"off": float(whole[1])} | found


def only(name: str, deg: float) -> dict[str, float]:
    names = ("the sleeve", "the layshaft", "the main shaft", "the reference")
    return {"off": deg} | {each: deg if each == name else 0.0 for each in names}


START_DEG = -0.006 * SLIP_RPM * BEFORE_MS
"""Where a tooth is with this slip, so long before it stands in the middle of the gap."""


@pytest.mark.parametrize(
    ("made", "name", "how"),
    [
        (
            shift(1.2, belief(START_DEG + 1.2, layshaft_rpm=-1.2 / (0.006 * BEFORE_MS))),
            "the layshaft",
            "its gear turned 3.3 rpm faster than predicted",
        ),
        (
            shift(1.2, belief(START_DEG + 1.2, main_rpm=1.2 / (0.006 * BEFORE_MS))),
            "the main shaft",
            "its shaft turned 3.3 rpm slower than predicted",
        ),
        (
            shift(1.2, belief(START_DEG), struck_rpm=-10.0),
            "the main shaft",
            "struck 20 ms before contact, which took the slip from +10 to +20 rpm",
        ),
        (
            shift(1.2, belief(START_DEG)),
            "the reference",
            "so far off was the phase when it was fired",
        ),
        (
            shift(1.2, belief(START_DEG), predicted_ms=CONTACT_MS - 20.0),
            "the sleeve",
            "20.0 ms late at +10 rpm of slip",
        ),
    ],
)
def test_the_cause_is_the_belief_that_was_wrong(made: ReportShift, name: str, how: str) -> None:
    said = cause(made, SHEET)
    assert parts(said) == pytest.approx(only(name, 1.2), abs=0.035)
    assert said is not None
    assert said.startswith("Fired for +0.00 ± 0.50 deg, met a tooth at +1.20 (the gap ends at")
    assert re.search(rf"of which {name} \+1\.\d\d \({re.escape(how)}\)", said)


def test_parts_add_up_and_the_largest_comes_first() -> None:
    made = shift(-1.9, belief(START_DEG - 1.0, layshaft_rpm=2.0), predicted_ms=CONTACT_MS + 4.0)
    found = parts(cause(made, SHEET))
    assert sum(value for name, value in found.items() if name != "off") == pytest.approx(
        found["off"], abs=0.03
    )
    told = list(found)[1:]
    assert told == sorted(told, key=lambda name: -abs(found[name]))


def test_without_the_controllers_beliefs_shafts_and_reference_are_one_part() -> None:
    said = cause(shift(1.2, None, predicted_ms=CONTACT_MS - 10.0), SHEET)
    found = {"off": 1.2, "shafts and reference": 0.6, "the sleeve": 0.6}
    assert parts(said) == pytest.approx(found, abs=0.011)
    assert said is not None
    assert "slip +10 instead of +10 rpm" in said or "10.0 ms late at +10 rpm of slip" in said


def test_without_the_rigs_truth_the_controllers_own_estimate_is_the_witness() -> None:
    """A real gearbox: nobody else says where the tooth was."""
    made = shift(1.2, belief(START_DEG), contact=None, contact_us=None)
    outcome = made.outcome._replace(
        measured_contact_time_us=404_000, estimated_phase_rad=-1.1 * DEG, attempts=1
    )
    blind = replace(made, series={}, outcome=outcome)
    said = cause(blind, SHEET)
    assert said is not None
    assert "met a tooth at -1.10 by the controller's own estimate" in said
    assert parts(said) == pytest.approx(
        {"off": -1.1, "shafts and reference": -1.34, "the sleeve": 0.24}, abs=0.011
    )
    hit = replace(blind, outcome=outcome._replace(estimated_phase_rad=0.5 * DEG))
    assert cause(hit, SHEET) is None


@pytest.mark.parametrize(
    ("strategy", "reference", "why"),
    [
        ("speed_window", "known", "this strategy does not aim"),
        ("speed_window", "unknown", "where the gear's teeth are was not known yet"),
    ],
)
def test_who_did_not_aim_met_a_tooth_by_chance(strategy: str, reference: str, why: str) -> None:
    made = shift(1.2, None, strategy=strategy, reference=reference)
    assert cause(made, SHEET) == f"Met a tooth by chance: {why}."


@pytest.mark.parametrize(
    ("off_deg", "meets"),
    [
        (1.2, ": it would have met a tooth at +1.20"),
        (0.3, " in vain: it would have met the gap at +0.30"),
    ],
)
def test_an_abort_says_what_would_have_been_met(off_deg: float, meets: str) -> None:
    """Stopped at 365 ms; the shafts go on as if it had not been."""
    made = shift(off_deg, belief(START_DEG), contact="gap", aborts=1)
    made = replace(made, series=made.series | {"aborted": ([365.0], [1.0])})
    said = cause(made, SHEET)
    assert said is not None
    assert said.startswith(f"Fired for +0.00 ± 0.50 deg, stopped 15 ms later{meets} deg: ")
    assert parts(said) == pytest.approx(only("the reference", off_deg), abs=0.011)


def test_a_failed_shift_says_by_which_fault_and_a_hit_says_nothing() -> None:
    failed = shift(1.2, belief(START_DEG), result="ended_in_neutral", fault="engage_failed")
    failed = replace(failed, outcome=failed.outcome._replace(fault=FaultCode.ENGAGE_FAILED))
    said = cause(failed, SHEET)
    assert said is not None
    assert said.startswith("Not engaged, ended in neutral: the sleeve did not go in, in all")
    assert "met a tooth at +1.20" in said
    assert cause(shift(0.3, belief(START_DEG), contact="gap"), SHEET) is None


def test_in_a_run_the_parts_lead_from_the_prediction_to_the_contact() -> None:
    """Of a real controller: every aimed shift, as if it had missed."""
    sheet, beliefs = load_sheet("thesis"), Beliefs()
    setup = Setup(sheet, ControllerSettings(), Preset.THESIS, seed=1, shifts=4)
    collector = ReportCollector(sheet, beliefs=beliefs)
    simulate(setup, lambda _time_us, frame: collector.receive(frame), on_step=beliefs.look)
    shifts = collector.finish()
    aimed = [s for s in shifts if s.row.reference == "known"]
    assert len(aimed) == 2
    for each in aimed:
        assert each.firings[-1].belief is not None
        missed = replace(each, row=replace(each.row, contact="tooth"))
        found = parts(cause(missed, sheet))
        assert len(found) == 5
        met_deg, expected_deg = each.contact_phase_deg, each.firings[-1].phase_deg
        assert met_deg is not None
        assert found["off"] == pytest.approx(met_deg - expected_deg, abs=0.02)
    report = Report("", "", sheet, [ReportRun("target_phase", shifts)], {})
    text = page(report, {"shifts": {}}, "")
    misses = [n for n, s in enumerate(shifts, 1) if s.row.contact == "tooth"]
    assert ("Missed or aborted, and why" in text) is bool(misses)
    for number in misses:
        assert f'<a href="#shift-1-{number}">{number}</a>' in text
