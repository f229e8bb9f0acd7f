"""An A2L file from the tables that the slave itself works by: settings, messages, figures."""

from __future__ import annotations

import dataclasses
import inspect
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

from meshpoint.bridges.a2l_blocks import block, hexadecimal, quoted
from meshpoint.bridges.a2l_transport import grammar, pages, xcp_on_can
from meshpoint.controller.settings.learned import Calibration
from meshpoint.controller.settings.settings import SettingsFile
from meshpoint.dbc.schema import SCHEMA
from meshpoint.dbc.specs import SignalSpec
from meshpoint.gearbox.keys import field_docs, groups_of, unit_of
from meshpoint.gearbox.tables import key_of
from meshpoint.xcp.memory import (
    FIGURE_BYTES,
    IDENTITY_ADDRESS,
    LEARNED,
    MEASURED_ADDRESS,
    MESSAGE_BYTES,
    MESSAGES,
    PAGE_ADDRESS,
    PAGE_BYTES,
    PARAMETERS,
    ROW_BYTES,
    SENT_BYTES,
    SLEEVES,
    LearnedFigure,
    identity,
)

PROTECTION: Final = ("Crc", "Counter")
"""Signals of the E2E header, which measure nothing."""
DATA_TYPES: Final = {1: ("UBYTE", "SBYTE"), 2: ("UWORD", "SWORD"), 4: ("ULONG", "SLONG"),
                     8: ("A_UINT64", "A_INT64")}  # fmt: skip
FLOAT_LIMITS: Final = "-3.4e38 3.4e38"
FIGURES_ADDRESS: Final = MEASURED_ADDRESS + SENT_BYTES


@dataclass(frozen=True)
class Conversion:
    """How a raw value becomes a physical one: scale * raw + offset, or by a table of words."""

    unit: str
    scale: float = 1.0
    offset: float = 0.0
    value_table: str | None = None

    def named(self, number: int) -> str:
        """The name in the file."""
        if self.value_table is not None:
            return self.value_table
        unit = re.sub(r"\W", "_", self.unit.replace("%", "percent")) or "number"
        return unit if (self.scale, self.offset) == (1.0, 0.0) else f"{unit}_{number}"


def a2l(version: str) -> str:
    """The whole file for this version of the product."""
    conversions: dict[Conversion, str] = {}
    objects = [*_parameters(conversions), *_signals(conversions), *_figures(conversions)]
    lines = [
        *grammar(),
        *_module_parameters(version),
        *block("MOD_COMMON", '""', ["BYTE_ORDER MSB_LAST", "ALIGNMENT_FLOAT32_IEEE 4"]),
        *xcp_on_can(),
        *_conversions(conversions),
        *_layout("single_value", "FLOAT32_IEEE"),
        *_layout("whole_value", "ULONG"),
        *objects,
        *_groups(),
    ]
    module = block("MODULE", f"controller {quoted('meshpoint controller')}", lines)
    project = block("PROJECT", f"meshpoint {quoted('meshpoint ' + version)}", module)
    return "\n".join(["ASAP2_VERSION 1 71", *project, ""])


def _module_parameters(version: str) -> Iterator[str]:
    page = f"{hexadecimal(PAGE_ADDRESS)} {PAGE_BYTES} -1 -1 -1 -1 -1"
    segment = block("MEMORY_SEGMENT", f'settings "" DATA FLASH INTERN {page}', pages())
    name = identity(version)
    lines = [f"ADDR_EPK {hexadecimal(IDENTITY_ADDRESS)}", f"EPK {quoted(name)}", *segment]
    return block("MOD_PAR", '""', lines)


def _layout(name: str, data_type: str) -> Iterator[str]:
    return block("RECORD_LAYOUT", name, [f"FNC_VALUES 1 {data_type} ROW_DIR DIRECT"])


def _conversion(known: dict[Conversion, str], wanted: Conversion) -> str:
    return known.setdefault(wanted, wanted.named(len(known)))


def _conversions(known: dict[Conversion, str]) -> Iterator[str]:
    for each, name in known.items():
        unit = quoted(each.unit)
        if each.value_table is None:
            yield from block(
                "COMPU_METHOD",
                f'{name} "" LINEAR "%.6" {unit}',
                [f"COEFFS_LINEAR {each.scale!r} {each.offset!r}"],
            )
            continue
        table = SCHEMA.value_tables[each.value_table]
        rows = [f"{value} {quoted(text)}" for value, text in table.items()]
        yield from block(
            "COMPU_METHOD", f'{name} "" TAB_VERB "%.0" {unit}', [f"COMPU_TAB_REF {name}_words"]
        )
        yield from block("COMPU_VTAB", f'{name}_words "" TAB_VERB {len(rows)}', rows)


def _parameters(known: dict[Conversion, str]) -> Iterator[str]:
    meanings = {key.path: key.meaning for group in groups_of(SettingsFile) for key in group.keys}
    for row, each in enumerate(PARAMETERS):
        conversion = _conversion(known, Conversion(unit_of(each.rule.key)))
        address = hexadecimal(PAGE_ADDRESS + ROW_BYTES * row)
        layout, low, high = (
            "whole_value" if each.is_whole else "single_value",
            each.rule.low,
            each.rule.high,
        )
        yield from block(
            "CHARACTERISTIC",
            f"{each.name} {quoted(meanings[each.name])}",
            [f"VALUE {address} {layout} 0 {conversion} {low:.15g} {high:.15g}"],
        )


def _signals(known: dict[Conversion, str]) -> Iterator[str]:
    for number, message in enumerate(MESSAGES):
        start = MEASURED_ADDRESS + MESSAGE_BYTES * number
        for signal in message.signals:
            if signal.name not in PROTECTION:
                yield from _signal(f"{message.name}.{signal.name}", signal, start, known)


def _signal(
    name: str, signal: SignalSpec, message_address: int, known: dict[Conversion, str]
) -> Iterator[str]:
    first, shift = divmod(signal.start_bit, 8)
    size = next(each for each in DATA_TYPES if 8 * each >= shift + signal.bits)
    conversion = _conversion(
        known, Conversion(signal.unit, signal.scale, signal.offset, signal.value_table)
    )
    low, high = (raw * signal.scale + signal.offset for raw in (signal.raw_min, signal.raw_max))
    lines = [f"{DATA_TYPES[size][signal.signed]} {conversion} 0 0 {low!r} {high!r}"]
    lines += [f"ECU_ADDRESS {hexadecimal(message_address + first)}"]
    if signal.bits < 8 * size:
        lines += [f"BIT_MASK 0x{(1 << signal.bits) - 1 << shift:X}"]
    return block("MEASUREMENT", f"{name} {quoted(signal.comment)}", lines)


def figures() -> Iterator[tuple[str, str, str]]:
    """Name, unit and text of each float behind the messages, in the order of their addresses."""
    for sleeve in SLEEVES:
        name = sleeve.name.lower()
        yield f"sleeve.{name}_mm", "mm", f"newest position of the sleeve {name}"
    yield "guard.row", "", "row of the guard that blocked this step's valve command; 0: none"
    for each in LEARNED:
        yield each.name, unit_of(each.rule.key), f"{_meaning(each)} NaN: not known yet."


def _meaning(figure: LearnedFigure) -> str:
    """What a calibration file's group and key mean, by their docstrings."""
    record: Any = Calibration
    for name in figure.groups:
        group = next(each for each in dataclasses.fields(record) if key_of(each) == name)
        record = group.metadata["group"]
    about = inspect.getdoc(record) or ""
    return f"{about} {figure.rule.key}: {field_docs(record).get(figure.attribute, '')}"


def _figures(known: dict[Conversion, str]) -> Iterator[str]:
    for number, (name, unit, text) in enumerate(figures()):
        address = hexadecimal(FIGURES_ADDRESS + FIGURE_BYTES * number)
        conversion = _conversion(known, Conversion(unit))
        lines = [f"FLOAT32_IEEE {conversion} 0 0 {FLOAT_LIMITS}", f"ECU_ADDRESS {address}"]
        yield from block("MEASUREMENT", f"{name} {quoted(text)}", lines)


def _groups() -> Iterator[str]:
    meanings = {group.name: group.meaning for group in groups_of(SettingsFile)}
    for name in dict.fromkeys(each.group for each in PARAMETERS):
        members = [each.name for each in PARAMETERS if each.group == name]
        yield from _group(name, meanings[name], "REF_CHARACTERISTIC", members)
    for message in MESSAGES:
        names = [s.name for s in message.signals if s.name not in PROTECTION]
        members = [f"{message.name}.{name}" for name in names]
        yield from _group(message.name, message.comment, "REF_MEASUREMENT", members)
    members = [name for name, _, _ in figures()]
    yield from _group("figures", "Sleeves, guard, what was learned", "REF_MEASUREMENT", members)


def _group(name: str, meaning: str, kind: str, members: list[str]) -> Iterator[str]:
    return block("GROUP", f"{name} {quoted(meaning)}", ["ROOT", *block(kind, "", members)])
