"""One judged shift of a gearbox that a campaign has drawn."""

from __future__ import annotations

from meshpoint.campaigns.draw import draw, upshifts
from meshpoint.campaigns.loop import ClosedLoop
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.gearbox import load_sheet
from meshpoint.results.rows import ShiftRow
from meshpoint.rig_sim.settings import Preset, Profile

LEARNED = 6


def judged_shift(gearbox: int, profile: Profile, judged: int, shifts: int) -> ShiftRow:
    """Of an upshift campaign with six shifts to learn and this many to judge, the one after these
    that are judged: of the gearbox with this seed, on `truck12`."""
    sheet = load_sheet("truck12")
    drawn = draw(gearbox, sheet, Preset.TRUCK, upshifts(), LEARNED + shifts, {}, profile)
    loop = ClosedLoop(sheet, ControllerSettings(), Preset.TRUCK, drawn)
    for _ in range(LEARNED):
        loop.shift()
    assert drawn.judged
    loop.change_conditions(drawn.judged)
    for _ in range(judged):
        loop.shift()
    row = loop.shift()
    assert row is not None
    return row
