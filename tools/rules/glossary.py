"""Documents and code use the field's words: none that the glossary's table "write / not" has given
up."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from rules import PRODUCT, ROOT, name_of

GLOSSARY = ROOT / "docs" / "glossary.md"
CODE = (*PRODUCT, "benchmarks", "examples")
"""Folders whose Python is held to it as well."""
TABLE = GLOSSARY.read_text(encoding="utf-8").split("| write | not |")[1]
RETIRED = re.findall(r"`([^`]+)`", "".join(row.split("|")[2] for row in TABLE.splitlines()[2:]))
ANY = re.compile(rf"\b(?:{'|'.join(map(re.escape, RETIRED))})\b", re.IGNORECASE)
ALWAYS = {"told", "drawn anew", "misfit", "course"}
"""Words of the table by which it is known to have been read."""


def checked() -> list[Path]:
    """README and the pages beside it, those of docs/, and the code of CODE."""
    pages = [path for path in sorted((ROOT / "docs").rglob("*.md")) if path != GLOSSARY]
    code = [path for name in CODE for path in sorted((ROOT / name).rglob("*.py"))]
    return [*sorted(ROOT.glob("*.md")), *pages, *code]


def retired_in(text: str) -> list[str]:
    """The retired words of a text, without "of course", code between backticks, and links."""
    plain = re.sub(r"`[^`\n]*`|\]\([^)]*\)|\bof course\b", " ", text)
    plain = re.sub(r"\s+", " ", plain)
    return [word.lower() for word in ANY.findall(plain)]


def findings() -> Iterator[str]:
    """Of all that is held to it."""
    if missing := ALWAYS - set(RETIRED):
        yield f"{name_of(GLOSSARY)}: its table lacks {sorted(missing)}"
    for path in checked():
        for word in retired_in(path.read_text(encoding="utf-8")):
            yield f'{name_of(path)}: "{word}" is not written any more: docs/glossary.md'
