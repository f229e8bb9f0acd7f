"""docs/thesis.md is complete, and what it names is there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from benchmarks.studies.registry import STUDY_NAMES, load

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "docs" / "thesis.md").read_text(encoding="utf-8")
EQUATIONS = {
    "2": [1],
    "3": [1, 2],
    "4": list(range(1, 18)),
    "5": list(range(1, 19)),
}


def cells(section: str) -> list[str]:
    """The first cell of every row of a section's table."""
    body = TEXT.split(f"## {section}")[1].split("\n## ")[0]
    rows = [line for line in body.splitlines() if line.startswith("| ")]
    return [row.split("|")[1].strip() for row in rows[1:]]


def named_equations() -> set[str]:
    found = set()
    for cell in cells("Equations"):
        for item in cell.split(", "):
            ends = re.findall(r"\d+\.\d+", item)
            if not ends:
                continue
            chapter, first = ends[0].split(".")
            last = ends[-1].split(".")[1]
            found |= {f"{chapter}.{n}" for n in range(int(first), int(last) + 1)}
    return found


def test_every_equation_of_the_thesis_is_there() -> None:
    wanted = {f"{chapter}.{n}" for chapter, numbers in EQUATIONS.items() for n in numbers}
    assert named_equations() == wanted


def test_every_figure_and_table_is_there() -> None:
    named = set(re.findall(r"(?:figure|table) \d\.\d+", " ".join(cells("Figures and tables"))))
    figures = {"2.1", "2.2", "3.1", "3.2", "4.1"} | {f"6.{n}" for n in range(1, 14)}
    assert named == {f"figure {n}" for n in figures} | {"table 6.1", "table 6.2"}


def test_every_study_is_there_and_those_named_exist() -> None:
    named = set()
    for group in re.findall(r"stud(?:y|ies) ((?:`\w+`(?:, | and )?)+)", TEXT):
        named |= set(re.findall(r"`(\w+)`", group))
    assert named <= set(STUDY_NAMES)
    assert {name for name in STUDY_NAMES if load(name).of} <= named


BY_CONSTRUCTION = {
    "torque",
    "delay",
    "delay_error",
    "parameters",
    "start_angle",
    "start_speed",
    "hold",
}
"""The studies of which a statement has that verdict: tests/studies/test_findings.py."""


def test_every_agreement_that_had_to_come_is_told_from_those_that_did_not() -> None:
    rows = " ".join(cells("What a verdict is worth"))
    assert set(re.findall(r"`(\w+)`", rows)) == BY_CONSTRUCTION


def test_misprints_are_named_where_they_are() -> None:
    named = set(re.findall(r"^\| (\d\.\d+)d? \| .* \| .* \| .* \|$", TEXT, re.MULTILINE))
    assert {"4.15", "4.16", "5.1", "5.5", "5.12", "5.17"} <= named


def test_a_shift_in_which_the_splitter_changes_too_has_a_row() -> None:
    assert "section 6.3.2" in cells("Figures and tables")


LIMITED = {
    "1.4", "2", "2.1", "2.3", "4.1", "4.2.1", "4.2.3", "4.5", "5.2.1", "5.4.2", "5.4.3", "6.1.2",
    "6.2", "6.4.3", "7.1", "7.2", "7.4",
}  # fmt: skip
"""Sections in which the thesis says what it leaves out, assumes or lacks."""
WISHES = ("input, main and propeller", "main-shaft speed", "first engagement", "keep that angle",
          "real system")  # fmt: skip


def test_every_limitation_is_there_and_answered() -> None:
    rows = cells("Limitations")
    named = {number for row in rows for number in re.findall(r"\b\d(?:\.\d)*\b(?! ms)", row)}
    assert named >= LIMITED


def test_every_item_of_future_work_is_there() -> None:
    rows = cells("Future work (8.2)")
    assert len(rows) == len(WISHES)
    for row, wish in zip(rows, WISHES, strict=True):
        assert wish in row


def test_no_row_is_left_empty() -> None:
    for line in TEXT.splitlines():
        if line.startswith("| "):
            assert any(cell.strip() for cell in line.split("|")[2:]), line


FILES = sorted(set(re.findall(r"`((?:[a-z_]+/)+[a-z_]+\.[a-z]+)`", TEXT)))


def test_files_are_found_in_the_text() -> None:
    assert len(FILES) > 40


@pytest.mark.parametrize("name", FILES)
def test_a_file_that_is_named_exists(name: str) -> None:
    assert (ROOT / name).is_file()
