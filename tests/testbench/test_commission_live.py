"""`check`, `commission` and `rig --stand`, processes of their own, on the local bus."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from live_command import live

from meshpoint.base.errors import CommandError
from meshpoint.bench.boards import board_of
from meshpoint.cli.main import main
from meshpoint.controller.settings.valve_name import ValveName
from meshpoint.firmware.board import Firmware

pytestmark = pytest.mark.timeout(900)


SPEED = ["--speed", "3"]
"""Bus time waits for a node that is silent for 14 ms of wall time, here 42 ms on the bus, where a
channel ends after 50."""


CORTEX_M4 = pytest.param(Firmware.CORTEX_M4, marks=pytest.mark.long)


@pytest.fixture(params=[None, Firmware.NATIVE, CORTEX_M4])
def standing(request: pytest.FixtureRequest, channel: str, tmp_path: Path) -> Iterator[list[str]]:
    """A rig that stands, alone or behind a board's firmware, on a bus time that waits for it; how
    others get onto that bus."""
    firmware: list[str] = []
    if request.param is not None:
        try:
            board_of(request.param)
        except CommandError as error:
            pytest.skip(str(error))
        firmware = ["--firmware", request.param]
    bus, pace = ["-c", channel], tmp_path / "bus.time"
    timed = [*bus, "--pace", str(pace), *SPEED]
    with live(tmp_path, "up", "--pace-only", str(pace), *SPEED) as keeper:
        keeper.until(pace.exists)
        with live(tmp_path, "rig", "--stand", *firmware, *timed) as rig:
            rig.until_said("on meshpoint channel")
            assert ("firmware" in rig.said) == bool(firmware)
            yield timed


def test_a_rig_that_stands_is_ready_and_each_output_moves_its_own_sleeve(
    standing: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    # A busy machine may keep the rig from running just while it listens.
    is_ready = any(main(["check", *standing, "--seconds", "2"]) == 0 for _ in range(9))
    assert is_ready, capsys.readouterr().out
    capsys.readouterr()
    code = main(["commission", *standing, "--yes", "--json", "-"])
    result = json.loads(capsys.readouterr().out)
    found = {f["subject"]: f["verdict"] for f in result["findings"]}
    bounds = "sleeve.valve_delay_ms", "brake.valve_delay_ms", "brake.time_constant_ms"
    good = {valve.name.lower(): "good" for valve in ValveName}
    assert found == good | dict.fromkeys(bounds, "unknown"), result
    assert (code, result["ready"]) == (0, True), result["reason"]


def test_a_rig_stands_or_has_a_speed(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["rig", "--stand", "--main-speed", "600"])
    assert ended.value.code == 2
    assert "--main-speed: not allowed with argument --stand" in capsys.readouterr().err
