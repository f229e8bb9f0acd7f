"""The text of an A2L file: blocks within blocks, names and texts as ASAM MCD-2 MC 1.7 has them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Final

from meshpoint.gearbox.plain_text import plain

INDENT: Final = "  "


def block(kind: str, first: str, lines: Iterable[str] = ()) -> Iterator[str]:
    """One block: its first line, and what stands in it."""
    yield f"/begin {kind} {first}".rstrip()
    yield from (INDENT + line for line in lines)
    yield f"/end {kind}"


def quoted(text: str) -> str:
    """A text on one line, without the marks of our pages."""
    one_line = " ".join(plain(text).replace("`", "").split())
    return '"{}"'.format(one_line.replace("\\", "\\\\").replace('"', '\\"'))


def hexadecimal(address: int) -> str:
    """An address or an identifier."""
    return f"0x{address:08X}"
