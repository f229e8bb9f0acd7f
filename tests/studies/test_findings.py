"""Verdicts follow the figures: a wrong product or another gearbox changes what a study says."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given as drawn
from hypothesis import strategies as st

from benchmarks.studies import hardware_trucks, prediction
from benchmarks.studies.equipment import Equipment, EquippedRun
from benchmarks.studies.excitation import BrakePoint, Figures, figures, matched
from benchmarks.studies.hardware import Bought, certainty
from benchmarks.studies.jobs import Delay, LoopResult, ShiftErrors
from benchmarks.studies.record import Finding, Given, Statement, ThesisVerdict
from benchmarks.studies.registry import load
from benchmarks.studies.settings import load_study_settings
from benchmarks.studies.thesis_predictions import predict_linear
from benchmarks.studies.validation import Compared, time_constant_s
from meshpoint.controller.models.layshaft import LayshaftState
from meshpoint.gearbox import load_sheet
from meshpoint.gearbox.wheels import Mesh

SHEET = load_sheet("thesis")


def given(name: str, **changed: Any) -> Given[Any]:
    """What the study starts from, parts of it changed."""
    return replace(load_study_settings(None).given(load(name)), **changed)


def conclude(name: str, **changed: Any) -> Finding:
    return load(name).conclude(given(name, **changed))


def test_zero_order_hold_equals_the_rig_and_a_predictor_that_is_not_it_is_found_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert conclude("hold").statements[0].verdict is ThesisVerdict.BY_CONSTRUCTION

    def wrong(state: LayshaftState, to_us: float, *_: Any) -> LayshaftState:
        return predict_linear(state, to_us)

    monkeypatch.setattr(prediction, "predict_hold", wrong)
    assert conclude("hold").statements[0].verdict is ThesisVerdict.DIFFERS


def test_a_prediction_varies_with_the_splitter_as_the_steps_inertias_differ() -> None:
    """By drag alone, at 1400 rpm over 45 ms: 0.0991 Nms, 0.357 kgm2 in the high step and 0.4615
    in the low one are 0.00935 rad, of a pitch of 0.1309."""
    found = conclude("splitter")
    assert found.statements[0].verdict is ThesisVerdict.DIFFERS
    low, high, _ = found.charts[0].panels[0].lines
    assert low.y[0] == pytest.approx(-100.0 * 0.00935 / SHEET.dog.pitch_rad, rel=0.02)
    assert np.abs(high.y).max() < 1e-6
    near = replace(SHEET, splitter=replace(SHEET.splitter, low=Mesh(33, 35), high=Mesh(34, 36)))
    assert conclude("splitter", sheet=near).statements[0].verdict is ThesisVerdict.AGREES


def test_friction_costs_too_much_in_our_gearbox_and_not_in_one_that_turns_more_easily() -> None:
    assert conclude("parameters").statements[1].verdict is ThesisVerdict.BY_CONSTRUCTION
    common = replace(given("parameters").common, friction_nms=SHEET.shafts.friction_nms)
    assert conclude("parameters", common=common).statements[1].verdict is ThesisVerdict.DIFFERS


def test_one_friction_is_that_of_all_studies_that_depend_on_it() -> None:
    c = given("parameters").common.friction_nms
    assert f"c = {c:g} Nms" in conclude("parameters").statements[1].reason
    for name in ("speed_estimate", "angle_estimate"):
        asked = given(name)
        jobs = load(name).jobs(asked)
        assert {job.sheet.shafts.friction_nms for job in jobs} == {c}


def test_no_slip_is_ascribed_to_the_thesis_that_it_does_not_give() -> None:
    size = conclude("delay_error").statements[0]
    assert "rpm" not in size.thesis
    assert "10 to 40 rpm" in size.ours


def test_a_gearbox_whose_brake_is_weaker_does_not_reach_the_thesis_s_torque() -> None:
    weak = replace(SHEET, brake=replace(SHEET.brake, max_torque_nm=80.0))
    assert conclude("torque").verdict is ThesisVerdict.BY_CONSTRUCTION
    assert conclude("torque", sheet=weak).verdict is ThesisVerdict.DIFFERS


@pytest.mark.parametrize(
    ("name", "statement"), [("torque", 0), ("delay_error", 0), ("parameters", 1), ("hold", 0),
                            ("start_angle", 0), ("start_speed", 0)]
)  # fmt: skip
def test_what_rig_sheet_or_study_was_given_is_no_agreement(name: str, statement: int) -> None:
    assert conclude(name).statements[statement].verdict is ThesisVerdict.BY_CONSTRUCTION


def test_a_mean_delay_that_the_rig_was_given_is_no_agreement() -> None:
    """Its cylinders are fed so that a stroke takes the sheet's 45 ms; the spread is as it comes."""

    def measured(*delays_ms: float) -> tuple[ThesisVerdict, ThesisVerdict]:
        asked = given("delay")
        delays = [Delay(10, each, each, on_tooth=False) for each in delays_ms]
        found = LoopResult([], {}, delays, [], [])
        finding = conclude("delay", results=dict.fromkeys(load("delay").jobs(asked), found))
        mean, spread = (each.verdict for each in finding.statements)
        return mean, spread

    assert measured(44.0, 46.0) == (ThesisVerdict.BY_CONSTRUCTION, ThesisVerdict.AGREES)
    assert measured(38.0, 40.0) == (ThesisVerdict.DIFFERS, ThesisVerdict.DIFFERS)


def test_early_contact_costs_more_than_late_because_the_brake_still_acts() -> None:
    finding = conclude("delay_error")
    for sides in finding.figures["by_slip_rpm"].values():
        assert sides["early"] > sides["late"] > 0.0
    # with a pressure that dies at once only drag is left, and the sides come together
    quick = replace(SHEET, brake=replace(SHEET.brake, time_constant_s=1e-3, valve_delay_s=0.0))
    at_once = conclude("delay_error", sheet=quick).figures["by_slip_rpm"]
    for slip, sides in finding.figures["by_slip_rpm"].items():
        spread = at_once[slip]["early"] - at_once[slip]["late"]
        assert spread < 0.5 * (sides["early"] - sides["late"])


def test_euler_s_method_is_of_first_order_and_costs_more_than_the_closed_form() -> None:
    values = conclude("step").figures
    assert values["order_of_convergence"] == pytest.approx(1.0, abs=0.02)
    euler, closed, stored = values["operations"].values()
    assert euler["arithmetic"] > closed["arithmetic"] > stored["arithmetic"] > 0
    assert closed["functions"] == 4  # two exp, two expm1


def test_hardware_that_helps_one_gearbox_of_four_may_have_been_lucky() -> None:
    def bought(*phase_deg2: float) -> Bought:
        return Bought(phase_deg2, 1, 1, 500.0, Figures(0.1, 1.0))

    base = bought(0.20, 0.15, 0.14, 0.29)
    assert "within what chance" in certainty(bought(0.20, 0.16, 0.13, 0.01), base)
    assert "better by more" in certainty(bought(0.10, 0.05, 0.05, 0.18), base)
    assert "worse by more" in certainty(bought(0.30, 0.25, 0.25, 0.40), base)
    assert base.phase_rms_deg == pytest.approx(0.195**0.5)


@drawn(tau_ms=st.floats(15.0, 90.0), first_ms=st.floats(5.0, 40.0))
def test_the_time_constant_of_a_first_order_rise_is_found_again(
    tau_ms: float, first_ms: float
) -> None:
    time_ms = np.arange(0.0, 400.0, 1.0)
    supply, base = SHEET.air.supply_gauge_pa / 1e5, SHEET.air.atmosphere_pa / 1e5
    rise = supply * (1.0 - np.exp(-np.maximum(time_ms - first_ms, 0.0) / tau_ms))
    compared = Compared(time_ms, base + rise, np.zeros_like(time_ms))
    assert 1e3 * time_constant_s(SHEET, compared) == pytest.approx(tau_ms, abs=1.5)


def test_the_comparison_is_made_where_the_production_speed_is_as_wrong_as_the_thesis_s() -> None:
    found = [
        BrakePoint(10.0, {"window": Figures(0.2, 4.845), "thesis": Figures(0.1, 1.0)}),
        BrakePoint(20.0, {"window": Figures(0.3, 6.845), "thesis": Figures(0.3, 3.0)}),
    ]
    match = matched(found)
    assert match is not None
    assert match.brake_nm == pytest.approx(15.0)
    assert match.figures["thesis"].speed_rpm == pytest.approx(2.0)
    assert matched(found[:1]) is None
    assert matched([found[1]]) is None


def test_a_wheel_s_mean_tooth_offset_is_no_error_of_its_angle() -> None:
    offset, scatter = 0.01, 0.002
    squares = ShiftErrors(2, 2 * offset, (offset - scatter) ** 2 + (offset + scatter) ** 2, 0.0)
    assert np.radians(figures([[{"thesis": squares}]], "thesis").angle_deg) == pytest.approx(
        scatter
    )


@pytest.mark.parametrize(
    ("verdicts", "overall"),
    [
        ((True, False, "not comparable"), False),
        ((True, "by construction", "not comparable"), True),
        (("by construction", "not comparable"), "by construction"),
        ((False, "by construction"), False),
        (("not comparable",), "not comparable"),
    ],
)
def test_one_statement_that_differs_makes_the_study_differ(
    verdicts: tuple[Any, ...], overall: Any
) -> None:
    statements = tuple(Statement("", "", ThesisVerdict(value), "") for value in verdicts)
    assert Finding(statements, {}).verdict.value == overall


@pytest.mark.parametrize(
    "name",
    ["commission", "counterfactual", "delay", "hardware"],
)
def test_gearboxes_are_drawn_from_the_profile_that_the_settings_name(name: str) -> None:
    start = given(name)
    harsh = replace(start, common=replace(start.common, profile="harsh"))
    jobs = [job for job in load(name).jobs(harsh) if not isinstance(job, EquippedRun)]
    assert {job.profile for job in jobs} == {"harsh"}


def test_trucks_with_other_equipment_are_drawn_like_today_s() -> None:
    start = given("hardware")
    harsh = replace(start.own, trucks=replace(start.own.trucks, profile="harsh", gearboxes=3))
    jobs = hardware_trucks.jobs(replace(start, own=harsh))
    assert {job.profile for job in jobs} == {"harsh"}
    seeds = {name: [job.seed for job in jobs if job.equipment is name] for name in Equipment}
    assert all(own == seeds[Equipment.TODAY] for own in seeds.values())
    assert len(set(seeds[Equipment.TODAY])) == 3


@pytest.mark.parametrize("name", ["identify", "commission"])
def test_gearboxes_of_the_truck_are_drawn_around_a_truck_s_sheet(name: str) -> None:
    """By the thesis's the plates touch at 10 % of the clutch's travel, in the truck at 35 %."""
    assert SHEET.clutch.kiss_share < 0.3
    for job in load(name).jobs(given(name)):
        assert job.sheet.clutch.kiss_share == pytest.approx(0.35)
