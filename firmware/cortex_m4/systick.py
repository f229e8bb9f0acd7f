"""SysTick, the processor's own timer (ARMv7-M architecture manual, B3.3)."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar, Final

from meshpoint.firmware.cortex_m4.registers import Peripheral, Register

CTRL, LOAD, VAL, CALIB = 0x10, 0x14, 0x18, 0x1C
ENABLE, TICKINT, PROCESSOR_CLOCK, COUNTFLAG = 1, 1 << 1, 1 << 2, 1 << 16
US_PER_S: Final = 1_000_000


class SysTick(Peripheral):
    """Counts down from LOAD; with zero it pends its exception."""

    TABLE: ClassVar = {
        CTRL: Register("CTRL", ENABLE | TICKINT | PROCESSOR_CLOCK, volatile=COUNTFLAG),
        LOAD: Register("LOAD", 0xFF_FFFF),
        VAL: Register("VAL", 0xFF_FFFF),
        CALIB: Register("CALIB", 0),
    }

    def __init__(self, clock_hz: Callable[[], int], pend: Callable[[], None]) -> None:
        super().__init__("SysTick")
        self._clock_hz, self._pend = clock_hz, pend
        self._begun_us = 0
        self.next_us: int | None = None
        """When it is next at zero."""

    def read(self, offset: int, now_us: int) -> int:
        """CTRL is read with COUNTFLAG, which that clears."""
        value = super().read(offset, now_us)
        if offset == CTRL:
            self.value[CTRL] &= ~COUNTFLAG
        if offset == VAL and self.next_us is not None:
            return (self.next_us - now_us) * self._clock_hz() // US_PER_S
        return value

    def write(self, offset: int, value: int, now_us: int) -> None:
        """Any value to VAL clears it, and counting begins anew."""
        super().write(offset, value, now_us)
        if offset == VAL:
            self.value[VAL] = 0
            self.value[CTRL] &= ~COUNTFLAG
        if offset in (CTRL, VAL):
            self._begin(now_us)

    def step(self, now_us: int) -> None:
        """It is at zero."""
        self.value[CTRL] |= COUNTFLAG
        if self.value[CTRL] & TICKINT:
            self._pend()
        self._begin(now_us)

    def _begin(self, now_us: int) -> None:
        self.next_us = None
        if not self.value[CTRL] & ENABLE or not self.value[LOAD]:
            return
        if not self.value[CTRL] & PROCESSOR_CLOCK:
            raise self.error(CTRL, "CLKSOURCE is 0: the clock divided by 8 is not modelled")
        self.next_us = now_us + (self.value[LOAD] + 1) * US_PER_S // self._clock_hz()
