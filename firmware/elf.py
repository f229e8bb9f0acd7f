"""What a linked image puts into memory: its loadable segments (System V ABI, ELF for 32 bits)."""

from __future__ import annotations

import struct
from typing import Final, NamedTuple

_HEADER: Final = struct.Struct("<4s5B7x2H5I6H")
_SEGMENT: Final = struct.Struct("<8I")
_MAGIC: Final = b"\x7fELF"
_LOADED: Final = 1


class Segment(NamedTuple):
    """Bytes and where they are stored: in flash, also those that the startup copies to memory."""

    address: int
    content: bytes


def segments(image: bytes) -> list[Segment]:
    """The parts of an image that are stored, in order of their addresses.

    ValueError: no image of a 32-bit processor, or one that is cut short."""
    try:
        magic, bits, *_, offset, _, _, _, size, count, _, _, _ = _HEADER.unpack_from(image)
        if magic != _MAGIC or bits != 1 or size != _SEGMENT.size:
            raise ValueError("no linked image of a 32-bit processor")
        found = []
        for place in range(count):
            kind, at, _, address, length, *_ = _SEGMENT.unpack_from(image, offset + size * place)
            if kind == _LOADED and length:
                found.append(Segment(address, image[at : at + length]))
                if len(found[-1].content) < length:
                    raise ValueError("an image that is cut short")
    except struct.error as error:
        raise ValueError("an image that is cut short") from error
    return sorted(found)


def flash_content(image: bytes) -> bytes:
    """All of it as one piece from the first address on; between segments as erased flash is."""
    parts = segments(image)
    first = parts[0].address
    content = bytearray()
    for address, part in parts:
        content += b"\xff" * (address - first - len(content)) + part
    return bytes(content)
