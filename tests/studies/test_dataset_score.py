"""The data set's scorer against figures worked out by hand, and what it says of a bad file."""

import ast
import json
import math
import sys
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from benchmarks.dataset.task import score

TASK = Path(score.__file__).parent
CONTACTS = (
    ("a", "upshift", "test", "target_phase", 0.5),
    ("b", "upshift", "test", "speed_window", 3.5),
    ("c", "downshift", "test", "speed_window", -1.0),
    ("d", "downshift", "train", "target_phase", 0.0),
)
GOOD = "shift,phase_deg,sd_deg\na,0.8,0.2\nb,-3.5,\nc,-3.0,1.1\n"
"""Errors: 0.3; -7 is 0.5 within half a pitch of 7.5; -2. In half a gap: two of three. Two have a
standard deviation, and are 1.5 and 1.8 of it off."""


@pytest.fixture
def truth(tmp_path: Path) -> Path:
    path = tmp_path / "contacts.parquet"
    names = ("shift", "kind", "split", "strategy", "phase_deg")
    rows = [dict(zip(names, row, strict=True)) for row in CONTACTS]
    pitch = {"pitch_deg": 7.5, "half_gap_deg": 0.75}
    pq.write_table(pa.Table.from_pylist([row | pitch for row in rows]), path)
    return path


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "mine.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_score_is_what_is_worked_out_by_hand(tmp_path, truth, capsys) -> None:
    assert score.main([str(written(tmp_path, GOOD)), str(truth), "--json"]) == score.SCORED
    found = json.loads(capsys.readouterr().out)
    assert found["all"] == {
        "shifts": 3,
        "rms_deg": round(math.sqrt((0.3**2 + 0.5**2 + 2.0**2) / 3), 4),
        "mean_deg": round((0.3 + 0.5 - 2.0) / 3, 4),
        "in_half_gap": 0.6667,
        "in_1_sd": 0.0,
        "in_2_sd": 1.0,
    }
    assert found["kind upshift"]["shifts"] == 2
    assert found["kind upshift"]["rms_deg"] == round(math.sqrt((0.3**2 + 0.5**2) / 2), 4)
    assert found["kind downshift"]["rms_deg"] == 2.0
    assert found["strategy speed_window"]["in_half_gap"] == 0.5


def test_radians_in_parquet_are_the_same(tmp_path, truth) -> None:
    path = tmp_path / "mine.parquet"
    said = {"a": (0.8, 0.2), "b": (-3.5, None), "c": (-3.0, 1.1)}
    rows = [
        {
            "shift": shift,
            "phase_rad": math.radians(phase),
            "sd_rad": None if sd is None else math.radians(sd),
        }
        for shift, (phase, sd) in said.items()
    ]
    pq.write_table(pa.Table.from_pylist(rows), path)
    assert score.score(path, truth, "test") == score.score(written(tmp_path, GOOD), truth, "test")


def test_limit_is_an_exit_code(tmp_path, truth) -> None:
    path = str(written(tmp_path, GOOD))
    assert score.main([path, str(truth), "--most-rms", "2"]) == score.SCORED
    assert score.main([path, str(truth), "--most-rms", "1"]) == score.OVER


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("shift,angle\na,1\n", "no column phase_deg or phase_rad; found are shift, angle"),
        ("phase_deg\n1\n", "no column shift; found are phase_deg"),
        ("shift,phase_deg,phase_rad\na,1,1\n", "phase_deg and phase_rad, allowed is one"),
        ("shift,phase_deg,sd\na,1,1\n", "column 'sd', allowed are shift"),
        ("shift,phase_deg\na,1\na,2\nb,1\nc,1\n", "shift: 'a' more than once"),
        ("shift,phase_deg\na,1\nb,1\n", "1 of the 3 shifts of the split 'test' are missing: 'c'"),
        ("shift,phase_deg\na,1\nb,1\nc,1\nx,1\n", "shift: 'x', allowed are those of"),
        ("shift,phase_deg\na,1\nb,nan\nc,1\n", "phase_deg of shift 'b': no number, allowed is a"),
        ("shift,phase_deg\na,1\nb,one\nc,1\n", "phase_deg: holds string, allowed are numbers"),
        ("shift,phase_deg,sd_deg\na,1,1\nb,1,0\nc,1,\n", "sd_deg of shift 'b': 0, allowed is"),
        ("shift,phase_deg\na,1,2\n", "no csv file"),
        ("", "no csv file"),
    ],
)
def test_bad_predictions_are_named(tmp_path, truth, capsys, text, words) -> None:
    path = written(tmp_path, text)
    assert score.main([str(path), str(truth)]) == score.WRONG
    said = capsys.readouterr().err
    assert str(path) in said
    assert words in said


def test_bad_files_are_named(tmp_path, truth, capsys) -> None:
    mine = written(tmp_path, GOOD)
    for arguments, words in (
        ((tmp_path / "none.csv", truth), "cannot be read"),
        ((tmp_path / "mine.txt", truth), "ends in '.txt', allowed are .csv and .parquet"),
        ((mine, mine), "no column 'kind'; this is not truth/contacts.parquet"),
    ):
        assert score.main([str(each) for each in arguments]) == score.WRONG
        assert words in capsys.readouterr().err


def test_programs_of_the_set_need_numpy_and_pyarrow_alone() -> None:
    for file in TASK.glob("*.py"):
        allowed = {"numpy", "pyarrow", *sys.stdlib_module_names}
        allowed |= set() if file.name == "score.py" else {"known"}
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                names = [node.module or "."]
            else:
                continue
            assert {name.partition(".")[0] for name in names} <= allowed, file.name
