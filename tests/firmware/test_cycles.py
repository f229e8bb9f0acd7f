"""What the machine code of the board takes at the most: cycles of interrupts and rounds, stack."""

from __future__ import annotations

import shutil

import pytest
from stack_bound import bound, call_graph, total_bytes
from worst_case import CYCLES_A_US, NAMES, worst_case

from meshpoint.firmware.build import CROSS_COMPILERS, source_folder

MOST_US = {"main loop": 1_000, "FDCAN1": 100, "SysTick": 10, "TIM5": 10, "DMA2 channel 1": 10}
"""An interrupt, behind another one, leaves a valve its 100 us."""
TICK_US = 1_000
SLOWEST_HZ, FASTEST_HZ = 29_500, 34_000
"""The watchdog's oscillator, from -40 to 125 degrees."""
COUNT, CLOSED, WHOLE = 4, 3, 16
"""A count of it in its periods; how many of them the window stays closed, and how many there are,
of which one may be short."""


@pytest.mark.parametrize("by", CROSS_COMPILERS)
def test_each_interrupt_and_each_round_of_the_main_loop_ends_in_its_time(by: str) -> None:
    found = worst_case(by)
    assert {NAMES[number] for number in found.cycles} == set(MOST_US)
    for number, cycles in found.cycles.items():
        assert 0 < cycles < CYCLES_A_US * MOST_US[NAMES[number]], NAMES[number]


@pytest.mark.parametrize("by", CROSS_COMPILERS)
def test_the_tick_restarts_the_watchdog_inside_its_window(by: str) -> None:
    """It comes next behind one interrupt, or one stretch of the main loop that keeps them out."""
    found = worst_case(by)
    interrupts = max(cycles for number, cycles in found.cycles.items() if number)
    late_us = (max(interrupts, found.locked_cycles) + found.cycles[15]) / CYCLES_A_US
    assert TICK_US - late_us > CLOSED * COUNT * 1e6 / SLOWEST_HZ
    assert TICK_US + late_us < (WHOLE - 1) * COUNT * 1e6 / FASTEST_HZ


@pytest.mark.skipif(
    shutil.which("arm-none-eabi-gcc") is None, reason="gcc-arm-none-eabi is not installed"
)
def test_the_stack_is_never_deeper_than_the_call_graph_says() -> None:
    assert 0 < worst_case("gcc").stack_bytes <= total_bytes(bound(call_graph(source_folder())))
