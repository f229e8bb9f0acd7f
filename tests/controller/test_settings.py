"""Settings are checked when read: an error names file, key, what was found and what is allowed."""

from __future__ import annotations

import math
import re
from dataclasses import fields, replace
from pathlib import Path
from typing import Final, NamedTuple

import pytest

from meshpoint.controller.settings.filters import CrossingFilterTuning
from meshpoint.controller.settings.settings import (
    ControllerSettings,
    load_settings,
    load_settings_file,
)
from meshpoint.controller.settings.strategy_file import StrategyFile
from meshpoint.dbc.messages import Estimator, Strategy
from meshpoint.gearbox import load_sheet
from meshpoint.gearbox.tables import TableError, read_group


def written(folder: Path, text: str) -> Path:
    path = folder / "bench.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_values_are_read_in_the_units_people_use(tmp_path: Path) -> None:
    path = written(
        tmp_path,
        'strategy = "speed_window"\nestimator = "window"\n[timing]\ntick_ms = 5\n'
        "[window]\nfire_slip_rpm = 30\n[aim]\ntarget_percent_of_gap = -10.0\n",
    )
    settings = load_settings(path)
    assert settings.strategy is Strategy.SPEED_WINDOW
    assert settings.estimator is Estimator.WINDOW
    assert settings.timing.tick_us == 5000
    assert settings.window.fire_slip_rad_s == pytest.approx(math.pi)
    assert settings.aim.target_rad_share == pytest.approx(-0.1)
    assert settings.limits == ControllerSettings().limits


def test_without_a_file_the_defaults_hold_and_given_values_win(tmp_path: Path) -> None:
    assert load_settings(None) == ControllerSettings()
    path = written(tmp_path, 'strategy = "speed_window"\n')
    assert load_settings(path, strategy_name="target_phase").strategy is Strategy.TARGET_PHASE
    assert load_settings(path, strategy_name=None).strategy is Strategy.SPEED_WINDOW


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("tick = 5", ("tick", "timing")),
        ("[timing]\ntick_us = 5", ("tick_us", "tick_ms")),
        ("[timing]\ntick_ms = 0", ("tick_ms", "0", "1", "100")),
        ("[timing]\ntick_ms = 10.0", ("tick_ms", "10.0", "whole")),
        ("[timing]\ntick_ms = true", ("tick_ms", "true")),
        ("[timing]\ntick_ms = nan", ("tick_ms", "nan")),
        ("[window]\nfire_slip_rpm = nan", ("fire_slip_rpm", "nan", "1", "200")),
        ("[window]\nfire_slip_rpm = inf", ("fire_slip_rpm", "inf")),
        ("[window]\nfire_slip_rpm = 201", ("fire_slip_rpm", "201", "200")),
        ('[window]\nfire_slip_rpm = "fast"', ("fire_slip_rpm", "fast")),
        ("window = 3", ("window", "3", "table")),
        ('strategy = "hope"', ("strategy", "hope", "speed_window", "target_phase")),
        ("strategy = 1", ("strategy", "1")),
        ('valve_timing = "soon"', ("valve_timing", "soon", "scheduled", "immediate")),
        (
            "[window]\ncontact_low_rpm = 30\ncontact_high_rpm = 20",
            ("contact_low_rpm", "contact_high_rpm"),
        ),
        ("[window]\ncontact_low_rpm = 20\ncontact_high_rpm = 20", ("less than",)),
        ("[aim]\ntarget_percent_of_gap = -91", ("target_percent_of_gap", "-91", "-90", "90")),
        ("[crossing_filter]\nfuse_input = true", ("fuse_input", "removed", "may be deleted")),
        ("[crossing_filter]\nmesh_side_ms = 30", ("mesh_side_ms", "removed", "may be deleted")),
        ("[crossing_filter]\nfar_hz = 4", ("far_hz", "removed", "may be deleted")),
        ("[crossing_filter]\nnear_rpm = 10", ("near_rpm", "removed", "swing_rpm")),
        ("[limits]\nattempts = 11", ("attempts", "11", "1", "10")),
        ("= what", ()),
        ("a" * 300_000, ("allowed",)),
        ("x = " + "{a = " * 9 + "1" + "}" * 9, ("nested",)),
    ],
)
def test_what_cannot_be_used_is_refused_by_file_key_and_range(
    tmp_path: Path, text: str, named: tuple[str, ...]
) -> None:
    with pytest.raises(TableError) as refusal:
        load_settings(written(tmp_path, text))
    for word in ("bench.toml", *named):
        assert word in str(refusal.value)


@pytest.mark.parametrize("what", ["missing", "folder", "binary"])
def test_what_is_no_file_of_settings_is_refused_by_name(tmp_path: Path, what: str) -> None:
    path = tmp_path / "bench.toml"
    if what == "folder":
        path.mkdir()
    elif what == "binary":
        path.write_bytes(b"\xff\x00\xfe")
    with pytest.raises(TableError, match=r"bench\.toml"):
        load_settings(path)


@pytest.mark.parametrize(
    ("content", "armed"),
    [("", None), ("[outputs]\narmed = true\n", True), ("[outputs]\narmed = false\n", False)],
)
def test_whether_outputs_are_armed_is_no_setting_of_the_core(
    tmp_path: Path, content: str, armed: bool | None
) -> None:
    """It is of one run on one bus: the settings, and so the run's hash, are the same."""
    path = written(tmp_path, content)
    assert load_settings_file(path).outputs.armed is armed
    assert load_settings(path) == ControllerSettings()


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
DEFAULTS: Final = ControllerSettings()


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
        at, row = SECTION.match(line), ROW.match(line)
        section = at[1] if at else section
        if row:
            numbers = (float(row[2]), bool(row[3]), float(row[4]), float(row[5]))
            found.append(Said(section, row[1], *numbers))
    return found


def setting(said: Said, value: float | None = None) -> float:
    """As a file that says so has it; None: its default."""
    group = getattr(DEFAULTS, said.section)
    name = next(each.name for each in fields(group)
                if each.metadata.get("rule") and each.metadata["rule"].key == said.key)  # fmt: skip
    if value is not None:
        given: dict[str, float] = {said.key: int(value) if said.is_whole else float(value)}
        ends = {"contact_low_rpm": {"contact_high_rpm": 200.0},
                "contact_high_rpm": {"contact_low_rpm": -50.0}}  # fmt: skip
        group = read_group(type(group), given | ends.get(said.key, {}), "file")
    found: float = getattr(group, name)
    return found


@pytest.mark.parametrize("said", rows(), ids=lambda each: f"{each.section}.{each.key}")
def test_a_setting_has_the_default_and_the_range_of_its_page(said: Said) -> None:
    """In SI, by the unit of its key; both ends of the range are allowed, and no more."""
    for given, value in ((None, said.default), (said.low, said.low), (said.high, said.high)):
        assert setting(said, given) == pytest.approx(value * said.unit, rel=1e-9)
    below = 1.0 if said.is_whole else 1e-6 * (abs(said.low) or 1.0)
    above = 1.0 if said.is_whole else 1e-6 * (abs(said.high) or 1.0)
    for value in (said.low - below, said.high + above):
        with pytest.raises(TableError, match=said.key):
            setting(said, value)


@pytest.mark.parametrize(
    ("key", "most", "beyond"), [("fire_slip_rpm", 120, 120.1), ("least_rpm", -60, -60.1)]
)
def test_no_window_is_wider_than_the_guards(
    tmp_path: Path, key: str, most: float, beyond: float
) -> None:
    load_settings(written(tmp_path, f"[window]\n{key} = {most}\n"))
    with pytest.raises(TableError, match=key):
        load_settings(written(tmp_path, f"[window]\n{key} = {beyond}\n"))


def test_a_users_strategy_is_named_by_its_file_where_it_acted() -> None:
    given = StrategyFile("own.py:Own", "12", False, b"")
    own = DEFAULTS.with_strategy("own.py:Own", given)
    assert (own.strategy_file, own.strategy) == (given, Strategy.SPEED_WINDOW)
    assert own.name_of(Strategy.SPEED_WINDOW) == "own.py:Own"
    assert own.name_of(Strategy.TARGET_PHASE) == "target_phase"
    assert own.values()["strategy_name"] == "own.py:Own"
    assert own.with_strategy("speed_window").strategy_file is None


def test_what_the_data_sheet_says_is_taken_from_it() -> None:
    whole = load_sheet("truck12")
    own_lash = replace(whole.driveline, backlash_rad=0.05, backlash_tolerance_rad=0.01)
    sheet = replace(whole, driveline=own_lash, air=replace(whole.air, sensor_sd_pa=777.0))
    own = CrossingFilterTuning(gate_sd=7.0).of(sheet)
    assert (own.gate_sd, own.pressure_sd_pa, own.lash_rad) == (7.0, 777.0, 0.05)
    assert own.lash_factor == own_lash.backlash_factor != whole.driveline.backlash_factor
