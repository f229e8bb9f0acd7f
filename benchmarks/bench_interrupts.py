"""What the board's machine code takes: instructions in each interrupt, and the deepest stack.

    python -m benchmarks.bench_interrupts --shifts 1 --by gcc

Shifts are made with the image on the emulated board, each instruction counted. An instruction of a
Cortex-M4 takes a cycle or more of 12.5 ns; the flash's wait states are not counted.
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict
from typing import Any

import unicorn

from meshpoint.controller.settings import ControllerSettings
from meshpoint.gearbox import load_sheet
from meshpoint.testbench.firmware.board import Firmware
from meshpoint.testbench.firmware.build import BOTH_IMAGES, CROSS_COMPILERS, image, source_folder
from meshpoint.testbench.firmware.cortex_m4.emulated_board import EmulatedBoard
from meshpoint.testbench.firmware.elf import segments
from meshpoint.testbench.firmware.firmware_rig import FirmwareRig
from meshpoint.testbench.loop import simulate
from meshpoint.testbench.loop.schedules import MIXED
from meshpoint.testbench.loop.setup import Setup

STACK_END, PAINTED, PAINT = 0x2001_8000, 4096, 0xA5
WFI = b"\x30\xbf"
NAMES = {0: "main loop, from one sleep to the next", 15: "tick (SysTick)", 37: "CAN (FDCAN1)",
         66: "compare timer (TIM5)", 72: "tenth scan (DMA2)"}  # fmt: skip


class Counter:
    """Counts instructions by exception, the most of each."""

    def __init__(self, elf: bytes, board: EmulatedBoard) -> None:
        self.most: dict[int, int] = defaultdict(int)
        self.times: dict[int, int] = defaultdict(int)
        self._board = board
        self._sleeps = {
            address + at
            for address, content in segments(elf)
            for at in range(0, len(content), 2)
            if content[at : at + 2] == WFI
        }
        self._entries: dict[int, int] = {}
        self._counts: dict[int, int] = defaultdict(int)
        self._active = 0
        board.processor.write_memory(STACK_END - PAINTED, bytes([PAINT]) * PAINTED)
        board.processor.unicorn.hook_add(unicorn.UC_HOOK_CODE, self._count)

    @property
    def stack_bytes(self) -> int:
        """The deepest that it became."""
        painted = self._board.processor.read_memory(STACK_END - PAINTED, PAINTED)
        return len(painted.lstrip(bytes([PAINT])))

    def _count(self, _uc: Any, address: int, _size: int, _data: Any) -> None:
        active = self._board.chip.nvic.active
        if active and self._entries.setdefault(active, address) == address:
            self._end(active)
        self._counts[active] += 1
        if active == 0 and address in self._sleeps:
            self._end(0)
        self.most[active] = max(self.most[active], self._counts[active])

    def _end(self, number: int) -> None:
        self._counts[number] = 0
        self.times[number] += 1


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--shifts", type=int, default=1)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--by", choices=CROSS_COMPILERS, default="gcc")
    given = parser.parse_args()
    elf = image(source_folder(), BOTH_IMAGES, given.by)
    board = EmulatedBoard(elf)
    counter = Counter(elf, board)
    simulate.around_rig = lambda *_: lambda rig: FirmwareRig(rig, board)
    simulate.simulate(
        Setup(load_sheet("truck12"), ControllerSettings(), seed=given.seed, shifts=given.shifts,
              pairs=MIXED, firmware=Firmware.CORTEX_M4),
        lambda _at_us, _frame: None,
    )  # fmt: skip
    print(f"{given.by}, {board.own_us / 1e6:.1f} s, most instructions at once (how often it came):")
    for number, most in sorted(counter.most.items()):
        print(f"{most:7d}  {NAMES.get(number, number)} ({counter.times[number]})")
    print(f"{counter.stack_bytes:7d}  bytes of stack, the deepest")
    return 0


if __name__ == "__main__":
    sys.exit(main())
