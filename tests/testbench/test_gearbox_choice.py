"""Any data sheet, by name or from a file, wherever one is chosen."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from meshpoint.cli.main import main
from meshpoint.gearbox import drive_gear, load_sheet
from meshpoint.gearbox.sheet import SHEET_NAMES

TRUCK12 = Path(__file__).parents[2] / "meshpoint" / "gearbox" / "sheets" / "truck12.toml"


@pytest.mark.parametrize("name", SHEET_NAMES)
def test_show_prints_ratios_teeth_and_derived_figures(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["show", "gearbox", name]) == 0
    lines = capsys.readouterr().out.splitlines()
    sheet = load_sheet(name)
    rows = {words[0]: words for line in lines[2:16] if (words := line.split())}
    assert len(rows) == 14
    twelve = rows["12"]
    assert float(twelve[5]) == pytest.approx(sheet.overall_ratio(drive_gear(12)), abs=5e-4)
    text = "\n".join(lines)
    for words in ("pitch 7.500 deg", "gap 1.500 deg", "25 rpm slip", "kg m2", sheet.sha256):
        assert words in text


def test_show_as_json_is_for_programs(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["show", "gearbox", "truck12", "--json", "-"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown["ratios"]["12"] == 1.0
    assert shown["sheet"]["main"]["third"] == {"driving": 37, "driven": 35}
    assert shown["derived"]["gap_deg"] == pytest.approx(1.5)
    assert shown["derived"]["steps"]["C1"] is None


@pytest.mark.long
def test_a_sheet_by_name_and_the_same_from_a_file_run_alike(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Three upshifts of the truck box: all engage, and where the gear came from changes nothing."""
    copied = tmp_path / "mine.toml"
    copied.write_text(TRUCK12.read_text(encoding="utf-8"), encoding="utf-8")
    results = []
    for gearbox in ("truck12", str(copied)):
        arguments = [
            "simulate",
            "--as-built",
            "clean",
            "--gearbox",
            gearbox,
            "--shifts",
            "3",
            "--seed",
            "3",
        ]
        assert main([*arguments, "--json", "-"]) == 0
        results.append(json.loads(capsys.readouterr().out))
    assert results[0] == results[1]
    assert results[0]["provenance"]["gearbox"] == "truck12"
    assert [row["result"] for row in results[0]["shifts"]] == ["engaged"] * 3
    assert any(row["reference"] == "known" for row in results[0]["shifts"])


@pytest.mark.long
def test_every_kind_of_upshift_of_the_truck_box_engages(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """From the crawl gears up, in both splits and both ranges."""
    pairs = "13-1,14-2,3-5,7-9,10-12"
    arguments = [
        "simulate",
        "--as-built",
        "clean",
        "--gearbox",
        "truck12",
        "--pairs",
        pairs,
        "--shifts",
        "5",
    ]
    assert main([*arguments, "--json", "-"]) == 0
    rows = json.loads(capsys.readouterr().out)["shifts"]
    assert [f"{row['from']}-{row['to']}" for row in rows] == pairs.split(",")
    assert all(row["result"] == "engaged" for row in rows)
