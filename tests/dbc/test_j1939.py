"""Parameter groups, and TSC1's counter and checksum."""

from __future__ import annotations

import pytest

from meshpoint.dbc.frame import Frame
from meshpoint.dbc.j1939 import (
    REQUEST_ID,
    canonical,
    checked_request,
    checksum,
    destination_of,
    group_of,
    is_intact,
)

GEAR_10 = bytes([0xFF, 0xFF, 0x87, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF])


@pytest.mark.parametrize(
    ("can_id", "group", "destination"),
    [
        (0x0C0103F9, 0x00100, 0x03),
        (0x18FECA03, 0x0FECA, 0xFF),
        (0x18EAFF21, 0x0EA00, 0xFF),
        (0x18DA03F1, 0x0DA00, 0x03),
        (0x0CF00400, 0x0F004, 0xFF),
        (0x19FECA03, 0x1FECA, 0xFF),
    ],
)
def test_group_and_destination(can_id: int, group: int, destination: int) -> None:
    assert (group_of(can_id), destination_of(can_id)) == (group, destination)


@pytest.mark.parametrize(
    ("can_id", "is_ours"),
    [
        (0x0C0103F9, True),
        (0x0C010321, True),  # another tool's address
        (0x180103F9, True),  # of another priority
        (0x0C01FF05, True),  # to all
        (0x0C010505, False),  # to another node
        (0x0C010303, False),  # from our own address
        (0x0D0103F9, False),  # another data page
        (0x0CF00400, False),
    ],
)
def test_a_request_counts_by_group_and_destination_whoever_sends_it(
    can_id: int, is_ours: bool
) -> None:
    frame = Frame(can_id, GEAR_10, is_fd=False)
    assert (canonical(frame).can_id == REQUEST_ID) is is_ours
    assert canonical(frame).data == GEAR_10


def test_an_11_bit_frame_is_no_request() -> None:
    frame = Frame(0x103, GEAR_10, is_fd=False, is_extended=False)
    assert canonical(frame) is frame


def test_the_checksum_is_the_one_of_the_standard_worked_out_by_hand() -> None:
    """Bytes FD C0 2B FF FF FF FF add up to 1508, counter 5 to 1513, the identifier 0C 00 00 03
    to 1528 = 0b10111111000: (23 & 3) + 191 + 1528 = 1722, its last three bits are 2."""
    data = bytes([0xFD, 0xC0, 0x2B, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF])
    assert sum(data[:7]) == 0xFD + 0xC0 + 0x2B + 4 * 0xFF == 1508
    assert checksum(0x0C000003, data, 5) == 1722 & 7 == 2
    frame = checked_request(Frame(0x0C000003, data, is_fd=False), 5)
    assert frame.data == data[:7] + bytes([0x25])
    assert is_intact(frame)


def test_the_counter_goes_round_at_eight_and_a_changed_byte_is_noticed() -> None:
    plain = Frame(0x0C000003, GEAR_10, is_fd=False)
    assert [checked_request(plain, n).data[7] & 0x0F for n in (0, 7, 8)] == [0, 7, 0]
    checked = checked_request(plain, 3)
    changed = [
        checked._replace(data=bytes([checked.data[0] ^ bit, *checked.data[1:]]))
        for bit in (1, 2, 4)
    ]
    assert not any(map(is_intact, changed))
    assert is_intact(plain), "one without counter and checksum"
