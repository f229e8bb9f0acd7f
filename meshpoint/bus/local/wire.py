"""How a frame is laid out on the stream between a node and the hub.

A connection begins with `GREETING` in both directions, then carries records: a header of 16
bytes, little-endian, and the payload. The header is a mark byte, flags, the length (0..8, or a
CAN FD length), a zero byte, the identifier, and the time the hub passed the frame on, in
microseconds since the epoch (0 on the way to the hub). A remote frame has a length and no payload.
"""

from collections.abc import Iterator
from enum import IntFlag
from struct import Struct
from typing import NamedTuple

GREETING = b"meshpoint-bus/1\n"

RECORD_HEADER = Struct("<BBBBIQ")
_TIME = Struct("<Q")
_TIME_OFFSET = 8
_MARK = 0xCA

FD_LENGTHS = frozenset((*range(9), 12, 16, 20, 24, 32, 48, 64))
CLASSIC_LENGTHS = frozenset(range(9))


class Flag(IntFlag):
    """What kind of frame a record holds."""

    EXTENDED = 1  # 29-bit identifier
    FD = 2
    BITRATE_SWITCH = 4
    ERROR_STATE = 8  # the sender was error passive
    REMOTE = 16
    ERROR = 32  # an error frame: the identifier holds the error class


_REMOTE = Flag.REMOTE.value  # a plain integer: flag arithmetic is slow, this runs once a frame


class WireError(ValueError):
    """A record that is none: the stream cannot be trusted any further."""


class WireRecord(NamedTuple):
    """One frame on the stream."""

    flags: int
    length: int
    can_id: int
    time_us: int
    data: bytes


def _allowed_kinds() -> frozenset[tuple[int, int]]:
    """Every (flags, length) a CAN controller could produce: remote and error frames are classic,
    and only FD frames switch the bit rate or tell the sender's error state."""
    fd_only = Flag.BITRATE_SWITCH | Flag.ERROR_STATE
    kinds = set()
    for flags in range(64):
        if flags & Flag.FD:
            if not flags & (Flag.REMOTE | Flag.ERROR):
                kinds |= {(flags, length) for length in FD_LENGTHS}
        elif not flags & fd_only and flags & (Flag.REMOTE | Flag.ERROR) != Flag.REMOTE | Flag.ERROR:
            kinds |= {(flags, length) for length in CLASSIC_LENGTHS}
    return frozenset(kinds)


_ALLOWED_KINDS = _allowed_kinds()
_MAX_ID = tuple(
    (1 << 29) - 1 if flags & (Flag.EXTENDED | Flag.ERROR) else (1 << 11) - 1 for flags in range(64)
)


def pack(flags: int, can_id: int, data: bytes | bytearray, length: int) -> bytes:
    """One record. `length` differs from len(data) for a remote frame only.

    Raises WireError for a frame that cannot exist on a CAN bus.
    """
    if (flags, length) not in _ALLOWED_KINDS or not 0 <= can_id <= _MAX_ID[flags]:
        raise WireError(_complaint(flags, length, can_id))
    if len(data) != (0 if flags & Flag.REMOTE else length):
        raise WireError(f"frame 0x{can_id:X} has length {length} but {len(data)} bytes of data")
    return RECORD_HEADER.pack(_MARK, flags, length, 0, can_id, 0) + data


def missing_bytes(buffer: bytes | bytearray) -> int:
    """Bytes still missing from the record at the start of `buffer`, 0 when it is complete.

    While the header is incomplete, only the rest of the header counts as missing.
    """
    if len(buffer) < RECORD_HEADER.size:
        return RECORD_HEADER.size - len(buffer)
    mark, flags, length, zero, can_id, _ = RECORD_HEADER.unpack_from(buffer)
    return RECORD_HEADER.size + _payload_bytes(mark, flags, length, zero, can_id) - len(buffer)


def records(buffer: bytes | bytearray) -> Iterator[tuple[WireRecord, int]]:
    """The complete records in `buffer`, each with the offset behind it.

    Raises WireError at the first record that is none, after the good ones before it.
    """
    unpack, header_bytes, end = RECORD_HEADER.unpack_from, RECORD_HEADER.size, len(buffer)
    start = 0
    while start + header_bytes <= end:
        mark, flags, length, zero, can_id, time_us = unpack(buffer, start)
        data_start = start + header_bytes
        start = data_start + _payload_bytes(mark, flags, length, zero, can_id)
        if start > end:
            return
        yield WireRecord(flags, length, can_id, time_us, bytes(buffer[data_start:start])), start


class Stamped(NamedTuple):
    """How far a buffer was stamped, and what stopped it, if a bad record did."""

    end: int
    error: WireError | None


def stamp(buffer: bytearray, time_us: int) -> Stamped:
    """Writes `time_us` into every complete record of `buffer`, in place."""
    unpack, header_bytes, end = RECORD_HEADER.unpack_from, RECORD_HEADER.size, len(buffer)
    start = 0
    while start + header_bytes <= end:
        mark, flags, length, zero, can_id, _ = unpack(buffer, start)
        try:
            behind = start + header_bytes + _payload_bytes(mark, flags, length, zero, can_id)
        except WireError as error:
            return Stamped(start, error)
        if behind > end:
            break
        _TIME.pack_into(buffer, start + _TIME_OFFSET, time_us)
        start = behind
    return Stamped(start, None)


def _payload_bytes(mark: int, flags: int, length: int, zero: int, can_id: int) -> int:
    if (
        mark != _MARK
        or zero != 0
        or (flags, length) not in _ALLOWED_KINDS
        or can_id > _MAX_ID[flags]
    ):
        raise WireError(
            f"record starts with 0x{mark:02X} (expected 0x{_MARK:02X}); "
            + _complaint(flags, length, can_id)
        )
    return 0 if flags & _REMOTE else length


def _complaint(flags: int, length: int, can_id: int) -> str:
    return (
        f"no CAN frame has flags 0x{flags:02X}, length {length} and identifier 0x{can_id:X} "
        "(classic frames carry 0..8 bytes, FD frames 0..8, 12, 16, 20, 24, 32, 48 or 64; "
        "identifiers have 11 bits, extended ones 29)"
    )
