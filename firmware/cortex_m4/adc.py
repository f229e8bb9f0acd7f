"""Analogue inputs (RM0440, chapter ADC): regular sequences, triggered, oversampled, by DMA.

A voltage is given in steps of which 65,520 are full scale. A single conversion has 12 bits of it;
the sum of several is taken to be exact, as the noise of a real input spreads it evenly, and to be
that of the middle of their time.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import ClassVar, Final

from meshpoint.firmware.cortex_m4.registers import Peripheral, Register, field

FULL_SCALE: Final = 65_520
ISR, IER, CR, CFGR, CFGR2, SMPR1, SQR1, DR = 0x00, 0x04, 0x08, 0x0C, 0x10, 0x14, 0x30, 0x40
ADRDY, EOC, EOS, OVR = 1, 1 << 2, 1 << 3, 1 << 4
ADEN, ADDIS, ADSTART, ADSTP = 1, 1 << 1, 1 << 2, 1 << 4
ADVREGEN, DEEPPWD, ADCAL = 1 << 28, 1 << 29, 1 << 31
DMAEN, DMACFG, OVRMOD = 1, 1 << 1, 1 << 12
ROVSE: Final = 1
RISING: Final = 1
FIXED_WHILE_CONVERTING: Final = (CFGR, CFGR2, SMPR1, 0x18, SQR1, 0x34, 0x38, 0x3C)
HALF_CYCLES: Final = (5, 13, 25, 49, 95, 185, 495, 1281)
"""Of the converters' clock that an input is sampled for, by SMPR: 2.5 to 640.5 cycles."""
CONVERTED_IN: Final = 25
"""As much again to convert 12 bits, in half cycles."""
MOST_OHM: Final = (
    (208, 470), (408, 1_200), (791, 1_800), (1_541, 3_900), (4_125, 10_000), (10_675, 33_000),
)  # fmt: skip
"""An input sampled for this number of ns wants no more than this source before it, to settle to
half a step of 12 bits: data sheet of the STM32G474, maximum ADC RAIN, slow channels."""
NS_PER_S, US_PER_S = 1_000_000_000, 1_000_000


class Adc(Peripheral):
    """One converter. It is ready at once; a sequence is converted as it is triggered, at once or in
    its time."""

    TABLE: ClassVar = {
        ISR: Register("ISR", 0x7FF),
        IER: Register("IER", 0x1D),
        CR: Register("CR", 0xF000_001F, reset=DEEPPWD),
        CFGR: Register("CFGR", 0x8000_1FE3, reset=0x8000_0000),
        CFGR2: Register("CFGR2", 0x5FD),
        SMPR1: Register("SMPR1", 0x3FFF_FFFF),
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
        clock_hz: Callable[[], int],
        takes_time: bool,
        sources_ohm: Mapping[tuple[str, int], int],
    ) -> None:
        """pin_of: of a channel. voltages: at pins. request: to DMA, for each value of DR.
        clock_hz: of the ADCs; 0 is none. takes_time: whether conversions do. sources_ohm: what is
        before pins at the most."""
        super().__init__(name)
        self._pin_of, self._voltages, self._request = pin_of, voltages, request
        self._sequence: list[tuple[str, int]] = []
        self._interrupt, self._clock_hz = interrupt, clock_hz
        self._takes_time, self._sources_ohm = takes_time, sources_ohm
        self._times: list[tuple[float, float]] = []  # middle and end of each input's, in us
        self._began_us, self._at, self._sampled = 0, 0, 0  # half steps of the sequence that runs
        self.next_us: int | None = None
        """When an input is next sampled or converted; None where nothing is under way."""

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
            self._control(value, now_us)
        else:
            if offset in FIXED_WHILE_CONVERTING and self.value[CR] & ADSTART:
                raise self.error(offset, "is written while CR.ADSTART is 1")
            super().write(offset, value, now_us)
        self._show()

    def middle_us(self, pins: Sequence[tuple[str, int]]) -> int:
        """From the trigger to the middle of the time in which these are sampled; 0 where they are
        none of the sequence."""
        middles = [
            middle for pin, (middle, _) in zip(self._sequence, self._times, strict=True)
            if pin in pins
        ]  # fmt: skip
        return round(sum(middles) / len(middles)) if middles else 0

    def step(self, now_us: int) -> None:
        """An input is sampled, or its value is there."""
        rank, is_converted = divmod(self._at, 2)
        if not is_converted:
            self._sampled = self._voltages[self._sequence[rank]]
        else:
            self._hand_over([self._one(self._sampled)])
        self._at += 1
        self._plan(now_us)
        if self.next_us is None:
            self._end()

    def trigger(self, number: int, now_us: int) -> None:
        """The external trigger of this number has risen. RegisterError: while it converts."""
        settings = self.value[CFGR]
        if (
            self.value[CR] & ADSTART
            and field(settings, 10, 2) == RISING
            and field(settings, 5, 5) == number
        ):
            self._convert(now_us)

    def _control(self, value: int, now_us: int) -> None:
        state = self.value[CR]
        needed = {
            ADVREGEN: (not value & DEEPPWD, "DEEPPWD is 1"),
            ADCAL: (state & ADVREGEN and not state & ADEN, "ADVREGEN is 0 or ADEN is 1"),
            ADEN: (state & ADVREGEN and not value & ADCAL and self._clock_hz(),
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
            self._set_times([self._rank(rank) for rank in ranks])
        if value & ADSTART and field(self.value[CFGR], 10, 2) == 0:
            self._convert(now_us)
            self.value[CR] &= ~ADSTART

    def _set_times(self, channels: Sequence[int]) -> None:
        """How long each input takes; RegisterError: too short for what is before its pin."""
        clock_hz, begun_us = self._clock_hz(), 0.0
        self._times = []
        for channel, pin in zip(channels, self._sequence, strict=True):
            half_cycles = HALF_CYCLES[field(self.value[SMPR1 + channel // 10 * 4],
                                            channel % 10 * 3, 3)]  # fmt: skip
            sampled_ns = half_cycles * NS_PER_S // (2 * clock_hz)
            most_ohm = max((ohm for ns, ohm in MOST_OHM if ns <= sampled_ns), default=0)
            if self._sources_ohm.get(pin, 0) > most_ohm:
                raise self.error(
                    SMPR1 + channel // 10 * 4,
                    f"channel {channel} is sampled for {sampled_ns} ns, enough for a source of "
                    f"{most_ohm} ohm; its pin has {self._sources_ohm[pin]}",
                )
            lasts_us = self._count * (half_cycles + CONVERTED_IN) * US_PER_S / (2 * clock_hz)
            self._times.append((begun_us + lasts_us / 2, begun_us + lasts_us))
            begun_us += lasts_us

    @property
    def _count(self) -> int:
        """How often an input is converted for a value."""
        settings = self.value[CFGR2]
        return 2 << field(settings, 2, 3) if settings & ROVSE else 1

    def _convert(self, now_us: int) -> None:
        """One sequence."""
        if self.next_us is not None:
            raise self.error(CFGR, "is triggered while it converts")
        if self._takes_time:
            self._began_us, self._at = now_us, 0
            self._plan(now_us)
            return
        self._hand_over([self._one(self._voltages[pin]) for pin in self._sequence])
        self._end()

    def _plan(self, now_us: int) -> None:
        rank, is_converted = divmod(self._at, 2)
        self.next_us = None
        if rank < len(self._times):
            self.next_us = max(now_us, self._began_us + round(self._times[rank][is_converted]))

    def _hand_over(self, values: Sequence[int]) -> None:
        self.value[DR] = values[-1]
        is_taken = bool(self.value[CFGR] & DMAEN) and self._request(values)
        if not is_taken:
            self.value[ISR] |= OVR | EOC if self.value[ISR] & EOC or len(values) > 1 else EOC
        self._show()

    def _end(self) -> None:
        """Of a sequence."""
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
        return (voltage * 4095 * self._count // FULL_SCALE >> field(settings, 5, 4)) & 0xFFFF

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
    def divided_by(self) -> int:
        """CKMODE: the bus clock divided by this is theirs; 0 where it is not."""
        return (0, 1, 2, 4)[field(self.value[0x08], 16, 2)]
