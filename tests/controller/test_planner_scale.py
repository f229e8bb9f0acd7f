"""The planner's windows and steps by pitch, slip rate and inertia; what a plan says of a miss."""

from __future__ import annotations

from dataclasses import replace

import pytest

from meshpoint.controller.motion.brake_input import BrakeInput
from meshpoint.controller.motion.models import free_motion
from meshpoint.controller.planning.gear_predictor import GearPredictor
from meshpoint.controller.planning.strategies.target_phase import COARSE_US, TargetPhase
from meshpoint.controller.planning.strategist import Plan, Strategist
from meshpoint.controller.report.log_lines import decision_line
from meshpoint.controller.settings import ControllerSettings
from meshpoint.dbc.messages import ShiftDecision
from meshpoint.gearbox import GearboxSheet, Split
from tests.controller.test_strategy import LAW, SHEET, VALVE_US, predictor_at

SETTINGS = ControllerSettings()
NOW_US = 0


def planned(sheet: GearboxSheet) -> tuple[TargetPhase, GearPredictor]:
    motion = free_motion(sheet, Split.HIGH, LAW, SETTINGS.crossing_filter)
    brake = BrakeInput(VALVE_US)
    brake.schedule(-1_000_000, True, -1_000_000)
    predictor = predictor_at(300.0, SHEET.air.supply_gauge_pa, brake)
    return TargetPhase(sheet, SETTINGS), replace(predictor, model=motion)


def scaled(inertia: float = 1.0, teeth: int = 48) -> GearboxSheet:
    shafts = SHEET.shafts
    lighter = replace(
        shafts,
        layshaft_inertia_kgm2=inertia * shafts.layshaft_inertia_kgm2,
        input_inertia_kgm2=inertia * shafts.input_inertia_kgm2,
    )
    return replace(SHEET, shafts=lighter, dog=replace(SHEET.dog, teeth=teeth))


def test_a_release_reaches_as_many_pitches_whatever_inertia_and_teeth() -> None:
    """A quarter of the inertia moves the phase about four times as far, half the teeth half as many
    pitches."""
    reach = {
        key: strategy._reach_us(predictor, NOW_US)
        for key, (strategy, predictor) in {
            "as it is": planned(scaled()),
            "light": planned(scaled(inertia=0.25)),
            "coarse": planned(scaled(teeth=24)),
        }.items()
    }
    assert 8e3 < reach["as it is"] < 25e3
    assert reach["light"] == pytest.approx(reach["as it is"] / 4.0, rel=0.2)
    assert reach["coarse"] == pytest.approx(2.0 * reach["as it is"], rel=0.05)


def test_contacts_are_looked_at_more_closely_where_drag_takes_the_slip_away_sooner() -> None:
    step_us, count = (lambda s, p: s._steps(p, NOW_US))(*planned(scaled()))
    light_us, more = (lambda s, p: s._steps(p, NOW_US))(*planned(scaled(inertia=0.1)))
    assert light_us < step_us <= COARSE_US
    assert light_us * more == pytest.approx(step_us * count, rel=0.02)


def test_a_plan_outside_the_gap_says_so() -> None:
    predictor, strategist = predictor_at(18.0), Strategist(SHEET, SETTINGS)
    plans = [
        strategist.plan_at(predictor, contact_us, ShiftDecision.FIRE)
        for contact_us in range(50_000, 450_000, 1_000)
    ]
    half = SHEET.dog.backlash_rad / 2.0
    assert {plan.misses for plan in plans} == {True, False}
    for plan in plans:
        line = decision_line(plan, NOW_US)
        assert plan.misses == (abs(plan.phase_rad) > half)
        assert line is not None
        assert ("outside the gap" in line) == plan.misses
    assert not Plan(ShiftDecision.BRAKE, 0, 0, 0.0, 0.0, 1.0).misses
