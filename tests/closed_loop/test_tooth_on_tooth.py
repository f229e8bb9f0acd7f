"""In the closed loop: a sleeve that sticks to a tooth is not pushed on for long."""

from __future__ import annotations

from meshpoint.controller.settings import ControllerSettings
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.settings import Preset, Profile
from meshpoint.testbench.campaign.draw import draw, upshifts
from meshpoint.testbench.campaign.loop import ClosedLoop

SEED = 900_000_006
"""Of 13 upshifts of this gearbox at least one sticks, tooth on tooth."""


def test_a_sleeve_that_sticks_to_a_tooth_is_not_pushed_on_for_long() -> None:
    sheet, settings = load_sheet("truck12"), ControllerSettings()
    drawn = draw(SEED, sheet, Preset.TRUCK, upshifts(), 13, {}, Profile.TYPICAL)
    loop = ClosedLoop(sheet, settings, Preset.TRUCK, drawn)
    rows = [row for _ in range(13) if (row := loop.shift()) is not None]
    stuck = [row for row in rows if row.blocked and row.attempts > 1]
    assert stuck
    for row in stuck:
        attempts_stuck = row.attempts - 1
        assert row.face_ms < attempts_stuck * 0.75 * settings.limits.face_ms
        assert row.result == "engaged"
