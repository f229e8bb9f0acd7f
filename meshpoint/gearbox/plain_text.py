"""Texts that others wrote, as words alone."""

from __future__ import annotations

import re
from typing import Final

STEERING: Final = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f"  # C0 but tab and line end, DEL, C1
    "\u061c\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff"  # directions, zero widths
    "\ud800-\udfff]"  # bytes of a file's name that are no text
)


def plain(text: str) -> str:
    """Characters that steer a terminal, or turn the order of others, are shown as escapes; so are
    those that cannot be written."""
    return STEERING.sub(_escape, text)


def _escape(found: re.Match[str]) -> str:
    code = ord(found[0])
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}"
