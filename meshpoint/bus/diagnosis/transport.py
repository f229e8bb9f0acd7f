"""ISO 15765-2 (ISO-TP) over classic frames with 29-bit identifiers, normal fixed addressing.

One conversation at a time with each tester: a single frame, or a first frame, the other side's
flow control, and consecutive frames. `can-isotp` is the peer in the tests; it needs a bus, a clock
and threads of its own, which a node without input and output cannot have.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from meshpoint.dbc.frame import Frame

SINGLE, FIRST, CONSECUTIVE, FLOW = 0, 1, 2, 3
MOST_BYTES: Final = 4095
IN_SINGLE, IN_FIRST, IN_CONSECUTIVE = 7, 6, 7
PADDING: Final = b"\xcc"
TIMEOUT_US: Final = 1_000_000
"""N_Bs and N_Cr of the standard."""
CLEAR, WAIT = 0, 1


@dataclass
class _Sending:
    rest: bytes
    sequence: int = 1
    may_send: int = 0
    """Frames until the next flow control; -1: as many as there are."""
    gap_us: int = 0
    next_us: int = 0
    until_us: int = 0
    waits: bool = True


class IsoTp:
    """One side of one conversation. `take_frames` gives what is due, `hear` a whole message."""

    def __init__(self, can_id: int) -> None:
        """can_id: of the frames that it sends."""
        self._can_id = can_id
        self._out: list[Frame] = []
        self._sending: _Sending | None = None
        self._got = b""
        self._wanted = 0
        self._sequence = 0
        self._got_us = 0

    def send(self, data: bytes, now_us: int) -> None:
        """Begins to send a message of 1 to 4095 bytes; one under way is given up."""
        if not 1 <= len(data) <= MOST_BYTES:
            raise ValueError(f"{len(data)} bytes, allowed are 1 to {MOST_BYTES}")
        if len(data) <= IN_SINGLE:
            self._sending = None
            self._put(bytes([len(data)]) + data)
            return
        self._put(bytes([FIRST << 4 | len(data) >> 8, len(data) & 0xFF]) + data[:IN_FIRST])
        self._sending = _Sending(data[IN_FIRST:], until_us=now_us + TIMEOUT_US)

    def hear(self, data: bytes, now_us: int) -> bytes | None:
        """The payload of a frame; the message that is complete with it."""
        if not data:
            return None
        kind = data[0] >> 4
        if kind == SINGLE and 1 <= (length := data[0] & 0x0F) <= len(data) - 1:
            self._wanted = 0
            return data[1 : 1 + length]
        if kind == FIRST and len(data) == 8:
            self._wanted, self._got = (data[0] & 0x0F) << 8 | data[1], data[2:]
            self._sequence, self._got_us = 1, now_us
            self._put(bytes([FLOW << 4 | CLEAR, 0, 0]))
        elif kind == CONSECUTIVE and self._wanted:
            return self._consecutive(data, now_us)
        elif kind == FLOW and self._sending is not None and len(data) >= 3:
            self._flow(data, now_us, self._sending)
        return None

    def _consecutive(self, data: bytes, now_us: int) -> bytes | None:
        if data[0] & 0x0F != self._sequence or now_us - self._got_us > TIMEOUT_US:
            self._wanted = 0  # a frame is missing: the tester asks again
            return None
        self._sequence = (self._sequence + 1) % 16
        self._got_us = now_us
        self._got += data[1:]
        if len(self._got) < self._wanted:
            return None
        whole, self._wanted = self._got[: self._wanted], 0
        return whole

    def _flow(self, data: bytes, now_us: int, sending: _Sending) -> None:
        status = data[0] & 0x0F
        sending.until_us = now_us + TIMEOUT_US
        if status == WAIT:
            return
        if status != CLEAR:
            self._sending = None  # overflow: the tester cannot take it
            return
        sending.waits = False
        sending.may_send = data[1] or -1
        gap = data[2]
        sending.gap_us = gap * 1000 if gap <= 0x7F else (gap - 0xF0) * 100
        sending.next_us = now_us

    @property
    def next_us(self) -> int | None:
        """When something is due; None: nothing is."""
        if self._out:
            return 0
        if self._sending is None or self._sending.waits:
            return None
        return self._sending.next_us

    def take_frames(self, now_us: int) -> list[Frame]:
        """What is due now."""
        frames, self._out = self._out, []
        sending = self._sending
        if sending is None:
            return frames
        if sending.waits:
            if now_us > sending.until_us:
                self._sending = None
            return frames
        while sending.rest and now_us >= sending.next_us and sending.may_send:
            part, sending.rest = sending.rest[:IN_CONSECUTIVE], sending.rest[IN_CONSECUTIVE:]
            frames.append(self._frame(bytes([CONSECUTIVE << 4 | sending.sequence]) + part))
            sending.sequence = (sending.sequence + 1) % 16
            sending.may_send -= sending.may_send > 0
            sending.next_us += sending.gap_us
        if not sending.rest:
            self._sending = None
        elif not sending.may_send:
            sending.waits, sending.until_us = True, now_us + TIMEOUT_US
        return frames

    def _put(self, data: bytes) -> None:
        self._out.append(self._frame(data))

    def _frame(self, data: bytes) -> Frame:
        return Frame(self._can_id, data.ljust(8, PADDING), is_fd=False)
