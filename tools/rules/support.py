"""docs/support.md: its messages are the DBC's, its tests are there."""

from __future__ import annotations

import re
from collections.abc import Iterator

import cantools

from meshpoint.dbc.j1939 import group_of
from meshpoint.dbc.source import DBC_PATH
from meshpoint.dbc.truck import TRUCK_DBC
from rules import ROOT, name_of

PAGE = ROOT / "docs" / "support.md"
LEAST_TESTS = 15


def expected_rows() -> set[tuple[str, str, str]]:
    """Name, group and SPNs of each message of the standard, by the two DBC files."""
    return {
        (each.name, str(group_of(each.frame_id)), ", ".join(str(s.spn) for s in each.signals))
        for path in (DBC_PATH, TRUCK_DBC)
        for each in cantools.database.load_file(path, sort_signals=None).messages
        if all(signal.spn for signal in each.signals)
    }


def findings() -> Iterator[str]:
    """Rows that the DBC has not, rows that lack, tests that are not there or not named."""
    page, text = name_of(PAGE), PAGE.read_text(encoding="utf-8")
    rows = re.findall(r"^\| (\w+) \| (\d+) \| ([\d, ]+) \|", text, re.MULTILINE)
    expected = expected_rows()
    for row in sorted(expected.symmetric_difference(rows)):
        yield f"{page}: {' | '.join(row)}: {'no row' if row in expected else 'not in the DBC'}"
    if len(rows) != len(set(rows)):
        yield f"{page}: a message has two rows"
    named = re.findall(r"`(tests/[\w/]+\.py)`", text)
    if len(named) <= LEAST_TESTS:
        yield f"{page}: names {len(named)} tests"
    for name in named:
        if not (ROOT / name).is_file():
            yield f"{page}: no {name}"
    for line in text.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        is_row = len(cells) == 5 and cells[0] and not set(line) <= set("|- ")
        if (
            is_row
            and cells[4] != "shown by"
            and bool(cells[1] or cells[2]) != ("`tests/" in cells[4])
        ):
            yield f"{page}: what is supported names its test, and nothing else does: {line}"
