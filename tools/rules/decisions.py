"""Each decision record says its status; the table of docs/decisions/README.md has every record with
its title, status and what was folded into it; no text names a record that there is not."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from pathlib import Path

from rules import ROOT, name_of
from rules.glossary import checked

FOLDER = ROOT / "docs" / "decisions"
TABLE = FOLDER / "README.md"
STATUS = re.compile(r"\*\*Status\.\*\* (Accepted \d{4}-\d\d-\d\d)\b")
FOLDED = re.compile(r"\b((?:\d{4}(?:, | and )?)+) (?:is|are) folded in\b")
NAMED = re.compile(r"\bdecisions?(?:/|\s+)(\d{4})\b", re.IGNORECASE)


def row_of(name: str, text: str) -> str | None:
    """The row of the table for a record; None where the record does not say its title or status."""
    title, _, rest = text.partition("\n")
    status = " ".join(rest.strip().partition("\n\n")[0].split())
    found = STATUS.match(status)
    if not found or not title.startswith(f"# {name[:4]} "):
        return None
    folded = FOLDED.search(status)
    numbers = ", ".join(re.findall(r"\d{4}", folded[1])) if folded else ""
    return f"| [{title[2:]}]({name}) | {found[1]} | {numbers} |"


def missing_in(text: str, records: Iterable[str]) -> list[str]:
    """Numbers of records that a text names and that there are not."""
    return sorted(set(NAMED.findall(text)) - {name[:4] for name in records})


def sources() -> Iterator[Path]:
    """All that may name a record."""
    yield ROOT / "CHANGELOG.md"
    yield from checked()


def findings() -> Iterator[str]:
    """Of the records, of their table, and of all that names one."""
    texts = {path.name: path.read_text(encoding="utf-8") for path in sorted(FOLDER.glob("0*.md"))}
    rows = [row_of(name, text) for name, text in texts.items()]
    for name, row in zip(texts, rows, strict=True):
        if row is None:
            yield f"docs/decisions/{name}: no title with its number, or no line of its status"
    table = [line for line in TABLE.read_text(encoding="utf-8").splitlines() if "](0" in line]
    expected = [row for row in rows if row]
    for line in sorted(set(expected) - set(table)):
        yield f"{name_of(TABLE)}: lacks {line}"
    for line in sorted(set(table) - set(expected)):
        yield f"{name_of(TABLE)}: no record says {line}"
    for path in sources():
        for number in missing_in(path.read_text(encoding="utf-8"), texts):
            yield f"{name_of(path)}: there is no decision {number}"
