"""How many frames the kernel has thrown away because a node did not read its socket in time.

Linux reports with each message that it delivers how many it could not (SO_RXQ_OVFL), where that is
asked for. python-can does not ask, and would not take the answer: so its socket is put into one
that asks and keeps the answer.
"""

from __future__ import annotations

import socket
import struct
from typing import Any, Final

import can

SO_RXQ_OVFL: Final = 40
"""From Linux's `asm-generic/socket.h`; Python's socket module has no name for it."""
_COUNT: Final = struct.Struct("=I")
MODULUS: Final = 1 << 32


class CountingSocket:
    """A socket like the one it holds, but for what `recvmsg` says of lost messages."""

    def __init__(self, inner: socket.socket) -> None:
        """Raises OSError where the system cannot tell."""
        inner.setsockopt(socket.SOL_SOCKET, SO_RXQ_OVFL, 1)
        self._inner = inner
        self._room = socket.CMSG_SPACE(_COUNT.size)
        self._reported = 0
        self.lost = 0
        """Messages lost so far."""

    def recvmsg(self, size: int, ancillary_bytes: int = 0, flags: int = 0) -> Any:
        """As socket.recvmsg, the count of lost messages taken out."""
        data, ancillary, reported, address = self._inner.recvmsg(
            size, ancillary_bytes + self._room, flags
        )
        rest = []
        for level, kind, content in ancillary:
            if (level, kind) == (socket.SOL_SOCKET, SO_RXQ_OVFL):
                (count,) = _COUNT.unpack_from(content)
                self.lost += (count - self._reported) % MODULUS
                self._reported = count
            else:
                rest.append((level, kind, content))
        return data, rest, reported, address

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)


def count_lost_frames(bus: can.BusABC) -> None:
    """From here on, what the kernel throws away of this SocketCAN bus is counted."""
    inner = getattr(bus, "socket", None)
    if isinstance(inner, socket.socket) and hasattr(inner, "recvmsg"):
        bus.socket = CountingSocket(inner)  # type: ignore[attr-defined]


def lost_frames(bus: can.BusABC) -> int:
    """Frames that the kernel has thrown away since the bus was opened; 0 where nothing counts
    them."""
    counting = getattr(bus, "socket", None)
    return counting.lost if isinstance(counting, CountingSocket) else 0
