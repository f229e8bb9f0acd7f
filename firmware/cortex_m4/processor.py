"""The Cortex-M4: instructions by unicorn, exceptions as ARMv7-M takes them (B1.5.6 to B1.5.8).

Unicorn knows the instructions of an M-profile processor, and no exception of it: what is pushed,
where the handler is and how it returns is done here. One that the code itself has made pending
comes at the next ISB, as it lets interrupts in, sleeps, or returns from a handler. Code takes no
time, and one that goes on for `BUDGET` instructions without sleeping waits for something: time has
to go on for it. Or its cycles are reported to a clock, and exceptions come between any two blocks.
Not modelled: process stack, floating point registers, BASEPRI, FAULTMASK, memory protection, the
fault of a misaligned LDM or LDRD.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable
from enum import Enum, auto
from typing import Any, Final, Protocol

from meshpoint.base.errors import CommandError
from meshpoint.base.extra import needed
from meshpoint.firmware.build import EXTRA
from meshpoint.firmware.cortex_m4.core_registers import (
    FRAME,
    LR,
    PC,
    PRIMASK,
    SP,
    XPSR,
    CoreRegisters,
)
from meshpoint.firmware.cortex_m4.cycles import ACCESS, EXCEPTION, block_cycles
from meshpoint.firmware.cortex_m4.nvic import (
    BFAR,
    BUS_FAULT,
    CFSR,
    HARD_FAULT,
    SVCALL,
    USAGE_FAULT,
    Nvic,
)
from meshpoint.firmware.cortex_m4.register_pages import map_registers
from meshpoint.firmware.cortex_m4.registers import WORD, RegisterError

FLASH: Final = range(0x0800_0000, 0x0808_0000)
MEMORIES: Final = (
    FLASH, range(len(FLASH)), range(0x2000_0000, 0x2002_0000), range(0x1000_0000, 0x1000_8000),
    range(0x4000_A000, 0x4000_B000),
)  # fmt: skip
"""Flash, and where it is seen after reset; SRAM1, SRAM2 and CCM SRAM in a row; CCM SRAM alone;
the message RAM of the CAN controllers."""
BUDGET: Final = 160_000
"""2 ms at 80 MHz and an instruction a cycle."""
MOST_ENTRIES: Final = 10_000
NOWHERE: Final = 0xFFFF_FFFE
RETURN_TO_HANDLER, RETURN_TO_THREAD = 0xFFFF_FFF1, 0xFFFF_FFF9
ALIGNED: Final = 1 << 9
FRAME_BYTES: Final = 32
THUMB: Final = 1 << 24
NO_MEMORY: Final = 0x1F00_0000
BRANCH_TO_ITSELF: Final = b"\xfe\xe7"
WFI: Final = b"\x30\xbf"
LETS_IN: Final = (b"\x62\xb6", b"\x10\x88", b"\x6f\x8f")
"""CPSIE i, and the ends of MSR PRIMASK and ISB."""
IS_EXIT, IS_BREAKPOINT, IS_SVC = 8, 7, 2
_FRAME: Final = struct.Struct("<8I")


class Bus(Protocol):
    """What lies beyond the memories."""

    nvic: Nvic
    reset_by: int
    """Not 0: a reset was asked for, and the processor stops."""

    def read(self, address: int, size: int) -> int:
        """Reads a register of this many bytes."""

    def write(self, address: int, size: int, value: int) -> None:
        """Writes it."""


class State(Enum):
    """How the processor came to its end at an instant."""

    RUNS = auto()
    SLEEPS = auto()
    SPINS = auto()
    """It waits for something without sleeping."""
    LOCKED = auto()
    """A fault in a fault handler: only a reset ends it."""


class Processor:
    """One processor with its memories. Its bus is given with each reset: it begins anew."""

    def __init__(
        self,
        segments: Iterable[tuple[int, bytes]],
        pages: Iterable[range],
        *,
        counts: bool,
        spend: Callable[[int], bool] | None = None,
    ) -> None:
        """segments: what is in flash. pages: where there are registers. counts: whether
        instructions are counted behind the first sleep too, which makes them three times as slow;
        else a loop there that waits is known by a branch to itself alone.

        spend: where code takes time, called with the cycles before they are spent; whether time
        is at its end, so that nothing more may be done now."""
        self._counts, self._spend = counts, spend
        self._block_cycles: dict[tuple[int, int], int] = {}
        self._paid = 0  # the block that time has ended before: its cycles are spent
        self._is_out_of_time = False
        unicorn, arm = needed("unicorn", EXTRA), needed("unicorn.arm_const", EXTRA)
        self._fault = unicorn.UcError
        self._is_instruction_fault = unicorn.UC_ERR_INSN_INVALID
        self._is_fetch_fault = unicorn.UC_ERR_FETCH_UNMAPPED
        self.unicorn = unicorn.Uc(
            unicorn.UC_ARCH_ARM, unicorn.UC_MODE_THUMB | unicorn.UC_MODE_MCLASS,
            arm.UC_CPU_ARM_CORTEX_M4,
        )  # fmt: skip
        read_only = unicorn.UC_PROT_READ | unicorn.UC_PROT_EXEC
        for memory in MEMORIES:
            protection = read_only if memory.start < FLASH.stop else unicorn.UC_PROT_ALL
            self.unicorn.mem_map(memory.start, len(memory), protection)
        self._callbacks = [
            map_registers(self.unicorn, page, self._read, self._write) for page in pages
        ]
        self._core = CoreRegisters(self.unicorn)
        self._primask = arm.UC_ARM_REG_PRIMASK
        self._wakes_at: set[int] = set()  # behind each WFI
        self._handlers: dict[int, int] = {}
        self.unicorn.hook_add(unicorn.UC_HOOK_INTR, self._on_exception)
        self.unicorn.hook_add(unicorn.UC_HOOK_MEM_INVALID, self._on_bad_access)
        if spend is not None:
            self.unicorn.hook_add(unicorn.UC_HOOK_BLOCK, self._on_block)
        for address, content in segments:
            self.unicorn.mem_write(address, content)
            self.unicorn.mem_write(address - FLASH.start, content)
            self._wakes_at |= {address + place for place in _behind(content, WFI)}
            for place in _behind(content, BRANCH_TO_ITSELF):
                at = address + place - len(BRANCH_TO_ITSELF)
                self.unicorn.hook_add(unicorn.UC_HOOK_CODE, self._on_waiting, begin=at, end=at)
            for place in (place for code in LETS_IN for place in _behind(content, code)):
                self.unicorn.hook_add(unicorn.UC_HOOK_CODE, self._on_let_in,
                                      begin=address + place, end=address + place)  # fmt: skip
        self.state = State.RUNS
        self._is_stuck = False
        self._pc = self._started_at = self._bad_address = 0
        self._exception, self._is_stopped = 0, False
        self._error: RegisterError | None = None

    def reset(self, bus: Bus) -> None:
        """Begins at the reset vector. The memories keep what they have."""
        self._bus, self._nvic = bus, bus.nvic
        self.state, self._is_stuck, self._error = State.RUNS, False, None
        self._budget = 0 if self._spend else BUDGET
        stack, entry = struct.unpack("<2I", self.read_memory(self._nvic.vector(0), 8))
        values = self._core.values
        values[LR], values[XPSR], values[SP], values[PRIMASK] = WORD, THUMB, stack & ~3, 0
        self._core.store()
        self._pc = entry & ~1

    def run(self) -> None:
        """Goes on until it sleeps, or waits without sleeping. CommandError: a register is used
        as it must not be."""
        self._is_out_of_time = False
        for _ in range(MOST_ENTRIES):
            number = self._nvic.due()
            if self.state is State.LOCKED or self._bus.reset_by or self._is_out_of_time:
                return
            if number and self.state is State.SLEEPS:
                self.state = State.RUNS  # with PRIMASK set it wakes as well, and serves nothing
            if number and (number <= HARD_FAULT or not self._core.values[PRIMASK]):
                self._enter(number)
            elif self.state is State.SLEEPS or (self._is_stuck and not self._nvic.active):
                return
            self._go()
            if self.state is State.SPINS:
                self.state = State.RUNS
                if not self._nvic.due() or self._core.values[PRIMASK]:
                    return

    def stick(self, is_stuck: bool) -> None:
        """A fault put in: the main loop does not go on, and lets interrupts in."""
        self._is_stuck = is_stuck
        self._core.values[PRIMASK] = 0
        self._core.store()

    def fault(self) -> None:
        """A fault put in: the processor reads an instruction where there is none."""
        self.state = State.RUNS
        self._pc = NO_MEMORY

    def read_memory(self, address: int, size: int) -> bytes:
        """Bytes of a memory."""
        return bytes(self.unicorn.mem_read(address, size))

    def write_memory(self, address: int, content: bytes) -> None:
        """As DMA and CAN controllers do. RegisterError: there is no memory."""
        try:
            self.unicorn.mem_write(address, content)
        except self._fault as error:
            raise RegisterError(f"no memory at 0x{address:08X}") from error

    def _go(self) -> None:
        """Runs until something ends it."""
        self._exception, self._started_at, self._is_stopped = 0, self._pc, False
        fault = None
        try:
            self.unicorn.emu_start(self._pc | 1, NOWHERE, count=self._budget)
        except self._fault as error:
            fault = error.errno
        self._pc = self._loaded_pc()
        if self._error is not None:
            raise CommandError(f"firmware: {self._error}; at PC 0x{self._pc:08X}")
        if fault is not None or self._exception == IS_BREAKPOINT:
            self._take_fault(fault)
        elif self._exception == IS_EXIT:
            self._leave()
        elif self._exception == IS_SVC:
            self._nvic.pend(SVCALL)
        elif not self._is_stopped:
            self.state = State.SLEEPS if self._pc in self._wakes_at else State.SPINS
            if self.state is State.SLEEPS and not self._counts:
                self._budget = 0  # unicorn's word for no end

    def _enter(self, number: int) -> None:
        """Pushes eight words and goes to the handler."""
        core = self._core.values
        core[PC] = self._pc
        if core[SP] & 4:  # the frame is at eight bytes, and bit 9 of what is pushed says so
            core[SP] -= 4
            core[XPSR] |= ALIGNED
        core[SP] -= FRAME_BYTES
        self.write_memory(core[SP], _FRAME.pack(*core[FRAME]))
        is_nested = bool(self._nvic.active)
        self._nvic.enter(number)
        self._go_to_handler(number, RETURN_TO_HANDLER if is_nested else RETURN_TO_THREAD)
        if self._spend:
            self._is_out_of_time = self._spend(EXCEPTION)

    def _go_to_handler(self, number: int, link: int) -> None:
        core = self._core.values
        core[LR], core[XPSR] = link, THUMB | number
        self._core.store()
        self._pc = self._handler(self._nvic.vector(number))

    def _handler(self, vector: int) -> int:
        """A handler's address; those in flash, at either place, are always the same."""
        found = self._handlers.get(vector)
        if found is None:
            found = struct.unpack("<I", self.read_memory(vector, 4))[0] & ~1
            if vector < FLASH.stop:
                self._handlers[vector] = found
        return found

    def _leave(self) -> None:
        """Returns from a handler: to the next one that waits, or to what was interrupted."""
        link, core = self._pc | 1, self._core.values
        self._nvic.leave()
        if link != (RETURN_TO_HANDLER if self._nvic.active else RETURN_TO_THREAD):
            raise CommandError(f"firmware: returns from a handler by 0x{link:08X}, which is not "
                               "where it came from")  # fmt: skip
        number = self._nvic.due()
        if number and (number <= HARD_FAULT or not core[PRIMASK]):
            self._nvic.enter(number)
            self._go_to_handler(number, link)
            return
        core[FRAME] = list(_FRAME.unpack(self.read_memory(core[SP], FRAME_BYTES)))
        core[SP] += FRAME_BYTES + (4 if core[XPSR] & ALIGNED else 0)
        core[XPSR] &= ~ALIGNED
        self._pc = core[PC]
        self._core.store()

    def _take_fault(self, error: int | None) -> None:
        """What was not an instruction, or not memory, as the exception that it is."""
        if error == self._is_instruction_fault:
            kind, status = USAGE_FAULT, 1 << 16
        elif error == self._is_fetch_fault:
            kind, status = BUS_FAULT, 1 << 8
        else:
            kind, status = BUS_FAULT, 1 << 9 | 1 << 15
            self._nvic.value[BFAR] = self._bad_address
        self._nvic.value[CFSR] |= status
        number = self._nvic.fault(kind)
        if number:
            self._enter(number)
        else:
            self.state = State.LOCKED

    def _stop(self) -> None:
        """A reset or an exception comes, and the processor runs."""
        self._is_stopped = True
        self.unicorn.emu_stop()

    def _read(self, address: int, size: int) -> int:
        if self._spend:
            self._spend(ACCESS)  # between two registers that a block reads time goes on
        try:
            return self._bus.read(address, size)
        except RegisterError as error:
            self._refuse(error)
            return 0

    def _write(self, address: int, size: int, value: int) -> None:
        try:
            self._bus.write(address, size, value)
        except RegisterError as error:
            self._refuse(error)
        if self._bus.reset_by:  # not for an exception: the instruction would be done a second time
            self._stop()

    def _refuse(self, error: RegisterError) -> None:
        self._error = self._error or error
        self._stop()

    def _on_exception(self, _uc: Any, number: int, _data: Any) -> None:
        if number == IS_EXIT and not self._is_stuck:
            self._pc = self._loaded_pc()
            self._leave()
            self._jump()
        else:
            self._exception = number
            self.unicorn.emu_stop()

    def _on_bad_access(self, _uc: Any, _kind: int, address: int, *_rest: Any) -> bool:
        self._bad_address = address
        return False

    def _on_waiting(self, _uc: Any, _address: int, _size: int, _data: Any) -> None:
        """At a branch to itself: nothing comes of it but time."""
        self.unicorn.emu_stop()

    def _on_block(self, _uc: Any, address: int, size: int, _data: Any) -> None:
        """Before a block is executed: its time goes on, unless an exception comes first."""
        if address != self._started_at and self._nvic.due() and not self._is_masked():
            self._stop()
            return
        key = address, size
        cycles = self._block_cycles.get(key)
        if cycles is None:
            cycles = self._block_cycles[key] = block_cycles(self.read_memory(address, size))
        paid, self._paid = self._paid, 0
        is_over = self._spend is not None and paid != address and self._spend(cycles)
        if is_over or self._bus.reset_by:
            self._paid, self._is_out_of_time = address, True
            self._stop()

    def _is_masked(self) -> bool:
        return bool(self.unicorn.reg_read(self._primask))

    def _on_let_in(self, _uc: Any, address: int, _size: int, _data: Any) -> None:
        """Behind an instruction that lets exceptions in: what waits comes now."""
        if address != self._started_at and self._nvic.due():
            self._stop()

    def _loaded_pc(self) -> int:
        self._core.load()
        return self._core.values[PC]

    def _jump(self) -> None:
        """Goes on at another place without an end: to start anew takes 20 us."""
        self._started_at = self._pc
        self._core.jump(self._pc)


def _behind(content: bytes, code: bytes) -> list[int]:
    """The places behind each instruction that ends with this halfword. Constants that look alike do
    no harm: nothing is executed there."""
    return [at + 2 for at in range(0, len(content), 2) if content[at : at + 2] == code]
