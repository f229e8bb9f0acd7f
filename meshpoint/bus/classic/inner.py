"""Frames of meshpoint.dbc made from what was heard on a classic bus."""

from __future__ import annotations

from typing import Any, Final

from meshpoint.dbc.e2e import COUNTER_MODULUS, write_crc
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS

COUNTER_BYTE: Final = 2


class InnerChannel:
    """One protected message of meshpoint.dbc as a core is to hear it; keeps its counter."""

    def __init__(self, name: str) -> None:
        spec = CODECS[name].spec
        self._encode = CODECS[name].encode
        self._can_id, self._data_id, self._length = spec.can_id, spec.protected_id, spec.length
        self._is_fd = spec.is_fd
        self._counter = COUNTER_MODULUS - 1
        self._latest: Frame | None = None

    def frame(self, message: Any, steps: int = 1) -> Frame:
        """The message's frame. steps: counts since the frame before; more than one where frames
        were lost."""
        buffer = bytearray(self._length)
        self._encode(buffer, (self._counter + steps - 1) % COUNTER_MODULUS, message)
        write_crc(buffer, self._data_id)  # counts on by one, then protects
        self._counter = buffer[COUNTER_BYTE]
        self._latest = Frame(self._can_id, bytes(buffer), self._is_fd)
        return self._latest

    def damaged(self) -> Frame:
        """A frame whose CRC is wrong, as one that was damaged out there."""
        buffer = bytearray(self._length)
        write_crc(buffer, self._data_id)
        buffer[0] ^= 0xFF
        return Frame(self._can_id, bytes(buffer), self._is_fd)

    def again(self) -> list[Frame]:
        """The frame before once more, as one that was repeated out there."""
        return [] if self._latest is None else [self._latest]
