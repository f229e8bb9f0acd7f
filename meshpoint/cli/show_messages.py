"""`meshpoint show messages`: the wire contract for other tools, and what is in it."""

from __future__ import annotations

import argparse
import hashlib
from pathlib import Path
from typing import Any

from rich.table import Table

from meshpoint.base.errors import CommandError
from meshpoint.base.exits import Exit
from meshpoint.bus.profile import WireProfile
from meshpoint.cli import arguments
from meshpoint.dbc import DBC_PATH, DBC_SHA256
from meshpoint.dbc.classic.source import CLASSIC_DBC
from meshpoint.dbc.j1939_view import J1939_DBC
from meshpoint.dbc.schema import SCHEMA, parse_schema
from meshpoint.dbc.specs import MessageSpec, Schema, SignalSpec
from meshpoint.results.output import console, tell, write_json


def add_parser(things: Any) -> None:
    """Its arguments."""
    parser: argparse.ArgumentParser = things.add_parser(
        "messages",
        help="the messages on the bus, the signals of one, or where the DBC is",
        description="Lists the messages of the DBC that all nodes speak, or the signals of one.",
    )
    parser.add_argument("message", nargs="?", metavar="MESSAGE", help="the signals of this one")
    parser.add_argument(
        "--path", action="store_true", help="print where the file is, for tools that read DBC"
    )
    parser.add_argument(
        "--j1939",
        action="store_true",
        help="with --path: the file that has the messages of the standard alone, by PGN, for tools "
        "that know J1939",
    )
    arguments.add_wire(parser)
    arguments.add_json(parser)
    parser.set_defaults(run=run)


def run(namespace: argparse.Namespace) -> int:
    """Prints it."""
    out = console(namespace.json)
    is_classic = arguments.wire_of(namespace) is WireProfile.CLASSIC
    path = CLASSIC_DBC if is_classic else DBC_PATH
    if namespace.j1939 and not namespace.path:
        raise CommandError("--j1939 without --path: it is a file for other tools")
    if namespace.path:
        tell(str(J1939_DBC if namespace.j1939 else path))
        return Exit.DONE
    schema, sha256 = _classic(path) if is_classic else (SCHEMA, DBC_SHA256)
    chosen = None if namespace.message is None else _message(schema, namespace.message)
    if namespace.json is not None:
        messages = schema.messages if chosen is None else (chosen,)
        write_json(namespace.json, {"sha256": sha256, "messages": [_json(m) for m in messages]})
    if namespace.json == "-":
        return Exit.DONE
    if chosen is None:
        out.print(messages_table(schema))
        out.print(f"\n{path}\nsha256 {sha256}", soft_wrap=True)
    else:
        out.print(signals_table(chosen))
    return Exit.DONE


def _classic(path: Path) -> tuple[Schema, str]:
    content = path.read_bytes()
    return parse_schema(content, path.name), hashlib.sha256(content).hexdigest()


def _message(schema: Schema, name: str) -> MessageSpec:
    by_name = {message.name.lower(): message for message in schema.messages}
    if name.lower() not in by_name:
        known = ", ".join(message.name for message in schema.messages)
        raise CommandError(f"there is no message {name!r}; messages are {known}")
    return by_name[name.lower()]


def messages_table(schema: Schema = SCHEMA) -> Table:
    """A line a message."""
    table = Table(box=None, pad_edge=False)
    table.add_column("message", no_wrap=True)
    table.add_column("id", no_wrap=True)
    table.add_column("bytes", justify="right", no_wrap=True)
    table.add_column("ms", justify="right", no_wrap=True)
    table.add_column("meaning")
    for message in schema.messages:
        cycle_us = message.cycle_time_us
        table.add_row(
            message.name, f"{message.can_id:08X}", str(message.length),
            f"{cycle_us / 1000:g}" if cycle_us else "-", message.comment,
        )  # fmt: skip
    return table


def signals_table(message: MessageSpec) -> Table:
    """A line a signal: range in its unit, or its value table."""
    table = Table(
        title=f"{message.name} {message.can_id:08X}, from {message.sender.name.lower()}: "
        f"{message.comment}",
        title_justify="left", box=None, pad_edge=False,
    )  # fmt: skip
    table.add_column("signal", no_wrap=True)
    table.add_column("bit", justify="right", no_wrap=True)
    table.add_column("bits", justify="right", no_wrap=True)
    table.add_column("unit", no_wrap=True)
    table.add_column("meaning")
    for signal in message.signals:
        meaning = "; ".join(filter(None, (signal.comment, _values(signal))))
        table.add_row(signal.name, str(signal.start_bit), str(signal.bits), signal.unit, meaning)
    return table


def _values(signal: SignalSpec) -> str:
    if signal.value_table is None:
        low, high = (raw * signal.scale + signal.offset for raw in (signal.raw_min, signal.raw_max))
        return f"{low:g} to {high:g}" if signal.is_ranged else ""
    names = SCHEMA.value_tables[signal.value_table]
    return ", ".join(f"{raw} {name}" for raw, name in names.items())


def _json(message: MessageSpec) -> dict[str, Any]:
    return {
        "name": message.name,
        "id": message.can_id,
        "length": message.length,
        "fd": message.is_fd,
        "sender": message.sender.name.lower(),
        "receivers": sorted(node.name.lower() for node in message.receivers),
        "cycle_time_us": message.cycle_time_us,
        "comment": message.comment,
        "signals": [
            {
                "name": signal.name,
                "start_bit": signal.start_bit,
                "bits": signal.bits,
                "signed": signal.signed,
                "scale": signal.scale,
                "offset": signal.offset,
                "unit": signal.unit,
                "values": _table(signal),
                "comment": signal.comment,
            }
            for signal in message.signals
        ],
    }


def _table(signal: SignalSpec) -> dict[str, str] | None:
    if signal.value_table is None:
        return None
    return {str(raw): name for raw, name in SCHEMA.value_tables[signal.value_table].items()}
