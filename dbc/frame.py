"""A CAN frame as the pure cores see it."""

from __future__ import annotations

import zlib
from collections.abc import Iterable
from typing import NamedTuple


class Frame(NamedTuple):
    """One CAN frame; it carries no time, because what a frame says about time is inside it.

    `can_id` has 29 bits, or 11 when `is_extended` is false; `data` is the payload without padding.
    """

    can_id: int
    data: bytes
    is_fd: bool = True
    is_extended: bool = True


def crc_of(frames: Iterable[Frame]) -> int:
    """CRC over identifiers and payloads, in order of identifier: frames of different senders may
    reach a log in another order than the node that consumed them."""
    crc = 0
    for frame in sorted(frames, key=lambda frame: frame.can_id):
        crc = zlib.crc32(frame.data, zlib.crc32(frame.can_id.to_bytes(4, "little"), crc))
    return crc
