"""The addresses of an XCP master: identity, measured values, calibration pages."""

from __future__ import annotations

import hashlib
from typing import Final

from meshpoint.controller.settings.xcp_access import XcpAccess
from meshpoint.controller.xcp.measured import LEARNED, MEASURED_BYTES, MeasuredMemory
from meshpoint.controller.xcp.parameters import PAGE_BYTES, PARAMETERS, CalibrationPages
from meshpoint.controller.xcp.protocol import RefusedError, XcpError
from meshpoint.dbc.source import DBC_SHA256

IDENTITY_ADDRESS: Final = 0x1000_0000
MEASURED_ADDRESS: Final = 0x2000_0000
PAGE_ADDRESS: Final = 0x3000_0000


def identity(version: str) -> str:
    """Name of the A2L that fits this build: a checksum over all that the A2L is made from (ASAM's
    EPK)."""
    made_from = (version, DBC_SHA256, repr(PARAMETERS), repr(LEARNED))
    return f"meshpoint_{hashlib.sha256(''.join(made_from).encode()).hexdigest()[:16]}"


class Memory:
    """What lies at which address."""

    def __init__(self, version: str, pages: CalibrationPages, access: XcpAccess) -> None:
        self.name = identity(version).encode()
        self.measured = MeasuredMemory()
        self._pages = pages
        self.is_writable = access is XcpAccess.WRITE

    def read(self, address: int, length: int) -> bytes:
        """RefusedError where not all of it lies in one region."""
        for start, size, read in (
            (IDENTITY_ADDRESS, len(self.name), self._identity),
            (MEASURED_ADDRESS, MEASURED_BYTES, self.measured.read),
            (PAGE_ADDRESS, PAGE_BYTES, self._pages.read),
        ):
            if start <= address and address + length <= start + size:
                return read(address - start, length)
        raise RefusedError(XcpError.ACCESS_DENIED)

    def write(self, address: int, content: bytes) -> None:
        """RefusedError: not of a page, not allowed, or a value that is."""
        start = address - PAGE_ADDRESS
        if not 0 <= start <= PAGE_BYTES - len(content):
            raise RefusedError(XcpError.ACCESS_DENIED)
        self.check_writable()
        self._pages.write(start, content)

    def check_writable(self) -> None:
        """RefusedError unless the node was started with `--xcp write`."""
        if not self.is_writable:
            raise RefusedError(XcpError.WRITE_PROTECTED)

    def _identity(self, start: int, length: int) -> bytes:
        return self.name[start : start + length]
