"""Frame lengths are those of a bit-level encoder that shares nothing with the product."""

from __future__ import annotations

import itertools
import random

import bit_encoder
import pytest

from meshpoint.bus.simulated.frame_bits import (
    FD_LENGTHS,
    BitTiming,
    FrameBits,
    WireFrame,
    arbitration_key,
    check_frame,
    common_bits,
    frame_bits,
    longest,
)


def written(frame: WireFrame) -> list[tuple[int, str]]:
    return bit_encoder.encode(
        frame.can_id,
        frame.data,
        fd=frame.is_fd,
        extended=frame.is_extended,
        brs=frame.is_fd and frame.bitrate_switch,
        esi=frame.error_state,
        remote_dlc=(frame.dlc or 0) if frame.is_remote else None,
    )


def counted(frame: WireFrame) -> FrameBits:
    rates = [rate for _, rate in written(frame)]
    return FrameBits(rates.count("n"), rates.count("d"))


def drawn(draw: random.Random) -> WireFrame:
    """Contents that stuff much, little, and at random."""
    extended, fd = draw.random() < 0.5, draw.random() < 0.6
    length = draw.choice(FD_LENGTHS if fd else FD_LENGTHS[:9])
    can_id = draw.choice((0, 0x1FFFFFFF, 0x1F07C1F0, draw.getrandbits(29)))
    data = draw.choice(
        (
            bytes(length),
            b"\xff" * length,
            (b"\x0f\x87\xc3\xe1\xf0\x78\x3c\x1e" * 8)[:length],
            bytes(draw.choice((0x00, 0xFF, 0xF0, 0x1F)) for _ in range(length)),
            draw.randbytes(length),
        )
    )
    remote = not fd and draw.random() < 0.1
    return WireFrame(
        can_id if extended else can_id >> 18,
        b"" if remote else data,
        fd,
        extended,
        fd and draw.random() < 0.7,
        remote,
        fd and draw.random() < 0.3,
        draw.randrange(9) if remote else None,
    )


@pytest.mark.parametrize(("width", "check"), [(15, 0x059E), (17, 0x04F03), (21, 0x0ED841)], ids=str)
def test_the_encoder_has_the_crcs_of_the_catalogue(width: int, check: int) -> None:
    """CRC-15/CAN, CRC-17/CAN-FD and CRC-21/CAN-FD over "123456789", from 0."""
    bits = [bit for byte in b"123456789" for bit in bit_encoder.number(byte, 8)]
    assert bit_encoder.crc(bits, width, 0) == bit_encoder.number(check, width)


def test_lengths_are_those_of_the_encoder() -> None:
    draw = random.Random(1)
    for _ in range(4_000):
        frame = drawn(draw)
        assert frame_bits(frame) == counted(frame), frame


@pytest.mark.parametrize("extended", [False, True])
def test_classic_frames_of_two_bytes_have_their_length(extended: bool) -> None:
    """A grid over all payloads of two bytes: the CRC and its end come in all forms."""
    for high, low in itertools.product(range(0, 256, 17), range(0, 256, 3)):
        frame = WireFrame(0, bytes([high, low]), is_fd=False, is_extended=extended)
        assert frame_bits(frame) == counted(frame)


def test_lengths_without_stuffing_are_those_of_the_standard() -> None:
    """Alternating contents: 44 + 8 n bits to the end of frame standard, 64 + 8 n extended, and
    the stuff bits that remain are those of the header."""
    for length in range(9):
        frame = WireFrame(0x555, b"\x55" * length, is_fd=False, is_extended=False)
        plain = 1 + 11 + 3 + 4 + 8 * length + 15 + 1 + 2 + 7
        assert plain <= frame_bits(frame).nominal <= plain + 4


def test_five_equal_bits_at_the_end_of_fd_data_get_the_fixed_stuff_bit_alone() -> None:
    """0xE0 ends with five zeros: no bit longer than 0xE1 with four."""
    five = WireFrame(0x555, b"\x55\xe0", is_extended=False)
    four = WireFrame(0x555, b"\x55\xe1", is_extended=False)
    assert frame_bits(five) == frame_bits(four)
    classic = [frame._replace(is_fd=False, bitrate_switch=False) for frame in (five, four)]
    assert [counted(frame) for frame in classic] == [frame_bits(frame) for frame in classic]


@pytest.mark.parametrize("is_fd", [False, True])
def test_the_longest_is_as_long_as_the_longest_of_all_payloads(is_fd: bool) -> None:
    """Tried out: all payloads of one byte, on identifiers that stuff differently. A classic
    frame's limit takes any CRC, and is not reached by each identifier."""
    for can_id in (0, 0x1FFFFFFF, 0x0CFF4003, 0x1555_5555):
        frames = [WireFrame(can_id, bytes([byte]), is_fd) for byte in range(256)]
        most = max(frame_bits(frame).duration_ns(BitTiming()) for frame in frames)
        limit = longest(frames[0]).duration_ns(BitTiming())
        assert limit == most if is_fd else most <= limit <= most + 3 * 2000


def test_no_drawn_frame_is_longer_than_the_longest() -> None:
    draw = random.Random(2)
    for _ in range(300):
        frame = drawn(draw)
        timing = BitTiming()
        assert frame_bits(frame).duration_ns(timing) <= longest(frame).duration_ns(timing)


def test_a_worst_case_payload_reaches_the_longest() -> None:
    """Five equal bits, then four of the other kind and so on: a stuff bit after every four."""
    frame = WireFrame(0x18FF1080, bytes(64))
    best = frame
    draw = random.Random(3)
    for start in range(9):
        for first in (0, 1):
            bits, bit = [draw.getrandbits(1) for _ in range(start)], first
            bits += [bit] * 5
            while len(bits) < 512:
                bit = 1 - bit
                bits += [bit] * 4
            data = bytes(int("".join(map(str, bits[k : k + 8])), 2) for k in range(0, 512, 8))
            candidate = frame._replace(data=data)
            best = max(best, candidate, key=lambda f: frame_bits(f).data)
    assert longest(frame).data - frame_bits(best).data <= 2


def test_arbitration_is_by_the_bits_on_the_wire() -> None:
    """The lower key is the frame that sends a dominant bit where they first differ."""
    draw = random.Random(4)
    base = [drawn(draw) for _ in range(24)]
    frames = base + [
        WireFrame(
            f.can_id >> 18 if f.is_extended else f.can_id << 18, is_extended=not f.is_extended
        )
        for f in base
    ]
    all_bits = {frame: [bit for bit, _ in written(frame)] for frame in frames}
    for first, second in itertools.combinations(frames, 2):
        keys = arbitration_key(first), arbitration_key(second)
        if keys[0] == keys[1]:
            continue
        bits = [all_bits[first], all_bits[second]]
        differ = next(k for k, (a, b) in enumerate(zip(*bits, strict=False)) if a != b)
        assert (keys[0] < keys[1]) == (bits[0][differ] == 0)


def test_equal_frames_share_all_bits_and_others_part_at_the_first_difference() -> None:
    frame = WireFrame(0x123, b"\x00\x01")
    assert common_bits(frame, frame) == 1 + 32 + 3 + 4 + 16
    assert common_bits(frame, frame._replace(data=b"\x00\x00")) == 1 + 32 + 3 + 4 + 15
    assert common_bits(frame, frame._replace(is_fd=False)) == 1 + 32


@pytest.mark.parametrize(
    "frame",
    [
        WireFrame(1 << 29),
        WireFrame(0x800, is_extended=False),
        WireFrame(-1),
        WireFrame(1, bytes(9), is_fd=False),
        WireFrame(1, bytes(10)),
        WireFrame(1, bytes(65)),
        WireFrame(1, is_remote=True),
        WireFrame(1, is_fd=False, is_remote=True, dlc=9),
        WireFrame(1, b"1", is_fd=False, is_remote=True),
    ],
)
def test_what_no_bus_could_carry_is_refused(frame: WireFrame) -> None:
    with pytest.raises(ValueError):
        check_frame(frame)
