"""Bad input on the command line: exit code 2 and one line that says what is allowed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from meshpoint.testbench.cli import main


def refusal(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Runs a command that must be refused; its one line."""
    try:
        code = main(arguments)
    except SystemExit as stop:
        code = int(stop.code or 0)
    out, err = capsys.readouterr()
    assert code == 2
    assert out == ""
    assert "Traceback" not in err
    lines = [line for line in err.splitlines() if "error" in line]
    assert len(lines) == 1
    return lines[0]


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ("simulate --shifts 0", ("shifts", "0", "1")),
        ("simulate --shifts 1.5", ("shifts", "1.5")),
        ("simulate --strategy hope", ("strategy", "hope", "target_phase")),
        ("simulate --preset thesis --pairs 8-9 --shifts 1", ("8-9", "8-10")),
        ("simulate --gearbox lorry --shifts 1", ("lorry", "thesis")),
        ("simulate --settings nowhere.toml --shifts 1", ("nowhere.toml",)),
        ("demo -i virtual --shifts 1 --as-built nowhere.toml", ("nowhere.toml",)),
        ("demo -i virtual --shifts 1 --faults nowhere.toml", ("nowhere.toml",)),
        ("replay nowhere.log", ("nowhere.log",)),
        ("fly", ("fly", "simulate")),
    ],
)
def test_a_mistake_is_told_in_one_line(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    arguments: str,
    named: tuple[str, ...],
) -> None:
    monkeypatch.chdir(tmp_path)
    line = refusal(capsys, *arguments.split())
    for word in named:
        assert word in line
    assert list(tmp_path.iterdir()) == []


def test_a_bad_setting_is_named_with_its_file(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = tmp_path / "bench.toml"
    path.write_text("[limits]\nattempts = 99\n")
    line = refusal(capsys, "simulate", "--settings", str(path), "--shifts", "1")
    for word in ("bench.toml", "attempts", "99", "1", "10"):
        assert word in line


def test_simulate_prints_nothing_but_json_where_json_is_asked_for(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["simulate", "--shifts", "1", "--seed", "3", "--json", "-"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert [(row["from"], row["to"], row["result"]) for row in report["shifts"]] == [
        (8, 10, "engaged")
    ]
