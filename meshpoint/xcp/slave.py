"""An XCP slave on CAN: command packets in, response packets out (ASAM MCD-1 XCP 1.1).

It answers nothing before CONNECT. The frame that CONNECT comes in decides whether packets have up
to 8 bytes or, on CAN FD, 64.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from enum import IntEnum
from typing import Final

from meshpoint.xcp.memory import (
    IDENTITY_ADDRESS,
    PAGE_ADDRESS,
    PAGE_BYTES,
    CalibrationPages,
    Memory,
    Page,
)
from meshpoint.xcp.protocol import (
    CLASSIC_BYTES,
    FD_BYTES,
    MODE_STAMPED,
    NEGATIVE,
    PACKETS_A_STEP,
    POSITIVE,
    PROPERTIES,
    STAMP_MODE,
    VERSION,
    WHOLE_BYTES,
    Command,
    DaqLists,
    Event,
    RefusedError,
    XcpError,
)

CAL_PAG, DAQ = 0x01, 0x04
"""Resources, in CONNECT's answer."""
BLOCKS_OPTIONAL: Final = 0xC0
"""Slave block mode, and GET_COMM_MODE_INFO is there; Intel byte order, addresses of bytes."""
MASTER_BLOCKS: Final = 0x01
MOST_OF_A_BLOCK: Final = 24
"""Packets of a DOWNLOAD and its DOWNLOAD_NEXT."""
CRC_32: Final = 0x09
DAQ_RUNNING: Final = 0x40
EVENT_OF_DAQ: Final = 0x04
UNIT_1_MS: Final = 6
READ_IN_ALL_PAGES, WRITE_IN_PAGE = 0x0F, 0x30
"""Page properties: the controller and a master may read whether or not the other has it; likewise
a master may write."""
USED_BY_CONTROLLER, SEEN_BY_MASTER, ALL_SEGMENTS = 0x01, 0x02, 0x80
"""Bits of SET_CAL_PAGE."""
EVENT_NAMES: Final = {Event.STEP: b"step", Event.SHIFT_END: b"end of shift"}


class IdType(IntEnum):
    """What GET_ID may be asked for and is there."""

    TEXT = 0
    A2L_NAME = 1


Handler = Callable[[bytes], bytes | None]
"""The packet to the answer's bytes behind its first; None: no answer yet."""


class XcpSlave:
    """One session at a time."""

    def __init__(self, memory: Memory, pages: CalibrationPages, tick_ms: int) -> None:
        self._memory, self._pages, self._tick_ms = memory, pages, tick_ms
        self.packet_bytes = CLASSIC_BYTES
        self._is_connected = False
        self._now_us = 0
        self._mta = 0
        self._event_name: tuple[int, bytes] | None = None
        """Where the name of an event is to be had, and the name, after GET_DAQ_EVENT_INFO."""
        self._block: tuple[int, bytes] | None = None
        """Bytes of a block that are still to come, and those that have."""
        self._daq = DaqLists(CLASSIC_BYTES)
        self._more: list[bytes] = []
        """Packets behind the first of an answer."""
        self._handlers: dict[int, tuple[int, Handler]] = {
            Command.DISCONNECT: (1, self._disconnect),
            Command.GET_STATUS: (1, self._get_status),
            Command.SYNCH: (1, self._synch),
            Command.GET_COMM_MODE_INFO: (1, self._get_comm_mode_info),
            Command.GET_ID: (2, self._get_id),
            Command.SET_MTA: (8, self._set_mta),
            Command.UPLOAD: (2, self._upload),
            Command.SHORT_UPLOAD: (8, self._short_upload),
            Command.BUILD_CHECKSUM: (8, self._build_checksum),
            Command.DOWNLOAD: (2, self._download),
            Command.DOWNLOAD_NEXT: (2, self._download_next),
            Command.SET_CAL_PAGE: (4, self._set_cal_page),
            Command.GET_CAL_PAGE: (3, self._get_cal_page),
            Command.GET_PAG_PROCESSOR_INFO: (1, lambda _: bytes([1, 0])),
            Command.GET_SEGMENT_INFO: (5, self._get_segment_info),
            Command.GET_PAGE_INFO: (4, self._get_page_info),
            Command.COPY_CAL_PAGE: (5, self._copy_cal_page),
            Command.CLEAR_DAQ_LIST: (4, self._clear_daq_list),
            Command.SET_DAQ_PTR: (6, self._set_daq_ptr),
            Command.WRITE_DAQ: (8, self._write_daq),
            Command.SET_DAQ_LIST_MODE: (8, self._set_daq_list_mode),
            Command.GET_DAQ_LIST_MODE: (4, self._get_daq_list_mode),
            Command.START_STOP_DAQ_LIST: (4, self._start_stop_daq_list),
            Command.START_STOP_SYNCH: (2, self._start_stop_synch),
            Command.GET_DAQ_CLOCK: (1, lambda _: struct.pack("<xxxI", self._stamp)),
            Command.GET_DAQ_PROCESSOR_INFO: (1, self._get_daq_processor_info),
            Command.GET_DAQ_RESOLUTION_INFO: (1, self._get_daq_resolution_info),
            Command.GET_DAQ_EVENT_INFO: (4, self._get_daq_event_info),
            Command.FREE_DAQ: (1, self._free_daq),
            Command.ALLOC_DAQ: (4, self._alloc_daq),
            Command.ALLOC_ODT: (5, self._alloc_odt),
            Command.ALLOC_ODT_ENTRY: (6, self._alloc_odt_entry),
        }
        """Least bytes of each command, and what answers it."""

    @property
    def _stamp(self) -> int:
        return self._now_us & 0xFFFF_FFFF

    @property
    def is_fd(self) -> bool:
        """Whether packets go in CAN FD frames."""
        return self.packet_bytes > CLASSIC_BYTES

    @property
    def packets_a_step(self) -> int:
        """Sent in a step, at most."""
        return PACKETS_A_STEP[self.packet_bytes]

    def answer(self, packet: bytes, is_fd: bool, now_us: int) -> list[bytes]:
        """The packets that a command is answered with at sensor time `now_us`; none before
        CONNECT."""
        self._now_us = now_us
        if not packet:
            return []
        if packet[0] == Command.CONNECT:
            return self._connect(packet, is_fd)
        if not self._is_connected or is_fd is not self.is_fd:
            return []  # of nobody, or of another master than the one that has connected
        self._more = []
        if packet[0] not in (Command.DOWNLOAD, Command.DOWNLOAD_NEXT):
            self._block = None
        least, handle = self._handlers.get(packet[0], (0, _unknown))
        try:
            content = handle(packet) if len(packet) >= least else _too_short(packet)
        except RefusedError as refused:
            return [bytes([NEGATIVE, refused.code]) + refused.more]
        return [] if content is None else [bytes([POSITIVE]) + content, *self._more]

    def sampled(self, event: Event, now_us: int) -> list[bytes]:
        """The packets of DAQ lists that run, at an event."""
        if not self._daq.is_running:
            return []
        stamp = struct.pack("<I", now_us & 0xFFFF_FFFF)
        return list(self._daq.packets(event, stamp, self._memory.read))

    # -- session

    def _connect(self, packet: bytes, is_fd: bool) -> list[bytes]:
        if packet[1:2] not in (b"", b"\0"):
            return []  # user-defined modes are other slaves' business
        self._is_connected = True
        self.packet_bytes = FD_BYTES if is_fd else CLASSIC_BYTES
        self._daq, self._block, self._mta = DaqLists(self.packet_bytes), None, 0
        resources = DAQ | (CAL_PAG if self._memory.is_writable else 0)
        return [
            struct.pack(
                "<BBBBHBB", POSITIVE, resources, BLOCKS_OPTIONAL, self.packet_bytes,
                self.packet_bytes, VERSION, VERSION,
            )
        ]  # fmt: skip

    def _disconnect(self, _: bytes) -> bytes:
        self._is_connected = False
        self._daq.free()
        return b""

    def _get_status(self, _: bytes) -> bytes:
        return bytes([DAQ_RUNNING if self._daq.is_running else 0, 0, 0, 0, 0])

    def _synch(self, _: bytes) -> bytes:
        raise RefusedError(XcpError.CMD_SYNCH)  # its one answer, by the standard

    def _get_comm_mode_info(self, _: bytes) -> bytes:
        return bytes([0, MASTER_BLOCKS, 0, MOST_OF_A_BLOCK, 0, 0, 0x11])

    def _get_id(self, packet: bytes) -> bytes:
        if packet[1] not in tuple(IdType):
            return struct.pack("<BHI", 0, 0, 0)
        self._mta, self._event_name = IDENTITY_ADDRESS, None
        return struct.pack("<BHI", 0, 0, len(self._memory.name))

    # -- memory

    def _set_mta(self, packet: bytes) -> bytes:
        self._mta, self._event_name = _address(packet), None
        return b""

    def _upload(self, packet: bytes) -> bytes:
        length = packet[1]
        if length == 0:
            raise RefusedError(XcpError.OUT_OF_RANGE)
        content = self._read(length)
        self._mta += length
        room = self.packet_bytes - 1
        self._more = [bytes([POSITIVE]) + content[i : i + room] for i in range(room, length, room)]
        return content[:room]

    def _short_upload(self, packet: bytes) -> bytes:
        length = packet[1]
        if not 1 <= length < self.packet_bytes:
            raise RefusedError(XcpError.OUT_OF_RANGE)
        self._set_mta(packet)
        content = self._read(length)
        self._mta += length
        return content

    def _read(self, length: int) -> bytes:
        if self._event_name is not None:
            start, name = self._event_name
            return name[self._mta - start : self._mta - start + length].ljust(length, b"\0")
        return self._memory.read(self._mta, length)

    def _build_checksum(self, packet: bytes) -> bytes:
        (size,) = struct.unpack_from("<I", packet, 4)
        if not 1 <= size <= PAGE_BYTES:
            raise RefusedError(XcpError.OUT_OF_RANGE, 0, 0, *struct.pack("<I", PAGE_BYTES))
        content = self._read(size)
        self._mta += size
        return struct.pack("<BxxI", CRC_32, zlib.crc32(content))

    def _download(self, packet: bytes) -> bytes | None:
        self._memory.check_writable()
        if self._block is not None:  # half of a block would be left out
            self._block = None
            raise RefusedError(XcpError.SEQUENCE)
        return self._take_block(packet[1], b"", packet[2:])

    def _download_next(self, packet: bytes) -> bytes | None:
        if self._block is None:
            raise RefusedError(XcpError.SEQUENCE, 0)
        awaited, content = self._block
        if packet[1] != awaited:
            self._block = None
            raise RefusedError(XcpError.SEQUENCE, awaited)
        return self._take_block(awaited, content, packet[2:])

    def _take_block(self, awaited: int, before: bytes, content: bytes) -> bytes | None:
        """Bytes of a block; they are written together, when the last of them is there."""
        if awaited == 0 or (len(content) < awaited and len(content) < self.packet_bytes - 2):
            self._block = None
            raise RefusedError(XcpError.CMD_SYNTAX if awaited else XcpError.OUT_OF_RANGE)
        content = content[:awaited]
        if len(content) < awaited:
            self._block = awaited - len(content), before + content
            return None
        self._block = None
        whole = before + content
        self._memory.write(self._mta, whole)
        self._mta += len(whole)
        return b""

    # -- pages

    def _set_cal_page(self, packet: bytes) -> bytes:
        mode, segment, page = packet[1:4]
        _check_segment(0 if mode & ALL_SEGMENTS else segment, page)
        if not mode & (USED_BY_CONTROLLER | SEEN_BY_MASTER):
            raise RefusedError(XcpError.MODE_NOT_VALID)
        if mode & USED_BY_CONTROLLER:
            self._memory.check_writable()
            self._pages.used = Page(page)
        if mode & SEEN_BY_MASTER:
            self._pages.seen = Page(page)
        return b""

    def _get_cal_page(self, packet: bytes) -> bytes:
        mode, segment = packet[1:3]
        _check_segment(segment, 0)
        if mode not in (USED_BY_CONTROLLER, SEEN_BY_MASTER):
            raise RefusedError(XcpError.MODE_NOT_VALID)
        page = self._pages.used if mode == USED_BY_CONTROLLER else self._pages.seen
        return bytes([0, 0, page])

    def _get_segment_info(self, packet: bytes) -> bytes:
        mode, segment, wanted = packet[1:4]
        _check_segment(segment, 0)
        if mode == 0 and wanted in (0, 1):
            return struct.pack("<xxxI", PAGE_BYTES if wanted else PAGE_ADDRESS)
        if mode == 1:
            return bytes([len(Page), 0, 0, 0, 0])
        raise RefusedError(XcpError.OUT_OF_RANGE)

    def _get_page_info(self, packet: bytes) -> bytes:
        segment, page = packet[2:4]
        _check_segment(segment, page)
        is_writable = page == Page.WORKING and self._memory.is_writable
        return bytes([READ_IN_ALL_PAGES | (WRITE_IN_PAGE if is_writable else 0), 0])

    def _copy_cal_page(self, packet: bytes) -> bytes:
        from_segment, from_page, to_segment, to_page = packet[1:5]
        _check_segment(from_segment, from_page)
        _check_segment(to_segment, to_page)
        self._memory.check_writable()
        if to_page == Page.REFERENCE:
            raise RefusedError(XcpError.WRITE_PROTECTED)
        if from_page == Page.REFERENCE:
            self._pages.copy_to_working()
        return b""

    # -- DAQ

    def _clear_daq_list(self, packet: bytes) -> bytes:
        self._daq.clear(_list_number(packet))
        return b""

    def _set_daq_ptr(self, packet: bytes) -> bytes:
        self._daq.point(_list_number(packet), packet[4], packet[5])
        return b""

    def _write_daq(self, packet: bytes) -> bytes:
        bit, size, extension = packet[1:4]
        address = _address(packet)
        if bit != WHOLE_BYTES or extension:
            raise RefusedError(XcpError.OUT_OF_RANGE)
        self._memory.read(address, size)
        self._daq.write(address, size)
        return b""

    def _set_daq_list_mode(self, packet: bytes) -> bytes:
        if packet[1] & ~MODE_STAMPED:
            raise RefusedError(XcpError.MODE_NOT_VALID)
        (event,) = struct.unpack_from("<H", packet, 4)
        self._daq.set_mode(_list_number(packet), event, packet[6])
        return b""

    def _get_daq_list_mode(self, packet: bytes) -> bytes:
        one = self._daq.of(_list_number(packet))
        return struct.pack("<BxxHBB", one.mode, one.event, one.prescaler, 0)

    def _start_stop_daq_list(self, packet: bytes) -> bytes:
        return bytes([self._daq.command(_list_number(packet), packet[1])])

    def _start_stop_synch(self, packet: bytes) -> bytes:
        self._daq.command_selected(packet[1])
        return b""

    def _get_daq_processor_info(self, _: bytes) -> bytes:
        return struct.pack("<BHHBB", PROPERTIES, len(self._daq.lists), len(Event), 0, 0)

    def _get_daq_resolution_info(self, _: bytes) -> bytes:
        return struct.pack("<BBBBBH", 1, self.packet_bytes - 1, 1, 0, STAMP_MODE, 1)

    def _get_daq_event_info(self, packet: bytes) -> bytes:
        number = _list_number(packet)
        if number not in tuple(Event):
            raise RefusedError(XcpError.OUT_OF_RANGE)
        event = Event(number)
        name = EVENT_NAMES[event]
        self._mta, self._event_name = 0, (0, name)
        cycle = self._tick_ms if event is Event.STEP else 0
        return bytes([EVENT_OF_DAQ, WHOLE_BYTES, len(name), cycle, UNIT_1_MS, 0])

    def _free_daq(self, _: bytes) -> bytes:
        self._daq.free()
        return b""

    def _alloc_daq(self, packet: bytes) -> bytes:
        self._daq.allocate(_list_number(packet))
        return b""

    def _alloc_odt(self, packet: bytes) -> bytes:
        self._daq.allocate_tables(_list_number(packet), packet[4])
        return b""

    def _alloc_odt_entry(self, packet: bytes) -> bytes:
        self._daq.allocate_entries(_list_number(packet), packet[4], packet[5])
        return b""


def _unknown(_: bytes) -> bytes:
    raise RefusedError(XcpError.CMD_UNKNOWN)


def _too_short(_: bytes) -> bytes:
    raise RefusedError(XcpError.CMD_SYNTAX)


def _list_number(packet: bytes) -> int:
    """Bytes 2 and 3 of most DAQ commands: a list, an event, a count."""
    number: int
    (number,) = struct.unpack_from("<H", packet, 2)
    return number


def _address(packet: bytes) -> int:
    """Bytes 3 to 7: an address and its extension, of which there is none but 0."""
    extension, address = struct.unpack_from("<BI", packet, 3)
    if extension:
        raise RefusedError(XcpError.OUT_OF_RANGE)
    return int(address)


def _check_segment(segment: int, page: int) -> None:
    if segment:
        raise RefusedError(XcpError.SEGMENT_NOT_VALID)
    if page not in tuple(Page):
        raise RefusedError(XcpError.PAGE_NOT_VALID)
