"""Exceptions: NVIC and system control block (ARMv7-M architecture manual, B1.5, B3.2 and B3.4).

Priorities of four bits, as the STM32G4 has them. What an exception pushes and how it returns is in
`processor`."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar, Final

from meshpoint.firmware.cortex_m4.registers import Peripheral, Register
from meshpoint.firmware.cortex_m4.systick import SysTick

RESET, NMI, HARD_FAULT, MEMORY_FAULT, BUS_FAULT, USAGE_FAULT = 1, 2, 3, 4, 5, 6
SVCALL, PENDSV, SYSTICK, FIRST_INTERRUPT = 11, 14, 15, 16
INTERRUPTS: Final = 102
CPUID, ICSR, VTOR, AIRCR, SCR, CCR = 0xD00, 0xD04, 0xD08, 0xD0C, 0xD10, 0xD14
SHPR1, SHCSR, CFSR, HFSR, MMFAR, BFAR, CPACR = 0xD18, 0xD24, 0xD28, 0xD2C, 0xD34, 0xD38, 0xD88
ISER, ICER, ISPR, ICPR, IABR, IPR = 0x100, 0x180, 0x200, 0x280, 0x300, 0x400
BANK: Final = 0x10
"""Four words of 32 interrupts each."""
PRIORITY_BITS: Final = 0xF0
THREAD: Final = 0x100
"""The priority of no exception: each comes before it."""
FIXED: Final = {RESET: -3, NMI: -2, HARD_FAULT: -1}
KEY: Final = 0x05FA
ENABLED_IN_SHCSR: Final = {MEMORY_FAULT: 1 << 16, BUS_FAULT: 1 << 17, USAGE_FAULT: 1 << 18}


def _banks() -> dict[int, Register]:
    table: dict[int, Register] = {}
    for base, name in ((ISER, "ISER"), (ICER, "ICER"), (ISPR, "ISPR"), (ICPR, "ICPR")):
        table |= {base + 4 * i: Register(f"{name}{i}") for i in range(BANK // 4)}
    table |= {IABR + 4 * i: Register(f"IABR{i}", 0) for i in range(BANK // 4)}
    table |= {IPR + 4 * i: Register(f"IPR{i}") for i in range(-(-INTERRUPTS // 4))}
    return table


class Nvic(Peripheral):
    """Which exception comes next. SysTick is in the same page and is reached through it."""

    TABLE: ClassVar = _banks() | {
        0x004: Register("ICTR", 0, reset=3),
        CPUID: Register("CPUID", 0, reset=0x410F_C241),
        ICSR: Register("ICSR"),
        VTOR: Register("VTOR", 0xFFFF_FF80),
        AIRCR: Register("AIRCR", reset=0xFA05_0000),
        SCR: Register("SCR", 1 << 4 | 1 << 2 | 1 << 1),
        CCR: Register("CCR", 0x31B, reset=0x200),
        **{SHPR1 + 4 * i: Register(f"SHPR{i + 1}") for i in range(3)},
        SHCSR: Register("SHCSR", 0x7_0000),
        CFSR: Register("CFSR"),
        HFSR: Register("HFSR"),
        MMFAR: Register("MMFAR"),
        BFAR: Register("BFAR"),
        CPACR: Register("CPACR", 0x00F0_0000),
    }

    def __init__(self, systick: SysTick, reset: Callable[[], None]) -> None:
        super().__init__("SCB")
        self.systick = systick
        self._reset = reset
        self._lines = [False] * INTERRUPTS
        self._pending: set[int] = set()
        self._enabled = {NMI, HARD_FAULT, SVCALL, PENDSV, SYSTICK}
        self._active: list[int] = []
        self.is_deaf = False
        """A fault put in: no interrupt is served."""

    @property
    def active(self) -> int:
        """The exception whose handler runs; 0 in thread mode."""
        return self._active[-1] if self._active else 0

    def line(self, interrupt: int, is_high: bool) -> None:
        """A peripheral's interrupt line. As it rises the interrupt is pending, and stays so though
        it may fall again; where it is high as the handler ends, it is pending once more."""
        if is_high and not self._lines[interrupt]:
            self._pending.add(FIRST_INTERRUPT + interrupt)
        self._lines[interrupt] = is_high

    def pend(self, number: int) -> None:
        """Makes an exception pending."""
        self._pending.add(number)

    def due(self) -> int:
        """The exception that comes before what runs now, or 0. PRIMASK is the processor's."""
        if not self._pending:
            return 0
        best, least = 0, self._running()
        for number in sorted(self._pending & self._enabled):
            if self.is_deaf and number > HARD_FAULT:
                continue
            if self._preempts(number) < least:
                best, least = number, self._preempts(number)
        return best

    def enter(self, number: int) -> None:
        """Its handler begins."""
        self._pending.discard(number)
        self._active.append(number)

    def leave(self) -> None:
        """The handler that runs has ended."""
        number = self._active.pop()
        if number >= FIRST_INTERRUPT and self._lines[number - FIRST_INTERRUPT]:
            self._pending.add(number)

    def fault(self, number: int) -> int:
        """Which exception this fault becomes: HardFault where it is not enabled, or cannot come
        before what runs; 0 is lock-up."""
        allowed = self.value[SHCSR] & ENABLED_IN_SHCSR.get(number, 0)
        if allowed and self._priority(number) < self._running():
            return number
        self.value[HFSR] |= 1 << 30
        return HARD_FAULT if self._running() > FIXED[HARD_FAULT] else 0

    def vector(self, number: int) -> int:
        """Where the handler's address is."""
        return self.value[VTOR] + 4 * number

    def read(self, offset: int, now_us: int) -> int:
        """Bytes and words."""
        if offset < 0x20 and offset != 0x004:
            return self.systick.read(offset, now_us)
        if offset == ICSR:
            return self.active | (SYSTICK in self._pending) << 26 | bool(self._pending) << 22
        bank = offset & ~0xF
        if bank in (ISER, ICER, ISPR, ICPR, IABR):
            held = self._enabled if bank in (ISER, ICER) else self._pending
            return _word(held if bank != IABR else set(self._active), offset)
        return super().read(offset, now_us)

    def write(self, offset: int, value: int, now_us: int) -> None:
        """Words."""
        bank = offset & ~0xF
        if offset < 0x20:
            self.systick.write(offset, value, now_us)
        elif bank in (ISER, ICER, ISPR, ICPR):
            self._write_bank(bank, _numbers(value, offset))
        elif offset == ICSR:
            self._write_icsr(value)
        elif offset == AIRCR:
            self._write_aircr(value)
        elif offset in (CFSR, HFSR):
            self.value[offset] &= ~value
        else:
            super().write(offset, value, now_us)
            if offset == SCR and value & 0b10110:
                raise self.error(SCR, "SLEEPONEXIT, SLEEPDEEP and SEVONPEND are not modelled")

    def write_byte(self, offset: int, value: int) -> None:
        """A byte of a priority register; no other one is written by bytes."""
        word = offset & ~3
        if not (IPR <= word < IPR + INTERRUPTS or SHPR1 <= word < SHCSR):
            raise self.error(word, "is written by a byte; allowed is a word")
        shift = (offset & 3) * 8
        self.value[word] = (self.value[word] & ~(0xFF << shift)) | (value & PRIORITY_BITS) << shift

    def _write_bank(self, bank: int, numbers: set[int]) -> None:
        if bank == ISER:
            self._enabled |= numbers
        elif bank == ICER:
            self._enabled -= numbers
        elif bank == ISPR:
            self._pending |= numbers
        else:
            self._pending -= {each for each in numbers if not self._lines[each - FIRST_INTERRUPT]}

    def _write_icsr(self, value: int) -> None:
        for bit, number, is_set in ((31, NMI, True), (28, PENDSV, True), (26, SYSTICK, True),
                                    (27, PENDSV, False), (25, SYSTICK, False)):  # fmt: skip
            if value >> bit & 1:
                (self._pending.add if is_set else self._pending.discard)(number)

    def _write_aircr(self, value: int) -> None:
        if value >> 16 != KEY:
            raise self.error(AIRCR, f"written with the key 0x{value >> 16:04X}, not 0x{KEY:04X}")
        self.value[AIRCR] = 0xFA05_0000 | value & 0x700
        if value & 1 << 2:
            self._reset()

    def _priority(self, number: int) -> int:
        if number in FIXED:
            return FIXED[number]
        place = (SHPR1 - 4 if number < FIRST_INTERRUPT else IPR - FIRST_INTERRUPT) + number
        return self.value[place & ~3] >> (place & 3) * 8 & PRIORITY_BITS

    def _preempts(self, number: int) -> int:
        """Its priority without the part that only orders what waits (PRIGROUP)."""
        below = 2 << (self.value[AIRCR] >> 8 & 7)
        priority = self._priority(number)
        return priority if priority < 0 else priority // below * below

    def _running(self) -> int:
        return min((self._preempts(each) for each in self._active), default=THREAD)


def _numbers(value: int, offset: int) -> set[int]:
    """The exceptions of a word's bits."""
    first = FIRST_INTERRUPT + (offset & 0xF) * 8
    return {first + bit for bit in range(32) if value >> bit & 1 and first + bit < 16 + INTERRUPTS}


def _word(numbers: set[int], offset: int) -> int:
    """The bits of a word's exceptions."""
    first = FIRST_INTERRUPT + (offset & 0xF) * 8
    return sum(1 << each - first for each in numbers if 0 <= each - first < 32)
