"""The gate in front of the DBC parser: refuses texts that would stall it or exhaust memory.

The parser's work grows with the square of a message's length, and it accepts signals of any size, so
these limits are checked on the text itself. What only the parsed file can tell is in `dbc.schema`.
"""

from __future__ import annotations

import math
import re
from typing import Final

MAX_TEXT_BYTES: Final = 2_000_000
MAX_MESSAGES: Final = 2_000
MAX_DLC_BYTES: Final = 64
MAX_SIGNAL_BITS: Final = 64

_STRING: Final = re.compile(r'"[^"\\]*(?:\\.[^"\\]*)*"', re.DOTALL)
_MESSAGE: Final = re.compile(r"\bBO_\s+(\S+)\s+(\S+?)\s*:\s*(\S+)")
_SIGNAL: Final = re.compile(
    r"\bSG_\s+(\w+)(?:\s+\w+)?\s*:\s*([^\s|]+)\s*\|\s*([^\s@]+)\s*@\s*\S+?"
    r"\s*\(\s*([^\s,]+)\s*,\s*([^\s)]+)\s*\)"
)
_SIGNAL_START: Final = re.compile(r"\bSG_\s+\w+(?:\s+\w+)?\s*:")
_MAX_DIGITS: Final = 10


class SchemaError(ValueError):
    """A DBC that is not accepted; the text names file, message or signal, what was found, what is allowed."""


def check_text(text: str, source: str) -> None:
    """Raise `SchemaError` unless `text` is safe to hand to the DBC parser; `source` names the file."""
    if len(text) > MAX_TEXT_BYTES:
        raise SchemaError(f"{source}: {len(text)} characters, at most {MAX_TEXT_BYTES} are allowed")
    bare = _STRING.sub('""', text)
    messages = _MESSAGE.findall(bare)
    if not 1 <= len(messages) <= MAX_MESSAGES:
        raise SchemaError(f"{source}: {len(messages)} messages, 1..{MAX_MESSAGES} are allowed")
    for _, name, length in messages:
        _whole(length, 0, MAX_DLC_BYTES, f"{source}: length of message {name}")
    signals = _SIGNAL.findall(bare)
    if len(signals) != len(_SIGNAL_START.findall(bare)):
        raise SchemaError(f"{source}: a signal is not written as 'start|bits@order (scale,offset)'")
    for name, start, bits, scale, offset in signals:
        where = f"{source}: signal {name}"
        _whole(start, 0, 8 * MAX_DLC_BYTES - 1, f"{where}: start bit")
        _whole(bits, 1, MAX_SIGNAL_BITS, f"{where}: size")
        if _finite(scale, f"{where}: scale") == 0.0:
            raise SchemaError(f"{where}: scale {scale}, a finite number other than 0 is allowed")
        _finite(offset, f"{where}: offset")


def _whole(digits: str, lowest: int, highest: int, what: str) -> None:
    """Check a whole number of the text; the count of digits first, as very long ones are slow to read."""
    readable = len(digits) <= _MAX_DIGITS and digits.isascii() and digits.isdigit()
    if not (readable and lowest <= int(digits) <= highest):
        raise SchemaError(f"{what} is {digits[:_MAX_DIGITS]}, {lowest}..{highest} is allowed")


def _finite(text: str, what: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise SchemaError(f"{what} is {text[:40]}, a finite number is allowed")
    return value
