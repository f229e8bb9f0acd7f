"""The DBC as typed, checked data: what is on the wire, who sends it, who may read it.

`SCHEMA` is the product's own wire contract, read once at import. `parse_schema` reads any DBC of the
same dialect (29-bit identifiers, little-endian integer signals, the attributes of meshpoint.dbc) and
refuses everything else with a `SchemaError`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from cantools.database import load_string
from cantools.database.can import Database
from cantools.database.can import Message as ParsedMessage
from cantools.database.can import Signal as ParsedSignal

from dbc.intake import SchemaError, check_text
from dbc.node import Node
from dbc.source import DBC_CONTENT, DBC_PATH
from dbc.units import UNITS

__all__ = ["SCHEMA", "MessageSpec", "Schema", "SchemaError", "SignalSpec", "parse_schema"]

FRAME_FORMAT_FD: Final = 15
FRAME_FORMAT_J1939: Final = 3
FD_LENGTHS: Final = frozenset({*range(9), 12, 16, 20, 24, 32, 48, 64})
E2E_HEADER: Final = (("Crc", 0, 16), ("Counter", 16, 8))
MAX_SCALED_BITS: Final = 48
"""A scaled signal must stay exact in a float of 53 bits, with bits to spare for the conversion."""


@dataclass(frozen=True)
class SignalSpec:
    """One signal: value in `unit` = raw * scale + offset, meaningful from `raw_min` to `raw_max`."""

    name: str
    start_bit: int
    bits: int
    signed: bool
    scale: float
    offset: float
    unit: str
    raw_min: int
    raw_max: int
    raw_start: int
    value_table: str | None
    comment: str

    @property
    def type_min(self) -> int:
        """Smallest raw value the bits can hold."""
        return -(1 << self.bits - 1) if self.signed else 0

    @property
    def type_max(self) -> int:
        """Largest raw value the bits can hold."""
        return (1 << self.bits - self.signed) - 1

    @property
    def is_ranged(self) -> bool:
        """Whether the DBC's range is tighter than what the bits can hold."""
        return self.raw_min > self.type_min or self.raw_max < self.type_max


@dataclass(frozen=True)
class MessageSpec:
    """One message. `cycle_time_us` is 0 for event messages, `data_id` None for unprotected ones."""

    name: str
    can_id: int
    length: int
    is_fd: bool
    sender: Node
    receivers: frozenset[Node]
    cycle_time_us: int
    data_id: int | None
    signals: tuple[SignalSpec, ...]
    comment: str

    @property
    def is_cyclic(self) -> bool:
        """Whether the message comes by the clock, so that its absence means something."""
        return self.cycle_time_us > 0

    @property
    def is_protected(self) -> bool:
        """Whether the frame starts with an E2E profile 5 header."""
        return self.data_id is not None


@dataclass(frozen=True)
class Schema:
    """A whole DBC: messages in the order of the file, value tables as raw value -> name."""

    messages: tuple[MessageSpec, ...]
    value_tables: dict[str, dict[int, str]]


def parse_schema(content: bytes, source: str) -> Schema:
    """Check and read the bytes of a DBC file; `source` names it in a `SchemaError`."""
    try:
        text = content.decode("cp1252")
    except UnicodeDecodeError as error:
        raise SchemaError(f"{source}: not a text in the DBC's character set: {error}") from error
    check_text(text, source)
    try:
        database = load_string(text, "dbc", strict=False, sort_signals=None)
    except Exception as error:  # on broken texts the parser leaks KeyError, ValueError, its own types
        raise SchemaError(f"{source}: not a DBC file: {error}") from error
    if not isinstance(database, Database):
        raise SchemaError(f"{source}: a diagnostics file, a DBC file is allowed")
    return _schema_of(database, source)


def _schema_of(database: Database, source: str) -> Schema:
    tables = {name: _value_table(name, choices, source) for name, choices in _tables(database)}
    messages = tuple(_message_spec(message, tables, source) for message in database.messages)
    _refuse_duplicates([message.name for message in messages], f"{source}: message name")
    _refuse_duplicates([f"0x{m.can_id:08X}" for m in messages], f"{source}: message identifier")
    data_ids = [str(m.data_id) for m in messages if m.data_id is not None]
    _refuse_duplicates(data_ids, f"{source}: E2EDataId")
    return Schema(messages=messages, value_tables=tables)


def _tables(database: Database) -> list[tuple[str, dict[int, str]]]:
    specifics = database.dbc
    if specifics is None:
        return []
    return [
        (name, {int(raw): str(text) for raw, text in choices.items()})
        for name, choices in specifics.value_tables.items()
    ]


def _value_table(name: str, choices: dict[int, str], source: str) -> dict[int, str]:
    """Check one VAL_TABLE_: its raw values must be 0, 1, 2 ... so that it makes an enumeration."""
    table = dict(sorted(choices.items()))
    if list(table) != list(range(len(table))):
        raise SchemaError(f"{source}: VAL_TABLE_ {name}: values {list(table)}, 0, 1, 2 ... is allowed")
    _refuse_duplicates(list(table.values()), f"{source}: VAL_TABLE_ {name}: name")
    return table


def _message_spec(
    message: ParsedMessage, tables: dict[str, dict[int, str]], source: str
) -> MessageSpec:
    where = f"{source}: message {message.name}"
    if not message.is_extended_frame:
        raise SchemaError(f"{where}: an 11-bit identifier, 29 bits are allowed")
    frame_format = _attribute(message, "VFrameFormat", where)
    if frame_format not in (FRAME_FORMAT_FD, FRAME_FORMAT_J1939):
        raise SchemaError(f"{where}: VFrameFormat {frame_format}, ExtendedCAN_FD or J1939PG is allowed")
    is_fd = frame_format == FRAME_FORMAT_FD
    if message.length not in FD_LENGTHS or (not is_fd and message.length > 8):
        raise SchemaError(f"{where}: {message.length} bytes is no length of its frame format")
    is_protected = _attribute(message, "E2EProfile", where, default=0) == 1
    signals = tuple(_signal_spec(signal, tables, where) for signal in message.signals)
    _check_layout(signals, message.length, is_protected, where)
    return MessageSpec(
        name=message.name,
        can_id=message.frame_id,
        length=message.length,
        is_fd=is_fd,
        sender=_node(message.senders, where),
        receivers=_receivers(message, where),
        cycle_time_us=_cycle_time_us(message, where),
        data_id=_attribute(message, "E2EDataId", where) if is_protected else None,
        signals=tuple(sorted(signals, key=lambda signal: signal.start_bit)),
        comment=message.comment or "",
    )


def _attribute(
    message: ParsedMessage, name: str, where: str, default: int | None = None
) -> int:
    specifics = message.dbc
    if specifics is None or name not in specifics.attributes:
        if default is not None:
            return default
        raise SchemaError(f"{where}: attribute {name} is missing")
    return int(specifics.attributes[name].value)


def _node(names: list[str], where: str) -> Node:
    if len(names) != 1 or names[0] not in set(Node):
        raise SchemaError(f"{where}: sender {names}, one of {[str(n) for n in Node]} is allowed")
    return Node(names[0])


def _receivers(message: ParsedMessage, where: str) -> frozenset[Node]:
    """The receivers all signals share: a frame is read as a whole or not at all."""
    groups = {frozenset(signal.receivers) for signal in message.signals}
    if len(groups) != 1:
        raise SchemaError(f"{where}: its signals have differing receivers, equal ones are allowed")
    return frozenset(_node([name], f"{where}: receiver") for name in groups.pop())


def _cycle_time_us(message: ParsedMessage, where: str) -> int:
    cycle_time_ms = _attribute(message, "GenMsgCycleTime", where)
    if (message.send_type == "Cyclic") != (cycle_time_ms > 0):
        raise SchemaError(f"{where}: send type {message.send_type} with GenMsgCycleTime {cycle_time_ms}")
    return 1000 * cycle_time_ms


def _signal_spec(
    signal: ParsedSignal, tables: dict[str, dict[int, str]], where: str
) -> SignalSpec:
    where = f"{where}: signal {signal.name}"
    if signal.byte_order != "little_endian" or signal.is_float:
        raise SchemaError(f"{where}: little-endian integers are allowed")
    if signal.is_multiplexer or signal.multiplexer_ids:
        raise SchemaError(f"{where}: multiplexed, plain signals are allowed")
    unit = signal.unit or ""
    if unit not in UNITS:
        raise SchemaError(f"{where}: unit {unit!r}, one of {list(UNITS)} is allowed")
    scale, offset = float(signal.scale), float(signal.offset)
    if scale != 1.0 and signal.length > MAX_SCALED_BITS:
        raise SchemaError(f"{where}: {signal.length} bits scaled, {MAX_SCALED_BITS} are allowed")
    if UNITS[unit].suffix == "_us" and (scale != 1.0 or offset != 0.0):
        raise SchemaError(f"{where}: microseconds with scale {scale}, scale 1 offset 0 is allowed")
    raw_min, raw_max = _raw_range(signal, scale, offset, where)
    table = _table_name(signal, tables, where)
    if table is not None and (raw_min, raw_max) != (0, len(tables[table]) - 1):
        raise SchemaError(f"{where}: range {raw_min}..{raw_max} is not that of table {table}")
    return SignalSpec(
        name=signal.name,
        start_bit=signal.start,
        bits=signal.length,
        signed=signal.is_signed,
        scale=scale,
        offset=offset,
        unit=unit,
        raw_min=raw_min,
        raw_max=raw_max,
        raw_start=int(signal.raw_initial or 0),
        value_table=table,
        comment=signal.comment or "",
    )


def _raw_range(signal: ParsedSignal, scale: float, offset: float, where: str) -> tuple[int, int]:
    """The DBC's physical range in raw values, never wider than the bits."""
    lowest = -(1 << signal.length - 1) if signal.is_signed else 0
    highest = lowest + (1 << signal.length) - 1
    if signal.minimum is None or signal.maximum is None:
        return lowest, highest
    ends = sorted((end - offset) / scale for end in (signal.minimum, signal.maximum))
    if not (math.isfinite(ends[0]) and math.isfinite(ends[1])):
        raise SchemaError(f"{where}: range {signal.minimum}..{signal.maximum}, finite is allowed")
    # A decimal end such as 13.107 / 0.0002 misses its whole number by a rounding error.
    slack = 1e-9 * max(1.0, abs(ends[0]), abs(ends[1]))
    raw_min = max(lowest, math.ceil(ends[0] - slack))
    raw_max = min(highest, math.floor(ends[1] + slack))
    if raw_min >= raw_max:
        raise SchemaError(f"{where}: range {signal.minimum}..{signal.maximum} holds no two values")
    return raw_min, raw_max


def _table_name(
    signal: ParsedSignal, tables: dict[str, dict[int, str]], where: str
) -> str | None:
    """The value table the signal's attribute names, which must be what its VAL_ says."""
    specifics = signal.dbc
    attribute = None if specifics is None else specifics.attributes.get("ValueTable")
    choices = {int(raw): str(text) for raw, text in (signal.choices or {}).items()}
    if attribute is None:
        if choices:
            raise SchemaError(f"{where}: VAL_ without the attribute ValueTable")
        return None
    name = str(attribute.value)
    if name not in tables:
        raise SchemaError(f"{where}: ValueTable {name}, one of {list(tables)} is allowed")
    if choices != tables[name]:
        raise SchemaError(f"{where}: its VAL_ differs from VAL_TABLE_ {name}")
    return name


def _check_layout(
    signals: tuple[SignalSpec, ...], length: int, is_protected: bool, where: str
) -> None:
    """Names unique, every bit inside the frame and used once, the E2E header where profile 5 has it."""
    _refuse_duplicates([signal.name for signal in signals], f"{where}: signal")
    owner: dict[int, str] = {}
    for signal in signals:
        for bit in range(signal.start_bit, signal.start_bit + signal.bits):
            if bit >= 8 * length:
                raise SchemaError(f"{where}: signal {signal.name} ends beyond its {length} bytes")
            if bit in owner:
                raise SchemaError(f"{where}: signals {owner[bit]} and {signal.name} overlap")
            owner[bit] = signal.name
        if is_protected and not signal.raw_min <= signal.raw_start <= signal.raw_max:
            raise SchemaError(f"{where}: signal {signal.name} starts outside its range")
    header = tuple((s.name, s.start_bit, s.bits) for s in signals if s.start_bit < 24)
    if is_protected and header != E2E_HEADER:
        raise SchemaError(f"{where}: bytes 0..2 hold {header}, the E2E header {E2E_HEADER} is allowed")


def _refuse_duplicates(names: list[str], what: str) -> None:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise SchemaError(f"{what} {name} twice")
        seen.add(name)


SCHEMA: Final = parse_schema(DBC_CONTENT, DBC_PATH.name)
"""The product's own wire contract."""
