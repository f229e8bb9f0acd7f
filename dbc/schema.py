"""Reads a DBC with cantools and checks what the codec and the link rely on.

`parse_schema` reads any DBC of the same dialect (29-bit identifiers, little-endian integer signals,
the attributes of meshpoint.dbc) and refuses everything else with a `SchemaError`. `SCHEMA` is the
product's own wire contract.

To read the product's own DBC takes a tenth of a start. So what it says is written beside it once,
as JSON: `python -m meshpoint.dbc.schema` (`make dbc`); `--check` compares and ends with 1 if they
differ.
"""

from __future__ import annotations

import hashlib
import json
import keyword
import math
import re
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from meshpoint.dbc.intake import SchemaError, check_text
from meshpoint.dbc.made import write_or_compare
from meshpoint.dbc.node import Node
from meshpoint.dbc.source import DBC_PATH
from meshpoint.dbc.specs import MessageSpec, Schema, SignalSpec
from meshpoint.dbc.units import UNITS

if TYPE_CHECKING:
    from cantools.database.can import Database
    from cantools.database.can import Message as ParsedMessage
    from cantools.database.can import Signal as ParsedSignal

__all__ = ["SCHEMA", "SchemaError", "parse_schema", "schema_of"]

OWN: Final = (DBC_PATH, DBC_PATH.with_name("truck.dbc"))
"""The DBC files that are read at each start."""

FRAME_FORMATS: Final = {"ExtendedCAN_FD": True, "ExtendedCAN": False, "J1939PG": False}
"""The frame formats there are; whether each is CAN FD."""
PROTECTION: Final = {"P05": True, "P01": True, "None": False}
SEND_TYPES: Final = {"Cyclic": True, "Event": False}
FD_LENGTHS: Final = (*range(9), 12, 16, 20, 24, 32, 48, 64)
E2E_HEADER: Final = (("Crc", 0, 16), ("Counter", 16, 8))
SHORT_HEADER: Final = (("Crc", 0, 8), ("Counter", 8, 4))
"""Of E2E profile 1, for classic frames."""
MAX_DATA_ID: Final = 0xFFFF
MAX_SCALED_BITS: Final = 48
"""A scaled signal must survive a float of 53 bits, with some to spare for the conversion."""

_NAME: Final = re.compile(r"[A-Z][A-Za-z0-9]*")
"""Names become classes and fields, so they must be plain words that begin with a capital letter."""

Tables = dict[str, dict[int, str]]
Header = tuple[tuple[str, int, int], ...]
"""Of each signal its name, first bit and bits."""


def parse_schema(content: bytes, source: str) -> Schema:
    """Check and read the bytes of a DBC file; `source` names it in a `SchemaError`."""
    from cantools.database import load_string
    from cantools.database.can import Database

    try:
        text = content.decode("cp1252")
    except UnicodeDecodeError as error:
        raise SchemaError(f"{source}: not a text in the character set of a DBC: {error}") from error
    check_text(text, source)
    try:
        database = load_string(text, "dbc", strict=False, sort_signals=None)
    except (
        Exception
    ) as error:  # broken texts make the parser leak KeyError and others besides its own
        raise SchemaError(f"{source}: not a DBC file: {error!r}") from error
    if not isinstance(database, Database) or database.dbc is None:
        raise SchemaError(f"{source}: not a DBC file")
    tables = {
        name: _value_table({int(raw): str(text) for raw, text in choices.items()}, source, name)
        for name, choices in database.dbc.value_tables.items()
    }
    messages = tuple(
        _message_spec(database, message, tables, source) for message in database.messages
    )
    _refuse_twice((*tables, *(m.name for m in messages)), f"{source}: message or value table")
    _refuse_twice((f"0x{m.can_id:08X}" for m in messages), f"{source}: identifier")
    _refuse_twice((m.data_id for m in messages if m.is_protected), f"{source}: E2EDataId")
    return Schema(messages, tables)


def _value_table(choices: dict[int, str], source: str, name: str) -> dict[int, str]:
    """One VAL_TABLE_; its raw values must be 0, 1, 2 ... so that it makes an enumeration."""
    where = f"{source}: VAL_TABLE_ {name}"
    _check_names([name], where)
    _refuse_twice((text.lower() for text in choices.values()), where)
    if not all(_NAME.fullmatch(text) for text in choices.values()):
        raise SchemaError(f"{where}: {list(choices.values())}, words like OnAt are allowed")
    table = dict(sorted(choices.items()))
    if list(table) != list(range(len(table))):
        raise SchemaError(f"{where}: values {list(table)}, 0, 1, 2 ... are allowed")
    return table


def _message_spec(
    database: Database, message: ParsedMessage, tables: Tables, source: str
) -> MessageSpec:
    where = f"{source}: message {message.name}"
    _check_names((message.name, *(signal.name for signal in message.signals)), where)
    is_fd = _choice(database, message, "VFrameFormat", FRAME_FORMATS, where)
    lengths = FD_LENGTHS if is_fd else FD_LENGTHS[:9]
    if not message.is_extended_frame or message.length not in lengths or not message.signals:
        raise SchemaError(
            f"{where}: 29-bit identifier, signals and length of {lengths} are allowed"
        )
    is_protected = _choice(database, message, "E2EProfile", PROTECTION, where)
    signals = tuple(
        sorted(
            (_signal_spec(signal, tables, where) for signal in message.signals),
            key=lambda signal: signal.start_bit,
        )
    )
    is_short = _attribute(database, message, "E2EProfile", where) == "P01"
    header = (SHORT_HEADER if is_short else E2E_HEADER) if is_protected else None
    _check_layout(signals, message.length, header, where)
    return MessageSpec(
        name=message.name,
        can_id=message.frame_id,
        length=message.length,
        is_fd=is_fd,
        sender=_nodes(message.senders[:1], f"{where}: sender")[0],
        receivers=frozenset(_receivers(message, where)),
        cycle_time_us=_cycle_time_us(database, message, where),
        data_id=_data_id(database, message, where) if is_protected else None,
        signals=signals,
        comment=message.comment or "",
        is_short=is_short,
    )


def _attribute(database: Database, message: ParsedMessage, name: str, where: str) -> object:
    """An attribute of a message as a number or a text: its own, or the file's default for all."""
    definition = database.dbc.attribute_definitions.get(name) if database.dbc else None
    if definition is None:
        raise SchemaError(f"{where}: attribute {name} is not defined")
    own = message.dbc.attributes.get(name) if message.dbc else None
    value = definition.default_value if own is None else own.value
    if definition.choices and isinstance(value, int) and 0 <= value < len(definition.choices):
        return definition.choices[value]
    return value


def _choice(
    database: Database, message: ParsedMessage, name: str, choices: dict[str, bool], where: str
) -> bool:
    value = str(_attribute(database, message, name, where))
    if value not in choices:
        raise SchemaError(f"{where}: {name} {value}, one of {list(choices)} is allowed")
    return choices[value]


def _cycle_time_us(database: Database, message: ParsedMessage, where: str) -> int:
    is_cyclic = _choice(database, message, "GenMsgSendType", SEND_TYPES, where)
    cycle_time_ms = _attribute(database, message, "GenMsgCycleTime", where)
    if not isinstance(cycle_time_ms, int) or cycle_time_ms < 0 or is_cyclic != (cycle_time_ms > 0):
        allowed = "more than 0 when Cyclic, 0 when Event"
        raise SchemaError(f"{where}: GenMsgCycleTime {cycle_time_ms}, {allowed} is allowed")
    return 1000 * cycle_time_ms


def _data_id(database: Database, message: ParsedMessage, where: str) -> int:
    data_id = _attribute(database, message, "E2EDataId", where)
    if not isinstance(data_id, int) or not 0 <= data_id <= MAX_DATA_ID:
        raise SchemaError(f"{where}: E2EDataId {data_id}, 0..{MAX_DATA_ID} is allowed")
    return data_id


def _nodes(names: Sequence[str], what: str) -> list[Node]:
    known = {str(node): node for node in Node}
    if not names or not known.keys() >= set(names):
        raise SchemaError(f"{what} {list(names)}, of {list(known)} are allowed")
    return [known[name] for name in names]


def _receivers(message: ParsedMessage, where: str) -> list[Node]:
    """The receivers its signals share: a frame is read as a whole or not at all."""
    groups = {tuple(signal.receivers) for signal in message.signals}
    if len(groups) != 1:
        raise SchemaError(
            f"{where}: its signals have receivers {sorted(groups)}, equal ones are allowed"
        )
    return _nodes(groups.pop(), f"{where}: receivers")


def _signal_spec(signal: ParsedSignal, tables: Tables, where: str) -> SignalSpec:
    where = f"{where}: signal {signal.name}"
    if signal.byte_order != "little_endian" or signal.is_float:
        raise SchemaError(f"{where}: little-endian integers are allowed")
    unit = signal.unit or ""
    if unit not in UNITS:
        raise SchemaError(f"{where}: unit {unit!r}, one of {list(UNITS)} is allowed")
    scale, offset = float(signal.scale), float(signal.offset)
    if scale != 1.0 and signal.length > MAX_SCALED_BITS:
        raise SchemaError(
            f"{where}: scaled with {signal.length} bits, {MAX_SCALED_BITS} are allowed"
        )
    if unit == "us" and (scale, offset) != (1.0, 0.0):
        raise SchemaError(f"{where}: microseconds with ({scale},{offset}), (1,0) is allowed")
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
        raw_start=_raw_start(signal, where),
        value_table=table,
        comment=signal.comment or "",
    )


def _raw_range(signal: ParsedSignal, scale: float, offset: float, where: str) -> tuple[int, int]:
    """The DBC's range in raw values, never wider than the bits; [0|0] says 'as the bits'."""
    lowest = -(1 << signal.length - 1) if signal.is_signed else 0
    highest = lowest + (1 << signal.length) - 1
    if signal.minimum is None or signal.maximum is None:
        return lowest, highest
    what = f"{where}: range {signal.minimum}..{signal.maximum}"
    ends = sorted((float(end) - offset) / scale for end in (signal.minimum, signal.maximum))
    # A decimal end such as 13.107 / 0.0002 misses its whole number by a rounding error.
    slack = 1e-9 * max(1.0, abs(ends[0]), abs(ends[1]))
    raw_min = max(lowest, math.ceil(ends[0] - slack))
    raw_max = min(highest, math.floor(ends[1] + slack))
    if raw_min >= raw_max:
        raise SchemaError(f"{what} holds no two values, raw {lowest}..{highest} is allowed")
    return raw_min, raw_max


def _raw_start(signal: ParsedSignal, where: str) -> int:
    start = 0 if signal.raw_initial is None else signal.raw_initial
    if not math.isfinite(start) or start != int(start):
        raise SchemaError(f"{where}: GenSigStartValue {start}, a whole raw value is allowed")
    return int(start)


def _table_name(signal: ParsedSignal, tables: Tables, where: str) -> str | None:
    """The value table the signal's attribute names, which must be what its VAL_ says."""
    attribute = signal.dbc.attributes.get("ValueTable") if signal.dbc else None
    name = str(attribute.value) if attribute else ""
    choices = {int(raw): str(text) for raw, text in (signal.choices or {}).items()}
    if choices != tables.get(name, {}) or bool(name) != bool(choices):
        raise SchemaError(f"{where}: VAL_ {choices} is not the table ValueTable names, {name!r}")
    return name or None


def _check_layout(
    signals: tuple[SignalSpec, ...], length: int, header: Header | None, where: str
) -> None:
    """Each name once, each bit inside the frame and used once, the E2E header in its place."""
    _refuse_twice((signal.name.lower() for signal in signals), f"{where}: signal")
    end, owner = 0, ""
    for signal in signals:
        if signal.start_bit < end:
            raise SchemaError(f"{where}: signals {owner} and {signal.name} overlap")
        end, owner = signal.start_bit + signal.bits, signal.name
        low = signal.type_min if header is None else signal.raw_min
        high = signal.type_max if header is None else signal.raw_max
        if not low <= signal.raw_start <= high:
            start = f"GenSigStartValue {signal.raw_start}, {low}..{high} is allowed"
            raise SchemaError(f"{where}: signal {signal.name}: {start}")
    if end > 8 * length:
        raise SchemaError(f"{where}: signal {owner} ends at bit {end}, {8 * length} is allowed")
    if header is None:
        return
    bits = sum(width for _, _, width in header)
    found = tuple((s.name, s.start_bit, s.bits) for s in signals if s.start_bit < bits)
    if found != header:
        raise SchemaError(f"{where}: starts with {found}, the header {header} is allowed")


def _check_names(names: Iterable[str], where: str) -> None:
    for name in names:
        is_taken = keyword.iskeyword(name) or keyword.iskeyword(name.lower())
        if is_taken or not _NAME.fullmatch(name):
            raise SchemaError(f"{where}: name {name!r}, words like BrakePressure are allowed")


def _refuse_twice(items: Iterable[object], what: str) -> None:
    seen: set[object] = set()
    for item in items:
        if item in seen:
            raise SchemaError(f"{what} {item} is there twice")
        seen.add(item)


def schema_of(path: Path) -> Schema:
    """What one of `OWN` says: by what was written beside it; one that was changed since is read
    itself."""
    content, written = path.read_bytes(), path.with_suffix(".json")
    said: dict[str, Any] = json.loads(written.read_bytes()) if written.exists() else {}
    if said.get("sha256") != hashlib.sha256(content).hexdigest():
        return parse_schema(content, path.name)
    tables = {
        name: {int(raw): text for raw, text in table.items()}
        for name, table in said["value_tables"].items()
    }
    return Schema(tuple(_message_said(*message) for message in said["messages"]), tables)


def _message_said(fields: dict[str, Any], receivers: list[str], signals: list[Any]) -> MessageSpec:
    return MessageSpec(
        **{**fields, "sender": Node(fields["sender"])},
        receivers=frozenset(map(Node, receivers)),
        signals=tuple(SignalSpec(*signal) for signal in signals),
    )


def _written(path: Path) -> bytes:
    """What a DBC says, a message a line."""
    content = path.read_bytes()
    schema, lines = parse_schema(content, path.name), []
    for message in schema.messages:
        fields = vars(message) | {"sender": message.sender.value}
        receivers = sorted(node.value for node in fields.pop("receivers"))
        signals = [[*vars(signal).values()] for signal in fields.pop("signals")]
        lines.append(json.dumps([fields, receivers, signals]))
    digest, tables = hashlib.sha256(content).hexdigest(), json.dumps(schema.value_tables)
    messages = ",\n".join(lines)
    said = f'{{"sha256": "{digest}",\n"value_tables": {tables},\n"messages": [\n{messages}\n]}}\n'
    return said.encode()


SCHEMA: Final = schema_of(DBC_PATH)
"""The product's own wire contract."""


def main(arguments: list[str] | None = None) -> int:
    """Write what the files say, or compare it."""
    return max(
        write_or_compare(
            "meshpoint.dbc.schema", path.with_suffix(".json"), _written(path), arguments
        )
        for path in OWN
    )


if __name__ == "__main__":
    sys.exit(main())
