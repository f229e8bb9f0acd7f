"""The most that the board's machine code takes: cycles of each interrupt, and stack.

    python tests/firmware/worst_case.py --by gcc

Cycles are an estimate from above: the image runs on the emulated board, and each instruction costs
the most that it can (firmware/cortex_m4/cycles.py). At 80 MHz a cycle is 12.5
ns. What is asked of the board is meant to be the hardest: noise on all wheels up to the most that
is taken, and three commands for all valves each millisecond, with times to keep.
The stack's bound is the compiler's (stack_bound.py); what was reached is beside it.
"""

from __future__ import annotations

import argparse
import random
from collections import defaultdict
from functools import cache
from typing import Any, Final, NamedTuple

from firmware_bench import AT_REST, VALVES, CommandBench, emulated_board
from stack_bound import bound, call_graph, total_bytes

from meshpoint.dbc.messages import ValveAction
from meshpoint.firmware.build import CROSS_COMPILERS, source_folder
from meshpoint.firmware.cortex_m4.cycles import block_cycles
from meshpoint.firmware.cortex_m4.emulated_board import EmulatedBoard
from meshpoint.firmware.cortex_m4.processor import WFI

CYCLES_A_US: Final = 80
NAMES: Final = {0: "main loop", 15: "SysTick", 37: "FDCAN1", 66: "TIM5", 72: "DMA2 channel 1"}
"""By the number of the exception, as the processor counts them."""
MASK, UNMASK = b"\x72\xb6", b"\x62\xb6"
"""CPSID i and CPSIE i."""
STACK_END, PAINTED, PAINT = 0x2001_8000, 4096, 0xA5
FIFO: Final = 3
"""Elements of the CAN controller."""
NOISE_EDGES: Final = 110
"""Of one channel in a read: as many are taken."""


class Found(NamedTuple):
    """The most cycles of each exception from entry to exit, 0 is the main loop from one sleep to
    the next; of a stretch of it in which interrupts are kept out; bytes of stack."""

    cycles: dict[int, int]
    locked_cycles: int
    stack_bytes: int


class Counter:
    """Counts cycles by exception, the most of each."""

    def __init__(self, board: EmulatedBoard) -> None:
        import unicorn

        self.most: dict[int, int] = defaultdict(int)
        self.most_locked = 0
        self._board = board
        self._instructions: dict[int, bytes] = {}
        self._locked: int | None = None
        self._spent: dict[int, int] = defaultdict(int)
        self._nested: list[int] = [0]
        board.processor.write_memory(STACK_END - PAINTED, bytes([PAINT]) * PAINTED)
        board.processor.unicorn.hook_add(unicorn.UC_HOOK_CODE, self._count)

    @property
    def stack_bytes(self) -> int:
        """The deepest that it became."""
        painted = self._board.processor.read_memory(STACK_END - PAINTED, PAINTED)
        return len(painted.lstrip(bytes([PAINT])))

    def sleeps(self) -> None:
        """What the main loop did since its last sleep is over."""
        self._spent[0] = 0

    def _count(self, _uc: Any, address: int, size: int, _data: Any) -> None:
        active = self._board.chip.nvic.active
        if active != self._nested[-1]:
            if active in self._nested:
                self._nested.pop()
            else:
                self._nested.append(active)
                self._spent[active] = 0
        code = self._instructions.get(address)
        if code is None:
            code = self._instructions[address] = self._board.processor.read_memory(address, size)
        cycles = block_cycles(code)
        self._spent[active] += cycles
        self.most[active] = max(self.most[active], self._spent[active])
        if not active:
            self._count_locked(code, cycles)

    def _count_locked(self, code: bytes, cycles: int) -> None:
        if code == MASK:
            self._locked = 0
        elif code in (UNMASK, WFI):
            self._locked = None
        if self._locked is not None:
            self._locked += cycles
            self.most_locked = max(self.most_locked, self._locked)


def hardest(bench: CommandBench, board: EmulatedBoard, counter: Counter, reads: int = 6) -> None:
    """Reads of 10 ms, everything at once: the receive FIFO is full as its interrupt comes."""
    rng = random.Random(48)
    for _ in range(reads):
        for _ in range(10):
            for channel in range(8):
                board.capture(channel, [board.sensor_us] * (NOISE_EDGES // 10))
            for _ in range(FIFO - 1):
                board.chip.fdcan.receive(bench.valve_frame(**orders(rng, bench.now_us)))
            bench.command(**orders(rng, bench.now_us))
            counter.sleeps()
            bench.wait(1_000)
        counter.sleeps()
        board.read(AT_REST)
        board.take_sent()


def orders(rng: random.Random, now_us: int) -> dict[str, tuple[ValveAction, int]]:
    """For each valve a time of its own."""
    actions = (ValveAction.ON_AT, ValveAction.OFF_AT)
    return {valve: (rng.choice(actions), now_us + rng.randrange(40_000)) for valve in VALVES}


@cache
def worst_case(by: str) -> Found:
    """Of the image with both parts, by this compiler."""
    board = emulated_board(by)
    bench = CommandBench(board)
    counter = Counter(board)
    hardest(bench, board, counter)
    return Found(dict(counter.most), counter.most_locked, counter.stack_bytes)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--by", choices=CROSS_COMPILERS, default="gcc")
    given = parser.parse_args()
    found = worst_case(given.by)
    for number, cycles in sorted(found.cycles.items()):
        print(f"{NAMES.get(number, number)!s:15} {cycles:7d} cycles {cycles / CYCLES_A_US:7.1f} us")
    locked = found.locked_cycles
    print(f"{'interrupts out':15} {locked:7d} cycles {locked / CYCLES_A_US:7.1f} us")
    print(f"{'stack':15} {found.stack_bytes:7d} bytes", end="")
    if given.by == "gcc":
        print(f" of {total_bytes(bound(call_graph(source_folder())))} by its call graph", end="")
    print()


if __name__ == "__main__":
    main()
