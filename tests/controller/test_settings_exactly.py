"""Each setting as its page in the documentation says: default, unit and range; and what is made of
them together."""

from __future__ import annotations

import math
import re
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import pytest

from meshpoint.controller.settings import (
    NO_KEYS,
    Aim,
    ControllerSettings,
    CrossingFilterTuning,
    SettingsFile,
    Timing,
    ValveTiming,
    load_settings,
    load_settings_file,
)
from meshpoint.controller.strategy_file import StrategyFile
from meshpoint.dbc.messages import Estimator, Strategy
from meshpoint.gearbox import load_sheet
from meshpoint.gearbox.tables import TableError, read_group

PAGE: Final = Path(__file__).parents[2] / "docs" / "reference" / "settings.md"
SECTION: Final = re.compile(r"^## `\[(\w+)\]`$")
ROW: Final = re.compile(
    r"^\| `(\w+)` \| `(\S+)` \|[^|]*\| a (whole )?number from (\S+) to (\S+) \|"
)
UNITS: Final = {
    "rpm": math.pi / 30.0, "bar": 1e5, "bar_s": 1e5, "kj": 1e3, "deg": math.pi / 180.0,
    "deg_s": math.pi / 180.0, "percent": 1e-2, "percent_of_gap": 1e-2,
}  # fmt: skip
"""SI of a key's unit; milliseconds and microseconds are kept as they are where whole numbers are
asked for, and where the key of a filter is not of `crossing_filter`."""


class Said(NamedTuple):
    """A row of the page."""

    section: str
    key: str
    default: float
    is_whole: bool
    low: float
    high: float

    @property
    def unit(self) -> float:
        for suffix, unit in UNITS.items():
            if self.key.endswith(f"_{suffix}"):
                return unit
        if self.section == "prices":
            return 1e-3
        if self.section == "crossing_filter":
            return {"ms": 1e-3, "us": 1e-6}.get(self.key.rsplit("_", 1)[-1], 1.0)
        return 1.0


def rows() -> list[Said]:
    found, section = [], ""
    for line in PAGE.read_text(encoding="utf-8").splitlines():
        at = SECTION.match(line)
        section = at[1] if at else section
        row = ROW.match(line)
        if row:
            numbers = (float(row[2]), bool(row[3]), float(row[4]), float(row[5]))
            found.append(Said(section, row[1], *numbers))
    return found


ROWS: Final = rows()
DEFAULTS: Final = ControllerSettings()


def attribute(said: Said) -> str:
    """The name of a setting's attribute, by its place among those of its group."""
    group = getattr(DEFAULTS, said.section)
    by_key = {each.metadata["rule"].key: each.name for each in fields(group)
              if each.metadata.get("rule")}  # fmt: skip
    return by_key[said.key]


def read(said: Said, value: float) -> float:
    """The setting if a file says so; all others of its group as they are."""
    group = type(getattr(DEFAULTS, said.section))
    given: dict[str, Any] = {said.key: int(value) if said.is_whole else float(value)}
    if said.key == "contact_low_rpm":
        given["contact_high_rpm"] = 200.0
    if said.key == "contact_high_rpm":
        given["contact_low_rpm"] = -50.0
    found: float = getattr(read_group(group, given, "file"), attribute(said))
    return found


def test_the_page_has_all_numbers() -> None:
    found = set()
    for each in fields(ControllerSettings):
        group = getattr(DEFAULTS, each.name)
        for field in fields(group) if hasattr(group, "__dataclass_fields__") else ():
            rule = field.metadata.get("rule")
            if rule is not None and rule.kind in (int, float):
                found.add((each.name, rule.key))
    assert {(said.section, said.key) for said in ROWS} == found
    assert len(ROWS) >= 75


@pytest.mark.parametrize("said", ROWS, ids=lambda each: f"{each.section}.{each.key}")
def test_a_setting_has_the_default_and_the_range_of_its_page(said: Said) -> None:
    """In SI, by the unit of its key; both ends of the range are allowed, and no more."""
    own = getattr(getattr(DEFAULTS, said.section), attribute(said))
    assert own == pytest.approx(said.default * said.unit, rel=1e-9)
    assert read(said, said.low) == pytest.approx(said.low * said.unit, rel=1e-9)
    assert read(said, said.high) == pytest.approx(said.high * said.unit, rel=1e-9)
    below = 1.0 if said.is_whole else 1e-6 * (abs(said.low) or 1.0)
    above = 1.0 if said.is_whole else 1e-6 * (abs(said.high) or 1.0)
    for value in (said.low - below, said.high + above):
        with pytest.raises(TableError, match=said.key):
            read(said, value)


def file(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "own.toml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("text", "is_allowed"),
    [("contact_low_rpm = 10\ncontact_high_rpm = 10", False),
     ("contact_low_rpm = 10\ncontact_high_rpm = 10.1", True), ("fire_slip_rpm = 120", True),
     ("fire_slip_rpm = 120.1", False), ("least_rpm = -60", True), ("least_rpm = -60.1", False)],
)  # fmt: skip
def test_no_window_is_empty_and_none_is_wider_than_the_guards(
    text: str, is_allowed: bool, tmp_path: Path
) -> None:
    path = file(tmp_path, f"[window]\n{text}\n")
    if is_allowed:
        load_settings(path)
    else:
        with pytest.raises(TableError, match=text.split(" ", maxsplit=1)[0]):
            load_settings(path)


def test_times_of_a_step_are_told_in_microseconds_too() -> None:
    assert Timing(tick_ms=7, lead_ms=3).tick_us == 7_000
    assert Timing(tick_ms=7, lead_ms=3).lead_us == 3_000


def test_a_target_is_a_share_of_half_a_gap() -> None:
    assert Aim().target_rad(0.02) == 0.0
    assert Aim(-0.3).target_rad(0.02) == pytest.approx(-0.003)


def test_names_are_those_of_the_bus() -> None:
    assert (DEFAULTS.strategy, DEFAULTS.estimator) == (Strategy.TARGET_PHASE, Estimator.CROSSING)
    assert ValveTiming(DEFAULTS.valve_timing) is ValveTiming.SCHEDULED
    for name, estimator in (("window", Estimator.WINDOW), ("thesis", Estimator.THESIS)):
        assert replace(DEFAULTS, estimator_name=name).estimator is estimator
    for strategy in Strategy:
        own = DEFAULTS.with_strategy(strategy.name.lower())
        assert own.strategy is strategy
        assert own.name_of(strategy) == strategy.name.lower()


def test_a_users_strategy_is_named_by_its_file_where_it_acted() -> None:
    given = StrategyFile("own.py:Own", "12", False, b"")
    own = DEFAULTS.with_strategy("own.py:Own", given)
    assert own.strategy_file is given
    assert own.strategy is Strategy.SPEED_WINDOW
    assert own.name_of(Strategy.SPEED_WINDOW) == "own.py:Own"
    assert own.name_of(Strategy.TARGET_PHASE) == "target_phase"
    assert own.with_strategy("speed_window").strategy_file is None


def test_values_are_what_a_file_could_say_and_nothing_of_the_data_sheet() -> None:
    own = DEFAULTS.with_strategy("own.py:Own", StrategyFile("own.py:Own", "12", False, b"text"))
    values = own.values()
    assert values["strategy_name"] == "own.py:Own"
    assert values["limits"]["attempts"] == DEFAULTS.limits.attempts
    sheets = {"pressure_sd_pa", "lash_rad", "lash_factor"}
    assert {*sheets, "strategy_file"} == NO_KEYS
    assert not NO_KEYS & {*values, *values["crossing_filter"]}


def test_what_the_data_sheet_says_is_taken_from_it() -> None:
    whole = load_sheet("truck12")
    own_lash = replace(whole.driveline, backlash_rad=0.05, backlash_tolerance_rad=0.01)
    air = replace(whole.air, sensor_sd_pa=777.0)
    sheet = replace(whole, driveline=own_lash, air=air)
    own = CrossingFilterTuning(gate_sd=7.0).of(sheet)
    assert own.gate_sd == 7.0
    assert (own.pressure_sd_pa, own.lash_rad) == (777.0, 0.05)
    assert own.lash_factor == own_lash.backlash_factor != whole.driveline.backlash_factor


def test_given_values_win_over_a_files_and_a_file_over_defaults(tmp_path: Path) -> None:
    path = file(
        tmp_path, 'strategy = "speed_window"\nestimator = "window"\n[timing]\nlead_ms = 9\n'
    )
    found = load_settings(path, strategy_name=None, estimator_name="thesis")
    assert (found.strategy_name, found.estimator_name) == ("speed_window", "thesis")
    assert (found.timing.lead_ms, found.timing.tick_ms) == (9, 10)
    assert type(found) is ControllerSettings
    assert load_settings(None) == DEFAULTS
    with pytest.raises(TableError, match=r"own\.toml"):
        load_settings(file(tmp_path, "[timing]\nlead_ms = 0\n"))


@pytest.mark.parametrize(("text", "armed"), [("", None), ("true", True), ("false", False)])
def test_whether_outputs_are_armed_is_said_by_a_file_alone(
    text: str, armed: bool | None, tmp_path: Path
) -> None:
    path = file(tmp_path, f"[outputs]\narmed = {text}\n" if text else "")
    found = load_settings_file(path)
    assert found.outputs.armed is armed
    assert found.settings == DEFAULTS
    assert load_settings_file(None) == SettingsFile()
    assert SettingsFile().outputs.armed is None
