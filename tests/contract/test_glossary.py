"""Documents use the field's words: none that the glossary's table "write / not" has given up."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
GLOSSARY = ROOT / "docs" / "glossary.md"
CODE = ("controller", "rig_sim", "dbc", "meshpoint", "benchmarks", "examples")
"""Folders whose Python is held to it as well."""
HISTORY = ROOT / "docs" / "decisions"
TABLE = GLOSSARY.read_text(encoding="utf-8").split("| write | not |")[1]
RETIRED = re.findall(r"`([^`]+)`", "".join(row.split("|")[2] for row in TABLE.splitlines()[2:]))
ANY = re.compile(rf"\b(?:{'|'.join(map(re.escape, RETIRED))})\b", re.IGNORECASE)


def checked() -> list[Path]:
    """README, the pages of docs/ but the decisions, which are history, and the code of CODE."""
    pages = [
        path
        for path in (ROOT / "docs").rglob("*.md")
        if path != GLOSSARY and not path.is_relative_to(HISTORY)
    ]
    return [ROOT / "README.md", *pages, *(p for name in CODE for p in (ROOT / name).rglob("*.py"))]


def retired_in(text: str) -> list[str]:
    """The retired words of a text, without "of course", code between backticks, and links."""
    plain = re.sub(r"`[^`\n]*`|\]\([^)]*\)|\bof course\b", " ", text)
    plain = re.sub(r"\s+", " ", plain)
    return [word.lower() for word in ANY.findall(plain)]


def test_the_table_has_the_words() -> None:
    assert {"told", "drawn anew", "misfit", "course"} <= set(RETIRED)


@pytest.mark.parametrize("path", checked(), ids=lambda path: path.relative_to(ROOT).as_posix())
def test_no_word_that_was_given_up_is_written(path: Path) -> None:
    assert retired_in(path.read_text(encoding="utf-8")) == []


def test_a_word_is_found_as_a_whole_and_over_a_line_s_end() -> None:
    assert retired_in("it was drawn\nanew") == ["drawn anew"]
    assert retired_in("Told by nobody") == ["told"]
    assert retired_in("untold, of course; `told`, [x](drawn-anew.md)") == []
