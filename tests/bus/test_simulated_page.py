"""docs/simulated_bus.md: its blocks run as they stand there, and other projects' code runs on the
simulated bus by configuration alone."""

from __future__ import annotations

import re
import runpy
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import pytest
from patience import until

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "simulated_bus.md").read_text(encoding="utf-8")
BIT_MS = 1e-3
"""At the bit rate that the page's environment asks for."""
SHORTEST = 47 + 8 * 8
"""Bits of a standard frame of eight bytes without stuff bits, intermission included."""


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)


@pytest.fixture
def configured(monkeypatch: pytest.MonkeyPatch) -> None:
    """The environment as the page exports it."""
    (line,) = re.findall(r"^export (.*)$", PAGE, re.MULTILINE)
    for word in shlex.split(line):
        monkeypatch.setenv(*word.split("=", 1))


@pytest.fixture(scope="module")
def example() -> dict[str, Any]:
    return runpy.run_path(str(ROOT / "examples" / "simulated_bus.py"))


def test_its_ten_lines_need_python_can_alone() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    needed = {re.split(r"[<>=]", each)[0] for each in settings["project"]["dependencies"]}
    absent = {"e2e", *(name.replace("-", "_") for name in needed - {"python-can"})}
    assert "numpy" in absent
    program = f"import sys; sys.modules.update(dict.fromkeys({absent}))\n{blocks('python')[0]}"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert float(done.stdout.split()[0]) >= 9 * 67 / 500  # the bits of an extended frame, at least


@pytest.mark.parametrize("block", blocks("python"))
def test_a_block_runs_as_it_stands(block: str) -> None:
    exec(compile(block, "simulated_bus.md", "exec"), {})


def test_its_file_configures_a_bus(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "can.conf").write_text(blocks("ini")[0])
    monkeypatch.setattr(can.util, "CONFIG_FILES", [str(tmp_path / "can.conf")])
    with can.Bus() as bus:
        assert bus.channel_info == "meshpoint_simulated channel bench"
        with pytest.raises(can.CanInitializationError, match="bitrate 1000000"):
            can.Bus(bitrate=500_000)


@pytest.mark.usefixtures("configured")
def test_the_example_finds_a_bus(example: dict[str, Any]) -> None:
    time_ms, _, state, *transfers = (answer for _, answer in example["answers"]())
    assert time_ms >= 49 * SHORTEST * BIT_MS
    assert state == "ERROR"
    frames = len(example["PAYLOAD"]) / 7 - 1
    assert all(took_ms >= frames * SHORTEST * BIT_MS for took_ms, _ in transfers)
    alone, loaded, disturbed = (errors for _, errors in transfers)
    assert alone == loaded == 0 < disturbed


@pytest.mark.usefixtures("configured")
def test_a_frame_of_higher_priority_goes_ahead_of_those_that_wait(example: dict[str, Any]) -> None:
    frames_ahead: Callable[..., int] = example["frames_ahead"]

    def overtakes() -> bool:
        """Unless this process was stopped until the frames before it had gone."""
        with can.Bus() as node, can.Bus() as other, can.Bus() as listener:
            return frames_ahead(node, other, listener) < example["FRAMES"]

    until(overtakes, "the frame handed over last is not the last on the bus")
