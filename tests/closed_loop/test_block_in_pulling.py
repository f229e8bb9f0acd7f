"""In the closed loop: a gear comes out although the guard has blocked the brake's early air."""

from __future__ import annotations

import pytest

from meshpoint.campaigns.draw import draw, upshifts
from meshpoint.campaigns.loop import ClosedLoop
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.settings import Preset, Profile

SEED, LEARNED, BEFORE = 2_000_182, 6, 6
"""In the judged shift after these of this gearbox, 9 to 11, the sleeve comes out so slowly that the
air would come before its teeth are out."""


@pytest.mark.long
def test_a_gear_comes_out_although_the_guard_has_blocked_the_brakes_early_air() -> None:
    """The block takes the pulling valve off as well; early air again would be blocked again."""
    sheet = load_sheet("truck12")
    drawn = draw(SEED, sheet, Preset.TRUCK, upshifts(), 14, {}, Profile.TYPICAL)
    loop = ClosedLoop(sheet, ControllerSettings(), Preset.TRUCK, drawn)
    for _ in range(LEARNED):
        loop.shift()
    assert drawn.judged
    loop.change_conditions(drawn.judged)
    for _ in range(BEFORE):
        loop.shift()
    loop.prepare()
    row = loop.shift()
    assert row is not None
    assert (row.result, row.fault) == ("engaged", "none")
