"""What an XCP master has changed, from its commands on the bus and the controller's answers."""

from __future__ import annotations

import struct

from meshpoint.dbc.frame import Frame
from meshpoint.dbc.j1939 import XCP_COMMAND_ID, XCP_RESPONSE_ID
from meshpoint.xcp.memory import PAGE_ADDRESS, PAGE_BYTES, PARAMETERS, ROW_BYTES, Page
from meshpoint.xcp.protocol import NEGATIVE, POSITIVE, Command
from meshpoint.xcp.slave import USED_BY_CONTROLLER

MTA_BYTES = 8


class XcpWrites:
    """Follows one master; what is not answered with yes has not happened."""

    def __init__(self) -> None:
        self._asked = b""
        """The command that waits for its answer."""
        self._address = 0
        self._awaited = 0
        """Bytes that a block has in all."""
        self._block = b""

    def take(self, frame: Frame) -> list[str]:
        """The changes that a frame confirms, in words."""
        if frame.can_id == XCP_COMMAND_ID and frame.data:
            self._command(frame.data)
        elif frame.can_id == XCP_RESPONSE_ID and frame.data[:1] == bytes([POSITIVE]):
            asked, self._asked = self._asked, b""
            return self._confirmed(asked)
        elif frame.can_id == XCP_RESPONSE_ID and frame.data[:1] == bytes([NEGATIVE]):
            self._asked = b""
        return []

    def _command(self, packet: bytes) -> None:
        if packet[0] == Command.DOWNLOAD and len(packet) > 1:
            self._awaited, self._block = packet[1], packet[2:]
        elif packet[0] == Command.DOWNLOAD_NEXT:
            self._block += packet[2:]
        self._asked = packet

    def _confirmed(self, asked: bytes) -> list[str]:
        code = asked[0] if asked else None
        if code == Command.SET_MTA and len(asked) >= MTA_BYTES:
            (self._address,) = struct.unpack_from("<I", asked, 4)
        elif code in (Command.DOWNLOAD, Command.DOWNLOAD_NEXT):
            content = self._block[: self._awaited]
            start, self._address = self._address - PAGE_ADDRESS, self._address + len(content)
            return _values(start, content)
        elif code == Command.COPY_CAL_PAGE:
            return ["copies the reference page to the working page"]
        elif code == Command.SET_CAL_PAGE and len(asked) > 3 and asked[3] in tuple(Page):
            if not asked[1] & USED_BY_CONTROLLER:
                return []
            return [f"has the controller use the {Page(asked[3]).name.lower()} page"]
        return []


def _values(start: int, content: bytes) -> list[str]:
    if start % ROW_BYTES or len(content) % ROW_BYTES or not 0 <= start <= PAGE_BYTES - len(content):
        return []
    rows = PARAMETERS[start // ROW_BYTES : (start + len(content)) // ROW_BYTES]
    places = [content[i : i + ROW_BYTES] for i in range(0, len(content), ROW_BYTES)]
    pairs = zip(rows, places, strict=True)
    return [f"sets {row.name} = {row.unpacked(place):g}" for row, place in pairs]
