"""The width of a terminal, into which errors that name many words are folded."""

from __future__ import annotations

import textwrap
from typing import Final

COLUMNS: Final = 80


def folded(text: str) -> str:
    """The text in lines that fit; those behind the first are indented."""
    return "\n  ".join(textwrap.wrap(text, COLUMNS - 2, break_on_hyphens=False))
