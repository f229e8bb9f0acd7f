"""A gear's phase reference is known after two shifts into it at most: every gear, gaps from 4 to 40
% of the pitch, sensors good and poor. With edges of 50 us, the most of the rig, tooth numbers are
lost now and then, and with them what was learned."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest

from meshpoint.campaigns.draw import draw
from meshpoint.campaigns.loop import ClosedLoop
from meshpoint.controller.settings.settings import load_settings
from meshpoint.gearbox.sheet import load_sheet
from meshpoint.rig_sim.settings import Preset, Profile

GAPS_PERCENT = (4, 8, 20, 40)
JITTERS_US = (5, 20, 40)
INTO = {"crawl": (1, 13), "first": (3, 1), "first, up": (13, 1), "second": (1, 3), "third": (3, 5)}
SMALLEST = (8, 40, "second")
WORN = {"hall.pitch_error_deg": 0.3, "hall.runout_mm": 0.2}


@pytest.mark.parametrize(
    ("gap_percent", "jitter_us", "into"),
    [
        pytest.param(*case, marks=() if case == SMALLEST else pytest.mark.long)
        for case in itertools.product(GAPS_PERCENT, JITTERS_US, INTO)
    ],
)
def test_a_reference_is_known_after_two_shifts_into_its_gear(
    tmp_path: Path, gap_percent: int, jitter_us: int, into: str
) -> None:
    path = tmp_path / "gap.toml"
    path.write_text(
        f'based_on = "truck12"\n[dog]\nbacklash_percent_of_pitch = {gap_percent}\n', "utf-8"
    )
    sheet = load_sheet(path)
    sensors = {"hall.jitter_us": jitter_us, **(WORN if jitter_us > 5 else {})}
    seed = 100 * gap_percent + jitter_us
    drawn = draw(seed, sheet, Preset.TRUCK, (INTO[into],), 3, sensors, Profile.CLEAN)
    loop = ClosedLoop(sheet, load_settings(None), Preset.TRUCK, drawn)
    loop.shift()
    loop.shift()
    third = loop.shift()
    assert third is not None, loop.refusal
    assert third.reference_source == "measured"
