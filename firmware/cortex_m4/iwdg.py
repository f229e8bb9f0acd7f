"""The independent watchdog (RM0440, chapter IWDG), on the 32 kHz oscillator LSI."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar, Final

from meshpoint.firmware.cortex_m4.registers import Peripheral, Register

KR, PR, RLR, SR, WINR = 0x00, 0x04, 0x08, 0x0C, 0x10
START, RELOAD, UNLOCK = 0xCCCC, 0xAAAA, 0x5555
LSI_HZ: Final = 32_000
US_PER_S: Final = 1_000_000
LARGEST: Final = 0xFFF


class Iwdg(Peripheral):
    """Counts down from RLR; at its end, or reloaded above WINR, it resets the chip. Its prescaler
    begins with each reload here; on silicon it runs freely, and the time may be one count less.
    New values of PR, RLR and WINR are there at once, and SR is 0."""

    TABLE: ClassVar = {
        KR: Register("KR", 0xFFFF),
        PR: Register("PR", 7),
        RLR: Register("RLR", LARGEST, reset=LARGEST),
        SR: Register("SR", 0),
        WINR: Register("WINR", LARGEST, reset=LARGEST),
    }

    def __init__(self, reset: Callable[[], None], lsi_hz: int = LSI_HZ) -> None:
        super().__init__("IWDG")
        self._reset, self._lsi_hz = reset, lsi_hz
        self._is_open = self._is_running = False
        self._reloaded_us = 0
        self.next_us: int | None = None
        """When it resets the chip; None where it was not started."""

    def read(self, offset: int, now_us: int) -> int:
        """KR is read as nothing."""
        return 0 if offset == KR else super().read(offset, now_us)

    def write(self, offset: int, value: int, now_us: int) -> None:
        """Keys; the other registers only behind the key that opens them."""
        if offset != KR:
            if not self._is_open:
                raise self.error(offset, "is written without the key 0x5555 in KR before")
            super().write(offset, value, now_us)
            if offset == WINR and self._is_running:
                self._reload(now_us)
            return
        self._is_open = value == UNLOCK
        if value == START:
            self._is_running = True
            self._reload(now_us)
        elif value == RELOAD and self._is_running:
            self._reload_in_window(now_us)
        elif value not in (UNLOCK, RELOAD):
            raise self.error(KR, f"0x{value:04X} is written; allowed are 0xCCCC, 0xAAAA and 0x5555")

    def step(self, now_us: int) -> None:  # noqa: ARG002 (of one form with the others)
        """Nobody has reloaded it."""
        self.next_us = None
        self._reset()

    @property
    def _count_us(self) -> int:
        return (4 << self.value[PR]) * US_PER_S // self._lsi_hz

    def _reload_in_window(self, now_us: int) -> None:
        left = self.value[RLR] - (now_us - self._reloaded_us) // self._count_us
        if left > self.value[WINR]:
            self._reset()
        else:
            self._reload(now_us)

    def _reload(self, now_us: int) -> None:
        self._reloaded_us = now_us
        self.next_us = now_us + (self.value[RLR] + 1) * self._count_us
