"""What a calibration file may hold: the format that files already written go by, key by key, in the
units of the keys, and what of it has to suit the data sheet."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from typing import Any, Final

import pytest
from calibration_example import SHEET, example

from meshpoint.controller.settings.learned import (
    BrakeRecord,
    CalibrationError,
    NoiseRecord,
    Provenance,
    ReferenceRecords,
    SleeveRecord,
    SleeveRecords,
    SwingRecord,
    WheelRecord,
    WheelRecords,
    check,
    read_calibration,
)
from meshpoint.gearbox import MainGear
from meshpoint.gearbox.gears import MAIN_GEARS
from meshpoint.gearbox.tables import TableError, read_group

DEG, RPM, TURN, BAR, MS, US = math.pi / 180.0, math.pi / 30.0, 2.0 * math.pi, 1e5, 1e-3, 1e-6
Range = tuple[float, float, float]
"""Least and most in the key's unit, and that unit in SI."""
SHIFTS: Final = (0, 10**9, 1)
SD5: Final = (0.0, 5.0, 1.0)
FORMAT: Final[dict[type, dict[str, Range]]] = {
    WheelRecord: {
        "teeth": (2, 1000, 1), "learned_from_edges": (0, 2**62, 1), "sd_deg": (1e-4, 5.0, DEG),
    },
    ReferenceRecords: {
        f"{gear}_deg": (-180.0, 180.0, DEG) for gear in ("crawl", "first", "second", "third")
    },
    BrakeRecord: {
        "learned_from_shifts": SHIFTS, "gain": (0.2, 5.0, 1.0), "gain_sd": (0.0, 1.0, 1.0),
        "drag_nm": (-200.0, 200.0, 1.0), "drag_sd_nm": (0.0, 200.0, 1.0),
        "touch_bar": (0.0, 2.0, BAR), "touch_sd_bar": (0.0, 2.0, BAR),
        "sensor_lag_ms": (0.0, 100.0, MS), "sensor_lag_sd_ms": (0.0, 300.0, MS),
        "off_delay_ms": (0.0, 200.0, MS), "off_delay_sd_ms": (0.0, 100.0, MS),
        "on_delay_ms": (0.0, 200.0, MS), "on_delay_sd_ms": (0.0, 100.0, MS),
    },
    NoiseRecord: {
        "learned_from_shifts": SHIFTS, "layshaft_edge_us": (0.05, 500.0, US),
        "layshaft_edge_sd": SD5, "main_edge_us": (0.05, 500.0, US), "main_edge_sd": SD5,
        "torque_nm": (1e-3, 1e3, 1.0), "torque_sd": SD5, "memory_ms": (0.1, 5e3, MS),
        "memory_sd": SD5, "friction_nms": (0.0, 10.0, 1.0), "friction_sd": SD5,
    },
    SwingRecord: {
        "learned_from_shifts": (1, 10**9, 1), "frequency_hz": (0.01, 1e3, TURN),
        "frequency_sd": SD5, "damping": (1e-4, 1.0, 1.0), "damping_sd": SD5,
        "speed_rpm": (1e-4, 1e4, RPM), "speed_sd": SD5, "noise_rad2_s3": (1e-9, 1e9, 1.0),
        "noise_sd": SD5, "shaft_noise_rad2_s3": (1e-9, 1e9, 1.0), "shaft_noise_sd": SD5,
        "hill_rad_s2": (1e-4, 1e5, 1.0), "hill_sd": SD5, "half_lash_deg": (1e-5, 90.0, DEG),
        "half_lash_sd": SD5,
    },
    SleeveRecord: {
        "delay_ms": (1.0, 500.0, MS), "samples": (0.01, 1e4, 1.0),
        "scatter_ms": (1e-3, 100.0, MS), "scatter_samples": (0.01, 1e4, 1.0),
    },
    Provenance: {"shifts": SHIFTS},
}  # fmt: skip
LISTS: Final[dict[type, dict[str, tuple[int, Range]]]] = {
    WheelRecord: {"error_deg": (4, (-5.0, 5.0, DEG))},
    BrakeRecord: {
        "emptying": (4, (0.1, 10.0, 1.0)), "emptying_sd": (4, (0.0, 2.0, 1.0)),
        "filling": (4, (0.1, 10.0, 1.0)), "filling_sd": (4, (0.0, 2.0, 1.0)),
    },
}  # fmt: skip
"""How many numbers a list holds, and the range of each."""
OTHERS: Final[dict[type, dict[str, Any]]] = {
    SwingRecord: {"has_lash": True},
    Provenance: {"meshpoint": "1", "sheet": "s", "sheet_sha256": "a", "written": "today"},
}
"""Keys that hold no numbers."""


def table(kind: type) -> dict[str, Any]:
    """One in the middle of all ranges."""
    numbers = {key: _middle(of) for key, of in FORMAT[kind].items()}
    lists = {key: [_middle(of)] * count for key, (count, of) in LISTS.get(kind, {}).items()}
    made = numbers | lists | OTHERS.get(kind, {})
    return made | ({"teeth": 2} if kind is WheelRecord else {})


def _middle(of: Range) -> float:
    low, high, _ = of
    return (low + high) // 2 if isinstance(low, int) else 0.5 * (low + high)


def beyond(of: Range) -> tuple[float, float]:
    low, high, _ = of
    if isinstance(low, int):
        return low - 1, high + 1
    return low - 1e-9 * (abs(low) or 1.0), high + 1e-9 * (abs(high) or 1.0)


def attribute(kind: type, key: str) -> str:
    return next(each.name for each in fields(kind) if each.metadata["rule"].key == key)


NUMBERS: Final = [(kind, key) for kind, keys in FORMAT.items() for key in keys]


@pytest.mark.parametrize(("kind", "key"), NUMBERS)
def test_a_number_is_kept_in_its_keys_unit_and_within_its_range(kind: type, key: str) -> None:
    low, high, unit = of = FORMAT[kind][key]
    for value in (low, high):
        given = table(kind) | {key: value}
        if key == "teeth":
            given["error_deg"] = [0.0] * (2 * int(value))
        found = getattr(read_group(kind, given, "file"), attribute(kind, key))
        assert found == pytest.approx(value * unit, rel=1e-12)
    for value in beyond(of):
        with pytest.raises(TableError, match=f"{key} = .* allowed is"):
            read_group(kind, table(kind) | {key: value}, "file")


@pytest.mark.parametrize(("kind", "key"), [(k, key) for k, keys in LISTS.items() for key in keys])
def test_a_list_has_its_length_and_each_of_its_numbers_its_range(kind: type, key: str) -> None:
    count, (low, high, unit) = LISTS[kind][key]
    ends = [low, high, low, high][:count]
    found = getattr(read_group(kind, table(kind) | {key: ends}, "file"), attribute(kind, key))
    assert found == pytest.approx(tuple(value * unit for value in ends))
    middle = _middle((low, high, unit))
    for value in beyond((low, high, unit)):
        with pytest.raises(TableError, match=key):
            read_group(kind, table(kind) | {key: [middle] * (count - 1) + [value]}, "file")
    for wrong in (count - 1, count + 1):
        with pytest.raises(TableError, match=f"holds {wrong} numbers, allowed are {count}"):
            read_group(kind, table(kind) | {key: [middle] * wrong}, "file")


@pytest.mark.parametrize("kind", list(FORMAT))
def test_no_key_may_be_missing_but_those_that_older_files_do_not_have(kind: type) -> None:
    """Friction and its sd are 0 then; a phase reference is not known."""
    for key in table(kind):
        less = {name: value for name, value in table(kind).items() if name != key}
        if kind is ReferenceRecords:
            assert getattr(read_group(kind, less, "file"), attribute(kind, key)) is None
        elif key.startswith("friction"):
            assert getattr(read_group(kind, less, "file"), attribute(kind, key)) == 0.0
        else:
            with pytest.raises(TableError, match=f"'{key}' is missing"):
                read_group(kind, less, "file")
    with pytest.raises(TableError, match="unknown key"):
        read_group(kind, table(kind) | {"other": 1}, "file")


@pytest.mark.parametrize("missing", ["layshaft", "main"])
def test_references_belong_to_the_teeth_of_both_wheels(missing: str) -> None:
    known = example()
    less = replace(known.wheels, **{missing: None})
    with pytest.raises(TableError, match="without the teeth of both wheels"):
        replace(known, wheels=less)
    without = replace(known, wheels=less, references=ReferenceRecords())
    assert getattr(without.wheels, missing) is None


def refused(text: str) -> str:
    with pytest.raises(CalibrationError) as error:
        read_calibration(text, "box.toml", SHEET)
    return str(error.value)


@pytest.mark.parametrize("name", ["layshaft", "main"])
def test_a_wheel_has_as_many_teeth_as_drawn_and_none_is_off_by_over_a_quarter_of_a_pitch(
    name: str,
) -> None:
    known = example()
    drawn = getattr(SHEET.wheels, name)
    most = drawn.pitch_rad / 4.0
    record: WheelRecord = getattr(known.wheels, name)
    for index, error in ((0, most), (89, -most), (37, 0.5 * most)):
        errors = tuple(error if k == index else 0.0 for k in range(90))
        fits = replace(record, error_rad=errors)
        check(replace(known, wheels=replace(known.wheels, **{name: fits})), SHEET, "box.toml")
        if abs(error) == most:
            off = replace(record, error_rad=tuple(1.001 * each for each in errors))
            wheels = replace(known.wheels, **{name: off})
            said = refused(replace(known, wheels=wheels).to_text())
            degrees = 1.001 * error / DEG
            assert said.startswith(f"box.toml: wheels: {name}: error_deg[{index}] = {degrees:g}")
            assert said.endswith(f"allowed is {most / DEG:.3g} at most")
    fewer = replace(record, teeth=44, error_rad=record.error_rad[:88])
    said = refused(replace(known, wheels=replace(known.wheels, **{name: fewer})).to_text())
    assert said == f"box.toml: wheels: {name}: teeth = 44, allowed is 45"


@pytest.mark.parametrize("only", ["layshaft", "main"])
def test_a_wheel_that_is_known_is_checked_though_the_other_is_not(only: str) -> None:
    known = example()
    wrong = replace(known.wheels.layshaft, teeth=44, error_rad=(0.0,) * 88)  # type: ignore[type-var]
    wheels = WheelRecords(**{only: wrong})
    said = refused(replace(known, wheels=wheels, references=ReferenceRecords()).to_text())
    assert f"wheels: {only}: teeth = 44" in said


@pytest.mark.parametrize("gear", MAIN_GEARS)
def test_no_sleeve_is_faster_than_its_valve(gear: MainGear) -> None:
    least_s = SHEET.sleeve.valve_delay_s
    for delay_s, is_allowed in ((least_s, True), (1.01 * least_s, True), (0.99 * least_s, False)):
        record = SleeveRecord(delay_s, 6.5, 0.0012, 10.0)
        sleeves = SleeveRecords(**{gear.name.lower(): record})
        text = replace(example(), sleeves=sleeves).to_text()
        if is_allowed:
            assert read_calibration(text, "box.toml", SHEET).sleeves.of(gear) is not None
        else:
            assert refused(text) == (
                f"box.toml: sleeves: {gear.name.lower()}: delay_ms = {delay_s / MS:g}, allowed is "
                f"no less than its valve's {least_s / MS:g}"
            )
