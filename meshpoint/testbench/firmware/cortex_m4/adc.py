"""Analogue inputs (RM0440, chapter ADC): regular sequences, triggered, oversampled, by DMA.

A voltage is given in steps of which 65,520 are full scale. A single conversion has 12 bits of it; of
2^n summed ones the noise of a real input is taken to spread the sum evenly, so that it is exact.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import ClassVar, Final

from meshpoint.testbench.firmware.cortex_m4.registers import Peripheral, Register, field

FULL_SCALE: Final = 65_520
ISR, IER, CR, CFGR, CFGR2, SQR1, DR = 0x00, 0x04, 0x08, 0x0C, 0x10, 0x30, 0x40
ADRDY, EOC, EOS, OVR = 1, 1 << 2, 1 << 3, 1 << 4
ADEN, ADDIS, ADSTART, ADSTP = 1, 1 << 1, 1 << 2, 1 << 4
ADVREGEN, DEEPPWD, ADCAL = 1 << 28, 1 << 29, 1 << 31
DMAEN, DMACFG, OVRMOD = 1, 1 << 1, 1 << 12
ROVSE: Final = 1
RISING: Final = 1
FIXED_WHILE_CONVERTING: Final = (CFGR, CFGR2, 0x14, 0x18, SQR1, 0x34, 0x38, 0x3C)


class Adc(Peripheral):
    """One converter. It is ready at once; a sequence is converted as it is triggered."""

    TABLE: ClassVar = {
        ISR: Register("ISR", 0x7FF),
        IER: Register("IER", 0x1D),
        CR: Register("CR", 0xF000_001F, reset=DEEPPWD),
        CFGR: Register("CFGR", 0x8000_1FE3, reset=0x8000_0000),
        CFGR2: Register("CFGR2", 0x5FD),
        0x14: Register("SMPR1", 0x3FFF_FFFF),
        0x18: Register("SMPR2", 0x07FF_FFFF),
        SQR1: Register("SQR1", 0x1F7D_F7CF),
        0x34: Register("SQR2", 0x1F7D_F7DF),
        0x38: Register("SQR3", 0x1F7D_F7DF),
        0x3C: Register("SQR4", 0x0000_07DF),
        DR: Register("DR", 0),
        0xB0: Register("DIFSEL", 0),
    }

    def __init__(
        self,
        name: str,
        pin_of: Callable[[int], tuple[str, int]],
        voltages: Mapping[tuple[str, int], int],
        request: Callable[[Sequence[int]], bool],
        interrupt: Callable[[bool], None],
        has_clock: Callable[[], bool],
    ) -> None:
        """pin_of: of a channel. voltages: at pins. request: to DMA, for each value of DR. has_clock: of the ADCs."""
        super().__init__(name)
        self._pin_of, self._voltages, self._request = pin_of, voltages, request
        self._sequence: list[tuple[str, int]] = []
        self._interrupt, self._has_clock = interrupt, has_clock

    def read(self, offset: int, now_us: int) -> int:
        """Reading DR clears EOC."""
        if offset == DR:
            self.value[ISR] &= ~EOC
        return super().read(offset, now_us)

    def write(self, offset: int, value: int, now_us: int) -> None:
        """RegisterError where the order is not kept: regulator, calibration, ADEN, ADSTART."""
        if offset == ISR:
            self.value[ISR] &= ~value
        elif offset == CR:
            self._control(value)
        else:
            if offset in FIXED_WHILE_CONVERTING and self.value[CR] & ADSTART:
                raise self.error(offset, "is written while CR.ADSTART is 1")
            super().write(offset, value, now_us)
        self._show()

    def trigger(self, number: int) -> None:
        """The external trigger of this number has risen."""
        settings = self.value[CFGR]
        if (
            self.value[CR] & ADSTART
            and field(settings, 10, 2) == RISING
            and field(settings, 5, 5) == number
        ):
            self._convert()

    def _control(self, value: int) -> None:
        state = self.value[CR]
        needed = {
            ADVREGEN: (not value & DEEPPWD, "DEEPPWD is 1"),
            ADCAL: (state & ADVREGEN and not state & ADEN, "ADVREGEN is 0 or ADEN is 1"),
            ADEN: (state & ADVREGEN and not value & ADCAL and self._has_clock(),
                   "ADVREGEN is 0, or there is no clock"),
            ADSTART: (state & ADEN, "ADEN is 0"),
        }  # fmt: skip
        for bit, (is_allowed, why) in needed.items():
            if value & bit and not state & bit and not is_allowed:
                raise self.error(CR, f"bit 0x{bit:08X} is set while {why}")
        # Bits that start something are not cleared by writing 0.
        state = (state & (ADEN | ADSTART)) | (value & (ADEN | ADSTART | ADVREGEN | DEEPPWD))
        if value & ADSTP:
            state &= ~ADSTART
        if value & ADDIS:
            state &= ~(ADEN | ADSTART)
        self.value[CR] = state
        if value & ADEN:
            self.value[ISR] |= ADRDY
        if value & ADSTART:
            ranks = range(1, field(self.value[SQR1], 0, 4) + 2)
            self._sequence = [self._pin_of(self._rank(rank)) for rank in ranks]
        if value & ADSTART and field(self.value[CFGR], 10, 2) == 0:
            self._convert()
            self.value[CR] &= ~ADSTART

    def _convert(self) -> None:
        """One sequence."""
        values = [self._one(self._voltages[pin]) for pin in self._sequence]
        self.value[DR] = values[-1]
        is_taken = bool(self.value[CFGR] & DMAEN) and self._request(values)
        if not is_taken:
            self.value[ISR] |= OVR | EOC if self.value[ISR] & EOC or len(values) > 1 else EOC
        self.value[ISR] |= EOS
        self._show()

    def _rank(self, number: int) -> int:
        """The channel at a place of the sequence, from 1."""
        register, place = divmod(number, 5)
        return field(self.value[SQR1 + 4 * register], 6 * place, 5)

    def _one(self, voltage: int) -> int:
        settings = self.value[CFGR2]
        if not settings & ROVSE:
            return voltage * 4095 // FULL_SCALE
        count = 2 << field(settings, 2, 3)
        return (voltage * 4095 * count // FULL_SCALE >> field(settings, 5, 4)) & 0xFFFF

    def _show(self) -> None:
        self._interrupt(bool(self.value[ISR] & self.value[IER]))


class AdcCommon(Peripheral):
    """What two converters have in common."""

    TABLE: ClassVar = {
        0x00: Register("CSR", 0),
        0x08: Register("CCR", 0x01FF_0000),
        0x0C: Register("CDR", 0),
    }

    @property
    def has_clock(self) -> bool:
        """CKMODE: whether the bus clock is theirs."""
        return field(self.value[0x08], 16, 2) != 0
