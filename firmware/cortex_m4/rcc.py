"""Reset and clock control (RM0440, chapter RCC)."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar, Final

from meshpoint.firmware.cortex_m4.registers import Peripheral, Register, field

CR, CFGR, PLLCFGR, CCIPR, CSR = 0x00, 0x08, 0x0C, 0x88, 0x94
AHB1ENR, AHB2ENR, APB1ENR1, APB2ENR = 0x48, 0x4C, 0x58, 0x60
READY: Final = {8: 10, 16: 17, 24: 25}
"""HSION, HSEON and PLLON of CR, and the bit that says that it runs."""
HSION, HSEON, PLLON = 8, 16, 24
PLLREN: Final = 1 << 24
LSION, LSIRDY, RMVF = 1, 1 << 1, 1 << 23
IWDG_RESET, SOFTWARE_RESET, PIN_RESET, BROWN_OUT_RESET = 1 << 29, 1 << 28, 1 << 26, 1 << 27
HSI_HZ: Final = 16_000_000
HSE_HZ: Final = 24_000_000
"""The crystal of the NUCLEO-G474RE."""
FROM_HSI, FROM_HSE, FROM_PLL = 1, 2, 3
PLL_INPUT_HZ: Final = range(2_660_000, 16_000_001)
PLL_OUTPUT_HZ: Final = range(96_000_000, 344_000_001)
HZ_A_WAIT_STATE: Final = 30_000_000
"""Of the flash, range 1 without boost (RM0440, chapter FLASH, wait states by HCLK)."""
MOST_HZ: Final = 150_000_000


class Rcc(Peripheral):
    """Clocks are ready as soon as they are switched on."""

    TABLE: ClassVar = {
        CR: Register("CR", 0x010D_0300, reset=0x500, volatile=0x0202_0400),
        0x04: Register("ICSCR", 0x7F00_0000, reset=0x4000_0000),
        CFGR: Register("CFGR", 0x7F00_3FF3, reset=5, volatile=0xC),
        PLLCFGR: Register("PLLCFGR", 0xFF73_7FF3, reset=0x1000),
        0x28: Register("AHB1RSTR", 0x111F),
        0x2C: Register("AHB2RSTR", 0x607F),
        0x38: Register("APB1RSTR1", 0x1200_003F),
        0x40: Register("APB2RSTR", 0x0001),
        AHB1ENR: Register("AHB1ENR", 0x111F, reset=0x100),
        AHB2ENR: Register("AHB2ENR", 0x607F),
        0x50: Register("AHB3ENR", 0),
        APB1ENR1: Register("APB1ENR1", 0x1200_0C3F, reset=0x400),
        0x5C: Register("APB1ENR2", 0),
        APB2ENR: Register("APB2ENR", 0x0001),
        CCIPR: Register("CCIPR", 0x3300_0000),
        CSR: Register("CSR", LSION | RMVF, volatile=0xFE00_0002),
    }

    def __init__(self, wait_states: Callable[[], int], why_reset: int) -> None:
        super().__init__("RCC")
        self._wait_states = wait_states
        self.value[CSR] = why_reset
        self.hclk_hz = HSI_HZ
        """Of processor, buses and timers: bus prescalers are not modelled."""

    def is_enabled(self, register: int, bit: int) -> bool:
        """Whether a peripheral has its clock."""
        return bool(self.value[register] >> bit & 1)

    def write(self, offset: int, value: int, now_us: int) -> None:
        """Ready flags follow; RegisterError where a clock is out of its range."""
        if offset == PLLCFGR and self.value[CR] >> PLLON & 1:
            raise self.error(PLLCFGR, "is written while CR.PLLON is 1")
        super().write(offset, value, now_us)
        if offset == CR:
            self._write_control()
        elif offset == CFGR:
            self._switch()
        elif offset == CSR:
            flags = 0 if value & RMVF else self.value[CSR] & 0xFE00_0000
            self.value[CSR] = flags | (LSION | LSIRDY if value & LSION else 0)

    @property
    def fdcan_hz(self) -> int:
        """The kernel clock of the CAN controllers."""
        source = field(self.value[CCIPR], 24, 2)
        if source == 0b01:
            raise self.error(CCIPR, "FDCANSEL is PLL Q, which is not modelled")
        return HSE_HZ if source == 0 else self.hclk_hz

    @property
    def has_adc_clock(self) -> bool:
        """Whether CCIPR gives the ADCs a clock of their own."""
        return field(self.value[CCIPR], 28, 2) != 0

    def _write_control(self) -> None:
        for on, ready in READY.items():
            is_on = self.value[CR] >> on & 1
            self.value[CR] = self.value[CR] & ~(1 << ready) | is_on << ready
        if self.value[CR] >> PLLON & 1:
            self._pll_hz()

    def _pll_hz(self) -> int:
        settings = self.value[PLLCFGR]
        source, bit = {2: (HSI_HZ, HSION), 3: (HSE_HZ, HSEON)}.get(settings & 3, (0, HSION))
        if not source or not self.value[CR] >> bit & 1:
            raise self.error(PLLCFGR, f"PLLSRC is {settings & 3}: no clock that is on")
        into_hz = source // (field(settings, 4, 4) + 1)
        vco_hz = into_hz * field(settings, 8, 7)
        if into_hz not in PLL_INPUT_HZ or vco_hz not in PLL_OUTPUT_HZ:
            raise self.error(
                PLLCFGR, f"PLL from {into_hz} to {vco_hz} Hz; allowed are 2.66 to 16 MHz, and "
                "96 to 344 MHz"
            )  # fmt: skip
        return vco_hz // (2 * field(settings, 25, 2) + 2)

    def _switch(self) -> None:
        """CFGR: SYSCLK is another clock."""
        settings = self.value[CFGR]
        if field(settings, 4, 4) or field(settings, 8, 3) or field(settings, 11, 3):
            raise self.error(CFGR, "bus prescalers are not modelled")
        source = settings & 3
        bit = {FROM_HSI: HSION, FROM_HSE: HSEON, FROM_PLL: PLLON}.get(source)
        has_output = source != FROM_PLL or self.value[PLLCFGR] & PLLREN
        if bit is None or not self.value[CR] >> bit & 1 or not has_output:
            raise self.error(CFGR, f"SW is {source}: a clock that does not run")
        self.hclk_hz = {FROM_HSI: HSI_HZ, FROM_HSE: HSE_HZ}.get(source) or self._pll_hz()
        least = (self.hclk_hz - 1) // HZ_A_WAIT_STATE
        if self.hclk_hz > MOST_HZ or self._wait_states() < least:
            raise self.error(
                CFGR, f"HCLK is {self.hclk_hz} Hz with {self._wait_states()} wait states of the "
                f"flash; needed are {least}, and at most 150 MHz without boost"
            )  # fmt: skip
        self.value[CFGR] = settings & ~0xC | source << 2
