"""Writes `meshpoint_j1939.dbc`: the messages of the standard alone, by their PGN from any source.

Tools that know J1939 find a message by its PGN; of ours they need no identifier, and our own
messages are none to them. `python -m meshpoint.dbc.j1939_view` writes the file from meshpoint.dbc
and truck.dbc; with `--check` it compares it and ends with 1 if they differ.
"""

from __future__ import annotations

import re
import sys
from typing import Final

from meshpoint.dbc.made import write_or_compare
from meshpoint.dbc.node import Node
from meshpoint.dbc.schema import SCHEMA
from meshpoint.dbc.source import DBC_CONTENT, DBC_PATH
from meshpoint.dbc.truck import TRUCK_CONTENT, TRUCK_SCHEMA

J1939_DBC: Final = DBC_PATH.with_name("meshpoint_j1939.dbc")
"""Where it is."""
NO_SOURCE: Final = 0xFE
"""The null address: in a DBC of J1939, any source."""
EXTENDED: Final = 1 << 31
STANDARD: Final = [
    message for message in (*SCHEMA.messages, *TRUCK_SCHEMA.messages) if not message.is_protected
]
OF_STANDARD: Final = {
    message.can_id | EXTENDED: message.can_id & ~0xFF | NO_SOURCE | EXTENDED for message in STANDARD
}
"""Identifiers as the two files write them, and as this one does."""
TABLES: Final = {signal.value_table for message in STANDARD for signal in message.signals}
"""Value tables that the standard's signals use."""
OF_A_MESSAGE: Final = re.compile(r'(BO_|CM_ BO_|CM_ SG_|BA_ "\w+" BO_|BA_ "\w+" SG_|VAL_) (\d+)\b')
OUR_OWN: Final = ("E2EProfile", "E2EDataId", "CANFD_BRS", "BaudrateCANFD")
"""Attributes that no message of the standard has."""
BEHIND: Final = {
    'BA_DEF_ "BusType"': 'BA_DEF_ "ProtocolType" STRING ;',
    'BA_DEF_DEF_ "BusType"': 'BA_DEF_DEF_ "ProtocolType" "J1939";',
    'BA_ "BusType"': 'BA_ "ProtocolType" "J1939";',
}
"""What this file has more, behind lines that begin so."""
SECTIONS: Final = (
    "VERSION", "NS_", "BS_", "BU_", "VAL_TABLE_", "BO_", "CM_", "BA_DEF_", "BA_DEF_DEF_", "BA_",
    "VAL_",
)  # fmt: skip
"""Of a DBC, by the first word of their lines, in their order."""
ABOUT: Final = (
    "J1939 messages of meshpoint's bus, by PGN: source address 0xFE stands for any. SPN is an "
    "attribute of each signal. Written from meshpoint.dbc and truck.dbc."
)


def make_dbc() -> str:
    """The text of the file: both files' sections together, what they share once."""
    sections: dict[str, list[str]] = {name: [] for name in SECTIONS}
    for content in (DBC_CONTENT, TRUCK_CONTENT):
        section = sections["VERSION"]
        for line in _kept(content.decode("cp1252").splitlines()):
            section = sections.get(line.split(" ")[0].rstrip(":"), section)
            if not line or line.startswith(" SG_") or line not in section:
                section.append(line)
    found = [line for section in sections.values() for line in section]
    return "\n".join(_without_double_blanks(found)) + "\n"


def _kept(lines: list[str]) -> list[str]:
    """The lines of one file that this one has, as it has them."""
    found: list[str] = []
    keeps = True
    for line in lines:
        match = OF_A_MESSAGE.match(line)
        if match is not None:
            keeps = int(match[2]) in OF_STANDARD
            if keeps:
                begin, end = match.span(2)
                found.append(f"{line[:begin]}{OF_STANDARD[int(match[2])]}{line[end:]}")
        elif not line.startswith(" SG_"):
            found += _of_all(line)
        elif keeps:
            found.append(line)
    return found


def _of_all(line: str) -> list[str]:
    """A line that belongs to no message as this file has it, and what comes behind it."""
    is_left_out = line.startswith("VAL_TABLE_") and line.split()[1] not in TABLES
    if is_left_out or any(f'"{name}"' in line for name in OUR_OWN):
        return []
    if line.startswith('CM_ "'):
        line = f'CM_ "{ABOUT}";'
    if line.startswith("BU_:"):
        line = f"BU_: {' '.join(Node)}"
    line = re.sub('"DBName" "[a-z]+"', '"DBName" "meshpoint_j1939"', line)
    line = line.replace('"BusType" "CAN FD"', '"BusType" "CAN"')
    behind = [of for begin, of in BEHIND.items() if line.startswith(begin)]
    return [line, *behind]


def _without_double_blanks(lines: list[str]) -> list[str]:
    return [line for k, line in enumerate(lines) if line or (k > 0 and lines[k - 1])]


def main(arguments: list[str] | None = None) -> int:
    """Write the file, or compare it."""
    content = make_dbc().encode("cp1252")
    return write_or_compare("meshpoint.dbc.j1939_view", J1939_DBC, content, arguments)


if __name__ == "__main__":
    sys.exit(main())
