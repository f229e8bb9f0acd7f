"""What study `identify` says of intervals that hold too few truths, too many, or as many as they
should."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from benchmarks.studies.identify_run import Gearbox, Reported, _Truth
from benchmarks.studies.record import Finding, ThesisVerdict
from benchmarks.studies.registry import load
from benchmarks.studies.settings import load_study_settings
from meshpoint.gearbox import load_sheet
from meshpoint.identify.identified import Figure, Identified
from meshpoint.identify.log_reader import LogContent
from meshpoint.rig_sim.truck.as_built import draw_as_built

GEARBOXES = 50


def found(**held: int) -> Finding:
    """By figure: in how many of the gearboxes its interval holds the truth."""
    study = load("identify")
    given = load_study_settings(None).given(study)
    given = replace(given, own=replace(given.own, gearboxes=GEARBOXES, dog_gearboxes=0))
    results: dict[Any, Any] = {}
    for number, job in enumerate(study.jobs(given)):
        reported = tuple(
            Reported(name, "ms", 12.0, 11.0, 13.0, 12.0, 12.5 if number < holds else 13.5)
            for name, holds in held.items()
        )
        results[job] = Gearbox(reported, (), ())
    return study.conclude(replace(given, results=results))


@pytest.mark.parametrize(
    ("held", "verdict", "outside"),
    [
        ({"torque": 47, "delay": 48}, ThesisVerdict.AGREES, []),
        ({"torque": 50, "delay": 47}, ThesisVerdict.AGREES, []),
        ({"torque": 47, "delay": 48, "detent": 12}, ThesisVerdict.DIFFERS, ["detent"]),
        ({"torque": 40, "delay": 50, "drag": 50}, ThesisVerdict.DIFFERS, ["torque"]),
        ({"torque": 50, "delay": 50}, ThesisVerdict.DIFFERS, []),
        ({"torque": 43, "delay": 44}, ThesisVerdict.DIFFERS, []),
    ],
    ids=["honest", "one all held", "one too narrow", "hidden by others", "too wide", "all narrow"],
)
def test_intervals_hold_90_to_99_per_cent_each_figure_by_itself(
    held: dict[str, int], verdict: ThesisVerdict, outside: list[str]
) -> None:
    finding = found(**held)
    assert finding.statements[0].verdict is verdict
    assert finding.figures["outside"] == outside


def test_a_figure_that_is_printed_and_has_no_truth_ends_the_study() -> None:
    sheet, printed = load_sheet("truck12"), Identified()
    printed.figures.append(Figure("sleeve detent first", "N", 400.0, 370.0, 430.0, 600.0, 9))
    truth = _Truth(sheet, draw_as_built(3), printed, LogContent(), 350.0)
    with pytest.raises(ValueError, match="sleeve detent first"):
        truth.reported()
    printed.figures[0] = replace(printed.figures[0], value=None, low=None, high=None)
    assert not truth.reported()
