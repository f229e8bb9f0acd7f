"""Encoders, decoders and E2E profile 1 channels of the classic profile, from its DBC."""

from __future__ import annotations

from enum import IntEnum
from typing import Any, Final, NamedTuple

from e2e.p01 import e2e_p01_check, e2e_p01_protect

from meshpoint.dbc.classic.source import CLASSIC_DBC
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import ENUMS, make_codec
from meshpoint.dbc.schema import parse_schema

CLASSIC_SCHEMA: Final = parse_schema(CLASSIC_DBC.read_bytes(), CLASSIC_DBC.name)
"""The classic profile, checked."""
CLASSIC_CODECS: Final = {spec.name: make_codec(spec, ENUMS) for spec in CLASSIC_SCHEMA.messages}
"""Its messages by name."""
CLASSIC_IDS: Final = frozenset(spec.can_id for spec in CLASSIC_SCHEMA.messages)
COUNTERS: Final = 15
"""Profile 1 counts from 0 to 14."""
COUNTER_BYTE: Final = 1
COUNTER_MASK: Final = 0x0F
LENGTH: Final = 8


class Heard(IntEnum):
    """What a frame of a protected message came to."""

    OK = 0
    DAMAGED = 1
    """Wrong CRC, length or format, or a value out of the DBC's range."""
    REPEATED = 2
    """The counter of the frame before."""


class Hearing(NamedTuple):
    """A frame heard: how far the counter went on, and the message where it is OK."""

    heard: Heard
    steps: int
    """Counts since the frame before, 1 to 14: more than one where frames were lost. The first one
    of all is one step."""
    counter: int
    message: Any


def plain_frame(name: str, message: Any) -> Frame:
    """The frame of a message without protection: J1939's."""
    codec = CLASSIC_CODECS[name]
    buffer = bytearray(LENGTH)
    codec.encode(buffer, 0, message)
    return Frame(codec.spec.can_id, bytes(buffer), is_fd=False)


class ClassicSender:
    """Sends one protected message; keeps its counter."""

    def __init__(self, name: str) -> None:
        codec = CLASSIC_CODECS[name]
        self._encode = codec.encode
        self._can_id = codec.spec.can_id
        self._data_id = codec.spec.protected_id
        self.message_type = codec.message_type
        self.counter = COUNTERS - 1
        """Of the frame before; the first one carries 0."""

    @property
    def next_counter(self) -> int:
        """What the next frame will carry."""
        return (self.counter + 1) % COUNTERS

    def frame(self, message: Any) -> Frame:
        """The message's frame; raises one of `layout.REFUSALS` for a value that does not fit."""
        buffer = bytearray(LENGTH)
        self._encode(buffer, self.counter, message)
        e2e_p01_protect(buffer, self._data_id)  # counts on by one, then protects
        self.counter = buffer[COUNTER_BYTE] & COUNTER_MASK
        return Frame(self._can_id, bytes(buffer), is_fd=False)


class ClassicEar:
    """Hears one protected message; keeps the counter of the frame before."""

    def __init__(self, name: str) -> None:
        codec = CLASSIC_CODECS[name]
        self._decode = codec.decode
        self._data_id = codec.spec.protected_id
        self.can_id = codec.spec.can_id
        self._counter: int | None = None

    def hear(self, frame: Frame) -> Hearing:
        """Judges and decodes a frame of this identifier."""
        data = bytearray(frame.data)  # the library's check wants one that can be written
        if frame.is_fd or len(data) != LENGTH or not e2e_p01_check(data, self._data_id):
            return Hearing(Heard.DAMAGED, 0, 0, None)
        counter = data[COUNTER_BYTE] & COUNTER_MASK
        message = self._decode(frame.data)
        if counter >= COUNTERS or message is None:
            return Hearing(Heard.DAMAGED, 0, counter, None)
        before, self._counter = self._counter, counter
        steps = 1 if before is None else (counter - before) % COUNTERS
        if steps == 0:
            return Hearing(Heard.REPEATED, 0, counter, None)
        return Hearing(Heard.OK, steps, counter, message)
