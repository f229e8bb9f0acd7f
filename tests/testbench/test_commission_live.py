"""`commission` and `rig --stand`, each a process of its own, on the local bus."""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from live_command import live

from meshpoint.controller.valve_name import ValveName
from meshpoint.testbench.cli import main

pytestmark = pytest.mark.timeout(900)


@pytest.fixture
def channel() -> Iterator[str]:
    with tempfile.TemporaryDirectory(prefix="mpc-") as folder:
        yield f"unix:{folder}/bus.sock"


def test_each_output_of_a_rig_that_stands_moves_its_own_sleeve(
    channel: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["commission", "-c", channel, "--yes", "--json", "-"]
    with live(tmp_path, "rig", "-c", channel, "--stand") as rig:
        rig.until_said("on meshpoint channel")
        code = main(words)
    result = json.loads(capsys.readouterr().out)
    found = {f["subject"]: f["verdict"] for f in result["findings"]}
    assert found == {valve.name.lower(): "good" for valve in ValveName}, result
    assert (code, result["ready"]) == (0, True), result["reason"]


def test_a_rig_stands_or_has_a_speed(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["rig", "--stand", "--main-speed", "600"])
    assert ended.value.code == 2
    assert "--main-speed: not allowed with argument --stand" in capsys.readouterr().err
