"""The reference pages and files are what the code says, and come back as they were."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import cantools.database
import pytest

from meshpoint.cli.json_keys import COUNTERFACTUAL_KEYS, JUDGED_KEYS
from meshpoint.cli.main import main
from meshpoint.cli.reference import PAGES
from meshpoint.cli.reference import main as reference
from meshpoint.cli.show_gearbox import sheet_toml
from meshpoint.cli.show_settings import settings_toml
from meshpoint.controller.settings.settings import (
    ControllerSettings,
    Outputs,
    SettingsFile,
    load_settings_file,
)
from meshpoint.gearbox import GearboxSheet, load_sheet
from meshpoint.gearbox.keys import groups_of, unit_of
from meshpoint.gearbox.sheet import SHEET_NAMES
from meshpoint.report.counterfactual import Counterfactual
from meshpoint.report.judged import Judged

DOCS = Path(__file__).resolve().parents[2] / "docs" / "reference"


def printed(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert main(arguments) == 0
    return capsys.readouterr().out


@pytest.mark.parametrize("name", PAGES)
def test_a_page_is_what_the_code_says(name: str) -> None:
    """`make reference` writes them anew."""
    assert (DOCS / name).read_text(encoding="utf-8") == PAGES[name]()


def test_a_page_that_is_out_of_date_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert reference([str(tmp_path), "--check"]) == 1
    assert list(tmp_path.iterdir()) == []
    assert reference([str(tmp_path)]) == 0
    assert reference([str(tmp_path), "--check"]) == 0
    (tmp_path / "settings.md").write_text("old")
    capsys.readouterr()
    assert reference([str(tmp_path), "--check"]) == 1
    assert "settings.md" in capsys.readouterr().err


def test_every_key_of_a_judged_shift_is_there() -> None:
    shift = Judged(
        8, 10, 0, "target_phase", "known", "waiting", "", None, None, None, None, None, "why",
        counterfactual=Counterfactual(),
    )  # fmt: skip
    row = shift.to_json()
    assert {*row, "recorded"} == set(JUDGED_KEYS)
    assert set(row["counterfactual"]) == set(COUNTERFACTUAL_KEYS)


@pytest.mark.parametrize("kind", [SettingsFile, GearboxSheet])
def test_every_key_has_a_meaning_of_its_own(kind: type) -> None:
    for group in groups_of(kind):
        assert group.meaning.endswith("."), group
        meanings = [key.meaning for key in group.keys]
        assert all(len(meaning) > 10 and meaning.endswith(".") for meaning in meanings), meanings
        assert len(set(meanings)) == len(meanings)


def test_every_setting_is_there_with_its_range_and_default() -> None:
    keys = {key.path: key for group in groups_of(SettingsFile) for key in group.keys}
    assert len(keys) > 60
    lead = keys["timing.lead_ms"]
    assert (lead.unit, lead.default, lead.allowed) == ("ms", "4", "a whole number from 1 to 80")
    assert keys["limits.supply_low_bar"].default == "5.5"
    assert keys["strategy"].default == '"target_phase"'
    assert keys["outputs.armed"].default is None


@pytest.mark.parametrize(
    ("key", "unit"),
    [
        ("delay_ms", "ms"), ("speed_m_s", "m/s"), ("w_speed_rad_s2", "rad/s2"), ("teeth", ""),
        ("backlash_percent_of_pitch", "% of pitch"), ("energy_ms_per_j", "ms/J"),
    ],
)  # fmt: skip
def test_a_unit_is_told_by_the_keys_name(key: str, unit: str) -> None:
    assert unit_of(key) == unit


def test_a_file_with_all_defaults_is_no_change(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "own.toml"
    path.write_text(printed(capsys, "show", "settings", "--toml"))
    assert path.read_text() == settings_toml()
    read = load_settings_file(path)
    assert read.settings == ControllerSettings()
    assert read == SettingsFile()
    path.write_text(path.read_text().replace("# armed =", "armed = true"))
    assert load_settings_file(path).outputs == Outputs(armed=True)


@pytest.mark.parametrize("name", SHEET_NAMES)
def test_a_sheet_written_out_is_the_same_sheet(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    path = tmp_path / "own.toml"
    path.write_text(printed(capsys, "show", "gearbox", name, "--toml"))
    assert load_sheet(path).sha256 == load_sheet(name).sha256


def test_missing_teeth_are_written_out_too(tmp_path: Path) -> None:
    sheet = load_sheet("thesis")
    wheel = dataclasses.replace(sheet.wheels.main, teeth=60, missing=(58, 59))
    sheet = dataclasses.replace(sheet, wheels=dataclasses.replace(sheet.wheels, main=wheel))
    path = tmp_path / "own.toml"
    path.write_text(sheet_toml(sheet))
    assert load_sheet(path) == sheet


def test_settings_are_shown_by_group_and_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    shown = printed(capsys, "show", "settings", "limits")
    assert "attempts = 3" in shown
    assert "a whole number from 1 to 10" in shown
    assert "How often a sleeve is fired in one shift." in shown
    assert "tick_ms" not in shown
    keys = json.loads(printed(capsys, "show", "settings", "--json", "-"))["keys"]
    assert {"group", "name", "unit", "allowed", "default", "meaning"} == set(keys[0])
    assert len(keys) > 60


def test_the_dbc_can_be_found_and_looked_into(capsys: pytest.CaptureFixture[str]) -> None:
    path = printed(capsys, "show", "messages", "--path").strip()
    database = cantools.database.load_file(path)
    names = {message.name for message in database.messages}
    listed = printed(capsys, "show", "messages")
    assert all(name in listed for name in names)
    one = printed(capsys, "show", "messages", "controllerstatus")
    assert "StepLateness" in one
    values = json.loads(printed(capsys, "show", "messages", "ControllerStatus", "--json", "-"))
    (message,) = values["messages"]
    parsed = database.get_message_by_name("ControllerStatus")
    assert [signal["name"] for signal in message["signals"]] == [s.name for s in parsed.signals]
    every = json.loads(printed(capsys, "show", "messages", "--json", "-"))["messages"]
    assert len(every) == len(names)
