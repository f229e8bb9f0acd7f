"""What a log has reported as figures and as a data sheet, and what it does not tell and why."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from logged_gearbox import SHEET
from scipy.stats import chi2
from scipy.stats import t as student_law

from meshpoint.gearbox import load_sheet
from meshpoint.gearbox.sheet import SheetError
from meshpoint.identify.identified import Figure, Identified, why_no_runs
from meshpoint.identify.identify import identify
from meshpoint.identify.jackknife import jackknife_sd, scatter_interval, student
from meshpoint.identify.log_reader import LogContent
from meshpoint.identify.overlay import entries, overlay
from meshpoint.identify.thinning import Thinned

FIGURES = {
    "brake torque": 91.5,
    "brake valve on delay": 13.0,
    "brake valve off delay": 16.0,
    "brake filling time": 40.0,
    "brake emptying time": 60.0,
    "inertia ratio": 0.5,
    "drag": 6.0,
    "sleeve delay first": 44.0,
    "sleeve delay third": 50.0,
    "sleeve delay spread": 1.5,
    "clutch kiss point": 36.0,
    "layshaft wheel duty": 51.0,
    "main wheel duty": 48.0,
}


def reported(**changed: float | None) -> Identified:
    """All figures, those that are named changed or left untold."""
    found = Identified(omega_ref_rad_s=100.0)
    values = FIGURES | {name.replace("_", " "): value for name, value in changed.items()}
    for name, value in values.items():
        low, high = (None, None) if value is None else (value - 2.0, value + 4.0)
        found.figures.append(Figure(name, "", value, low, high, None, 20))
    return found


def by_key(found: Identified) -> dict[str, float]:
    return {f"{each.table}.{each.key}": each.value for each in entries(found, SHEET)}


def test_every_figure_has_its_key_in_the_units_of_the_file() -> None:
    """Delays and times of the brake are means of both ways; the sleeve's delay is the mean of the
    gears."""
    assert by_key(reported()) == pytest.approx(
        {
            "brake.max_torque_nm": 91.5,
            "brake.valve_delay_ms": 14.5,
            "brake.time_constant_ms": 50.0,
            "shafts.input_inertia_kgm2": 0.5 * 0.24,
            "shafts.friction_nms": 0.06,
            "sleeve.delay_ms": 47.0,
            "sleeve.delay_sd_ms": 1.5,
            "clutch.kiss_percent": 36.0,
            "clutch.kiss_tolerance_percent": 3.0,
            "wheels.layshaft.duty_percent": 51.0,
            "wheels.main.duty_percent": 48.0,
        }
    )


def test_what_was_not_reported_has_no_key_and_of_two_ways_the_one_that_was_stands_for_both() -> (
    None
):
    found = by_key(reported(brake_valve_off_delay=None, brake_filling_time=None, drag=None,
                        sleeve_delay_first=None, sleeve_delay_third=None,
                        clutch_kiss_point=None))  # fmt: skip
    assert found == pytest.approx(
        {
            "brake.max_torque_nm": 91.5,
            "brake.valve_delay_ms": 13.0,
            "brake.time_constant_ms": 60.0,
            "shafts.input_inertia_kgm2": 0.12,
            "wheels.layshaft.duty_percent": 51.0,
            "wheels.main.duty_percent": 48.0,
        }
    )


def test_a_spread_is_a_tenth_of_a_millisecond_at_least_and_drag_never_negative() -> None:
    found = by_key(reported(sleeve_delay_spread=0.05, drag=-1.0))
    assert (found["sleeve.delay_sd_ms"], found["shafts.friction_nms"]) == (0.1, 0.0)
    still = reported()
    still.omega_ref_rad_s = 0.0
    assert "shafts.friction_nms" not in by_key(still)


def test_the_file_names_each_table_once_and_says_where_a_value_comes_from() -> None:
    """100 rad/s are 955 rpm. A number that is whole has its point all the same, one with an
    exponent none."""
    found = Identified(omega_ref_rad_s=100.0)
    for name, value in (
        ("brake torque", 91.0), ("brake valve on delay", 12.3456789), ("drag", 1e-5),
        ("main wheel duty", 50.0),
    ):  # fmt: skip
        found.figures.append(Figure(name, "", value, None, None, None, 9))
    assert overlay(found, SHEET, 'a "b" \\c', "x.log").splitlines() == [
        "# Identified by meshpoint from x.log.",
        "# What is not here is as in the data sheet that it is based on.",
        'based_on = "a \\"b\\" \\\\c"',
        f'name = "{SHEET.name}, identified"',
        "",
        "[brake]",
        "max_torque_nm = 91.0    # at 955 rpm of the layshaft",
        "valve_delay_ms = 12.346    # mean of on and off",
        "",
        "[shafts]",
        "friction_nms = 1e-07    # the whole drag at 955 rpm over the speed",
        "",
        "[wheels.main]",
        "duty_percent = 50.0",
    ]


def test_an_overlay_is_a_data_sheet_that_changes_what_was_reported(tmp_path: Path) -> None:
    path = tmp_path / "own.toml"
    path.write_text(
        overlay(reported(inertia_ratio=None), SHEET, "truck12", "a.log"), encoding="utf-8"
    )
    sheet = load_sheet(path)
    assert sheet.name == "truck12, identified"
    assert sheet.brake.max_torque_nm == 91.5
    assert sheet.shafts.friction_nms == pytest.approx(0.06)
    assert sheet.shafts.input_inertia_kgm2 == SHEET.shafts.input_inertia_kgm2
    again = tmp_path / "again.toml"
    again.write_text('based_on = "own.toml"\n[brake]\nvalve_delay_ms = 10.0\n', encoding="utf-8")
    twice = load_sheet(again)
    assert (twice.brake.max_torque_nm, twice.brake.valve_delay_s) == (91.5, 0.01)
    for text in ('based_on = "own.toml"\n', "based_on = 3\n", 'based_on = "none.toml"\n'):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(SheetError, match=r"own\.toml|none\.toml"):
            load_sheet(path)


def test_an_empty_log_tells_nothing_and_says_why() -> None:
    steps: list[str] = []
    found = identify(LogContent(), SHEET, steps.append)
    assert steps == ["teeth", "brake", "sleeves", "clutch"]
    assert all(figure.value is None and figure.why for figure in found.figures)
    for name, why, by_sheet in (
        ("brake torque", "no valve commands in the log", 100.0),
        ("brake valve on delay", "no valve commands in the log", 12.0),
        ("inertia ratio", "no valve commands in the log", 0.11 / 0.24),
        ("sleeve delay second", "no valve commands in the log", 45.0),
        ("clutch kiss point", "no engine speed (EEC1) in the log", 35.0),
        ("layshaft wheel duty", "no layshaft edges in the log", 50.0),
    ):
        assert (found.figure(name).why, found.figure(name).sheet) == (why, pytest.approx(by_sheet))
    with pytest.raises(KeyError):
        found.value("no such figure")


def test_the_first_message_that_a_log_lacks_is_why_it_has_no_runs() -> None:
    content = LogContent()
    for name, why in (
        ("EdgesLayshaftRise", "no layshaft edges in the log"),
        ("SleevesMain", "no sleeve positions in the log"),
        ("SleevesAux", "no positions of splitter and range in the log"),
        ("GearboxSensors", "no clutch position and pressures in the log"),
    ):
        assert why_no_runs(content) == why
        content.messages[name] = 1
    assert why_no_runs(content) == "0 runs in neutral with an open clutch, 5 are needed"


def test_a_long_list_is_thinned_evenly() -> None:
    kept: Thinned[int] = Thinned(8)
    for k in range(100):
        kept.add(k)
    assert kept.seen == 100
    assert list(kept) == [0, 16, 32, 48, 64, 80, 96]


def test_intervals_are_those_of_the_textbook() -> None:
    """A jackknife of means is their standard error; Student's and chi-squared laws for 95 %."""
    values = np.array([1.0, 3.0, 2.0, 6.0])
    without = np.array([np.delete(values, k).mean() for k in range(4)])
    assert float(jackknife_sd(without)) == pytest.approx(values.std(ddof=1) / 2.0)
    for freedom in (1.0, 1.1, 10.0):
        assert student(freedom) == pytest.approx(float(student_law.ppf(0.975, freedom)))
    low, high = scatter_interval(2.0, 10.0)
    assert low == pytest.approx(2.0 * np.sqrt(10.0 / chi2.ppf(0.975, 10.0)))
    assert high == pytest.approx(2.0 * np.sqrt(10.0 / chi2.ppf(0.025, 10.0)))


def test_a_key_that_is_a_mean_of_two_ways_has_the_mean_of_their_intervals() -> None:
    """A log's own figures reach 2 below and 4 above their values. On and off are 13 and 16 ms; drag
    of 6 Nm at 100 rad/s; a spread has none below a tenth of a millisecond."""
    made = {one.key: one for one in entries(reported(sleeve_delay_spread=1.0), SHEET)}
    for key, low, high in (
        ("max_torque_nm", 89.5, 95.5),
        ("valve_delay_ms", 12.5, 18.5),
        ("input_inertia_kgm2", (0.5 - 2.0) * 0.24, (0.5 + 4.0) * 0.24),
        ("friction_nms", 0.04, 0.10),
        ("delay_ms", 45.0, 51.0),
        ("delay_sd_ms", 0.1, 5.0),
    ):
        assert (made[key].low, made[key].high) == (pytest.approx(low), pytest.approx(high))
    assert made["kiss_tolerance_percent"].low is None
    text = overlay(reported(), SHEET, "truck12", "x.log")
    assert "valve_delay_ms = 14.5    # 12.5 to 18.5; mean of on and off" in text
