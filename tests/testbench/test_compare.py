"""`meshpoint compare`: the same is the same, and what differs is named where it does."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from meshpoint.cli.main import main

RUN = ["simulate", "--preset", "thesis", "--shifts", "2"]
Runs = dict[str, Path]


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Runs:
    """Logs and records of the same two shifts: twice alike, and with another strategy."""
    folder = tmp_path_factory.mktemp("compare")
    made = {}
    for name, more in (
        ("a", ["--seed", "3"]),
        ("other", ["--seed", "3", "--strategy", "speed_window_anticipating"]),
    ):
        log, record = folder / f"{name}.log", folder / f"{name}.json"
        assert main([*RUN, *more, "--log", str(log), "--json", str(record)]) == 0
        made[f"{name}.log"], made[f"{name}.json"] = log, record
    for kind in ("log", "json"):
        made[f"same.{kind}"] = shutil.copy(made[f"a.{kind}"], folder / f"same.{kind}")
    return made


def compared(tmp_path: Path, *words: str) -> tuple[int, dict[str, Any]]:
    out = tmp_path / "out.json"
    code = main(["compare", *words, "--json", str(out)])
    values: dict[str, Any] = json.loads(out.read_text())
    return code, values


def test_the_same_run_is_the_same(runs: Runs, tmp_path: Path) -> None:
    for kind in ("log", "json"):
        words = str(runs[f"a.{kind}"]), str(runs[f"same.{kind}"])
        code, values = compared(tmp_path, *words)
        assert (code, values["same"]) == (0, True)


def test_two_strategies_part_at_a_step_and_each_says_what_it_knew(
    runs: Runs, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = tmp_path / "page.html"
    words = str(runs["a.log"]), str(runs["other.log"]), "--report", str(page)
    code, values = compared(tmp_path, *words)
    assert code == 1
    parting = values["parting"]
    assert parting["messages"]
    # until the controllers part, the rig has answered alike
    assert parting["inputs_differ_from"] is None
    knew = [parting[side]["knew"] for side in ("a", "b")]
    assert knew[0]["layshaft_speed_rad_s"] == knew[1]["layshaft_speed_rad_s"]
    assert "ControllerStatus" in {message["name"] for message in values["messages"]}
    text = page.read_text(encoding="utf-8")
    assert f"part at step {parting['step']}" in text
    first, *details = capsys.readouterr().out.splitlines()
    assert first == f"{len(values['messages'])} messages differ"
    assert any("part at step" in line for line in details)


def flat(row: dict[str, Any]) -> dict[str, Any]:
    """A shift's fields, those of its phases among them."""
    phases = {f"phases.{name}": value for name, value in row["phases"].items()}
    return {name: value for name, value in row.items() if name != "phases"} | phases


def test_records_differ_shift_by_shift(runs: Runs, tmp_path: Path) -> None:
    code, values = compared(tmp_path, str(runs["a.json"]), str(runs["other.json"]))
    assert code == 1
    a, b = (json.loads(runs[f"{name}.json"].read_text()) for name in ("a", "other"))
    before, after = ([flat(row) for row in values["shifts"]] for values in (a, b))
    expected = {
        f"shifts.{k}.{name}": (row[name], after[k][name])
        for k, row in enumerate(before)
        for name in row
        if row[name] != after[k][name]
    }
    assert expected
    found = {one["path"]: (one["a"], one["b"]) for one in values["differences"]}
    assert {path: pair for path, pair in found.items() if path.startswith("shifts.")} == expected
    assert values["shifts"] == sorted({".".join(path.split(".")[:2]) for path in expected})


def test_two_records_of_the_same_shifts_say_which_was_better(tmp_path: Path) -> None:
    """Of a strategy of one's own beside ours: `simulate --json` of both."""
    for name, contact, duration in (("a", "tooth", 500.0), ("b", "gap", 450.0)):
        rows = [
            {"from": 8, "to": 10, "result": "engaged", "contact": contact,
             "duration_ms": duration + k, "impact_j": 1.0}
            for k in range(6)
        ]  # fmt: skip
        (tmp_path / f"{name}.json").write_text(json.dumps({"shifts": rows}))
    words = str(tmp_path / "a.json"), str(tmp_path / "b.json")
    assert compared(tmp_path, *words)[1]["verdict"] == (
        "On the same 6 shifts B is better than A: first contact in a gap 6 instead of 0 of 6 "
        "(better, beyond chance); time 452 instead of 502 ms (better, beyond chance); impact 1.00 "
        "instead of 1.00 J."
    )
    (tmp_path / "b.json").write_text(json.dumps({"shifts": rows[1:]}))
    assert compared(tmp_path, *words)[1]["verdict"] == ""


def test_tolerances_and_ignored_fields_decide(tmp_path: Path) -> None:
    for name, duration, version in (("a", 400.0, "1"), ("b", 404.0, "2")):
        row = {"duration_ms": duration, "slip_rpm": 20.0, "contact": "gap"}
        values = {"version": version, "shifts": [row]}
        (tmp_path / f"{name}.json").write_text(json.dumps(values))
    words = str(tmp_path / "a.json"), str(tmp_path / "b.json")
    assert compared(tmp_path, *words)[0] == 1
    assert compared(tmp_path, *words)[1]["differences"] == [
        {"path": "shifts.0.duration_ms", "a": 400.0, "b": 404.0}
    ]
    assert compared(tmp_path, *words, "--tolerance", "3.9")[0] == 1
    assert compared(tmp_path, *words, "--tolerance", "4")[0] == 0
    assert compared(tmp_path, *words, "--tolerance", "slip_rpm=4")[0] == 1
    assert compared(tmp_path, *words, "--tolerance", "duration_ms=4")[0] == 0
    assert compared(tmp_path, *words, "--ignore", "shifts.*.duration_ms")[0] == 0
    assert compared(tmp_path, *words, "--ignore", "duration_ms")[0] == 0


def test_settings_are_compared_with_their_defaults(tmp_path: Path) -> None:
    one, two = tmp_path / "a.toml", tmp_path / "b.toml"
    one.write_text("[window]\nfire_slip_rpm = 15.0\n")
    two.write_text("")
    code, values = compared(tmp_path, str(one), str(two))
    assert code == 1
    (found,) = values["settings"]
    assert found["path"] == "window.fire_slip_rad_s"
    assert compared(tmp_path, str(two), str(two))[0] == 0


@pytest.mark.long
def test_two_settings_part_in_the_shifts_of_a_log(runs: Runs, tmp_path: Path) -> None:
    """Against the recorded settings: both parted from the log at the step that `replay` names."""
    recorded, later = tmp_path / "recorded.toml", tmp_path / "later.toml"
    recorded.write_text("")
    later.write_text('strategy = "speed_window_anticipating"\n')
    page, reported = tmp_path / "page.html", tmp_path / "replay.json"
    log = str(runs["a.log"])
    words = str(recorded), str(later), "--log", log, "--report", str(page)
    code, values = compared(tmp_path, *words)
    assert code == 1
    assert main(["replay", log, "--settings", str(later), "--json", str(reported)]) == 0
    rows = json.loads(reported.read_text())["shifts"]
    assert len(values["shifts"]) == len(rows) == 2
    parted = 0
    for shift, row in zip(values["shifts"], rows, strict=True):
        assert shift["a"]["parted"] is None
        assert shift["a"]["fired_ms"] == row["recorded"]["fired_ms"]
        assert shift["b"]["fired_ms"] == row["fired_ms"]
        if row["parted"] is None:
            continue
        parted += 1
        parting = shift["parting"]
        assert parting["at_ms"] <= row["parted"]["at_ms"]
        assert parting["messages"]
        # the same frames until there: what is measured is the same
        assert parting["a"]["layshaft_speed_rad_s"] == parting["b"]["layshaft_speed_rad_s"]
        assert "fired_ms" in shift["differences"]
    assert parted
    assert page.read_text(encoding="utf-8").count("What each knew there") >= parted
    assert compared(tmp_path, str(later), str(later), "--log", log)[0] == 0


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("a.json", "a.json", "--log", "x.log"), "must be two .toml"),
        (("a.json", "b.log"), "allowed are two logs"),
        (("a.json", "missing.json"), "No such file"),
        (("a.json", "a.json", "--tolerance", "-1"), "0 or more"),
    ],
)
def test_bad_input_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], said: str
) -> None:
    (tmp_path / "a.json").write_text("{}")
    given = [str(tmp_path / w) if w.endswith((".json", ".log")) else w for w in words]
    try:
        code = main(["compare", *given])
    except SystemExit as error:
        code = int(error.code or 0)
    assert code == 2
    assert said in capsys.readouterr().err
