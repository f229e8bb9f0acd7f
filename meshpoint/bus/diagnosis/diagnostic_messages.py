"""J1939-73: DM1 (active codes, once a second), DM2 (stored ones, on request), DM3 and DM11 (clear).

What is longer than a frame goes out by J1939-21's broadcast transport (BAM), a packet every 50 ms.
"""

from __future__ import annotations

from typing import Final

from meshpoint.bus.diagnosis.trouble_codes import TroubleCode, TroubleMemory
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.j1939 import CONTROLLER, GLOBAL, REQUEST, destination_of, group_of

DM1, DM2, DM3, DM11 = 0xFECA, 0xFECB, 0xFECC, 0xFED3
ACKNOWLEDGE, ANNOUNCE, PACKET = 0xE800, 0xEC00, 0xEB00
EVERY_US: Final = 1_000_000
PACKET_US: Final = 50_000
LAMP_OFF, AMBER_ON = 0x00, 0x04
NO_FLASH: Final = 0xFF
BAM: Final = 0x20
GIVEN, REFUSED = 0, 1
PER_PACKET: Final = 7


class DiagnosticMessages:
    """Sends DM1, and answers requests."""

    def __init__(self, memory: TroubleMemory, address: int = CONTROLLER) -> None:
        self._memory = memory
        self._address = address
        self._next_us = 0
        self._at_once: list[Frame] = []
        self._packets: list[Frame] = []
        self._packet_us = 0

    def hear(self, frame: Frame) -> bool:
        """A frame of the bus; whether it asked this node for something of ours."""
        if group_of(frame.can_id) != REQUEST or len(frame.data) < 3:
            return False
        to = destination_of(frame.can_id)
        if to not in (self._address, GLOBAL):
            return False
        wanted = int.from_bytes(frame.data[:3], "little")
        if wanted == DM1:
            self._next_us = 0
        elif wanted == DM2:
            self._say(DM2, self._memory.stored)
        elif wanted in (DM3, DM11):
            self._memory.clear(active_too=wanted == DM11)
            self._acknowledge(GIVEN, wanted, frame.can_id & 0xFF, to)
        elif to == self._address:
            self._acknowledge(REFUSED, wanted, frame.can_id & 0xFF, to)
        return True

    def news(self) -> None:
        """What is active has changed: DM1 need not wait for its second."""
        self._next_us = 0

    @property
    def next_us(self) -> int:
        """When something is due."""
        due = self._next_us if not self._packets else min(self._next_us, self._packet_us)
        return 0 if self._at_once else due

    def take_frames(self, now_us: int) -> list[Frame]:
        """What is due now."""
        if now_us >= self._next_us:
            self._next_us = now_us + EVERY_US
            self._say(DM1, self._memory.active)
        frames, self._at_once = self._at_once, []
        if self._packets and now_us >= self._packet_us:
            self._packet_us = now_us + PACKET_US
            frames.append(self._packets.pop(0))
        return frames

    def _say(self, group: int, codes: list[TroubleCode]) -> None:
        """One of the messages that list codes: lamps, then four bytes a code."""
        lamp = AMBER_ON if self._memory.active else LAMP_OFF
        data = bytes([lamp, NO_FLASH])
        data += b"".join(code.counted for code in codes) or bytes(4)
        if len(data) <= 8:
            self._at_once.append(self._frame(6, group, data.ljust(8, b"\xff")))
            return
        if self._packets:
            return  # the one before is still on its way
        count = -(-len(data) // PER_PACKET)
        announced = bytes([BAM, len(data) & 0xFF, len(data) >> 8, count, 0xFF])
        self._at_once.append(
            self._frame(7, ANNOUNCE | GLOBAL, announced + group.to_bytes(3, "little"))
        )
        for number in range(count):
            part = data[number * PER_PACKET : (number + 1) * PER_PACKET]
            filled = bytes([number + 1]) + part.ljust(PER_PACKET, b"\xff")
            self._packets.append(self._frame(7, PACKET | GLOBAL, filled))

    def _acknowledge(self, control: int, group: int, asker: int, to: int) -> None:
        """A request to all is never refused, but one to clear is acknowledged all the same."""
        data = bytes([control, 0xFF, 0xFF, 0xFF, asker]) + group.to_bytes(3, "little")
        if to != GLOBAL:
            self._at_once.append(self._frame(6, ACKNOWLEDGE | GLOBAL, data))

    def _frame(self, priority: int, group: int, data: bytes) -> Frame:
        return Frame(priority << 26 | group << 8 | self._address, data, is_fd=False)
