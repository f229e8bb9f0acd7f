"""A calibration goes over a restart: what a controller was given and has not learned anew is handed
on."""

from __future__ import annotations

from dataclasses import is_dataclass, replace
from typing import Any

import pytest
from calibration_example import SHEET, example

from meshpoint.controller.core.core import ControllerCore
from meshpoint.controller.settings.header import new_header
from meshpoint.controller.settings.learned import (
    Calibration,
    ReferenceRecords,
    SleeveRecords,
    SwingRecords,
    WheelRecords,
)
from meshpoint.controller.settings.settings import ControllerSettings


def core_with(calibration: Calibration | None, estimator: str = "crossing") -> ControllerCore:
    settings = replace(ControllerSettings(), estimator_name=estimator)
    return ControllerCore(new_header("2.0", SHEET, settings, calibration))


def are_alike(found: Any, given: Any) -> bool:
    """Two records of numbers, whose last digits a way through logarithms changes."""
    if is_dataclass(given):
        pairs = [(getattr(found, each), own) for each, own in vars(given).items()]
        return type(found) is type(given) and all(are_alike(*pair) for pair in pairs)
    if isinstance(given, tuple):
        return bool(found == pytest.approx(given))
    return bool(found == (pytest.approx(given) if isinstance(given, float) else given))


def test_a_controller_that_has_done_nothing_hands_on_what_it_was_given() -> None:
    """The wheels' patterns are memories until the wheels have turned, and kept as they were."""
    given = example()
    core = core_with(given)
    kept = core.calibration("at noon")
    assert vars(kept.provenance) == {
        "meshpoint": "2.0", "sheet": SHEET.name, "sheet_sha256": SHEET.sha256,
        "written": "at noon", "shifts": given.provenance.shifts,
    }  # fmt: skip
    assert (kept.format_, kept.end.complete) == (1, True)
    assert are_alike(kept.wheels, given.wheels)
    assert are_alike(kept.references, given.references)
    assert are_alike(kept.sleeves, given.sleeves)
    core.shifts = 5
    assert core.calibration("").provenance.shifts == given.provenance.shifts + 5
    fresh = core_with(None).calibration("")
    assert fresh.provenance.shifts == 0
    assert (fresh.wheels, fresh.references) == (WheelRecords(), ReferenceRecords())
    assert fresh.sleeves == SleeveRecords()


@pytest.mark.parametrize("estimator", ["window", "thesis"])
def test_a_baseline_keeps_what_it_cannot_learn_and_starts_with_delays(estimator: str) -> None:
    given = example()
    core = core_with(given, estimator)
    kept = core.calibration("")
    assert (kept.wheels, kept.references) == (given.wheels, given.references)
    assert (kept.brake, kept.noise, kept.swings) == (given.brake, given.noise, given.swings)
    assert are_alike(kept.sleeves, given.sleeves)
    assert kept.provenance.shifts == given.provenance.shifts
    none = core_with(None, estimator).calibration("")
    assert (none.wheels, none.references) == (WheelRecords(), ReferenceRecords())
    assert (none.brake, none.noise, none.swings) == (None, None, SwingRecords())
    assert none.provenance.shifts == 0
