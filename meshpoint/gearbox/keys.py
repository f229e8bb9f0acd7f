"""What a TOML file of ours may hold, key by key: unit, allowed values, default and meaning.

Everything comes from the dataclasses themselves: the rules of their fields, and the docstring below
each field, so that a reference page cannot say anything else than the code.
"""

from __future__ import annotations

import ast
import dataclasses
import inspect
import math
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Any, Final

from meshpoint.gearbox.plain_text import plain
from meshpoint.gearbox.table_text import quoted
from meshpoint.gearbox.tables import Rule, key_of

KEY_UNITS: Final = {
    "_percent_of_pitch": "% of pitch",
    "_percent_of_gap": "% of half a gap",
    "_ms_per_j": "ms/J",
    "_rad_s2": "rad/s2",
    "_deg_s": "deg/s",
    "_bar_s": "bar/s",
    "_kgm2": "kg m2",
    "_m_s": "m/s",
    "_percent": "%",
    "_nsm": "N s/m",
    "_nms": "Nm s",
    "_rpm": "rpm",
    "_bar": "bar",
    "_deg": "deg",
    "_nm": "Nm",
    "_kj": "kJ",
    "_cm2": "cm2",
    "_cm3": "cm3",
    "_kg": "kg",
    "_mm": "mm",
    "_ms": "ms",
    "_us": "us",
    "_n": "N",
}
"""A key's ending, and the unit it stands for; the longest that fits counts."""
FLOAT_DIGITS: Final = 17
"""Enough for every float to come back as it was."""
KEY_WIDTH: Final = 80


@dataclass(frozen=True)
class Key:
    """One key of a file."""

    group: str
    """The table it stands in, as `wheels.main`; empty at the top."""
    name: str
    unit: str
    allowed: str
    default: str | None
    """As TOML; None where there is none."""
    meaning: str

    @property
    def path(self) -> str:
        """Group and name, as errors and `--sweep` have it."""
        return f"{self.group}.{self.name}" if self.group else self.name


@dataclass(frozen=True)
class KeyGroup:
    """One table of a file and the keys that stand in it."""

    name: str
    meaning: str
    keys: tuple[Key, ...]


def groups_of(cls: type, values: Any = None) -> list[KeyGroup]:
    """Every table of the file that `cls` is read from, in order; the first is the top.

    values: an instance, whose values then take the place of the defaults."""
    return list(_walk(cls, "", values))


def _walk(cls: Any, name: str, values: Any) -> Iterator[KeyGroup]:
    docs, keys, inner = field_docs(cls), [], []
    for field in dataclasses.fields(cls):
        if not field.metadata:
            continue  # not a key of the file
        value = _default(field) if values is None else getattr(values, field.name)
        rule: Rule | None = field.metadata.get("rule")
        if rule is None:
            if values is not None and value is None:
                continue  # a table that this instance leaves out
            path = f"{name}.{key_of(field)}" if name else key_of(field)
            inner.append((field.metadata["group"], path, value))
        else:
            text = None if value is None else toml_value(value, rule)
            meaning = docs.get(field.name, "")
            keys.append(Key(name, rule.key, unit_of(rule.key), rule.allowed(), text, meaning))
    yield KeyGroup(name, _one_line(cls.__doc__ or ""), tuple(keys))
    for group, path, value in inner:
        yield from _walk(group, path, value)


def _default(field: dataclasses.Field[Any]) -> Any:
    return None if field.default is dataclasses.MISSING else field.default


def unit_of(key: str) -> str:
    """The unit that a key's name ends with; empty for a bare number."""
    fits = [ending for ending in KEY_UNITS if key.endswith(ending)]
    return KEY_UNITS[max(fits, key=len)] if fits else ""


def toml_value(value: Any, rule: Rule) -> str:
    """An attribute's SI value as the file has it: read again it gives the same float."""
    if rule.kind is bool:
        return "true" if value else "false"
    if rule.kind is str:
        return quoted(str(value))
    if rule.kind in (tuple, list):
        one = Rule(rule.key, int if rule.kind is tuple else float, rule.low, rule.high, rule.si)
        return f"[{', '.join(toml_value(item, one) for item in value)}]"
    return str(value) if rule.kind is int else _in_unit(value, rule.si)


def _in_unit(value: float, si: float) -> str:
    """The shortest number that is `value` times its factor to SI."""
    near = value / si
    for digits in range(1, FLOAT_DIGITS + 1):
        for other in (near, math.nextafter(near, -math.inf), math.nextafter(near, math.inf)):
            text = repr(float(f"{other:.{digits}g}"))
            if float(text) * si == value:
                return text
    raise ValueError(f"no number times {si} is {value}")


def rounded(text: str | None) -> str:
    """A TOML value as people read it: a float to ten digits, nothing where there is no value."""
    try:
        return "" if text is None else f"{float(text):.10g}"
    except ValueError:
        return text or ""


@cache
def field_docs(cls: type) -> dict[str, str]:
    """The docstring below each field of a dataclass, in one line; its bases' too."""
    docs: dict[str, str] = {}
    for base in reversed(cls.__mro__):
        if dataclasses.is_dataclass(base):
            docs |= _own_docs(base)
    return docs


def _own_docs(cls: type) -> dict[str, str]:
    tree = ast.parse(textwrap.dedent(inspect.getsource(cls)))
    body = next(node for node in tree.body if isinstance(node, ast.ClassDef)).body
    docs = {}
    for field, after in pairwise(body):
        if not isinstance(field, ast.AnnAssign) or not isinstance(field.target, ast.Name):
            continue
        if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
            docs[field.target.id] = _one_line(str(after.value.value))
    return docs


def _one_line(text: str) -> str:
    return " ".join(text.split())


def to_toml(groups: list[KeyGroup], title: str) -> str:
    """A file that holds every key, each with its meaning, unit and allowed values above it; the
    lines of the title begin lines of its own."""
    lines = [line for part in title.split("\n") for line in _comment(part)]
    for group in groups:
        if not group.keys:
            continue
        if group.name:
            lines += ["", f"[{group.name}]", *_comment(group.meaning)]
        for key in group.keys:
            unit = f"{key.unit}; " if key.unit else ""
            lines += ["", *_comment(f"{key.meaning} ({unit}{key.allowed})")]
            lines.append(
                f"# {key.name} =" if key.default is None else f"{key.name} = {key.default}"
            )
    return "\n".join(lines) + "\n"


def _comment(text: str) -> list[str]:
    return textwrap.wrap(plain(text), KEY_WIDTH, initial_indent="# ", subsequent_indent="# ")
