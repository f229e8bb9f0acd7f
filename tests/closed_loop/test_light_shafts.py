"""In the closed loop: shafts so light that drag takes the slip window within a sleeve's way."""

from __future__ import annotations

from dataclasses import replace

import pytest

from meshpoint.campaigns.draw import draw, upshifts
from meshpoint.campaigns.loop import ClosedLoop
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.settings import Preset, Profile

SHIFTS = 8


@pytest.mark.parametrize("seed", [900_000_002, pytest.param(900_000_016, marks=pytest.mark.long)])
def test_with_a_quarter_of_the_inertia_no_shift_is_given_up(seed: int) -> None:
    """Also those without a phase reference: fired only inside 50 rpm, their sleeve would have met
    the gear at less than its least slip, and the engine's speed was lost again as fast. Of
    other gearboxes three shifts in 96 are given up, with the engine's raises used up (seed 955)."""
    whole = load_sheet("truck12")
    shafts = whole.shafts
    sheet = replace(
        whole,
        shafts=replace(
            shafts,
            layshaft_inertia_kgm2=0.25 * shafts.layshaft_inertia_kgm2,
            input_inertia_kgm2=0.25 * shafts.input_inertia_kgm2,
        ),
    )
    drawn = draw(seed, sheet, Preset.TRUCK, upshifts(), SHIFTS, {}, Profile.CLEAN)
    loop = ClosedLoop(sheet, ControllerSettings(), Preset.TRUCK, drawn)
    rows = [loop.shift() for _ in range(SHIFTS)]
    assert [row and row.result for row in rows] == ["engaged"] * SHIFTS
