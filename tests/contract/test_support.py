"""docs/support.md: its messages are the DBC's, its tests are there."""

from __future__ import annotations

import re
from pathlib import Path

import cantools

from meshpoint.dbc.j1939 import group_of
from meshpoint.dbc.source import DBC_PATH
from meshpoint.dbc.truck import TRUCK_DBC

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "support.md").read_text("utf-8")


def test_the_messages_of_the_standard_are_those_of_the_dbc() -> None:
    expected = [
        (each.name, str(group_of(each.frame_id)), ", ".join(str(s.spn) for s in each.signals))
        for path in (DBC_PATH, TRUCK_DBC)
        for each in cantools.database.load_file(path, sort_signals=None).messages
        if all(signal.spn for signal in each.signals)
    ]
    rows = re.findall(r"^\| (\w+) \| (\d+) \| ([\d, ]+) \|", PAGE, re.MULTILINE)
    assert sorted(rows) == sorted(expected)


def test_each_test_that_is_named_is_there() -> None:
    named = re.findall(r"`(tests/[\w/]+\.py)`", PAGE)
    assert len(named) > 15
    assert [path for path in named if not (ROOT / path).is_file()] == []


def test_what_is_supported_names_its_test() -> None:
    for line in PAGE.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if len(cells) == 5 and cells[0] and not set(line) <= set("|- ") and cells[4] != "shown by":
            assert bool(cells[1] or cells[2]) == ("`tests/" in cells[4]), line
