"""Reading TOML tables into frozen dataclasses: every key known, every number in its range.

A setting group is a frozen dataclass whose fields are made with `quantity`, `count` or `choice`.
The attribute is in SI; the TOML key carries the unit people use (`valve_delay_ms`).
"""

from __future__ import annotations

import dataclasses
import math
import re
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeVar

from meshpoint.gearbox.reading import UnreadableError, read_text

TABLE_LIMIT_BYTES: Final = 256 * 1024
DEPTH_LIMIT: Final = 6
# A key of this many parts, or a text that looks like one: reading it takes time by their square.
_LONG_KEY: Final = re.compile(
    r"""(?<![\w-])(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){32}""", re.ASCII
)
_SHORT: Final = 80
T = TypeVar("T")


class TableError(ValueError):
    """A configuration file that cannot be used; the message names file, key, found and allowed."""


@dataclass(frozen=True)
class Rule:
    """What a key may hold: its name in the file, its range there, and the factor to SI."""

    key: str
    kind: type
    low: float
    high: float
    si: float = 1.0
    choices: tuple[str, ...] = ()

    def allowed(self) -> str:
        """The allowed values in words."""
        if self.kind is bool:
            return "true or false"
        if self.kind is tuple:
            return f"a list of whole numbers from {self.low:g} to {self.high:g}, rising"
        if self.kind is list:
            return f"a list of numbers from {self.low:g} to {self.high:g}"
        if self.kind is str:
            return f"one of {', '.join(self.choices)}" if self.choices else "a text"
        noun = "a whole number" if self.kind is int else "a number"
        return f"{noun} from {self.low:g} to {self.high:g}"


def quantity(key: str, low: float, high: float, si: float = 1.0, **default: Any) -> Any:
    """A real number; `key` carries the unit, the attribute is key value x `si`.

    `default`, when given, is in SI."""
    return dataclasses.field(metadata={"rule": Rule(key, float, low, high, si)}, **default)


def count(key: str, low: int, high: int, **default: Any) -> Any:
    """A whole number."""
    return dataclasses.field(metadata={"rule": Rule(key, int, low, high)}, **default)


def counts(key: str, low: int, high: int, **default: Any) -> Any:
    """Whole numbers, each larger than the one before; a tuple."""
    return dataclasses.field(metadata={"rule": Rule(key, tuple, low, high)}, **default)


def quantities(key: str, low: float, high: float, si: float = 1.0, **default: Any) -> Any:
    """Real numbers in any order, each within the range; a tuple, in SI."""
    return dataclasses.field(metadata={"rule": Rule(key, list, low, high, si)}, **default)


def text(key: str, *choices: str, **default: Any) -> Any:
    """A text, free or one of `choices`."""
    return dataclasses.field(metadata={"rule": Rule(key, str, 0, 0, 1.0, choices)}, **default)


def flag(key: str, **default: Any) -> Any:
    """True or false."""
    return dataclasses.field(metadata={"rule": Rule(key, bool, 0, 1)}, **default)


def load_toml(path: Path) -> dict[str, Any]:
    """The parsed file. TableError where it is missing, too large, too deep or not TOML."""
    try:
        content = read_text(path, TABLE_LIMIT_BYTES)
    except UnreadableError as error:
        raise TableError(str(error)) from error
    return parse_toml(content, str(path))


def parse_toml(content: str, where: str) -> dict[str, Any]:
    """The tables in a text of at most `TABLE_LIMIT_BYTES` characters. TableError names `where`."""
    if len(content) > TABLE_LIMIT_BYTES:
        raise TableError(f"{where}: {len(content)} characters, allowed are {TABLE_LIMIT_BYTES}")
    if _LONG_KEY.search(content):
        raise TableError(f"{where}: torn, or not a TOML file: a key of too many parts")
    try:
        table = tomllib.loads(content)
    # A whole number of over 4300 digits is a ValueError of another kind than TOML's own.
    except (ValueError, RecursionError) as error:
        raise TableError(f"{where}: torn, or not a TOML file: {error}") from error
    _check_depth(table, where, 1)
    return table


def _check_depth(table: dict[str, Any], where: str, depth: int) -> None:
    if depth > DEPTH_LIMIT:
        raise TableError(f"{where}: tables nested over {DEPTH_LIMIT} deep")
    for value in table.values():
        if isinstance(value, dict):
            _check_depth(value, where, depth + 1)


def read_group(cls: type[T], table: Any, where: str) -> T:
    """Builds the frozen dataclass `cls` from a TOML table.

    `where` names file and table for errors (`truck.toml [brake]`). A field without a rule is a
    group of its own, read from the sub-table of its name. TableError on an unknown or missing key,
    a wrong type, or a value out of range. A field without metadata is no key of the file. A class
    constant `REMOVED` says of keys that older files may have why they are gone, and what to do.
    """
    if not isinstance(table, dict):
        raise TableError(f"{where}: found {table!r}, allowed is a table")
    all_fields = dataclasses.fields(cls)  # type: ignore[arg-type]
    fields = {key_of(field): field for field in all_fields if field.metadata}
    unknown = sorted(set(table) - set(fields))
    if unknown:
        gone = getattr(cls, "REMOVED", {}).get(unknown[0])
        if gone is not None:
            raise TableError(f"{where}: key '{unknown[0]}' was removed: {gone}")
        raise TableError(f"{where}: unknown key '{unknown[0]}', allowed are {', '.join(fields)}")
    values: dict[str, Any] = {}
    for key, field in fields.items():
        if key in table:
            values[field.name] = _read(field, table[key], f"{where}: {key}")
        elif _is_required(field):
            raise TableError(f"{where}: key '{key}' is missing")
    return _made(cls, values, where)


def read_values(cls: type[T], table: Any, where: str) -> T:
    """The inverse of `to_table`: builds `cls` from a table of attributes in SI, every one given.

    The ranges are those of `read_group`; TableError as there."""
    if not isinstance(table, dict):
        raise TableError(f"{where}: found {table!r}, allowed is a table")
    all_fields = dataclasses.fields(cls)  # type: ignore[arg-type]
    fields = {field.name: field for field in all_fields if field.metadata}
    for key in sorted(set(table) ^ set(fields)):
        fault = "is missing" if key in fields else "is unknown"
        raise TableError(f"{where}: key '{key}' {fault}")
    values = {name: _value(fields[name], table[name], f"{where}: {name}") for name in fields}
    return _made(cls, values, where)


def _made(cls: type[T], values: dict[str, Any], where: str) -> T:
    try:
        return cls(**values)
    except TableError as error:
        raise TableError(f"{where}: {error}") from error


def _value(field: dataclasses.Field[Any], value: Any, where: str) -> Any:
    """A value in SI, as it is: what is hashed must come back bit for bit."""
    rule: Rule | None = field.metadata.get("rule")
    if rule is None:
        if value is None and field.default is None:
            return None
        return read_values(field.metadata["group"], value, where)
    limits = dataclasses.replace(rule, low=rule.low * rule.si, high=rule.high * rule.si)
    if rule.kind is list:
        _read_list(value, limits, where)
        return tuple(value)
    if not _fits(value, limits):
        raise TableError(f"{where} = {_short(value)}, allowed is {limits.allowed()}")
    return tuple(value) if rule.kind is tuple else value


def key_of(field: dataclasses.Field[Any]) -> str:
    """The field's key in the file."""
    rule: Rule | None = field.metadata.get("rule")
    return rule.key if rule else field.name.rstrip("_")


def _is_required(field: dataclasses.Field[Any]) -> bool:
    return field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING


def _read(field: dataclasses.Field[Any], value: Any, where: str) -> Any:
    rule: Rule | None = field.metadata.get("rule")
    if rule is None:
        group = field.metadata["group"]
        return read_group(group, value, where)
    if rule.kind is list:
        return _read_list(value, rule, where)
    if not _fits(value, rule):
        raise TableError(f"{where} = {_short(value)}, allowed is {rule.allowed()}")
    if rule.kind is tuple:
        return tuple(value)
    return value * rule.si if rule.kind is float else value


def _fits(value: Any, rule: Rule) -> bool:
    fits = {
        bool: isinstance(value, bool),
        str: isinstance(value, str) and (not rule.choices or value in rule.choices),
        int: isinstance(value, int) and _is_inside(value, rule),
        float: _is_inside(value, rule),
        tuple: _is_rising(value, rule),
    }
    return fits[rule.kind]


def _short(value: Any) -> str:
    """What was found as TOML has it, as long as a line may be; a number of thousands of digits has
    no text."""
    if isinstance(value, bool):
        return "true" if value else "false"
    try:
        text = repr(value)
    except (ValueError, RecursionError):
        text = f"{type(value).__name__} ..."
    return text if len(text) <= _SHORT else f"{text[:_SHORT]} ..."


def _is_inside(value: Any, rule: Rule) -> bool:
    """Whether it is a number in the range; NaN never is, and a whole number may be a huge one."""
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return is_number and bool(rule.low <= value <= rule.high) and math.isfinite(value)


def _read_list(value: Any, rule: Rule, where: str) -> tuple[float, ...]:
    if not isinstance(value, list):
        raise TableError(f"{where} = {_short(value)}, allowed is {rule.allowed()}")
    for index, item in enumerate(value):
        if not _is_inside(item, rule):
            found = f"{where}[{index}] = {_short(item)}"
            raise TableError(f"{found}, allowed is a number from {rule.low:g} to {rule.high:g}")
    return tuple(item * rule.si for item in value)


def _is_rising(value: Any, rule: Rule) -> bool:
    if not isinstance(value, list) or not all(type(item) is int for item in value):
        return False
    inside = all(rule.low <= item <= rule.high for item in value)
    return inside and value == sorted(set(value))


def group(cls: type, **default: Any) -> Any:
    """A nested setting group, a sub-table of the field's name."""
    return dataclasses.field(metadata={"group": cls}, **default)


def to_table(values: Any) -> dict[str, Any]:
    """The dataclass as plain values under its attribute names (SI): for hashing and reports."""
    return dataclasses.asdict(values)


def merged_tables(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    """`above` wins, key by key; tables are merged."""
    both = dict(below)
    for key, value in above.items():
        inner = both.get(key)
        if isinstance(inner, dict) and isinstance(value, dict):
            both[key] = merged_tables(inner, value)
        else:
            both[key] = value
    return both
