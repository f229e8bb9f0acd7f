"""Exceptions of the emulated Cortex-M4 (ARMv7-M, B1.5), by a program of its own."""

from __future__ import annotations

import pytest
from chip_program import Program

from meshpoint.base.errors import CommandError

HARD_FAULT = 3
SLOT_3 = 18
"""The number of the third interrupt."""


def test_interrupts_come_by_priority_and_what_they_interrupt_goes_on(cross: str) -> None:
    program = Program("exceptions", cross)
    assert program.said == [
        1, 10, 11, 12, 13, SLOT_3,  # preempted by the second; the third waits and is chained
        2, 3, 11, 4,  # held back by PRIMASK
        1 + 2 + 3 + 4 + 5,  # the registers outlast an interrupt
    ]  # fmt: skip


def test_sleep_ends_with_each_tick(cross: str) -> None:
    program = Program("exceptions", cross)
    begun = len(program.said)
    program.board.advance(2_999)
    assert program.said[begun:] == [30, 31] * 2
    program.board.advance(1)
    assert program.said[begun:] == [30, 31] * 3


@pytest.mark.parametrize(
    ("part", "status", "address"),
    [(0, 1 << 9 | 1 << 15, 0x6000_0004), (1, 1 << 16, 0), (2, 1 << 8, 0),
     (5, 1 << 9 | 1 << 15, 0x0800_1000)],
    ids=["no memory", "no instruction", "no code", "flash is written"],
)  # fmt: skip
def test_a_fault_comes_to_its_handler_with_its_status(
    cross: str, part: int, status: int, address: int
) -> None:
    assert Program("faults", cross, part).said == [HARD_FAULT, status, address]


def test_a_fault_in_the_fault_handler_is_the_end_until_a_reset(cross: str) -> None:
    program = Program("faults", cross, 3)
    program.board.advance(1_000_000)
    assert program.said[0] == HARD_FAULT
    program.board.power_on(0)
    assert program.said[0] == HARD_FAULT


def test_a_peripheral_without_its_clock_is_an_error_that_names_it(cross: str) -> None:
    with pytest.raises(CommandError, match=r"TIM2: .* bit 0 of RCC\.APB1ENR1; at PC 0x0800"):
        Program("faults", cross, 4)
