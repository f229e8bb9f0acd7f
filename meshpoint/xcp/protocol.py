"""The XCP protocol layer (ASAM MCD-1 XCP 1.1, part 2): the codes that are used here, and DAQ lists.

A dynamic DAQ list says which bytes are sent at which event. It has object descriptor tables (ODT);
each is a packet of its own, and the packet identifier is the ODT's number counted over all lists.
The first packet of a list carries the time stamp.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
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

MOST_LISTS: Final = 8
SPARE_PACKETS: Final = 2
"""Left for answers in a step in which every list is sent."""
MOST_ENTRIES: Final = 63
STAMP_BYTES: Final = 4
DYNAMIC, PRESCALER, STAMPED = 0x01, 0x02, 0x10
PROPERTIES: Final = DYNAMIC | PRESCALER | STAMPED
STAMP_MODE: Final = 0x3C
"""Four bytes, always, in units of 1 us."""
MODE_SELECTED, MODE_STAMPED, MODE_RUNNING = 0x01, 0x10, 0x40
"""Bits of GET_DAQ_LIST_MODE; SET_DAQ_LIST_MODE has the second."""
WHOLE_BYTES: Final = 0xFF
"""The bit offset of an entry that is no bit."""


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


class Event(IntEnum):
    """When a list is sent."""

    STEP = 0
    SHIFT_END = 1


class ListAction(IntEnum):
    """What START_STOP_DAQ_LIST does to one list."""

    STOP = 0
    START = 1
    SELECT = 2


class SynchAction(IntEnum):
    """What START_STOP_SYNCH does."""

    STOP_ALL = 0
    START_SELECTED = 1
    STOP_SELECTED = 2


@dataclass
class DaqList:
    """One list as it is configured."""

    tables: list[list[tuple[int, int] | None]] = field(default_factory=list)
    """Address and size of each entry."""
    event: Event = Event.STEP
    prescaler: int = 1
    is_selected: bool = False
    is_running: bool = False
    events: int = 0
    """Since it was started."""

    @property
    def mode(self) -> int:
        """As GET_DAQ_LIST_MODE reports it."""
        selected = MODE_SELECTED if self.is_selected else 0
        return MODE_STAMPED | selected | (MODE_RUNNING if self.is_running else 0)

    def start(self) -> None:
        """From its next event on."""
        self.is_running, self.is_selected, self.events = True, False, 0

    def stop(self) -> None:
        """Sends nothing more."""
        self.is_running = self.is_selected = False


class DaqLists:
    """All lists of a master, and the entry that it writes next."""

    def __init__(self, packet_bytes: int) -> None:
        self._packet_bytes = packet_bytes
        self._most_tables = PACKETS_A_STEP[packet_bytes] - SPARE_PACKETS
        self.lists: list[DaqList] = []
        self._place: tuple[int, int, int] | None = None

    @property
    def is_running(self) -> bool:
        """Whether any list is."""
        return any(each.is_running for each in self.lists)

    def of(self, number: int) -> DaqList:
        """A list that there is. RefusedError for another."""
        if number >= len(self.lists):
            raise RefusedError(XcpError.OUT_OF_RANGE)
        return self.lists[number]

    def free(self) -> None:
        """Stops and forgets all."""
        self.lists, self._place = [], None

    def allocate(self, count: int) -> None:
        """Empty lists, after all were freed."""
        if self.lists:
            raise RefusedError(XcpError.SEQUENCE)
        if count > MOST_LISTS:
            raise RefusedError(XcpError.MEMORY_OVERFLOW)
        self.lists = [DaqList() for _ in range(count)]

    def allocate_tables(self, number: int, count: int) -> None:
        """Tables for a list that has none."""
        one = self.of(number)
        if one.tables:
            raise RefusedError(XcpError.SEQUENCE)
        if count + sum(len(each.tables) for each in self.lists) > self._most_tables:
            raise RefusedError(XcpError.MEMORY_OVERFLOW)
        one.tables = [[] for _ in range(count)]

    def allocate_entries(self, number: int, table: int, count: int) -> None:
        """Entries for a table that has none."""
        one = self.of(number)
        if table >= len(one.tables):
            raise RefusedError(XcpError.OUT_OF_RANGE)
        if one.tables[table]:
            raise RefusedError(XcpError.SEQUENCE)
        if count > MOST_ENTRIES:
            raise RefusedError(XcpError.MEMORY_OVERFLOW)
        one.tables[table] = [None] * count

    def point(self, number: int, table: int, entry: int) -> None:
        """Where the next entry is written. RefusedError where there is none, or the list runs."""
        one = self.of(number)
        if table >= len(one.tables) or entry >= len(one.tables[table]):
            raise RefusedError(XcpError.OUT_OF_RANGE)
        if one.is_running:
            raise RefusedError(XcpError.DAQ_ACTIVE)
        self._place = number, table, entry

    def write(self, address: int, size: int) -> None:
        """An entry, whose bytes are to be had; the next one follows."""
        if self._place is None:
            raise RefusedError(XcpError.SEQUENCE)
        number, table, entry = self._place
        one = self.lists[number]
        entries = one.tables[table]
        if entry >= len(entries) or one.is_running:
            raise RefusedError(XcpError.DAQ_CONFIG)
        others = sum(each[1] for i, each in enumerate(entries) if each is not None and i != entry)
        room = self._packet_bytes - 1 - (STAMP_BYTES if table == 0 else 0)
        if not 1 <= size <= room - others:
            raise RefusedError(XcpError.OUT_OF_RANGE)
        entries[entry] = address, size
        self._place = number, table, entry + 1

    def clear(self, number: int) -> None:
        """Stops a list and forgets what stands in its entries."""
        one = self.of(number)
        one.stop()
        one.tables = [[None] * len(entries) for entries in one.tables]

    def set_mode(self, number: int, event: int, prescaler: int) -> None:
        """When a list is sent: at every `prescaler`th of the events."""
        one = self.of(number)
        if one.is_running:
            raise RefusedError(XcpError.DAQ_ACTIVE)
        if event not in tuple(Event) or prescaler == 0:
            raise RefusedError(XcpError.OUT_OF_RANGE)
        one.event, one.prescaler = Event(event), prescaler

    def command(self, number: int, action: int) -> int:
        """START_STOP_DAQ_LIST; the packet identifier of the list's first table."""
        one = self.of(number)
        if action not in tuple(ListAction):
            raise RefusedError(XcpError.MODE_NOT_VALID)
        if action == ListAction.STOP:
            one.stop()
        elif not one.tables or any(None in entries for entries in one.tables):
            raise RefusedError(XcpError.DAQ_CONFIG)
        elif action == ListAction.START:
            one.start()
        else:
            one.is_selected = True
        return self._first_packet(number)

    def command_selected(self, action: int) -> None:
        """START_STOP_SYNCH."""
        if action not in tuple(SynchAction):
            raise RefusedError(XcpError.MODE_NOT_VALID)
        for one in self.lists:
            if action == SynchAction.STOP_ALL or (
                action == SynchAction.STOP_SELECTED and one.is_selected
            ):
                one.stop()
            elif action == SynchAction.START_SELECTED and one.is_selected:
                one.start()

    def packets(
        self, event: Event, stamp: bytes, read: Callable[[int, int], bytes]
    ) -> Iterator[bytes]:
        """What running lists send at an event."""
        for number, one in enumerate(self.lists):
            if not one.is_running or one.event is not event:
                continue
            one.events += 1
            if one.events % one.prescaler:
                continue
            first = self._first_packet(number)
            for table, entries in enumerate(one.tables):
                content = b"".join(read(*entry) for entry in entries if entry is not None)
                yield bytes([first + table]) + (stamp if table == 0 else b"") + content

    def _first_packet(self, number: int) -> int:
        return sum(len(each.tables) for each in self.lists[:number])
