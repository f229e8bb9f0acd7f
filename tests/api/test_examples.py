"""What stands in examples/ runs as it stands there."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import pytest

import meshpoint

EXAMPLES = Path(__file__).parents[2] / "examples"


def lines_of(path: Path, name: str) -> int:
    """Lines of a class that hold something."""
    text = path.read_text()
    body = re.split(r"\n(?=\S)", text[text.index(f"class {name}") :], maxsplit=1)[0]
    return sum(bool(line.strip()) for line in body.splitlines())


def test_own_strategy_has_thirty_lines_and_shifts() -> None:
    path = EXAMPLES / "own_strategy.py"
    assert lines_of(path, "NextGap") <= 30
    with meshpoint.Bench(preset="thesis", strategy=f"{path}:NextGap") as bench:
        assert bench.shift(10).result == "engaged"


def test_own_controller_has_sixty_lines_and_shifts() -> None:
    path = EXAMPLES / "own_controller.py"
    assert lines_of(path, "SpeedWindow") <= 60
    made = runpy.run_path(str(path))["SpeedWindow"]
    sheet = meshpoint.load_gearbox("thesis")
    with meshpoint.Bench(controller=made(sheet), gearbox=sheet, preset="thesis") as bench:
        row = bench.shift(10)
        again = bench.shift(10, from_gear=8)
    assert (row.from_, row.to, row.result) == (8, 10, "engaged")
    assert again.result == "engaged" and again.contact in ("gap", "tooth")
    assert 0.0 < row.slip_rpm < 40.0


@pytest.mark.long
def test_the_hardware_loop_runs_on_a_bus_in_this_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    main = runpy.run_path(str(EXAMPLES / "hardware_loop.py"))["main"]
    assert main(["-i", "virtual", "-c", "hardware_loop", "--shifts", "1"]) == 0
    said = capsys.readouterr().out
    assert "8 -> 10: engaged" in said
    assert "log hardware_loop.log: identical" in said


def test_the_settings_for_an_emulated_machine_are_those_that_compute_least() -> None:
    settings = meshpoint.load_settings(EXAMPLES / "emulated.toml")
    assert (settings.strategy_name, settings.estimator_name) == ("speed_window", "thesis")
