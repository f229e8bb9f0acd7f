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


@pytest.fixture
def ask(configured: None, example: dict[str, Any]) -> Callable[..., Any]:
    """One of the example's questions, on nodes of its own."""

    def answer(question: str, *cyclic: object) -> Any:
        with can.Bus() as node, can.Bus() as other, can.Bus() as listener:
            return example[question](node, other, listener, *cyclic)

    return answer


def test_a_burst_takes_the_time_of_its_bits(ask: Callable[..., float]) -> None:
    assert ask("time_on_the_bus_ms") >= 49 * SHORTEST * BIT_MS


def test_a_node_that_spoils_its_own_frames_goes_bus_off(ask: Callable[..., str]) -> None:
    assert ask("state_after_errors") == "ERROR"


def test_isotp_gets_through_beside_higher_priority_and_error_frames(
    ask: Callable[..., tuple[int, int]], example: dict[str, Any]
) -> None:
    """Fewer frames than in the example, which a busy machine cannot make."""
    took_ms, errors = ask("isotp_transfer", (example["frame"](0x010), 0.01), example["ERRORS"])
    assert took_ms >= (len(example["PAYLOAD"]) / 7 - 1) * SHORTEST * BIT_MS
    assert errors > 0


def test_a_frame_of_higher_priority_goes_ahead_of_those_that_wait(ask: Callable[..., int]) -> None:
    """Unless this process was stopped until the frames before it had gone."""
    until(lambda: ask("frames_ahead") < 50, "the frame handed over last is not the last")


@pytest.mark.long
@pytest.mark.usefixtures("configured")
def test_the_example_has_all_its_answers(example: dict[str, Any]) -> None:
    *_, alone, loaded, disturbed = (answer for _, answer in example["answers"]())
    assert alone[1] == loaded[1] == 0 < disturbed[1]
