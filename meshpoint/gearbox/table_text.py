"""Writing what `tables` reads: a frozen dataclass as TOML, the same bytes for the same values.

Numbers are written in the units of their keys to nine digits, so that a file that was read and is
written again is the same, byte for byte; no quantity of a gearbox is known to the tenth.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any, Final

from meshpoint.gearbox.plain_text import STEERING, plain
from meshpoint.gearbox.tables import Rule, key_of

TABLE_DIGITS: Final = 9
A_LINE: Final = 8
"""Numbers on a line of a long list."""


def to_toml(values: Any, comment: str = "") -> str:
    """The dataclass as a TOML document; what is None is left out."""
    lines = [f"# {line}" for line in plain(comment).splitlines()]
    return "\n".join([*lines, *_table(values, "")]) + "\n"


def _table(values: Any, name: str) -> Iterator[str]:
    groups = []
    for field in dataclasses.fields(values):
        value = getattr(values, field.name)
        rule: Rule | None = field.metadata.get("rule")
        if value is None or not field.metadata:
            continue
        if rule is None:
            groups.append((f"{name}.{key_of(field)}".lstrip("."), value))
        else:
            yield f"{rule.key} = {_text(value, rule)}"
    for inner, value in groups:
        yield ""
        yield f"[{inner}]"
        yield from _table(value, inner)


def _text(value: Any, rule: Rule) -> str:
    if rule.kind is bool:
        return "true" if value else "false"
    if rule.kind is str:
        return quoted(value)
    if rule.kind is int:
        return str(value)
    if rule.kind is tuple:
        return "[" + ", ".join(map(str, value)) + "]"
    if rule.kind is float:
        return number(value / rule.si, TABLE_DIGITS)
    numbers = [number(item / rule.si, TABLE_DIGITS) for item in value]
    rows = (", ".join(numbers[k : k + A_LINE]) for k in range(0, len(numbers), A_LINE))
    return "[\n" + "".join(f"    {row},\n" for row in rows) + "]"


def number(value: float, digits: int) -> str:
    """To this many digits; always with a point or an exponent, so that it is read as a float."""
    text = f"{value:.{digits}g}"
    if text == "-0":
        text = "0"
    return text if any(mark in text for mark in ".en") else f"{text}.0"


def quoted(text: str) -> str:
    """A basic string: quotes, backslashes and what steers a terminal escaped (TOML 1.0)."""
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return '"' + "".join(_plain(character) for character in escaped) + '"'


def _plain(character: str) -> str:
    is_plain = character not in "\t\n" and not STEERING.match(character)
    return character if is_plain else f"\\u{ord(character):04x}"
