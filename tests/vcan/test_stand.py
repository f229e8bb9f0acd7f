"""A gearbox that stands, behind a board's firmware, on a real vcan0."""

from __future__ import annotations

import json
import signal
from collections.abc import Iterator
from pathlib import Path
from time import monotonic

import pytest
from patience import HANG_S, Patience, until
from vcan_bench import LOOK_S, SPEED, VCAN, Command, meshpoint

from meshpoint.base.errors import CommandError
from meshpoint.bench.boards import board_of
from meshpoint.cli.table import build_parser
from meshpoint.controller.settings.valve_name import ValveName
from meshpoint.firmware.board import Firmware

for _name in ("check", "commission"):
    build_parser(_name)  # loads the command, before anything is forked

TIMES = {Firmware.NATIVE: 2.5, Firmware.CORTEX_M4: 0.5}
"""Of the speed of time that rig and controller with all that watches them keep up with: a rig alone
costs less, an emulated board on an emulated processor more."""
BUS = VCAN.options("vcan0")


@pytest.fixture(params=list(TIMES))
def standing(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[list[str]]:
    """How others get onto the bus time that waits for the rig."""
    try:
        board_of(request.param)
    except CommandError as error:
        pytest.skip(str(error))
    VCAN.prepare()
    pace = tmp_path / "bus.time"
    speed = ["--speed", str(TIMES[request.param] * SPEED)]
    timed = [*BUS, "--pace", str(pace), *speed]
    keeper = Command(tmp_path, "up", "--pace-only", str(pace), *speed)
    until(lambda: keeper.poll() is not None or pace.exists(), "a bus time")
    rig = Command(tmp_path, "rig", "--stand", "--firmware", request.param, *timed)
    try:
        # It loads for a minute on an emulated processor, while bus time waits for nobody.
        patience = Patience(HANG_S, monotonic)
        until(lambda: "on socketcan" in rig.said, "the rig", patience=patience, poll_s=LOOK_S)
        yield timed
        rig.signal(signal.SIGTERM)
        assert rig.wait() == 0, rig.said
    finally:
        for command in (rig, keeper):
            command.signal(signal.SIGTERM)
            command.wait()


def test_a_rig_behind_firmware_is_ready_and_each_output_moves_its_own_sleeve(
    standing: list[str], tmp_path: Path
) -> None:
    for _ in range(9):  # a busy machine may keep the rig from running just while it listens
        checked = meshpoint(tmp_path, "check", *standing, "--seconds", "1")
        if checked.returncode == 0:
            break
    assert checked.returncode == 0, checked.printed + checked.said
    record = tmp_path / "found.json"
    commissioned = meshpoint(tmp_path, "commission", "--yes", *standing, "--json", str(record))
    assert commissioned.returncode == 0, commissioned.printed + commissioned.said
    found = {f["subject"]: f["verdict"] for f in json.loads(record.read_text())["findings"]}
    assert found == {valve.name.lower(): "good" for valve in ValveName}
