"""The run header: what a log needs beside it to be repeated."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import platform
from pathlib import Path

import numpy as np
import pytest

from meshpoint.controller.settings.header import HeaderError, RunHeader, header_name, load_header
from meshpoint.controller.settings.settings import Aim, ControllerSettings, ShiftLimits
from meshpoint.dbc import DBC_SHA256
from meshpoint.gearbox.sheet import SHEET_NAMES, load_sheet


def test_a_header_comes_back_as_it_was_saved(header: RunHeader, tmp_path: Path) -> None:
    settings = ControllerSettings(
        strategy_name="speed_window", aim=Aim(0.1), limits=ShiftLimits(attempts=2)
    )
    others = (
        dataclasses.replace(header, settings=settings),
        dataclasses.replace(header, armed=False),
    )
    for saved in (header, *others):
        path = saved.save(tmp_path / "new folder")
        assert path.name == header_name(saved.run_hash)
        assert load_header(path.parent, saved.run_hash) == saved


def test_the_run_hash_is_the_start_of_the_sha256_of_the_file(
    header: RunHeader, tmp_path: Path
) -> None:
    """So that the name can be checked with sha256sum."""
    text = header.save(tmp_path).read_text().rstrip("\n")
    assert header.run_hash.to_bytes(8, "little") == hashlib.sha256(text.encode()).digest()[:8]
    assert json.loads(text)["dbc_sha256"] == DBC_SHA256


@pytest.mark.parametrize(
    "other",
    [
        {"version": "1.2.4"},
        {"architecture": "pdp11"},
        {"arithmetic": "numpy 1.0"},
        {"dbc_sha256": "0" * 64},
        {"settings": ControllerSettings(aim=Aim(1e-9))},
        {"armed": False},
    ],
)
def test_whatever_a_step_depends_on_changes_the_hash(
    header: RunHeader, other: dict[str, object]
) -> None:
    assert dataclasses.replace(header, **other).run_hash != header.run_hash


def test_an_armed_run_is_not_mentioned(header: RunHeader) -> None:
    """So that runs from before the switch keep their hash."""
    assert "armed" not in json.loads(header.canonical())
    assert json.loads(dataclasses.replace(header, armed=False).canonical())["armed"] is False


def test_python_is_no_part_of_a_run(header: RunHeader) -> None:
    """Its minor version decides no byte, so the same run has the same hash in all of them."""
    assert header.architecture == platform.machine()
    assert "ython" not in header.canonical()


def test_a_header_from_before_arithmetic_was_kept_comes_back_with_its_hash(
    header: RunHeader, tmp_path: Path
) -> None:
    machine = f"{platform.machine()} python 3.12"
    old = dataclasses.replace(header, architecture=machine, arithmetic=None)
    old.save(tmp_path)
    assert "arithmetic" not in json.loads(old.canonical())
    assert load_header(tmp_path, old.run_hash) == old
    assert old.rounds_otherwise == ""


def test_what_may_round_otherwise_is_named_and_nothing_else(header: RunHeader) -> None:
    assert header.rounds_otherwise == ""
    assert header.arithmetic is not None
    here = f"numpy {np.__version__}"
    assert here in header.arithmetic
    there = header.arithmetic.replace(here, "numpy 1.0")
    other = dataclasses.replace(header, arithmetic=there)
    assert other.rounds_otherwise == f"recorded with numpy 1.0, this is {here}"
    other = dataclasses.replace(header, architecture="pdp11 python 3.11", arithmetic=None)
    assert "architecture pdp11, this is architecture" in other.rounds_otherwise


def test_another_tooth_changes_the_hash(header: RunHeader) -> None:
    dog = dataclasses.replace(header.sheet.dog, teeth=47)
    sheet = dataclasses.replace(header.sheet, dog=dog)
    assert dataclasses.replace(header, sheet=sheet).run_hash != header.run_hash


def test_a_header_that_was_changed_is_refused(header: RunHeader, tmp_path: Path) -> None:
    path = header.save(tmp_path)
    path.write_text(path.read_text().replace('"attempts":3', '"attempts":4'))
    with pytest.raises(HeaderError, match=r"header-.*another hash"):
        load_header(tmp_path, header.run_hash)


def test_a_missing_header_is_named(header: RunHeader, tmp_path: Path) -> None:
    with pytest.raises(HeaderError, match=header_name(header.run_hash)):
        load_header(tmp_path, header.run_hash)


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"null",
        b"[1, 2]",
        b"{}",
        b'"text"',
        b"\xff\xfe",
        b"[" * 100_000,
        b'{"version": 1, "settings": []}',
        b" " * (5 * 1024 * 1024),
    ],
    ids=["empty", "null", "list", "nothing", "text", "no utf-8", "deep", "wrong kinds", "huge"],
)
def test_what_is_no_header_is_refused_by_name(
    header: RunHeader, tmp_path: Path, content: bytes
) -> None:
    (tmp_path / header_name(header.run_hash)).write_bytes(content)
    with pytest.raises(HeaderError, match=header_name(header.run_hash)):
        load_header(tmp_path, header.run_hash)


@pytest.mark.parametrize("group", ["settings", "sheet", "version"])
def test_a_torn_header_is_refused(header: RunHeader, tmp_path: Path, group: str) -> None:
    values = json.loads(header.canonical())
    del values[group]
    (tmp_path / header_name(header.run_hash)).write_text(json.dumps(values))
    with pytest.raises(HeaderError, match=group):
        load_header(tmp_path, header.run_hash)


def with_name(folder: Path, values: dict[str, object]) -> int:
    """Saves a header of any content under the hash that it has."""
    text = json.dumps(values, sort_keys=True, separators=(",", ":"))
    run_hash = int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "little")
    (folder / header_name(run_hash)).write_text(text, encoding="utf-8")
    return run_hash


@pytest.mark.parametrize(
    ("where", "value"),
    [
        ("settings timing tick_ms", 0),
        ("settings timing tick_ms", 10.5),
        ("settings timing tick_ms", True),
        ("settings timing tick_ms", 10**400),
        ("settings window fire_slip_rad_s", float("nan")),
        ("settings window fire_slip_rad_s", float("inf")),
        ("settings window fire_slip_rad_s", 1e300),
        ("settings strategy_name", "hope"),
        ("settings guard", [1]),
        ("settings limits attempts", None),
        ("sheet wheels main teeth", 10**9),
        ("sheet wheels main missing", [1, 1]),
        ("sheet main first driving", 0),
        ("sheet dog backlash_share", float("nan")),
        ("sheet dog backlash_share", "0.2"),
        ("sheet name", 7),
        ("calibration", 7),
        ("calibration", "a = 1"),
        ("version", ["1"]),
        ("arithmetic", 7),
    ],
)
def test_a_value_out_of_its_range_is_refused_by_key(
    header: RunHeader, tmp_path: Path, where: str, value: object
) -> None:
    """The hash of the file is right: it was made so, by whatever."""
    values = json.loads(header.canonical())
    *path, key = where.split()
    table = values
    for name in path:
        table = table[name]
    assert key in table
    table[key] = value
    run_hash = with_name(tmp_path, values)
    with pytest.raises(HeaderError, match=header_name(run_hash)) as refusal:
        load_header(tmp_path, run_hash)
    is_number = isinstance(value, float) and value != 1e300
    assert is_number or key in str(refusal.value)
    assert len(str(refusal.value)) < 500


@pytest.mark.parametrize("where", ["settings", "settings timing", "sheet", "sheet wheels main"])
def test_a_key_too_many_or_too_few_is_refused(
    header: RunHeader, tmp_path: Path, where: str
) -> None:
    for change in ("more", "less"):
        values = json.loads(header.canonical())
        table = values
        for name in where.split():
            table = table[name]
        if change == "more":
            table["further"] = 1
        else:
            table.pop(next(iter(table)))
        run_hash = with_name(tmp_path, values)
        with pytest.raises(HeaderError, match=f"{where.split()[-1]}.*key '"):
            load_header(tmp_path, run_hash)


def test_every_shipped_sheet_and_the_settings_come_back_bit_for_bit(
    header: RunHeader, tmp_path: Path
) -> None:
    """Ranges in SI are those of the keys, rounded the same way: what a file may hold passes."""
    for name in SHEET_NAMES:
        saved = dataclasses.replace(header, sheet=load_sheet(name), calibration=None)
        saved.save(tmp_path)
        assert load_header(tmp_path, saved.run_hash).canonical() == saved.canonical()
