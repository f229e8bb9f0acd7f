"""What the tests of the campaign share: small campaigns through the command, and their results."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

from meshpoint.campaigns.columns import FIELDS
from meshpoint.campaigns.draw import upshifts
from meshpoint.campaigns.record import JudgedShift
from meshpoint.campaigns.spec import CampaignSpec
from meshpoint.cli.main import main
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.settings import Preset, Profile

BOTH = "speed_window,target_phase"
SMALL = ("--learn", "1", "--judged", "1", "--strategy", BOTH, "--as-built", "clean")
SHEETS = {Preset.THESIS: "thesis", Preset.TRUCK: "truck12"}


@dataclass
class Outcome:
    code: int
    folder: Path

    @property
    def text(self) -> str:
        return (self.folder / "result.json").read_text()

    @property
    def values(self) -> dict[str, Any]:
        values: dict[str, Any] = json.loads(self.text)
        return values

    @property
    def table(self) -> list[dict[str, Any]]:
        rows: list[dict[str, Any]] = pq.read_table(self.folder / "shifts.parquet").to_pylist()
        return rows


def campaign(folder: Path, *arguments: str) -> Outcome:
    """Runs the command with `--out` and `--json` in a folder."""
    given = ["campaign", *SMALL, "--out", str(folder), "--json", str(folder / "result.json")]
    return Outcome(main([*given, *arguments]), folder)


def judged_shift(**values: Any) -> JudgedShift:
    """A judged shift up by a main gear, of which nothing is known but these values."""
    nothing: dict[str, Any] = {
        name: None if field.is_optional else field.kind() for name, field in FIELDS.items()
    }
    return JudgedShift(**nothing | {"from_gear": 8, "to_gear": 10} | values)


def small_spec(preset: Preset = Preset.THESIS, **changes: Any) -> CampaignSpec:
    values: dict[str, Any] = {
        "sheet": load_sheet(SHEETS[preset]),
        "settings": ControllerSettings(),
        "preset": preset,
        "strategies": tuple(BOTH.split(",")),
        "true_state": True,
        "pairs": upshifts(),
        "learn": 2,
        "judged": 1,
        "seed": 1,
        "profile": Profile.CLEAN,
    }
    return CampaignSpec(**(values | changes))
