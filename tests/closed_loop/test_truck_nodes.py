"""A controller on a bus with the truck's other nodes: it counts them, and nothing else is new."""

from __future__ import annotations

import json
from pathlib import Path

from meshpoint.bus.logs.reader import read_log
from meshpoint.cli.main import main
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.link import read_alone
from meshpoint.dbc.truck import TRUCK_SCHEMA

OTHERS = {spec.can_id for spec in TRUCK_SCHEMA.messages}


def test_its_shifts_are_made_and_its_log_is_verified(tmp_path: Path) -> None:
    log, result = tmp_path / "run.log", tmp_path / "run.json"
    asked = ["simulate", "--truck", "--shifts", "2", "--seed", "3"]
    assert main([*asked, "--log", str(log), "--json", str(result)]) == 0
    assert main(["replay", str(log), "--verify"]) == 0
    frames = [frame for _, frame in read_log(log)]
    others = [frame for frame in frames if frame.can_id in OTHERS]
    assert {frame.can_id for frame in others} == OTHERS
    status = next(
        found
        for frame in reversed(frames)
        if (found := read_alone(CODECS["ControllerStatus"], frame)) is not None
    )
    assert len(others) - 10 <= status.foreign_frames <= len(others)
    assert (status.guard_blocks, status.format_errors, status.e2e_errors) == (0, 0, 0)
    shifts = json.loads(result.read_text())["shifts"]
    assert [shift["result"] for shift in shifts] == ["engaged"] * 2
