"""One data sheet and one profile for all who name none, and every result says which it is of."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

import meshpoint
from meshpoint.cli import arguments
from meshpoint.cli.main import main
from meshpoint.cli.table import build_parser

OF = "sheet truck12, profile typical"


@pytest.mark.parametrize("command", ["demo", "simulate", "up", "rig", "campaign"])
def test_a_command_with_a_rig_has_the_sheet_of_its_preset_and_the_one_profile(command: str) -> None:
    asked = build_parser(command).parse_args([command])
    assert arguments.sheet_of(asked).name == "truck12"
    assert arguments.as_built_of(asked).profile == "typical"
    thesis = build_parser(command).parse_args([command, "--preset", "thesis"])
    assert arguments.sheet_of(thesis).name == "thesis"
    named = ["--preset", "thesis", "--gearbox", "truck12", "--as-built", "harsh"]
    other = build_parser(command).parse_args([command, *named])
    assert arguments.sheet_of(other).name == "truck12"
    assert arguments.as_built_of(other).profile == "harsh"


@pytest.mark.parametrize("command", ["controller", "play", "watch", "check", "commission"])
def test_a_command_without_a_rig_has_the_sheet_of_the_default_preset(command: str) -> None:
    asked = build_parser(command).parse_args([command])
    assert arguments.sheet_of(asked).name == "truck12"


def test_a_sheet_is_shown_where_none_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["show", "gearbox"]) == 0
    assert capsys.readouterr().out.startswith("gearbox truck12")
    assert meshpoint.load_gearbox().name == "truck12"


def test_a_bench_has_the_sheet_of_its_preset_and_the_one_profile() -> None:
    with meshpoint.Bench() as bench:
        assert bench.sheet.name == "truck12"
        assert bench.as_built is not None
        assert bench.as_built["profile"] == "typical"
    with meshpoint.Bench(preset="thesis") as bench:
        assert bench.sheet.name == "thesis"


def test_values_that_are_fixed_by_name_leave_the_rest_to_the_one_profile() -> None:
    with meshpoint.Bench(as_built={"vehicle.slope_percent": 2.0}) as bench:
        assert bench.as_built is not None
        assert bench.as_built["profile"] == "typical"
        assert bench.as_built["vehicle"]["slope_percent"] == 2.0
    with meshpoint.Bench(as_built={"profile": "clean", "vehicle.slope_percent": 2.0}) as bench:
        assert bench.as_built is not None
        assert bench.as_built["profile"] == "clean"


@pytest.mark.parametrize(
    ("as_built", "words"),
    [
        ({"profile": "muddy"}, ["profile", "muddy", "typical"]),
        ({"vehicle.slope": 2.0}, ["vehicle.slope", "groups are"]),
        ({"vehicle.slope_percent": "steep"}, ["vehicle.slope_percent", "steep", "allowed"]),
    ],
)
def test_a_value_that_cannot_be_fixed_is_named(
    as_built: dict[str, float | str], words: list[str]
) -> None:
    with pytest.raises(meshpoint.TableError) as refused:
        meshpoint.Bench(as_built=as_built)
    assert all(word in str(refused.value) for word in words)


def test_a_simulation_names_sheet_and_profile_in_all_that_it_gives(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = {name: tmp_path / name for name in ("json", "junit", "markdown", "report")}
    options = [word for name, path in files.items() for word in (f"--{name}", str(path))]
    assert main(["simulate", "--shifts", "1", *options]) == 0
    values = json.loads(files["json"].read_text())
    assert values["provenance"]["gearbox"] == "truck12"
    assert values["provenance"]["profile"] == values["as_built"]["profile"] == "typical"
    printed = capsys.readouterr().out
    assert f"target_phase, seed 1, {OF}" in printed
    assert f"summary, {OF}" in printed
    said = ET.parse(files["junit"]).getroot().findtext("system-out")
    assert said is not None and said.endswith(OF)
    assert OF in files["markdown"].read_text().splitlines()[0]
    page = files["report"].read_text(encoding="utf-8")
    assert f"preset truck, {OF}." in page
    assert "<dt>profile</dt><dd><code>typical</code></dd>" in page


def test_the_thesis_s_gearbox_has_no_profile(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    result = tmp_path / "result.json"
    assert main(["simulate", "--preset", "thesis", "--shifts", "1", "--json", str(result)]) == 0
    provenance = json.loads(result.read_text())["provenance"]
    assert (provenance["gearbox"], provenance["profile"]) == ("thesis", None)
    assert "sheet thesis, preset thesis" in capsys.readouterr().out


def test_values_that_were_fixed_are_counted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fixed = tmp_path / "slope.toml"
    fixed.write_text("[vehicle]\nslope_percent = 2.0\n")
    assert main(["simulate", "--shifts", "1", "--as-built", str(fixed)]) == 0
    said = " ".join(capsys.readouterr().out.split())  # a title is as wide as its table
    assert f"{OF}, 1 as-built value overridden" in said


def test_a_campaign_names_sheet_and_profile_in_all_that_it_gives(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = {name: tmp_path / name for name in ("json", "junit", "markdown")}
    options = [word for name, path in files.items() for word in (f"--{name}", str(path))]
    small = ["--runs", "1", "--learn", "1", "--judged", "1", "--jobs", "1"]
    assert main(["campaign", *small, *options, "--out", str(tmp_path / "out")]) == 0
    campaign = json.loads(files["json"].read_text())["campaign"]
    assert (campaign["provenance"]["gearbox"], campaign["profile"]) == ("truck12", "typical")
    printed = " ".join(capsys.readouterr().out.split())
    assert printed.count(OF) == 3, printed  # strategies, phases, ratios
    for name in ("junit", "markdown"):
        assert f"1 runs, {OF}" in files[name].read_text()
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert f"preset truck, {OF};" in page


def test_a_replay_names_the_sheet_of_its_run_header(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, result = tmp_path / "run.log", tmp_path / "replay.json"
    made = ["simulate", "--preset", "thesis", "--gearbox", "truck12", "--shifts", "1"]
    assert main([*made, "--log", str(log)]) == 0
    assert main(["replay", str(log), "--json", str(result)]) == 0
    assert "run.log as recorded, sheet truck12" in capsys.readouterr().out
    assert json.loads(result.read_text())["gearbox"] == "truck12"


def test_the_page_to_play_with_names_its_sheet(tmp_path: Path) -> None:
    page = tmp_path / "play.html"
    assert main(["play", "--out", str(page)]) == 0
    assert "those of the data sheet truck12" in page.read_text(encoding="utf-8")
