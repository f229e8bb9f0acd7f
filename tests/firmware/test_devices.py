"""The emulated chip's peripherals together, by programs that use them as a board does."""

from __future__ import annotations

import pytest
from chip_program import Program

from meshpoint.dbc.frame import Frame

CAPTURE, COMPARE, TOGGLE, SCAN, ECHO, GUARD = range(6)
RISING, FALLING, SCANNED = 0x2000_A000, 0x2000_A010, 0x2000_A100
HALF, COMPLETE = 0b100, 0b10
RING = 8
WATCHDOG_RESET = 1 << 29


def test_both_edges_of_a_pin_go_to_their_rings_as_16_bits(cross: str) -> None:
    board = (program := Program("devices", cross, CAPTURE)).board
    board.chip.edges(("A", 0), rising=True, counts=[0x1_0001, 0x2_0002, 0x3_FFFF])
    board.chip.edges(("A", 0), rising=False, counts=[7])
    assert program.halfwords(RISING, 4) == [1, 2, 0xFFFF, 0]
    assert program.halfwords(FALLING, 2) == [7, 0]
    board.chip.edges(("A", 1), rising=True, counts=[9])  # no input of the timer
    assert program.halfwords(RISING, 4) == [1, 2, 0xFFFF, 0]


def test_a_ring_goes_round_and_its_flags_tell_of_each_half(cross: str) -> None:
    board = (program := Program("devices", cross, CAPTURE)).board
    flags = []
    for count in range(1, RING + 1):
        board.chip.edges(("A", 0), rising=True, counts=[count])
        flags.append(board.chip.dmas[0].value[0] & (HALF | COMPLETE))
    assert flags == [0] * 3 + [HALF] * 4 + [HALF | COMPLETE]
    board.chip.edges(("A", 0), rising=True, counts=range(101, 101 + RING + 2))
    assert program.halfwords(RISING, RING) == [109, 110, *range(103, 109)]


def test_a_compare_timer_interrupts_at_its_microsecond(cross: str) -> None:
    program = Program("devices", cross, COMPARE)
    program.board.advance(749)
    assert program.said[1:] == [500]
    program.board.advance(1)
    assert program.said[1:] == [500, 750]
    program.board.advance(2_000)
    assert sorted(program.said[1:]) == [7, *range(500, 2_751, 250)]  # the one pulse comes once


def test_a_timer_starts_the_other_one_and_turns_its_pin_over(cross: str) -> None:
    board = (program := Program("devices", cross, TOGGLE)).board
    board.advance(1_000)
    assert program.said[1:] == [0, 1]
    assert board.outputs == [
        (100, ("A", 6), True), (400, ("A", 6), False), (700, ("A", 6), True),
        (1_000, ("A", 6), False),
    ]  # fmt: skip


def test_scans_come_each_millisecond_by_dma(cross: str) -> None:
    board = (program := Program("devices", cross, SCAN)).board
    board.voltages |= {("C", 0): 65_520, ("C", 1): 32_761}
    board.advance(999)
    assert program.said[1:] == []
    board.advance(1)
    board.voltages[("C", 0)] = 1
    board.advance(1_000)
    assert program.said[1:] == [65_520 << 16 | 32_761, 1 << 16 | 32_761]


@pytest.mark.parametrize(
    "frame",
    [
        Frame(0x18FF1080, bytes(range(64))),
        Frame(0x18FF1080, bytes(12)),
        Frame(0x18FF1080, b"12345678", is_fd=False),
        Frame(0x18FF1080, b"", is_fd=False),
    ],
    ids=["64 bytes", "12 bytes", "classic", "empty"],
)
def test_what_is_sent_is_what_was_received(cross: str, frame: Frame) -> None:
    board = Program("devices", cross, ECHO).board
    for _ in range(4):  # more than either FIFO holds
        board.receive(frame)
        assert board.take_sent() == [frame._replace(can_id=frame.can_id + 1)]


def test_a_watchdog_that_nobody_restarts_resets_the_chip_and_says_so(cross: str) -> None:
    board = (program := Program("devices", cross, GUARD)).board
    board.advance(1_999)
    assert (board.resets, program.said[0] & WATCHDOG_RESET) == (0, 0)
    board.advance(1)
    assert (board.resets, program.said[0] & WATCHDOG_RESET) == (1, WATCHDOG_RESET)
