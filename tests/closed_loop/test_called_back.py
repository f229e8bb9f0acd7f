"""A sleeve that is recalled before it has moved."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from meshpoint.controller.planning.strategies.target_phase import TargetPhase
from meshpoint.controller.settings import ControllerSettings
from meshpoint.controller.shift.engage import CALLS
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.settings import Preset, Profile
from meshpoint.testbench.campaign.draw import draw, upshifts
from meshpoint.testbench.campaign.loop import ClosedLoop
from meshpoint.testbench.results.rows import ShiftRow
from meshpoint.units import RPM

LITTLE_DRAG = {"drag.constant_nm": 0.5, "sheet.friction_factor": 0.2}
"""Slip falls so slowly that another gap comes before the gear is too slow."""
SEED = 18
PLAIN = ControllerSettings()
FAST = replace(PLAIN, window=replace(PLAIN.window, aim_slip_rad_s=24.0 * RPM))


def aimed_shift(monkeypatch: pytest.MonkeyPatch, doubted: int) -> tuple[ShiftRow, list[int]]:
    """An aimed shift of a rigid gearbox whose firings are said, this many times, to meet a tooth
    once their valve is on; and when it was said (us after the firing)."""
    sheet = load_sheet("truck12")
    drawn = draw(SEED, sheet, Preset.TRUCK, upshifts(), 4, LITTLE_DRAG, Profile.CLEAN)
    loop = ClosedLoop(sheet, FAST, Preset.TRUCK, drawn)
    for _ in range(3):
        loop.shift()
    said: list[int] = []
    core: Any = loop.controller
    plain = TargetPhase.is_to_go_back

    def doubting(
        self: TargetPhase, predictor: Any, now_us: int, contact_us: int, earliest_us: int
    ) -> bool:
        late_us = now_us - core.sequence.running.plan.fire_us
        if late_us >= 0 and len(said) < doubted:
            said.append(late_us)
            return True
        return plain(self, predictor, now_us, contact_us, earliest_us)

    monkeypatch.setattr(TargetPhase, "is_to_go_back", doubting)
    row = loop.shift()
    assert row is not None
    return row, said


def test_a_sleeve_that_would_meet_a_tooth_goes_back_and_meets_the_next_gap(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    plain, _ = aimed_shift(monkeypatch, 0)
    monkeypatch.undo()
    row, said = aimed_shift(monkeypatch, 1)
    assert len(said) == 1, said
    assert (row.result, row.contact, row.attempts, row.ratchets) == ("engaged", "gap", 1, 0)
    assert row.face_ms == 0.0
    assert plain.duration_ms + 10.0 < row.duration_ms < plain.duration_ms + 400.0


def test_a_sleeve_is_recalled_no_more_often_than_is_allowed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    row, said = aimed_shift(monkeypatch, 100)
    assert row.result == "engaged"
    assert len(said) <= CALLS
