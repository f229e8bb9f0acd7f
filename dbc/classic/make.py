"""Writes `meshpoint_classic.dbc` from the contract, which itself is in terms of meshpoint.dbc.

`python -m meshpoint.dbc.classic.make` writes the file; with `--check` it compares it and ends with
1 if they differ.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from decimal import Decimal
from typing import Final

from meshpoint.dbc.classic.contract import CONTRACT
from meshpoint.dbc.classic.source import CLASSIC_DBC
from meshpoint.dbc.made import write_or_compare
from meshpoint.dbc.source import DBC_CONTENT
from meshpoint.dbc.specs import MessageSpec, SignalSpec

EXTENDED: Final = 1 << 31
J1939_FORMAT, EXTENDED_FORMAT = 3, 1
"""Of the attribute VFrameFormat."""
_ABOUT: Final = (
    "meshpoint wire contract, classic profile: CAN 500 kbit/s, frames of 8 bytes. Own frames carry "
    "an AUTOSAR E2E profile 1 header: CRC in byte 0, counter in the low half of byte 1. Unused "
    "bits are sent as 0 in own frames and as 1 in J1939 frames. Written from meshpoint.dbc."
)


def make_dbc() -> str:
    """The text of the file."""
    fd = DBC_CONTENT.decode("cp1252").splitlines()
    lines = ['VERSION "1.0"', "", "NS_ :", "", "BS_:", ""]
    lines += [line for line in fd if line.startswith("BU_:")]
    lines += ["", *(line for line in fd if line.startswith("VAL_TABLE_")), ""]
    for message in CONTRACT.messages:
        lines += [*_message(message), ""]
    lines += [f'CM_ "{_ABOUT}";', *(line for line in fd if line.startswith("CM_ BU_"))]
    for message in CONTRACT.messages:
        lines += _comments(message)
    lines += [_definition(line) for line in fd if line.startswith("BA_DEF")]
    lines += ['BA_ "DBName" "meshpoint_classic";', 'BA_ "BusType" "CAN";', 'BA_ "Baudrate" 500000;']
    lines += [line for line in fd if line.startswith('BA_ "NmStationAddress"')]
    for message in CONTRACT.messages:
        lines += _attributes(message)
    lines += [line for line in fd if line.startswith('BA_ "SPN"') and _is_kept(line)]
    for message in CONTRACT.messages:
        lines += _values(message)
    return "\n".join(lines) + "\n"


def _is_kept(line: str) -> bool:
    """Whether an attribute's line is of a message that is the same in both profiles."""
    return int(line.split()[3]) & ~EXTENDED in {message.can_id for message in CONTRACT.messages}


def _definition(line: str) -> str:
    """Of an attribute, as in meshpoint.dbc; there is one E2E profile more."""
    line = line.replace('"E2EProfile" ENUM "None","P05"', '"E2EProfile" ENUM "None","P05","P01"')
    return line.replace('"BusType" "CAN FD"', '"BusType" "CAN"').replace(
        '"DBName" "meshpoint"', '"DBName" "meshpoint_classic"'
    )


def _number(value: float) -> str:
    return f"{Decimal(repr(value)).normalize():f}"


def _raw(signal: SignalSpec, raw: int) -> str:
    """A raw value in the signal's unit, as a DBC writes it."""
    value = Decimal(raw) * Decimal(repr(signal.scale)) + Decimal(repr(signal.offset))
    return f"{value.normalize():f}"


def _message(message: MessageSpec) -> Iterator[str]:
    yield f"BO_ {message.can_id | EXTENDED} {message.name}: {message.length} {message.sender}"
    receivers = ",".join(node for node in sorted(message.receivers))
    for s in message.signals:
        sign = "-" if s.signed else "+"
        yield (
            f" SG_ {s.name} : {s.start_bit}|{s.bits}@1{sign} ({_number(s.scale)},"
            f"{_number(s.offset)}) [{_raw(s, s.raw_min)}|{_raw(s, s.raw_max)}] "
            f'"{s.unit}" {receivers}'
        )


def _comments(message: MessageSpec) -> Iterator[str]:
    can_id = message.can_id | EXTENDED
    yield f'CM_ BO_ {can_id} "{message.comment}";'
    for signal in message.signals:
        if signal.comment:
            yield f'CM_ SG_ {can_id} {signal.name} "{signal.comment}";'


def _attributes(message: MessageSpec) -> Iterator[str]:
    can_id = message.can_id | EXTENDED
    form = EXTENDED_FORMAT if message.is_protected else J1939_FORMAT
    yield f'BA_ "VFrameFormat" BO_ {can_id} {form};'
    yield f'BA_ "GenMsgCycleTime" BO_ {can_id} {message.cycle_time_us // 1000};'
    if not message.is_cyclic:
        yield f'BA_ "GenMsgSendType" BO_ {can_id} 1;'
    if message.data_id is not None:
        yield f'BA_ "E2EProfile" BO_ {can_id} 2;'
        yield f'BA_ "E2EDataId" BO_ {can_id} {message.data_id};'
    for signal in message.signals:
        if signal.value_table is not None:
            yield f'BA_ "ValueTable" SG_ {can_id} {signal.name} "{signal.value_table}";'
        yield f'BA_ "GenSigStartValue" SG_ {can_id} {signal.name} {signal.raw_start};'


def _values(message: MessageSpec) -> Iterator[str]:
    for signal in message.signals:
        if signal.value_table is not None:
            table = CONTRACT.value_tables[signal.value_table]
            words = " ".join(f'{raw} "{text}"' for raw, text in sorted(table.items(), reverse=True))
            yield f"VAL_ {message.can_id | EXTENDED} {signal.name} {words} ;"


def main(arguments: list[str] | None = None) -> int:
    """Write the file, or compare it."""
    content = make_dbc().encode("cp1252")
    return write_or_compare("meshpoint.dbc.classic.make", CLASSIC_DBC, content, arguments)


if __name__ == "__main__":
    sys.exit(main())
