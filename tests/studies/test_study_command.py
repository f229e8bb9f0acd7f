"""`python -m benchmarks.studies`: records, files, page; settings; the same results on any number of
workers."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path
from typing import Any

import pytest

from benchmarks.studies.command import main
from benchmarks.studies.registry import STUDY_NAMES

KEYS = {"thesis", "ours", "agrees", "reason", "files"}


def study(tmp_path: Path, *words: str, settings: str = "", workers: int = 1) -> dict[str, Any]:
    """Runs the command, and returns its JSON."""
    file = tmp_path / "changed.toml"
    file.write_text(settings, encoding="utf-8")
    target = tmp_path / "results.json"
    code = main(
        [*words, "--out", str(tmp_path / "out"), "--settings", str(file),
         "--json", str(target), "--workers", str(workers)]
    )  # fmt: skip
    assert code == 0
    records: dict[str, Any] = json.loads(target.read_text(encoding="utf-8"))
    return records


def test_each_study_has_a_record_and_its_files(tmp_path: Path) -> None:
    records = study(tmp_path, "torque", "6.8")
    assert sorted(records) == ["parameters", "torque"]
    for record in records.values():
        assert set(record) >= KEYS
        assert record["agrees"] in (True, False, "by construction", "not comparable")
        assert record["reason"]
        assert record["files"]
        for name in record["files"]:
            assert (tmp_path / "out" / name).stat().st_size > 0


def test_the_csv_holds_what_the_picture_shows(tmp_path: Path) -> None:
    records = study(tmp_path, "torque")
    with (tmp_path / "out" / "torque" / "torque.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    least = min(float(row["y"]) for row in rows)
    assert -least == pytest.approx(records["torque"]["ours"]["torque_nm"])


def test_the_page_fetches_nothing_and_links_to_every_file(tmp_path: Path) -> None:
    records = study(tmp_path, "torque")
    page = (tmp_path / "out" / "studies.html").read_text(encoding="utf-8")
    own = re.sub(r"<script>.*?</script>", "", page, flags=re.DOTALL)
    assert "default-src 'none'" in own
    assert not re.search(r"""(src|href)=["'](https?:)?//""", own)
    for name in records["torque"]["files"]:
        assert f'href="{name}"' in own


def test_one_changed_setting_moves_the_result(tmp_path: Path) -> None:
    as_shipped = study(tmp_path, "start_speed")["start_speed"]
    truck12 = study(tmp_path, "start_speed", settings='[common]\ngearbox = "truck12"\n')
    assert truck12["start_speed"]["ours"] != as_shipped["ours"]
    assert truck12["start_speed"]["provenance"]["gearbox"] == "truck12"


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ("[torque]\nuntil_ms = 5\n", r"changed\.toml \[torque\]: until_ms = 5, allowed is"),
        ("[torques]\n", r"changed\.toml: unknown table \[torques\], allowed are common, valve"),
        ("[torque]\nspan = 1\n", r"\[torque\]: unknown key 'span', allowed are until_ms"),
        ("[common.shift]\nbrake_off_ms = 20\n", r"brake_off_ms and until_ms must rise"),
    ],
)
def test_bad_settings_are_named_with_what_is_allowed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], settings: str, said: str
) -> None:
    file = tmp_path / "changed.toml"
    file.write_text(settings, encoding="utf-8")
    out = tmp_path / "out"
    assert main(["torque", "--out", str(out), "--settings", str(file)]) == 2
    assert re.search(said, capsys.readouterr().err)
    assert not (out / "studies.html").exists()


def test_a_folder_that_is_not_there_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["6.8", "--json", "nowhere/run.json"]) == 2
    said = capsys.readouterr().err
    assert said.startswith("python -m benchmarks.studies: error: ")
    assert "no folder nowhere" in said


def test_the_list_names_every_study(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", "--json", "-"]) == 0
    listed = json.loads(capsys.readouterr().out)
    assert listed["torque"]["of"] == ["figure 6.2"]


@pytest.mark.long
def test_every_study_runs_and_writes_its_files(tmp_path: Path) -> None:
    """As small as it goes: not what it finds."""
    smallest = Path(__file__).with_name("smallest.toml").read_text(encoding="utf-8")
    records = study(tmp_path, "all", settings=smallest, workers=2)
    assert set(records) == set(STUDY_NAMES)
    for record in records.values():
        assert record["statements"]
        assert all((tmp_path / "out" / name).stat().st_size > 0 for name in record["files"])


@pytest.mark.long
def test_results_do_not_depend_on_the_number_of_workers(tmp_path: Path) -> None:
    settings = "[valve]\nshifts = 1\n"
    (tmp_path / "one").mkdir()
    (tmp_path / "two").mkdir()
    words = ("valve", "delay_error")
    one = study(tmp_path / "one", *words, settings=settings, workers=1)
    two = study(tmp_path / "two", *words, settings=settings, workers=2)
    assert one == two
    for record in one.values():
        for name in record["files"]:
            first = (tmp_path / "one" / "out" / name).read_bytes()
            assert first == (tmp_path / "two" / "out" / name).read_bytes()
