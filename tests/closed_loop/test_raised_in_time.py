"""A downshift's engine: asked in time, and the layshaft let go at the slip of a first contact.

By the rig's truth, with its engine's lag and its clutch's plates."""

from __future__ import annotations

import pytest

from meshpoint.campaigns.draw import draw
from meshpoint.campaigns.loop import ClosedLoop
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.gearbox import load_sheet
from meshpoint.results.rows import ShiftRow
from meshpoint.rig_sim.settings import Preset, Profile
from meshpoint.units import RPM

SHEET = load_sheet("truck12")
SEEDS = (5, 6, 7)
"""Whose old gear comes out at once, so that nothing else is timed."""


@pytest.fixture(scope="module")
def downshifts() -> list[ShiftRow]:
    """From 10 to 8, the second one of three gearboxes each."""
    rows = []
    for seed in SEEDS:
        drawn = draw(seed, SHEET, Preset.TRUCK, [(10, 8)], 2, {}, Profile.CLEAN)
        loop = ClosedLoop(SHEET, ControllerSettings(), Preset.TRUCK, drawn)
        loop.shift()
        row = loop.shift()
        assert row is not None
        rows.append(row)
    assert all(row.result == "engaged" for row in rows)
    return rows


def test_the_engine_has_risen_when_the_plates_meet(downshifts: list[ShiftRow]) -> None:
    """From neutral until the plates have parted again: closing takes 130 ms until they meet, and
    opening 65 at most; asked in neutral, the engine made it some 380."""
    for row in downshifts:
        assert row.phases.raising_ms is not None
        assert 130.0 < row.phases.raising_ms < 320.0


def test_a_gear_whose_phase_is_known_is_braked_for_it_and_no_other(
    downshifts: list[ShiftRow],
) -> None:
    """And its first contact is made before drag has taken the slip beyond the least allowed."""
    window = ControllerSettings().window
    for row in downshifts:
        assert (row.phases.braking_ms is not None) is (row.reference == "known")
        assert row.slip_rpm is not None
        assert window.contact_low_rad_s < row.slip_rpm * RPM < 30.0 * RPM
