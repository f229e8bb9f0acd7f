"""Codes of the XCP protocol layer (ASAM MCD-1 XCP 1.1, part 2), those that are used here."""

from __future__ import annotations

from enum import IntEnum
from typing import Final

POSITIVE: Final = 0xFF
NEGATIVE: Final = 0xFE
"""First byte of a response, and of an error."""
VERSION: Final = 1
"""Of protocol and transport layer, as CONNECT reports them: the whole number of 1.1."""
CLASSIC_BYTES: Final = 8
FD_BYTES: Final = 64
"""Largest packet, by the frame that CONNECT came in."""
PACKETS_A_STEP: Final = {CLASSIC_BYTES: 12, FD_BYTES: 6}
"""Sent in a step, by their size: some 3 ms of a bus of 500 kbit/s and 2 Mbit/s. What is more waits,
so that the next valve command does not."""
FD_LENGTHS: Final = (*range(9), 12, 16, 20, 24, 32, 48, 64)
"""Bytes that a CAN FD frame can have."""


class Command(IntEnum):
    """Packet identifiers of commands."""

    CONNECT = 0xFF
    DISCONNECT = 0xFE
    GET_STATUS = 0xFD
    SYNCH = 0xFC
    GET_COMM_MODE_INFO = 0xFB
    GET_ID = 0xFA
    SET_MTA = 0xF6
    UPLOAD = 0xF5
    SHORT_UPLOAD = 0xF4
    BUILD_CHECKSUM = 0xF3
    DOWNLOAD = 0xF0
    DOWNLOAD_NEXT = 0xEF
    SET_CAL_PAGE = 0xEB
    GET_CAL_PAGE = 0xEA
    GET_PAG_PROCESSOR_INFO = 0xE9
    GET_SEGMENT_INFO = 0xE8
    GET_PAGE_INFO = 0xE7
    COPY_CAL_PAGE = 0xE4
    CLEAR_DAQ_LIST = 0xE3
    SET_DAQ_PTR = 0xE2
    WRITE_DAQ = 0xE1
    SET_DAQ_LIST_MODE = 0xE0
    GET_DAQ_LIST_MODE = 0xDF
    START_STOP_DAQ_LIST = 0xDE
    START_STOP_SYNCH = 0xDD
    GET_DAQ_CLOCK = 0xDC
    GET_DAQ_PROCESSOR_INFO = 0xDA
    GET_DAQ_RESOLUTION_INFO = 0xD9
    GET_DAQ_EVENT_INFO = 0xD7
    FREE_DAQ = 0xD6
    ALLOC_DAQ = 0xD5
    ALLOC_ODT = 0xD4
    ALLOC_ODT_ENTRY = 0xD3


class XcpError(IntEnum):
    """Error codes."""

    CMD_SYNCH = 0x00
    DAQ_ACTIVE = 0x11
    CMD_UNKNOWN = 0x20
    CMD_SYNTAX = 0x21
    OUT_OF_RANGE = 0x22
    WRITE_PROTECTED = 0x23
    ACCESS_DENIED = 0x24
    PAGE_NOT_VALID = 0x26
    MODE_NOT_VALID = 0x27
    SEGMENT_NOT_VALID = 0x28
    SEQUENCE = 0x29
    DAQ_CONFIG = 0x2A
    MEMORY_OVERFLOW = 0x30


class RefusedError(Exception):
    """A command that is answered with an error."""

    def __init__(self, code: XcpError, *more: int) -> None:
        """more: what some errors say besides, bytes."""
        super().__init__(code.name)
        self.code, self.more = code, bytes(more)
