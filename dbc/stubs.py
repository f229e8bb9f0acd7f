"""Writes `messages.pyi`, which shows type checkers and people what `messages` makes from the DBC.

`python -m meshpoint.dbc.stubs` writes the file; `python -m meshpoint.dbc.stubs --check` compares it
with the DBC and ends with 1 if they differ.
"""

from __future__ import annotations

import sys
import textwrap
from enum import IntEnum
from pathlib import Path
from typing import Final

from meshpoint.dbc.fields import FieldKind, FieldSpec
from meshpoint.dbc.layout import CODECS, ENUMS, Codec
from meshpoint.dbc.made import write_or_compare

STUB_PATH: Final = Path(__file__).with_name("messages.pyi")

_HEADER: Final = '''\
# Written by `python -m meshpoint.dbc.stubs` from meshpoint.dbc. Do not edit.
"""The messages and enumerations of the DBC as Python classes in SI units."""

from enum import IntEnum
from typing import Final, NamedTuple, TypeAlias
'''
_TYPES: Final = {FieldKind.BOOL: "bool", FieldKind.INT: "int", FieldKind.FLOAT: "float"}
_WIDTH: Final = 100


def make_stub() -> str:
    """The text of the stub."""
    parts = [_HEADER]
    parts += [_enum_text(enum) for enum in ENUMS.values()]
    parts += [_message_text(codec) for codec in CODECS.values()]
    union = "\n    | ".join(CODECS)
    parts.append(f"Message: TypeAlias = (\n    {union}\n)\n")
    parts.append("MESSAGE_TYPES: Final[dict[str, type[Message]]]\n")
    return "\n".join(parts)


def _enum_text(enum: type[IntEnum]) -> str:
    members = "\n".join(f"    {member.name} = {member.value}" for member in enum)
    return f"class {enum.__name__}(IntEnum):\n{members}\n"


def _message_text(codec: Codec) -> str:
    spec = codec.spec
    receivers = ", ".join(sorted(spec.receivers))
    rhythm = f"every {spec.cycle_time_us // 1000} ms" if spec.is_cyclic else "on events"
    doc = f'"""{spec.comment}.\n\n{spec.sender} -> {receivers}, {rhythm}.\n"""'
    lines = [f"class {spec.name}(NamedTuple):", *_wrapped(doc)]
    for field in codec.fields:
        lines += ["", f"    {field.name}: {_type_text(field)} = ...", *_wrapped(_field_doc(field))]
    return "\n".join(lines) + "\n"


def _type_text(field: FieldSpec) -> str:
    table = field.signals[0].value_table
    text = table if field.kind is FieldKind.ENUM and table is not None else _TYPES[field.kind]
    text = f"tuple[{text}, ...]" if field.is_tuple else text
    return f"{text} | None" if field.is_optional else text


def _field_doc(field: FieldSpec) -> str:
    first = field.signals[0]
    count = f"{len(field.signals)} values; the first: " if field.is_tuple else ""
    limits = f" ({field.allowed(first)})" if field.kind in (FieldKind.INT, FieldKind.FLOAT) else ""
    return f'"""{count}{first.comment}{limits}."""'


def _wrapped(text: str) -> list[str]:
    lines: list[str] = []
    for paragraph in text.splitlines():
        lines += textwrap.wrap(
            paragraph, _WIDTH, initial_indent="    ", subsequent_indent="    "
        ) or [""]
    return lines


def main(arguments: list[str] | None = None) -> int:
    """Write the stub, or compare it."""
    return write_or_compare("meshpoint.dbc.stubs", STUB_PATH, make_stub().encode(), arguments)


if __name__ == "__main__":
    sys.exit(main())
