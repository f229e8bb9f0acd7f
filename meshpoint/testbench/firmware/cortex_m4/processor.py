"""The Cortex-M4: instructions by unicorn, exceptions as ARMv7-M takes them (B1.5.6 to B1.5.8).

Unicorn knows the instructions of an M-profile processor, and no exception of it: what is pushed,
where the handler is and how it returns is done here. Code takes no time: one that goes on for
`BUDGET` instructions without sleeping waits for something, and time has to go on for it.
Not modelled: process stack, floating point registers, BASEPRI, FAULTMASK, memory protection, the
fault of a misaligned LDM or LDRD.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from enum import Enum, auto
from typing import Any, Final, Protocol

from meshpoint.testbench.errors import CommandError
from meshpoint.testbench.extra import needed
from meshpoint.testbench.firmware.build import EXTRA
from meshpoint.testbench.firmware.cortex_m4.nvic import (
    BFAR,
    BUS_FAULT,
    CFSR,
    HARD_FAULT,
    SVCALL,
    USAGE_FAULT,
    Nvic,
)
from meshpoint.testbench.firmware.cortex_m4.registers import RegisterError

FLASH: Final = range(0x0800_0000, 0x0808_0000)
MEMORIES: Final = (FLASH, range(0x2000_0000, 0x2002_0000), range(0x1000_0000, 0x1000_8000))
"""Flash; SRAM1, SRAM2 and CCM SRAM in a row; CCM SRAM at its own place."""
BUDGET: Final = 160_000
"""2 ms at 80 MHz and an instruction a cycle."""
MOST_ENTRIES: Final = 10_000
NOWHERE: Final = 0xFFFF_FFFE
RETURN_TO_HANDLER, RETURN_TO_THREAD = 0xFFFF_FFF1, 0xFFFF_FFF9
ALIGNED: Final = 1 << 9
FRAME: Final = 32
STUBS: Final = 0x1F00_0000
PUSH: Final = bytes.fromhex("82b02de90f50")  # sub sp, #8; push.w {r0-r3, r12, lr}
POP: Final = bytes.fromhex("bde80f5002b0")  # pop.w {r0-r3, r12, lr}; add sp, #8
WFI: Final = b"\x30\xbf"
CPSIE: Final = b"\x62\xb6"
MSR_PRIMASK: Final = b"\x10\x88"
IS_EXIT, IS_BREAKPOINT, IS_SVC = 8, 7, 2


class Bus(Protocol):
    """What lies beyond the memories."""

    def read(self, address: int, size: int) -> int:
        """Reads a register."""

    def write(self, address: int, size: int, value: int) -> None:
        """Writes a register."""


class State(Enum):
    """How the processor came to its end at an instant."""

    RUNS = auto()
    SLEEPS = auto()
    SPINS = auto()
    """It waits for something without sleeping."""
    LOCKED = auto()
    """A fault in a fault handler: only a reset ends it."""


class Processor:
    """One processor with its memories. `nvic` is given with each reset: it begins anew."""

    def __init__(
        self, segments: Iterable[tuple[int, bytes]], pages: Iterable[range], bus: Bus
    ) -> None:
        unicorn, arm = needed("unicorn", EXTRA), needed("unicorn.arm_const", EXTRA)
        self.bus = bus
        self._pc_id, self._sp_id = arm.UC_ARM_REG_PC, arm.UC_ARM_REG_SP
        self._lr_id, self._xpsr_id = arm.UC_ARM_REG_LR, arm.UC_ARM_REG_XPSR
        self._primask_id = arm.UC_ARM_REG_PRIMASK
        self._fault = unicorn.UcError
        self._is_instruction_fault = unicorn.UC_ERR_INSN_INVALID
        self._is_fetch_fault = unicorn.UC_ERR_FETCH_UNMAPPED
        self.unicorn = unicorn.Uc(
            unicorn.UC_ARCH_ARM, unicorn.UC_MODE_THUMB | unicorn.UC_MODE_MCLASS,
            arm.UC_CPU_ARM_CORTEX_M4,
        )  # fmt: skip
        for memory in MEMORIES:
            self.unicorn.mem_map(memory.start, len(memory))
        self.unicorn.mem_map(STUBS, 0x1000)
        self.unicorn.mem_write(STUBS, PUSH + POP)
        for page in pages:
            self.unicorn.mmio_map(page.start, len(page), self._read, page.start, self._write,
                                  page.start)  # fmt: skip
        self.unicorn.hook_add(unicorn.UC_HOOK_INTR, self._on_exception)
        self.unicorn.hook_add(unicorn.UC_HOOK_MEM_UNMAPPED, self._on_unmapped)
        for address, content in segments:
            self.unicorn.mem_write(address, content)
            for place in _unmaskings(content):
                self.unicorn.hook_add(unicorn.UC_HOOK_CODE, self._on_unmasked,
                                      begin=address + place, end=address + place)  # fmt: skip
        self.state = State.RUNS
        self.is_stuck = False
        """A fault put in: the main loop does not go on, while interrupts are served."""
        self._pc = self._started_at = self._bad_address = 0
        self._exception, self._is_stopped = 0, False
        self._error: RegisterError | None = None

    def reset(self, nvic: Nvic) -> None:
        """Begins at the reset vector. The memories keep what they have."""
        self.nvic = nvic
        self.state, self.is_stuck = State.RUNS, False
        # The table is at address 0 after reset, where the flash is seen as well.
        stack, entry = struct.unpack("<2I", self.read_memory(FLASH.start, 8))
        for register, value in ((self._sp_id, stack & ~3), (self._lr_id, 0xFFFF_FFFF),
                                (self._xpsr_id, 1 << 24), (self._primask_id, 0)):  # fmt: skip
            self.unicorn.reg_write(register, value)
        self._pc = entry & ~1

    def run(self) -> None:
        """Goes on until it sleeps, or waits without sleeping. CommandError: a register is used
        as it must not be."""
        for _ in range(MOST_ENTRIES):
            number = self.nvic.due()
            if self.state is State.LOCKED:
                return
            if number and self.state is State.SLEEPS:
                self.state = State.RUNS  # with PRIMASK set it wakes as well, and serves nothing
            if number and (number <= HARD_FAULT or not self._is_masked()):
                self._enter(number)
            elif self.state is State.SLEEPS or (self.is_stuck and not self.nvic.active):
                return
            self._go()
            if self.state is State.SPINS:
                self.state = State.RUNS
                return

    def fault(self) -> None:
        """A fault put in: the processor reads an instruction where there is none."""
        self.state = State.RUNS
        self._pc = STUBS + 0x1000

    def read_memory(self, address: int, size: int) -> bytes:
        """Bytes of a memory."""
        return bytes(self.unicorn.mem_read(address, size))

    def write_memory(self, address: int, content: bytes) -> None:
        """As DMA does. RegisterError: there is no memory."""
        try:
            self.unicorn.mem_write(address, content)
        except self._fault as error:
            raise RegisterError(f"DMA: no memory at 0x{address:08X}") from error

    def _go(self) -> None:
        self._exception, self._started_at, self._is_stopped = 0, self._pc, False
        try:
            self.unicorn.emu_start(self._pc | 1, NOWHERE, count=BUDGET)
        except self._fault as error:
            if self._error is None:
                self._pc = self.unicorn.reg_read(self._pc_id)
                self._take_fault(error.errno)
                return
        if self._error is not None:
            error_at, self._error = self._error, None
            place = self.unicorn.reg_read(self._pc_id)
            raise CommandError(f"{error_at}; near PC 0x{place:08X}") from error_at
        self._pc = self.unicorn.reg_read(self._pc_id)
        if self._exception == IS_EXIT:
            self._leave()
        elif self._exception == IS_SVC:
            self.nvic.pend(SVCALL)
        elif self._exception == IS_BREAKPOINT:
            self._take_fault(0)
        elif self._exception == 0 and not self._is_stopped:
            is_asleep = self.read_memory(self._pc - 2, 2) == WFI
            self.state = State.SLEEPS if is_asleep else State.SPINS

    def _is_masked(self) -> bool:
        return bool(self.unicorn.reg_read(self._primask_id))

    def _enter(self, number: int) -> None:
        """Pushes eight words and goes to the handler."""
        sp, xpsr = self.unicorn.reg_read(self._sp_id), self.unicorn.reg_read(self._xpsr_id)
        if sp & 4:  # the frame is at eight bytes, and bit 9 of what is pushed says so
            sp, xpsr = sp - 4, xpsr | ALIGNED
            self.unicorn.reg_write(self._sp_id, sp)
        self.write_memory(sp - 8, struct.pack("<2I", self._pc, xpsr))
        self._run_stub(STUBS, len(PUSH))
        is_nested = bool(self.nvic.active)
        self.nvic.enter(number)
        self._go_to_handler(number, RETURN_TO_HANDLER if is_nested else RETURN_TO_THREAD)

    def _go_to_handler(self, number: int, link: int) -> None:
        self.unicorn.reg_write(self._lr_id, link)
        self.unicorn.reg_write(self._xpsr_id, 1 << 24 | number)
        self._pc = struct.unpack("<I", self.read_memory(self.nvic.vector(number), 4))[0] & ~1

    def _leave(self) -> None:
        """Returns from a handler: to the next one that waits, or to what was interrupted."""
        link = self._pc | 1
        is_nested = link == RETURN_TO_HANDLER
        self.nvic.leave()
        number = self.nvic.due()
        if number and (number <= HARD_FAULT or not self._is_masked()):
            self.nvic.enter(number)
            self._go_to_handler(number, link)
            return
        if is_nested != bool(self.nvic.active) or link not in (RETURN_TO_THREAD, RETURN_TO_HANDLER):
            raise CommandError(f"firmware: returns from a handler by 0x{link:08X}, which is not "
                               "where it came from")  # fmt: skip
        sp = self.unicorn.reg_read(self._sp_id)
        self._pc, xpsr = struct.unpack("<2I", self.read_memory(sp + FRAME - 8, 8))
        self.unicorn.reg_write(self._xpsr_id, xpsr & ~ALIGNED)
        self._run_stub(STUBS + len(PUSH), len(POP))
        if xpsr & ALIGNED:
            self.unicorn.reg_write(self._sp_id, sp + FRAME + 4)

    def _run_stub(self, begin: int, size: int) -> None:
        self.unicorn.emu_start(begin | 1, begin + size)

    def _take_fault(self, error: int) -> None:
        """What was not an instruction, or not memory, as the exception that it is."""
        if error == self._is_instruction_fault:
            kind, status = USAGE_FAULT, 1 << 16
        elif error == self._is_fetch_fault:
            kind, status = BUS_FAULT, 1 << 8
        else:
            kind, status = BUS_FAULT, 1 << 9 | 1 << 15
            self.nvic.value[BFAR] = self._bad_address
        self.nvic.value[CFSR] |= status
        number = self.nvic.fault(kind)
        if number:
            self._enter(number)
        else:
            self.state = State.LOCKED

    def _stop(self) -> None:
        """A hook asks for it, because an exception is due."""
        self._is_stopped = True
        self.unicorn.emu_stop()

    def _read(self, _uc: Any, offset: int, size: int, page: int) -> int:
        try:
            return self.bus.read(page + offset, size)
        except RegisterError as error:
            self._error = error
            self.unicorn.emu_stop()
            return 0

    def _write(self, _uc: Any, offset: int, size: int, value: int, page: int) -> None:
        try:
            self.bus.write(page + offset, size, value)
        except RegisterError as error:
            self._error = error
            self.unicorn.emu_stop()
        if self.nvic.due():
            self._stop()

    def _on_exception(self, _uc: Any, number: int, _data: Any) -> None:
        self._exception = number
        self.unicorn.emu_stop()

    def _on_unmapped(self, _uc: Any, _kind: int, address: int, *_rest: Any) -> bool:
        self._bad_address = address
        return False

    def _on_unmasked(self, _uc: Any, address: int, _size: int, _data: Any) -> None:
        """Behind an instruction that lets interrupts in: what waits comes now."""
        if address != self._started_at and self.nvic.due():
            self._stop()


def _unmaskings(content: bytes) -> list[int]:
    """The places behind each CPSIE i and MSR PRIMASK of a segment. Constants that look alike do
    no harm: nothing is executed there."""
    places = []
    for place in range(0, len(content) - 3, 2):
        if content[place : place + 2] == CPSIE:
            places.append(place + 2)
        elif content[place + 2 : place + 4] == MSR_PRIMASK and content[place + 1] == 0xF3:
            places.append(place + 4)
    return places
