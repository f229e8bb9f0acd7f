"""The gate in front of the DBC parser: refuses texts that would stall it or exhaust memory.

The parser's work grows with the square of a message's length, and it takes signals of any size, so
these limits are held against the text itself. What only a parsed file can tell is in
`meshpoint.dbc.schema`.
"""

from __future__ import annotations

import math
import re
from typing import Final

MAX_TEXT_BYTES: Final = 400_000
MAX_MESSAGES: Final = 1_000
MAX_DLC_BYTES: Final = 64
MAX_SIGNAL_BITS: Final = 64

_MAX_DIGITS: Final = 10
# What the parser takes for a text. The closing quote is optional here, so that an unclosed text is
# consumed once instead of being searched for again and again from each quote inside it.
_TEXT: Final = re.compile(r'"(?:\\"|[^"])*("?)')
_MULTIPLEXED: Final = re.compile(r"\bSG_\s+(\w+)\s+\w+\s*:|\bSG_MUL_VAL_\s+(\d+)")
_MESSAGE: Final = re.compile(r"\bBO_\s+\S+\s+(\S+?)\s*:\s*(\S+)")
_SIGNAL_NAME: Final = re.compile(r"\bSG_\s+\w+\s*:")
_SIGNAL: Final = re.compile(
    r"\bSG_\s+(\w+)\s*:\s*([^\s|]+)\s*\|\s*([^\s@]+)\s*@\s*\S+?"
    r"\s*\(\s*([^\s,]+)\s*,\s*([^\s)]+)\s*\)\s*\[\s*([^\s|]+)\s*\|\s*([^\s\]]+)\s*\]"
)


class SchemaError(ValueError):
    """A DBC that is refused: names file, message or signal, what was found, what is allowed."""


def check_text(text: str, source: str) -> None:
    """Raise `SchemaError` unless the text of file `source` is safe to hand to the DBC parser."""
    if len(text) > MAX_TEXT_BYTES:
        raise SchemaError(f"{source}: {len(text)} bytes, at most {MAX_TEXT_BYTES} are allowed")
    if any(not text_match[1] for text_match in _TEXT.finditer(text)):
        raise SchemaError(f'{source}: a text begins with " and never ends')
    bare = _TEXT.sub('""', text)
    if multiplexed := _MULTIPLEXED.search(bare):
        raise SchemaError(f"{source}: {multiplexed[0]!r} is multiplexed, plain signals are allowed")
    messages = _MESSAGE.findall(bare)
    if not 1 <= len(messages) <= MAX_MESSAGES:
        raise SchemaError(f"{source}: {len(messages)} messages, 1..{MAX_MESSAGES} are allowed")
    for name, length in messages:
        _check_whole(length, 0, MAX_DLC_BYTES, f"{source}: message {name}: length")
    signals = _SIGNAL.findall(bare)
    if len(signals) != len(_SIGNAL_NAME.findall(bare)):
        raise SchemaError(f"{source}: a signal is not start|bits@sign (scale,offset) [min|max]")
    for name, start, bits, scale, *others in signals:
        where = f"{source}: signal {name}"
        _check_whole(start, 0, 8 * MAX_DLC_BYTES - 1, f"{where}: start bit")
        _check_whole(bits, 1, MAX_SIGNAL_BITS, f"{where}: size")
        for number in (scale, *others):
            _check_finite(number, f"{where}: (scale,offset) [min|max]: a number")
        if float(scale) == 0.0:
            raise SchemaError(f"{where}: scale is {scale}, other than 0 is allowed")


def _check_whole(digits: str, lowest: int, highest: int, what: str) -> None:
    """Hold a whole number of the text against its limits; very long ones are not even read."""
    is_number = len(digits) <= _MAX_DIGITS and digits.isascii() and digits.isdigit()
    if not (is_number and lowest <= int(digits) <= highest):
        raise SchemaError(f"{what} is {digits[:_MAX_DIGITS]}, {lowest}..{highest} is allowed")


def _check_finite(text: str, what: str) -> None:
    try:
        is_finite = math.isfinite(float(text))
    except ValueError:
        is_finite = False
    if not is_finite:
        raise SchemaError(f"{what} is {text[:40]}, a finite number is allowed")
