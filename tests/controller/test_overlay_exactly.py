"""What a log has told as a data sheet, key by key, and the small parts that figures stand on."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import t as student_law
from test_identification import SHEET

from meshpoint.testbench.identify.held_out import check_samples
from meshpoint.testbench.identify.identified import (
    Figure,
    Identified,
    untold,
    why_no_runs,
)
from meshpoint.testbench.identify.jackknife import student
from meshpoint.testbench.identify.log_reader import LogContent
from meshpoint.testbench.identify.overlay import entries, overlay
from meshpoint.testbench.identify.thinning import Thinned

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


def told(**changed: float | None) -> Identified:
    """All figures, those that are named changed or left untold."""
    found = Identified(omega_ref_rad_s=100.0)
    found.supply_pa = 1.44 * SHEET.air.supply_gauge_pa + SHEET.air.atmosphere_pa
    values = FIGURES | {name.replace("_", " "): value for name, value in changed.items()}
    for name, value in values.items():
        low, high = (None, None) if value is None else (value - 2.0, value + 4.0)
        found.figures.append(Figure(name, "", value, low, high, None, 20))
    return found


def by_key(found: Identified) -> dict[str, float]:
    return {f"{each.table}.{each.key}": each.value for each in entries(found, SHEET)}


def test_every_figure_has_its_key_in_the_units_of_the_file() -> None:
    """Delays and times of the brake are means of both ways; the sleeve's delay is the mean of the
    gears, and less air than in the log, by 1.44, makes its way 1.2 times as long but not the
    valve's 12 ms: 12 + 1.2 (47 - 12)."""
    assert by_key(told()) == pytest.approx(
        {
            "brake.max_torque_nm": 91.5,
            "brake.valve_delay_ms": 14.5,
            "brake.time_constant_ms": 50.0,
            "shafts.input_inertia_kgm2": 0.5 * 0.24,
            "shafts.friction_nms": 0.06,
            "sleeve.delay_ms": 54.0,
            "sleeve.delay_sd_ms": 1.5,
            "clutch.kiss_percent": 36.0,
            "clutch.kiss_tolerance_percent": 3.0,
            "wheels.layshaft.duty_percent": 51.0,
            "wheels.main.duty_percent": 48.0,
        }
    )


def test_of_two_ways_the_one_that_was_told_stands_for_both() -> None:
    found = by_key(told(brake_valve_off_delay=None, brake_filling_time=None))
    assert found["brake.valve_delay_ms"] == 13.0
    assert found["brake.time_constant_ms"] == 60.0


@pytest.mark.parametrize(
    ("figures", "keys"),
    [
        (["brake torque"], ["brake.max_torque_nm"]),
        (["brake valve on delay", "brake valve off delay"], ["brake.valve_delay_ms"]),
        (["brake filling time", "brake emptying time"], ["brake.time_constant_ms"]),
        (["inertia ratio"], ["shafts.input_inertia_kgm2"]),
        (["drag"], ["shafts.friction_nms"]),
        (["sleeve delay spread"], ["sleeve.delay_sd_ms"]),
        (
            ["sleeve delay first", "sleeve delay third"],
            ["sleeve.delay_ms", "sleeve.delay_sd_ms"],
        ),
        (["clutch kiss point"], ["clutch.kiss_percent", "clutch.kiss_tolerance_percent"]),
        (["layshaft wheel duty"], ["wheels.layshaft.duty_percent"]),
        (["main wheel duty"], ["wheels.main.duty_percent"]),
    ],
)
def test_what_was_not_told_has_no_key(figures: list[str], keys: list[str]) -> None:
    whole = by_key(told())
    less = by_key(told(**{name.replace(" ", "_"): None for name in figures}))
    assert set(whole) - set(less) == set(keys)


@pytest.mark.parametrize(("spread_ms", "kept_ms"), [(0.05, 0.1), (0.11, 0.11)])
def test_a_spread_is_a_tenth_of_a_millisecond_at_least(spread_ms: float, kept_ms: float) -> None:
    assert by_key(told(sleeve_delay_spread=spread_ms))["sleeve.delay_sd_ms"] == kept_ms


def test_drag_is_told_over_the_speed_it_was_seen_at_and_is_never_negative() -> None:
    assert by_key(told(drag=-1.0))["shafts.friction_nms"] == 0.0
    for omega, keeps in ((0.0, False), (0.5, True)):
        found = told()
        found.omega_ref_rad_s = omega
        assert ("shafts.friction_nms" in by_key(found)) is keeps
    assert by_key(found)["shafts.friction_nms"] == pytest.approx(12.0)


@pytest.mark.parametrize(("low", "high"), [(None, 38.0), (35.0, None), (None, None)])
def test_a_kiss_point_without_an_interval_has_no_tolerance(
    low: float | None, high: float | None
) -> None:
    found = told(clutch_kiss_point=None)
    found.figures = [each for each in found.figures if each.name != "clutch kiss point"]
    found.figures.append(Figure("clutch kiss point", "%", 36.0, low, high, 35.0, 20))
    keys = by_key(found)
    assert keys["clutch.kiss_percent"] == 36.0
    assert "clutch.kiss_tolerance_percent" not in keys


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


def test_a_figure_is_found_by_its_name_and_so_is_its_value() -> None:
    found = told(drag=None)
    assert found.value("brake torque") == 91.5
    assert found.value("drag") is None
    with pytest.raises(KeyError):
        found.value("no such figure")


def test_nothing_is_known_of_a_log_before_it_is_read() -> None:
    found = Identified()
    assert (found.omega_ref_rad_s, found.supply_pa) == (0.0, 0.0)
    untold(found, "so", ("a", "Nm", 3.0), ("b", "ms", None))
    assert found.figures == [
        Figure("a", "Nm", None, None, None, 3.0, 0, "so"),
        Figure("b", "ms", None, None, None, None, 0, "so"),
    ]


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
    run: Any = SimpleNamespace()
    for _ in range(3):
        content.runs.add(run)
    assert why_no_runs(content) == "3 runs in neutral with an open clutch, 5 are needed"


def test_a_long_list_begins_to_be_thinned_at_its_257th_item() -> None:
    kept: Thinned[int] = Thinned()
    for k in range(256):
        kept.add(k)
    assert list(kept) == list(range(256))
    kept.add(256)
    assert list(kept) == list(range(0, 257, 2))
    assert (len(kept), kept[3], kept[-1]) == (129, 6, 256)


def test_half_an_interval_is_student_s_for_95_percent_and_one_degree_of_freedom_at_least() -> None:
    """By the tables: 12.706 of one, 2.228 of ten, 1.960 of very many."""
    for freedom, half in ((0.0, 12.706), (1.0, 12.706), (10.0, 2.228), (1e7, 1.960)):
        assert student(freedom) == pytest.approx(half, abs=5e-4)
    assert student(1.1) == pytest.approx(float(student_law.ppf(0.975, 1.1)))


def test_errors_are_told_as_the_root_of_their_mean_square() -> None:
    found = check_samples("a", "ms", np.array([3.0, -4.0]), np.array([6.0, 8.0]))
    assert (found.name, found.unit, found.samples) == ("a", "ms", 2)
    assert found.identified == pytest.approx(math.sqrt(12.5))
    assert found.by_sheet == pytest.approx(math.sqrt(50.0))
