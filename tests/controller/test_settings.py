"""Settings are checked when read: an error names file, key, what was found and what is allowed."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from meshpoint.controller.settings import ControllerSettings, load_settings, load_settings_file
from meshpoint.dbc.messages import Estimator, Strategy
from meshpoint.gearbox.tables import TableError


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
