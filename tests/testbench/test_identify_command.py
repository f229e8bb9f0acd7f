"""`meshpoint identify`: which data sheet it begins with."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from meshpoint.cli.main import main

SHEET = (
    'based_on = "truck12"\nname = "own"\n[wheels.layshaft]\nteeth = 50\n[wheels.main]\nteeth = 60\n'
)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One shift of a gearbox with sensor wheels of its own."""
    folder = tmp_path_factory.mktemp("own")
    (folder / "own.toml").write_text(SHEET, encoding="utf-8")
    assert main(["simulate", "--gearbox", str(folder / "own.toml"), "--shifts", "1",
                 "--log", str(folder / "own.log")]) == 0  # fmt: skip
    return folder / "own.log"


def reported(log: Path, capsys: pytest.CaptureFixture[str], *more: str) -> tuple[str, str]:
    """The name of the sheet in its JSON, and its first line on standard error."""
    capsys.readouterr()
    assert main(["identify", str(log), "--json", "-", *more]) == 0
    said = capsys.readouterr()
    return json.loads(said.out)["gearbox"], said.err.split("\n")[0]


def test_it_begins_with_the_sheet_of_the_log_s_run_header(
    log: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    name, said = reported(log, capsys)
    assert name.startswith("own (header-")
    assert said.endswith("by the log's run header")
    assert reported(log, capsys, "--gearbox", "truck12") == ("truck12", "")
    alone = tmp_path / "alone.log"
    alone.write_bytes(log.read_bytes())
    name, said = reported(alone, capsys)
    assert name == "truck12"
    assert said.endswith("no run header says another (--gearbox)")
    assert main(["identify", str(log), "-o", str(tmp_path / "found.toml")]) == 2
    assert "needs --gearbox" in capsys.readouterr().err


def test_a_log_that_is_not_there_is_all_that_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    there = tmp_path / "there.log"
    there.write_text("nonsense\n")
    assert main(["identify", str(there), str(tmp_path / "run.toml")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "run.toml" in line and "No such file" in line


def test_a_log_that_is_named_twice_is_refused(
    log: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """By its own name, by another one, and by its folder: its shifts would count twice."""
    alias = tmp_path / "alias.log"
    alias.symlink_to(log)
    for again in (log, alias, log.parent):
        assert main(["identify", str(log), str(again)]) == 2
        assert "is the same log as" in capsys.readouterr().err
