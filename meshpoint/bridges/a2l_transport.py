"""IF_DATA XCP: how a tool reaches the controller, and what its slave can do."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

from meshpoint.bridges.a2l_blocks import block, hexadecimal
from meshpoint.controller.settings.settings import Timing
from meshpoint.dbc.j1939 import XCP_COMMAND_ID, XCP_RESPONSE_ID
from meshpoint.xcp.memory import PAGE_BYTES, Page
from meshpoint.xcp.protocol import FD_BYTES, VERSION, Command, Event
from meshpoint.xcp.slave import EVENT_NAMES, MOST_OF_A_BLOCK

GRAMMAR: Final = Path(__file__).with_name("xcp.aml")
SHORT_NAMES: Final = {Event.STEP: "step", Event.SHIFT_END: "shiftend"}
"""Of eight letters at most."""
BIT_RATE: Final = 500_000
DATA_BIT_RATE: Final = 2_000_000
"""Those of the wire contract (docs/wire.md)."""
EXTENDED: Final = 0x8000_0000
TIMEOUT_MS: Final = 1_000
"""For each of T1 to T7: an answer comes with the next step, some 10 ms later; a step of a live node
on a busy machine may be late."""
MANDATORY: Final = {Command.CONNECT, Command.DISCONNECT, Command.GET_STATUS, Command.SYNCH}


def grammar() -> Iterator[str]:
    """What an IF_DATA block may hold, for tools that do not know it: the A2ML block."""
    return block("A2ML", "", GRAMMAR.read_text("ascii").splitlines())


def xcp_on_can() -> Iterator[str]:
    """The module's IF_DATA block."""
    return block("IF_DATA", "XCP", [*_protocol(), *_daq(), *block("PAG", "0x01"), *_can()])


def pages() -> Iterator[str]:
    """The memory segment's IF_DATA block: a reference page and a working page."""
    free = "ECU_ACCESS_DONT_CARE XCP_READ_ACCESS_DONT_CARE"
    lines = [f"0 {len(Page)} 0 0 0", *block("CHECKSUM", f"XCP_CRC_32 MAX_BLOCK_SIZE {PAGE_BYTES}")]
    for page in Page:
        written = "DONT_CARE" if page is Page.WORKING else "NOT_ALLOWED"
        lines += block("PAGE", f"{page} {free} XCP_WRITE_ACCESS_{written} INIT_SEGMENT 0")
    return block("IF_DATA", "XCP", block("SEGMENT", "", lines))


def _protocol() -> Iterator[str]:
    version = f"0x{VERSION:02X}01"
    times = " ".join(str(TIMEOUT_MS) for _ in range(7))
    lines = [f"{version} {times} {FD_BYTES} {FD_BYTES}"]
    lines += ["BYTE_ORDER_MSB_LAST ADDRESS_GRANULARITY_BYTE"]
    lines += [f"OPTIONAL_CMD {each.name}" for each in Command if each not in MANDATORY]
    lines += [f"COMMUNICATION_MODE_SUPPORTED BLOCK SLAVE MASTER {MOST_OF_A_BLOCK} 0"]
    return block("PROTOCOL_LAYER", "", lines)


def _daq() -> Iterator[str]:
    lines = [f"DYNAMIC 0 {len(Event)} 0 OPTIMISATION_TYPE_DEFAULT ADDRESS_EXTENSION_FREE"]
    lines += ["IDENTIFICATION_FIELD_TYPE_ABSOLUTE GRANULARITY_ODT_ENTRY_SIZE_DAQ_BYTE"]
    lines += [f"{FD_BYTES - 1} NO_OVERLOAD_INDICATION PRESCALER_SUPPORTED"]
    lines += block("TIMESTAMP_SUPPORTED", "1 SIZE_DWORD UNIT_1US TIMESTAMP_FIXED")
    for event in Event:
        name = EVENT_NAMES[event].decode()
        cycle_ms = Timing().tick_ms if event is Event.STEP else 0
        lines += block("EVENT", f'"{name}" "{SHORT_NAMES[event]}" {event} DAQ 0xFF {cycle_ms} 6 0')
    return block("DAQ", "", lines)


def _can() -> Iterator[str]:
    lines = [
        f"0x{VERSION:02X}01",
        f"CAN_ID_MASTER {hexadecimal(XCP_COMMAND_ID | EXTENDED)}",
        f"CAN_ID_SLAVE {hexadecimal(XCP_RESPONSE_ID | EXTENDED)}",
        f"BAUDRATE {BIT_RATE}",
    ]
    fd = [f"MAX_DLC {FD_BYTES}", f"CAN_FD_DATA_TRANSFER_BAUDRATE {DATA_BIT_RATE}"]
    return block("XCP_ON_CAN", "", [*lines, *block("CAN_FD", "", fd)])
