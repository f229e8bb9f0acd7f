"""How long a frame is on the wire, to the bit: ISO 11898-1, classic and FD, with stuff bits.

A stuff bit follows five equal bits, from the start of frame to the end of the CRC (classic) or of
the data field (FD). An FD frame's CRC field has fixed stuff bits instead, one before its first bit
and one after every four; where five equal bits end the data field, only the fixed one follows. So
the length of a classic frame depends on its CRC, that of an FD frame does not.

With bit rate switch the bus changes rate in the BRS bit and back in the CRC delimiter, at their
sample points. Together these two bits last one bit of each rate wherever the sample points are.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final, NamedTuple

FD_LENGTHS: Final[tuple[int, ...]] = (*range(9), 12, 16, 20, 24, 32, 48, 64)
"""Data lengths an FD frame can have, by its DLC."""
MAX_ID: Final = (1 << 29) - 1
MAX_STANDARD_ID: Final = (1 << 11) - 1
CRC15: Final = 0x4599
FRAME_END_BITS: Final = 2 + 7
"""Acknowledge slot and delimiter, end of frame."""
INTERMISSION_BITS: Final = 3
CRC17_BITS: Final = 17
CRC21_BITS: Final = 21
STUFF_COUNT_BITS: Final = 4
CRC17_MOST_BYTES: Final = 16


class BitTiming(NamedTuple):
    """Length of a bit (ns) in the arbitration and in the data phase: 500 kbit/s and 2 Mbit/s."""

    nominal_ns: int = 2000
    data_ns: int = 500


class WireFrame(NamedTuple):
    """A frame as its sender hands it to the wire.

    `data` is padded to a length that the format can carry; a remote frame has none and carries the
    length asked for in `dlc`. `error_state` is the ESI bit of an FD frame.
    """

    can_id: int
    data: bytes = b""
    is_fd: bool = True
    is_extended: bool = True
    bitrate_switch: bool = True
    is_remote: bool = False
    error_state: bool = False
    dlc: int | None = None


class FrameBits(NamedTuple):
    """Bits of a frame by rate, from start of frame to end of frame; the intermission follows."""

    nominal: int
    data: int

    def duration_ns(self, timing: BitTiming) -> int:
        """How long they last (ns)."""
        return self.nominal * timing.nominal_ns + self.data * timing.data_ns


class _Head(NamedTuple):
    """What comes before the data field, counted with its stuff bits."""

    nominal: int
    data: int
    state: int
    crc: int


# The stuffing state is 5 * bit + run - 1: the last bit on the wire and how many like it stand in a
# row, one to five. The stuff bit that five demand is counted when the next bit comes, because at
# the end of an FD frame's data field it is left out.
_START: Final = 5
"""The idle bus: a recessive bit, and the start of frame begins a new run."""


def _next_state(state: int, bit: int) -> tuple[int, int]:
    """State and number of stuff bits after one more bit of the frame."""
    last, run = divmod(state, 5)
    stuffed = 0
    if run == 4:
        last, run, stuffed = 1 - last, 0, 1
    if bit == last:
        return 5 * last + run + 1, stuffed
    return 5 * bit, stuffed


def _over(state: int, bits: int, width: int) -> tuple[int, int]:
    """The same over the `width` lowest bits of a number, highest first."""
    stuffed = 0
    for position in range(width - 1, -1, -1):
        state, more = _next_state(state, bits >> position & 1)
        stuffed += more
    return state, stuffed


def _crc15(crc: int, bits: int, width: int) -> int:
    for position in range(width - 1, -1, -1):
        top = crc >> 14 ^ bits >> position & 1
        crc = (crc << 1) & 0x7FFF
        if top:
            crc ^= CRC15
    return crc


_BYTE_STEPS: Final = [[_over(state, byte, 8) for byte in range(256)] for state in range(10)]
_NEXT: Final = [bytes(step[0] for step in row) for row in _BYTE_STEPS]
_STUFFED: Final = [bytes(step[1] for step in row) for row in _BYTE_STEPS]
_CRC15_BYTES: Final = [_crc15(0, byte, 8) for byte in range(256)]


def dlc_of(length: int, is_fd: bool) -> int:
    """The DLC of a data length; ValueError where no frame has it."""
    lengths = FD_LENGTHS if is_fd else FD_LENGTHS[:9]
    if length not in lengths:
        raise ValueError(f"{length} bytes, allowed are {lengths}")
    return lengths.index(length)


def arbitration_key(frame: WireFrame) -> int:
    """The bits by which frames compete for the bus, as a number: the lowest wins.

    32 bits from the identifier to RTR or RRS; a standard frame's are filled up from below."""
    remote = frame.is_remote and not frame.is_fd
    if not frame.is_extended:
        return (frame.can_id << 2 | remote << 1) << 19
    return (frame.can_id >> 18) << 21 | 0b11 << 19 | (frame.can_id & 0x3FFFF) << 1 | remote


def check_frame(frame: WireFrame) -> None:
    """ValueError where no CAN bus could carry this frame."""
    limit = MAX_ID if frame.is_extended else MAX_STANDARD_ID
    if not 0 <= frame.can_id <= limit:
        raise ValueError(f"identifier 0x{frame.can_id:X}, allowed is 0 to 0x{limit:X}")
    if frame.is_remote:
        if frame.is_fd or frame.data:
            raise ValueError("a remote frame is a classic one and has no data")
        if not 0 <= (frame.dlc or 0) <= 8:
            raise ValueError(f"a remote frame's DLC {frame.dlc}, allowed is 0 to 8")
    else:
        dlc_of(len(frame.data), frame.is_fd)


@lru_cache(maxsize=4096)
def _head(
    can_id: int, is_fd: bool, is_extended: bool, flags: tuple[bool, bool, bool], dlc: int
) -> _Head:
    """`flags`: bit rate switch, remote, error state."""
    switch, remote, error_state = flags
    rtr = int(remote and not is_fd)
    if is_extended:
        bits, width = can_id >> 18, 12  # SOF is a dominant 0 before the identifier
        bits, width = bits << 2 | 0b11, width + 2  # SRR, IDE
        bits, width = bits << 18 | can_id & 0x3FFFF, width + 18
        bits, width = bits << 1 | rtr, width + 1
    else:
        bits, width = can_id << 2 | rtr << 1, 14  # RTR or RRS, IDE
    if not is_fd:
        reserved = 2 if is_extended else 1
        bits, width = bits << reserved + 4 | dlc, width + reserved + 4
        state, stuffed = _over(_START, bits, width)
        return _Head(width + stuffed, 0, state, _crc15(0, bits, width))
    bits, width = bits << 3 | 0b100 | int(switch), width + 3  # FDF, res, BRS
    state, stuffed = _over(_START, bits, width)
    after, more = _over(state, int(error_state) << 4 | dlc, 5)
    return _Head(width + stuffed, 5 + more, after, 0)


def _head_of(frame: WireFrame) -> _Head:
    dlc = (frame.dlc or 0) if frame.is_remote else dlc_of(len(frame.data), frame.is_fd)
    flags = (frame.bitrate_switch, frame.is_remote, frame.error_state)
    return _head(frame.can_id, frame.is_fd, frame.is_extended, flags, dlc)


def _fd_tail_bits(length: int) -> int:
    """Stuff count and CRC with their fixed stuff bits, and the CRC delimiter."""
    crc = CRC17_BITS if length <= CRC17_MOST_BYTES else CRC21_BITS
    field = STUFF_COUNT_BITS + crc
    return field + (field + 3) // 4 + 1


def frame_bits(frame: WireFrame) -> FrameBits:
    """The frame's bits. ValueError for a length that no frame has."""
    nominal, data_bits, state, crc = _head_of(frame)
    stuffed = 0
    data = frame.data
    for byte in data:
        stuffed += _STUFFED[state][byte]
        state = _NEXT[state][byte]
    if frame.is_fd:
        data_bits += 8 * len(data) + stuffed + _fd_tail_bits(len(data))
        if frame.bitrate_switch:
            return FrameBits(nominal + FRAME_END_BITS, data_bits)
        return FrameBits(nominal + data_bits + FRAME_END_BITS, 0)
    for byte in data:
        crc = (crc << 8 & 0x7FFF) ^ _CRC15_BYTES[crc >> 7 ^ byte]
    state, more = _over(state, crc, 15)
    stuffed += more + (state % 5 == 4)
    return FrameBits(nominal + 8 * len(data) + 15 + stuffed + 1 + FRAME_END_BITS, 0)


def longest(frame: WireFrame) -> FrameBits:
    """The most bits a frame with this identifier, format and length can have, whatever its data.

    Exact for FD. For a classic frame it takes the worst of all CRCs as well, which no data may
    have: never too short."""
    nominal, data_bits, state, _ = _head_of(frame)
    free = 8 * len(frame.data) + (0 if frame.is_fd else 15)
    most = {state: 0}
    for _ in range(free):
        reached: dict[int, int] = {}
        for before, stuffed in most.items():
            for bit in (0, 1):
                after, more = _next_state(before, bit)
                reached[after] = max(reached.get(after, -1), stuffed + more)
        most = reached
    if frame.is_fd:
        data_bits += free + max(most.values()) + _fd_tail_bits(len(frame.data))
        if frame.bitrate_switch:
            return FrameBits(nominal + FRAME_END_BITS, data_bits)
        return FrameBits(nominal + data_bits + FRAME_END_BITS, 0)
    stuffed = max(count + (state % 5 == 4) for state, count in most.items())
    return FrameBits(nominal + free + stuffed + 1 + FRAME_END_BITS, 0)


def common_bits(first: WireFrame, second: WireFrame) -> int:
    """After how many bits of arbitration, control and data two frames differ: there the sender of
    the recessive bit sees that it is not alone. Stuff bits are not counted."""
    bits = [_plain_bits(first), _plain_bits(second)]
    shortest = min(len(text) for text in bits)
    return next((k for k in range(shortest) if bits[0][k] != bits[1][k]), shortest)


def _plain_bits(frame: WireFrame) -> str:
    control = f"{int(frame.is_fd)}{int(frame.bitrate_switch)}{int(frame.error_state)}"
    dlc = (frame.dlc or 0) if frame.is_remote else dlc_of(len(frame.data), frame.is_fd)
    data = "".join(f"{byte:08b}" for byte in frame.data)
    return f"0{arbitration_key(frame):032b}{control}{dlc:04b}{data}"


def fd_length(length: int) -> int:
    """The least length of an FD frame that holds this many bytes, 64 at most."""
    return next(longer for longer in FD_LENGTHS if longer >= length)
