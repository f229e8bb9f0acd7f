"""From signals to typed fields: Python names, SI units, enumerations and the message classes.

A field is one signal, or a numbered row of equal signals (`Angle00`, `Angle01` ...) as one tuple.
"""

from __future__ import annotations

import math
import operator
import re
from collections import namedtuple
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from enum import Enum, IntEnum, auto
from typing import Any, Final, SupportsIndex, cast

from meshpoint.dbc.specs import MessageSpec, Schema, SignalSpec
from meshpoint.dbc.units import UNITS

BOOLEAN_TABLE: Final = "OffOn"
"""Signals with this value table are plain `bool`."""
MODULE: Final = "meshpoint.dbc.messages"
"""Where the classes made here live, for their names, reprs and pickles."""

_ROW: Final = re.compile(r"(?P<name>.*\D)(?P<number>\d\d)")
_WORD: Final = re.compile(r"(?<=[a-z0-9])(?=[A-Z])")


class FieldKind(Enum):
    """What a signal's value is in Python."""

    BOOL = auto()
    ENUM = auto()
    INT = auto()
    FLOAT = auto()


@dataclass(frozen=True)
class FieldSpec:
    """One field: its signals, more than one for a tuple, and SI value = raw * scale + offset."""

    name: str
    kind: FieldKind
    signals: tuple[SignalSpec, ...]
    is_tuple: bool
    is_optional: bool
    """True for the numbers of unprotected (J1939) messages: None stands for 'not available'."""
    scale: float
    offset: float

    def si_value(self, raw: int) -> float | int:
        """The number inside for a raw value."""
        return (
            raw * self.scale + self.offset
            if self.kind is FieldKind.FLOAT
            else raw + int(self.offset)
        )

    def raw_value(self, value: object) -> int:
        """The raw value of a number inside; raises if it is not finite, or not whole but should."""
        if self.kind is FieldKind.FLOAT:
            return round((cast(float, value) - self.offset) / self.scale)
        return operator.index(cast(SupportsIndex, value)) - int(self.offset)

    def accepts(self, signal: SignalSpec, value: object) -> bool:
        """Whether a value may be sent as one of its signals."""
        if value is None:
            return self.is_optional
        try:
            return signal.raw_min <= self.raw_value(value) <= signal.raw_max
        except (TypeError, ValueError, OverflowError):
            return False

    def allowed(self, signal: SignalSpec) -> str:
        """The values that may be sent as one of its signals, for people."""
        low, high = sorted((self.si_value(signal.raw_min), self.si_value(signal.raw_max)))
        span = f"{low:.9g}..{high:.9g}" if self.kind is FieldKind.FLOAT else f"{low}..{high}"
        return f"{span} or None" if self.is_optional else span


def snake_case(name: str) -> str:
    """`BrakePressure` -> `brake_pressure`."""
    return _WORD.sub("_", name).lower()


def make_enums(schema: Schema) -> dict[str, type[IntEnum]]:
    """One IntEnum a value table, members in UPPER_CASE; the boolean table needs none."""
    return {
        name: IntEnum(  # type: ignore[misc]  # a functional enumeration named at run time
            name,
            {snake_case(text).upper(): raw for raw, text in table.items()},
            module=MODULE,
        )
        for name, table in schema.value_tables.items()
        if name != BOOLEAN_TABLE
    }


def make_fields(message: MessageSpec) -> tuple[FieldSpec, ...]:
    """The fields of a message in the order of the wire; CRC and counter belong to the link."""
    if not message.is_protected:
        return tuple(_field(signal.name, (signal,), is_optional=True) for signal in message.signals)
    rows: dict[str, list[SignalSpec]] = {}
    for signal in message.signals[2:]:
        match = _ROW.fullmatch(signal.name)
        name = (
            match["name"] if match and _continues(rows.get(match["name"]), signal) else signal.name
        )
        rows.setdefault(name, []).append(signal)
    return tuple(_field(name, tuple(row), is_optional=False) for name, row in rows.items())


def _continues(row: list[SignalSpec] | None, signal: SignalSpec) -> bool:
    """Whether a numbered signal is the next of a row: numbered from 00 on, and like the first."""
    first = row[0] if row else signal
    alike = replace(signal, name=first.name, start_bit=first.start_bit, comment=first.comment)
    return alike == first and int(signal.name[-2:]) == len(row or ())


def _field(name: str, signals: tuple[SignalSpec, ...], is_optional: bool) -> FieldSpec:
    signal = signals[0]
    unit = UNITS[signal.unit]
    kind = _kind(signal)
    return FieldSpec(
        name=snake_case(name) + unit.suffix,
        kind=kind,
        signals=signals,
        is_tuple=name != signal.name,
        is_optional=is_optional and kind in (FieldKind.INT, FieldKind.FLOAT),
        scale=_short(signal.scale * unit.factor),
        offset=_short(signal.offset * unit.factor + unit.offset),
    )


def _short(value: float) -> float:
    """The short decimal a product or sum was meant to be: 19.999999999999996 is 20.0."""
    short = float(f"{value:.12g}")
    return short if math.isclose(value, short, rel_tol=1e-15) else value


def _kind(signal: SignalSpec) -> FieldKind:
    if signal.value_table == BOOLEAN_TABLE:
        return FieldKind.BOOL
    if signal.value_table is not None:
        return FieldKind.ENUM
    is_whole = signal.scale == 1.0 and signal.offset.is_integer()
    return FieldKind.INT if UNITS[signal.unit].is_integer and is_whole else FieldKind.FLOAT


def make_message_type(
    message: MessageSpec, fields: tuple[FieldSpec, ...], enums: Mapping[str, type[IntEnum]]
) -> type[Any]:
    """The NamedTuple class of a message; every field has the DBC's start value as its default."""
    names = [field.name for field in fields]
    starts = [_start_value(field, enums) for field in fields]
    made = namedtuple(message.name, names, defaults=starts, module=MODULE)  # type: ignore[misc]
    made.__doc__ = message.comment
    return made


def _start_value(field: FieldSpec, enums: Mapping[str, type[IntEnum]]) -> object:
    values = tuple(_value(field, signal, enums) for signal in field.signals)
    return values if field.is_tuple else values[0]


def _value(field: FieldSpec, signal: SignalSpec, enums: Mapping[str, type[IntEnum]]) -> object:
    raw = signal.raw_start
    if field.kind is FieldKind.BOOL:
        return raw == 1
    if signal.value_table is not None:
        return enums[signal.value_table](raw)
    return field.si_value(raw) if signal.raw_min <= raw <= signal.raw_max else None


def why_refused(fields: tuple[FieldSpec, ...], message: tuple[object, ...]) -> str:
    """Which signal of a message cannot be sent: its name, its value, and what is allowed."""
    for field, value in zip(fields, message, strict=True):
        values = value if field.is_tuple else (value,)
        if not isinstance(values, Iterable) or len(items := tuple(values)) != len(field.signals):
            return f"{field.name} is {value!r}, {len(field.signals)} values are allowed"
        for signal, item in zip(field.signals, items, strict=True):
            if not field.accepts(signal, item):
                allowed = field.allowed(signal)
                return f"{signal.name} ({field.name}) is {item!r}, {allowed} is allowed"
    raise AssertionError("every field is acceptable")
