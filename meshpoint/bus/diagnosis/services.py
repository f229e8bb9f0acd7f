"""ISO 14229 (UDS): the few services a garage needs of this controller, read and clear only.

No library on the package index offers the server's side; `udsoncan` is the tester in the tests.
Nothing here moves a valve: there is no routine, no output control, no write.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from meshpoint.bus.diagnosis.trouble_codes import TroubleMemory

SESSION, CLEAR, READ_CODES, READ_DATA, PRESENT = 0x10, 0x14, 0x19, 0x22, 0x3E
POSITIVE, NEGATIVE = 0x40, 0x7F
NOT_SUPPORTED, NO_SUCH_FUNCTION, WRONG_LENGTH, OUT_OF_RANGE = 0x11, 0x12, 0x13, 0x31
DEFAULT, EXTENDED = 1, 3
NUMBER_BY_MASK, BY_MASK, SUPPORTED = 0x01, 0x02, 0x0A
J1939_FORMAT: Final = 0x02
"""Codes are three bytes as in J1939-73: SPN and FMI."""
TEST_FAILED, CONFIRMED = 0x01, 0x08
AVAILABLE: Final = TEST_FAILED | CONFIRMED
ALL_GROUPS: Final = 0xFFFFFF
TIMES: Final = bytes([0x00, 0x32, 0x01, 0xF4])
"""P2 of 50 ms, P2* of 5 s."""
SILENT: Final = 0x80
"""Of a sub-function: no positive answer is wanted."""

DataIdentifiers = Mapping[int, Callable[[], bytes]]


class Services:
    """Answers requests. data: what each data identifier reads."""

    def __init__(self, memory: TroubleMemory, data: DataIdentifiers) -> None:
        self._memory = memory
        self._data = data
        self._services = {
            SESSION: self._session,
            CLEAR: self._clear,
            READ_CODES: self._read_codes,
            READ_DATA: self._read_data,
            PRESENT: self._present,
        }

    def answer(self, request: bytes) -> bytes | None:
        """The answer to a request; None where none is wanted."""
        service = self._services.get(request[0])
        if service is None:
            return _refused(request[0], NOT_SUPPORTED)
        found = service(request)
        if isinstance(found, int):
            return _refused(request[0], found)
        if request[0] in (SESSION, PRESENT) and len(request) > 1 and request[1] & SILENT:
            return None
        return bytes([request[0] + POSITIVE]) + found

    def _session(self, request: bytes) -> bytes | int:
        if len(request) != 2:
            return WRONG_LENGTH
        session = request[1] & ~SILENT
        if session not in (DEFAULT, EXTENDED):
            return NO_SUCH_FUNCTION
        return bytes([session]) + TIMES

    def _present(self, request: bytes) -> bytes | int:
        if len(request) != 2:
            return WRONG_LENGTH
        return b"\x00" if request[1] & ~SILENT == 0 else NO_SUCH_FUNCTION

    def _clear(self, request: bytes) -> bytes | int:
        if len(request) != 4:
            return WRONG_LENGTH
        if int.from_bytes(request[1:], "big") != ALL_GROUPS:
            return OUT_OF_RANGE
        self._memory.clear(active_too=True)
        return b""

    def _read_codes(self, request: bytes) -> bytes | int:
        if len(request) < 2:
            return WRONG_LENGTH
        kind = request[1]
        if kind == SUPPORTED and len(request) == 2:
            return bytes([kind, AVAILABLE]) + self._listed(AVAILABLE)
        if kind not in (NUMBER_BY_MASK, BY_MASK):
            return NO_SUCH_FUNCTION
        if len(request) != 3:
            return WRONG_LENGTH
        listed = self._listed(request[2])
        if kind == BY_MASK:
            return bytes([kind, AVAILABLE]) + listed
        return bytes([kind, AVAILABLE, J1939_FORMAT]) + (len(listed) // 4).to_bytes(2, "big")

    def _listed(self, mask: int) -> bytes:
        listed = b""
        for code in self._memory.codes:
            status = CONFIRMED | (TEST_FAILED if code.is_active else 0)
            if status & mask:
                listed += code.packed + bytes([status])
        return listed

    def _read_data(self, request: bytes) -> bytes | int:
        if len(request) < 3 or len(request) % 2 == 0:
            return WRONG_LENGTH
        found = b""
        for at in range(1, len(request), 2):
            read = self._data.get(int.from_bytes(request[at : at + 2], "big"))
            if read is None:
                return OUT_OF_RANGE
            found += request[at : at + 2] + read()
        return found


def _refused(service: int, why: int) -> bytes:
    return bytes([NEGATIVE, service, why])
