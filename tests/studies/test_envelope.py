"""The envelope: its rows can be made, are made once, and fall where figures say so."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.envelope import command
from benchmarks.envelope.command import main
from benchmarks.envelope.making import OWN, ROW_FILE, SAID_FILE, Product, Work
from benchmarks.envelope.rows import DOWN, GROUPS, NEIGHBOURS, ROWS, Row, changes
from benchmarks.envelope.verdict import FIGURES, Pairs, chance, holm, pairs, verdicts
from meshpoint.base.errors import CommandError
from meshpoint.base.exits import Exit
from meshpoint.campaigns.columns import FIELDS, Shifts
from meshpoint.campaigns.record import JudgedShift
from meshpoint.campaigns.stored import write_shifts
from meshpoint.cli import arguments
from meshpoint.cli.table import build_parser
from meshpoint.gearbox.gears import DRIVE_GEARS

TINY = {"gearboxes": 1, "learn": 0, "judged": 1, "profile": "clean"}


@pytest.mark.parametrize("row", ROWS.values(), ids=ROWS)
def test_every_row_is_a_campaign_that_can_be_made(row: Row, tmp_path: Path) -> None:
    product = Product("", tmp_path)
    words = Work(product, row, true_state=True).arguments(tmp_path)
    given = build_parser("campaign").parse_args(words)
    sheet, built = arguments.sheet_of(given), arguments.as_built_of(given)
    settings = arguments.settings_of(given)
    assert built.profile == row.profile
    assert bool(built.fixed) == bool(row.as_built)
    assert (sheet.name == "truck12") == (not row.sheet)
    assert settings.strategy_name == OWN
    assert (settings.timing.tick_ms != 10) == bool(row.settings)


def test_no_two_rows_have_a_name_or_are_the_same() -> None:
    rows = [row for group in GROUPS for row in group.rows]
    assert len(ROWS) == len(rows)
    looks = {
        tuple(v for k, v in vars(row).items() if k not in ("name", "changed", "why"))
        for row in rows
    }
    assert len(looks) == len(rows)


def test_kinds_of_shift_are_what_they_are_called() -> None:
    assert set(changes({"main"}, 1)) >= {(8, 10), (13, 1)}
    assert set(DOWN) == {(after, before) for before, after in changes({"main"}, 1)}
    assert set(changes({"main"}, 2)) == {(1, 5), (2, 6), (7, 11), (8, 12), (13, 3), (14, 4)}
    assert all(DRIVE_GEARS[a].main is DRIVE_GEARS[b].main for a, b in changes({"split"}, 0))
    assert {gear for pair in NEIGHBOURS for gear in pair} == set(DRIVE_GEARS)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A table of one tiny row."""
    folder = tmp_path_factory.mktemp("envelope")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(command, "ROWS", tiny_rows())
        assert envelope(folder, "--markdown", str(folder / "page.md")) == Exit.DONE
    return folder


def tiny_rows() -> dict[str, Row]:
    return {"gap_33": replace(ROWS["gap_33"], **TINY)}


def envelope(folder: Path, *more: str) -> int:
    json_file = ["--json", str(folder / "table.json")]
    return main(["--jobs", "1", "--out", str(folder / "out"), *json_file, *more])


def values_of(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / "table.json").read_text())
    return found


def test_a_row_has_every_column(made: Path) -> None:
    values = values_of(made)
    found = values["rows"]["gap_33"]
    assert found["shifts"] == 1
    assert (found["not_engaged"], found["refused"], found["outside_window"]) == (0, 0, 0)
    assert found["gap"]["rate"] in (0.0, 1.0)
    assert found["true_state"] in (0.0, 1.0)
    assert found["after_ramp_ms"]["mean"] == found["after_ramp_ms"]["p99"] > 100.0
    assert found["duration_ms"] >= found["after_ramp_ms"]["mean"], "from the request on"
    assert values["conditions"]["seeds"] == [900]
    page = (made / "page.md").read_text()
    assert "Simulated:" in page
    line = next(line for line in page.splitlines() if line.startswith("| `gap_33`"))
    head = next(line for line in page.splitlines() if line.startswith("| row"))
    assert line.count("|") == head.count("|")


def test_a_row_that_is_made_is_not_made_again(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(command, "ROWS", tiny_rows())
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    said = next(tmp_path.rglob(SAID_FILE))
    said.unlink()
    assert envelope(tmp_path) == Exit.BAD_INPUT
    assert envelope(tmp_path, "--resume") == Exit.DONE
    assert not said.exists()
    assert values_of(tmp_path)["rows"] == values_of(made)["rows"]
    assert envelope(tmp_path, "--resume", "--seed", "1") == Exit.BAD_INPUT


def test_a_row_that_fell_against_a_commit_is_exit_code_1(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The commit's rows stand beside; there all shifts met their gap, and now none does."""
    row = tiny_rows()["gap_33"]
    monkeypatch.setattr(command, "ROWS", {row.name: row})
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    now = next(tmp_path.rglob(ROW_FILE)).parent
    before = Product("commit before", tmp_path / "out" / "before")
    shutil.copytree(now, before.row(row))
    monkeypatch.setattr(command, "of_commit", lambda _reference, _out: before)
    assert envelope(tmp_path, "--resume", "--against", "before") == Exit.DONE
    assert values_of(tmp_path)["rows"][row.name]["against"]["verdict"] == "same"
    write(before.table(row), *(shift(seed) for seed in range(20)))
    write(now / before.table(row).name, *(shift(seed, contact="tooth") for seed in range(20)))
    assert envelope(tmp_path, "--resume", "--against", "before") == Exit.FAILED
    found = values_of(tmp_path)["rows"][row.name]["against"]
    assert (found["verdict"], found["in"]) == ("fell", ["missed"])


def test_a_row_that_cannot_be_made_says_why(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """As one with an option that the product of an old commit has not."""
    row = replace(tiny_rows()["gap_33"], words=("--warp", "9"))
    monkeypatch.setattr(command, "ROWS", {row.name: row})
    assert envelope(tmp_path) == Exit.FAILED
    said = capsys.readouterr().err
    assert "gap_33, " in said
    assert "its campaign ended with 2" in said
    assert "--warp 9" in said


def test_a_row_nobody_knows_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--only", "moon"])
    assert "hall_40" in capsys.readouterr().err


def shift(seed: int, **values: Any) -> JudgedShift:
    """A judged shift that met its gap in 400 ms, but for these values."""
    nothing: dict[str, Any] = {
        name: None if field.is_optional else field.kind() for name, field in FIELDS.items()
    }
    usual = {"strategy": OWN, "result": "engaged", "contact": "gap", "duration_ms": 400.0}
    return JudgedShift(**nothing | usual | {"seed": seed} | values)


def write(path: Path, *records: JudgedShift) -> Path:
    write_shifts(path, Shifts.of(records))
    return path


def test_pairs_are_of_the_same_draws(tmp_path: Path) -> None:
    before = write(tmp_path / "before.parquet", shift(1), shift(2, contact="tooth"), shift(4))
    after = write(
        tmp_path / "after.parquet",
        shift(1, contact="tooth", duration_ms=500.0),
        shift(2, result="failed", contact=None, duration_ms=None),
        shift(3),
        shift(4, result="refused", contact=None, duration_ms=None),
    )
    found = pairs(before, after, OWN)
    assert found.shifts == 3
    assert {name: each.tolist() for name, each in found.more.items()} == {
        "missed": [1.0, 0.0, 1.0],
        "not_engaged": [0.0, 1.0, 1.0],
        "duration_ms": [100.0, 0.0, 0.0],
        "impact_j": [0.0, 0.0, 0.0],
    }
    other = write(tmp_path / "other.parquet", shift(1, layshaft_rpm=1.0))
    with pytest.raises(CommandError, match="run 1 was not drawn as in"):
        pairs(before, other, OWN)
    with pytest.raises(CommandError, match="no shift that is in"):
        pairs(before, write(tmp_path / "none.parquet", shift(9)), OWN)


def test_what_both_refuse_is_no_pair(tmp_path: Path) -> None:
    refused = shift(1, result="refused", contact=None)
    table = write(tmp_path / "before.parquet", refused, shift(2))
    assert pairs(table, table, OWN).shifts == 1


@pytest.mark.parametrize(
    ("more", "probability"),
    [
        ([0.0, 0.0], 1.0),
        ([1.0], 1 / 2),
        ([1.0, 1.0, 1.0, 0.0], 1 / 8),
        ([2.0, -1.0], 2 / 4),
        ([-1.0, -1.0], 1.0),
    ],
)
def test_the_chance_of_as_much_or_more_by_signs_alone(
    more: list[float], probability: float
) -> None:
    assert chance(np.array(more)) == pytest.approx(probability)


def test_many_gearboxes_are_counted_by_signs_drawn() -> None:
    """Forty that differ by one: 26 to 14 or further, 4.0 % by the binomial distribution."""
    assert chance(np.array([1.0] * 26 + [-1.0] * 14)) == pytest.approx(0.0403, abs=0.003)


def test_the_number_of_rows_is_counted() -> None:
    assert holm([0.01, 0.04, 0.02]) == pytest.approx([0.03, 0.04, 0.04])
    assert holm([0.9, 0.8]) == pytest.approx([1.0, 1.0])


def row_pairs(**more: list[float]) -> Pairs:
    zeros = {name: np.zeros(40) for name in FIGURES}
    given = {name: np.array(each + [0.0] * (40 - len(each))) for name, each in more.items()}
    means = dict.fromkeys(FIGURES, 0.0)
    return Pairs(120, zeros | given, means, means)


def test_a_row_falls_by_more_than_chance_with_all_rows_counted() -> None:
    """Of 40 rows one with seven gearboxes worse and none better is doubtful (1 of 128 by chance),
    with eleven it fell (1 of 2,048, times 40); alone seven are enough."""
    same = {f"same_{k}": row_pairs() for k in range(37)}
    rows = {
        "doubtful": row_pairs(missed=[1.0] * 7),
        "fell": row_pairs(not_engaged=[1.0] * 11),
        "rose": row_pairs(missed=[-1.0] * 11),
    }
    found = verdicts(rows | same)
    assert {name: found[name]["verdict"] for name in rows} == {name: name for name in rows}
    assert found["fell"]["in"] == ["not_engaged"]
    assert {found[name]["verdict"] for name in same} == {"same"}
    assert verdicts({"alone": rows["doubtful"]})["alone"]["verdict"] == "fell"


def test_every_figure_of_a_row_can_fall() -> None:
    for figure in FIGURES:
        found = verdicts({"row": row_pairs(**{figure: [1.0] * 8})})["row"]
        assert (found["verdict"], found["in"]) == ("fell", [figure])
