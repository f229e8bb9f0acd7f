"""What is no shift, or has no teeth to meet, counts as neither met nor missed."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from campaigns import judged_shift, small_spec

from meshpoint.campaigns import run
from meshpoint.campaigns.baseline import Outcome, paired_runs
from meshpoint.campaigns.columns import Shifts
from meshpoint.campaigns.draw import Draw, draw
from meshpoint.campaigns.record import JudgedShift
from meshpoint.campaigns.spec import TRUE_STATE, Job
from meshpoint.campaigns.summary import summarise
from meshpoint.campaigns.table import CELLS
from meshpoint.rig_sim.settings import Preset

OWN = "target_phase"
FAST_RAD_S = 110.0
"""Of the main shaft: 2,560 rpm of the input shaft in gear 8."""


def shift(seed: int, **values: object) -> JudgedShift:
    made = {"from_gear": 8, "to_gear": 10, "result": "engaged", "contact": "gap"}
    return judged_shift(strategy=OWN, seed=seed, **made | values)


def refused(seed: int) -> JudgedShift:
    return shift(seed, result="refused", contact=None)


def too_fast(*given: Any) -> Draw:
    """Down, then up, at a speed at which the input shaft would turn at over 2,400 rpm."""
    drawn = draw(*given)
    return replace(drawn, plan=(replace(drawn.plan[0], main_rad_s=FAST_RAD_S), *drawn.plan[1:]))


def test_a_request_that_the_controller_does_not_begin_is_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(run, "draw", too_fast)
    spec = small_spec(Preset.TRUCK, strategies=(OWN,), pairs=((10, 8),), learn=0, judged=2)
    result = run.run_one(spec, Job(7))
    assert result.error is None
    found = [(record.strategy, record.result, record.fault) for record in result.records]
    assert found == [
        (OWN, "refused", "input_overspeed"),
        (OWN, "engaged", "none"),
        (TRUE_STATE, "refused", "input_overspeed"),
        (TRUE_STATE, "engaged", "none"),
    ]


def test_refused_requests_are_counted_apart_from_shifts_not_engaged() -> None:
    shifts = [*(shift(seed) for seed in range(6)), shift(6, result="failed", contact=None)]
    records = [*shifts, *(refused(seed) for seed in range(7, 10))]
    found = summarise(Shifts.of(records), (OWN,))["strategies"][OWN]
    assert (found["shifts"], found["refused"], found["not_engaged"]) == (7, 3, 1)
    assert found["first_contact_gap"]["rate"] == pytest.approx(6 / 7)
    assert (CELLS["refused"](found), CELLS["not engaged"](found)) == ("3", "1")


def test_a_campaign_of_refused_requests_says_so() -> None:
    found = summarise(Shifts.of([refused(1), refused(2)]), (OWN,))["strategies"][OWN]
    assert (found["shifts"], found["refused"], found["not_engaged"]) == (0, 2, 0)
    assert found["first_contact_gap"]["rate"] is None
    assert found["duration_ms"]["mean"] is None


def test_a_request_refused_before_and_now_is_no_pair() -> None:
    drawn = (8, 10, 0.0, None, None, None, None)
    before = {seed: {0: Outcome(seed == 3, None, None, drawn)} for seed in range(4)}
    found = paired_runs(before, [shift(0), refused(1), refused(3)])
    assert [(run.seed, run.worse, run.better, run.both) for run in found] == [
        (0, 0, 1, 0),
        (3, 1, 0, 0),
    ]


def test_a_change_of_the_splitter_alone_has_no_teeth_to_meet() -> None:
    splits = [shift(seed, from_gear=7, to_gear=8, contact=None) for seed in range(4)]
    found = summarise(Shifts.of(splits), (OWN,))["strategies"][OWN]
    assert (found["shifts"], found["first_contact_gap"]["rate"]) == (4, None)
    ranges = [shift(9, from_gear=1, to_gear=7), shift(10, from_gear=6, to_gear=7, contact="tooth")]
    found = summarise(Shifts.of([*splits, *ranges]), (OWN,))["strategies"][OWN]
    assert (found["shifts"], found["first_contact_gap"]["rate"]) == (6, pytest.approx(1 / 2))


def test_what_was_promised_is_held_against_what_was_kept() -> None:
    """A tooth at the flank of its gap: half of them; one as far off as its deviation: 84 %."""
    pitch = {"pitch_deg": 10.0, "backlash_percent": 20.0, "predicted_phase_sd_deg": 0.5}
    at_the_flank = [
        shift(seed, attempts=1, predicted_phase_deg=1.0, contact=contact, **pitch)
        for seed, contact in enumerate(("gap", "tooth"))
    ]
    inside = shift(2, attempts=1, predicted_phase_deg=0.5, **pitch)
    twice = shift(3, attempts=2, predicted_phase_deg=0.0, contact="tooth", **pitch)
    unknown = shift(4, attempts=1, contact="tooth")
    found = summarise(Shifts.of([*at_the_flank, inside, twice, unknown]), (OWN,))
    promise = found["strategies"][OWN]["promise"]
    assert promise["shifts"] == 3
    assert promise["said"] == pytest.approx((0.5 + 0.5 + 0.84) / 3, abs=2e-3)
    assert promise["kept"] == pytest.approx(2 / 3)


def test_a_strategy_that_does_not_aim_promises_nothing() -> None:
    pitch = {"pitch_deg": 10.0, "backlash_percent": 20.0, "predicted_phase_sd_deg": 0.5}
    row = shift(1, attempts=1, predicted_phase_deg=1.0, contact="gap", **pitch)
    rows = [replace(row, strategy="speed_window")]
    found = summarise(Shifts.of(rows), ("speed_window",))
    assert found["strategies"]["speed_window"]["promise"] == {
        "shifts": 0, "said": None, "kept": None,
    }  # fmt: skip
