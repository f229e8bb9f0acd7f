"""Timers (RM0440, chapters TIM2/TIM3/TIM4/TIM5 and TIM6/TIM7): counter, capture, compare, trigger.

Counting up alone; no PWM, no DMA but of captures, no preloaded compare value, no encoder, no
capture prescaler. The input filter is taken as nothing. A compare value that equals the counter as
it is written matches one period later: silicon may match at once, and code must not rely on it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import ClassVar, Final, NamedTuple

from meshpoint.firmware.cortex_m4.registers import WORD, Peripheral, Register, field

CR1, CR2, SMCR, DIER, SR, EGR = 0x00, 0x04, 0x08, 0x0C, 0x10, 0x14
CCMR1, CCMR2, CCER, CNT, PSC, ARR, CCR1 = 0x18, 0x1C, 0x20, 0x24, 0x28, 0x2C, 0x34
CEN, UDIS, URS, OPM = 1, 1 << 1, 1 << 2, 1 << 3
UPDATE, TRIGGER = 1, 1 << 6
UPDATE_DMA: Final = 1 << 8
CAPTURE_DMA: Final = 1 << 8
"""Of DIER, shifted by the unit."""
ON_RESET, ON_ENABLE, ON_UPDATE = 0, 1, 2
"""What TRGO says: MMS of CR2."""
TRIGGER_MODE: Final = 6
US_PER_S: Final = 1_000_000
UNITS: Final = (1, 2, 3, 4)
DIRECT, INDIRECT = 1, 2
"""CCxS: a unit captures its own input, or that of its neighbour."""
ACTIVE, INACTIVE, TOGGLE, FORCE_INACTIVE, FORCE_ACTIVE = 1, 2, 3, 4, 5
COMPARE_VALUES: Final = tuple(CCR1 + 4 * i for i in range(len(UNITS)))
FLAGS: Final = 0x1E5F
INTERRUPTS: Final = 0x5F
BASIC: Final = {
    CR1: Register("CR1", 0x088F),
    CR2: Register("CR2", 0x70),
    DIER: Register("DIER", UPDATE_DMA | 1),
    SR: Register("SR", 1),
    EGR: Register("EGR", 1),
    CNT: Register("CNT", 0xFFFF),
    PSC: Register("PSC", 0xFFFF),
    ARR: Register("ARR", 0xFFFF, reset=0xFFFF),
}


class Wires(NamedTuple):
    """Where a timer's signals go."""

    interrupt: Callable[[bool], None]
    dma: Callable[[int, Sequence[int]], bool]
    """A unit's request, for each value of its register. Whether a channel took them."""
    trigger: Callable[[int], None]
    """TRGO has risen, at this time in us."""
    output: Callable[[int, bool, int], None]
    """A unit's output is switched: its level, and the time in us."""


class Timer(Peripheral):
    """A counter of 16 bits: TIM6, TIM7."""

    TABLE: ClassVar[Mapping[int, Register]] = BASIC
    UNITS: ClassVar[tuple[int, ...]] = ()

    def __init__(self, name: str, clock_hz: Callable[[], int], wires: Wires) -> None:
        super().__init__(name)
        self._clock_hz, self._wires = clock_hz, wires
        self._mask = self.TABLE[CNT].writable
        self._base = self._base_us = self._done = 0
        self._rate = (1, 1)
        self._prescaler = 0  # what PSC says counts from the next update on
        self.preset = 0
        """Added to the counter: a clock that began earlier than this timer."""
        self._next_us: int | None = None
        self._is_line_high = False
        self._is_known = True  # whether _next_us is what comes of all that was written

    @property
    def is_running(self) -> bool:
        """Whether it counts."""
        return bool(self.value[CR1] & CEN)

    @property
    def asks_dma(self) -> bool:
        """Whether its update is a request for DMA."""
        return bool(self.value[DIER] & UPDATE_DMA)

    def count(self, now_us: int) -> int:
        """The counter."""
        return (self._base + self.preset + self._ticks(now_us)) % self._period

    def show(self, count: int, now_us: int) -> None:
        """Makes the counter show this, without an event."""
        self.preset += count - self.count(now_us)
        self._is_known = False

    @property
    def next_us(self) -> int | None:
        """When something comes of a count: an interrupt, a trigger, an output."""
        if not self._is_known:
            ticks = [self._next_tick(count) for count in self._awaited()]
            counts, us = self._rate
            self._next_us = self._base_us - (-min(ticks) * us // counts) if ticks else None
            self._is_known = True
        return self._next_us

    def read(self, offset: int, now_us: int) -> int:
        """CNT as it is; SR with all that has come."""
        if offset == CNT:
            return self.count(now_us)
        if offset == SR:
            self.step(now_us)
        return super().read(offset, now_us)

    def write(self, offset: int, value: int, now_us: int) -> None:
        """What has come so far is settled first."""
        self.step(now_us)
        if offset == SR:
            self.value[SR] &= value
        elif offset == EGR:
            super().write(EGR, value, now_us)
            self.value[EGR] = 0
            self._generate(value, now_us)
        elif offset == CNT:
            self._restart(value & self._mask, now_us)
        elif offset == CR1:
            self._write_control(value, now_us)
        else:
            super().write(offset, value, now_us)
            if offset == ARR:
                self._restart(self.count(now_us), now_us)
        self._update_line()
        self._is_known = False

    def start(self, now_us: int) -> None:
        """The counter is enabled."""
        if self.is_running:
            return
        self._restart(self.count(now_us), now_us)
        self.value[CR1] |= CEN
        self._is_known = False
        if self._trigger_output == ON_ENABLE:
            self._wires.trigger(now_us)

    def step(self, now_us: int) -> None:
        """Settles what the counter has come past."""
        if not self.value[CR1] & CEN:
            return
        total = self._ticks(now_us)
        if total == self._done:
            return
        passed = [
            unit for unit in self._comparing() if self._next_tick(self._compare(unit)) <= total
        ]
        updates = self._next_tick(0) <= total
        self._done = total
        for unit in passed:
            self._match(unit, now_us)
        if updates:
            self._update(now_us)
        if passed or updates:
            self._update_line()
        self._is_known = False

    @property
    def _period(self) -> int:
        return self.value[ARR] + 1

    @property
    def _trigger_output(self) -> int:
        return field(self.value[CR2], 4, 3)

    def _ticks(self, now_us: int) -> int:
        """Counts since it began."""
        counts, us = self._rate
        return (now_us - self._base_us) * counts // us if self.value[CR1] & CEN else 0

    def _next_tick(self, count: int) -> int:
        """At which of the counts since it began it next shows this one."""
        first = self._done + 1
        return first + (count - self._base - self.preset - first) % self._period

    def _restart(self, count: int, now_us: int) -> None:
        """Counts on from here."""
        self._base, self._base_us, self._done = count - self.preset, now_us, 0
        clock_hz = self._clock_hz()
        whole, rest = divmod(clock_hz, US_PER_S * (self._prescaler + 1))
        self._rate = (whole, 1) if not rest else (clock_hz, US_PER_S * (self._prescaler + 1))

    def _awaited(self) -> list[int]:
        """The counts of which something comes."""
        if not self.value[CR1] & CEN:
            return []
        enabled = self.value[DIER]
        is_update = enabled & UPDATE or self._trigger_output == ON_UPDATE
        awaited = [0] if is_update or self.value[CR1] & OPM else []
        return awaited + [
            self._compare(unit)
            for unit in self._comparing()
            if enabled & 1 << unit or self._has_output(unit)
        ]

    def _write_control(self, value: int, now_us: int) -> None:
        count, was_running = self.count(now_us), self.is_running
        super().write(CR1, value & ~CEN, now_us)
        if value & CEN and was_running:
            self.value[CR1] |= CEN
        elif value & CEN:
            self.start(now_us)
        elif was_running:
            self._restart(count, now_us)

    def _generate(self, value: int, now_us: int) -> None:
        """EGR: events made by software."""
        if value & UPDATE:
            self._prescaler = self.value[PSC]
            self._restart(self.preset, now_us)
            if not self.value[CR1] & URS:
                self._update(now_us)
        for unit in self.UNITS:
            if value >> unit & 1:
                self._match(unit, now_us)

    def _update(self, now_us: int) -> None:
        if self.value[CR1] & UDIS:
            return
        self.value[SR] |= UPDATE
        if self._prescaler != self.value[PSC]:
            self._prescaler = self.value[PSC]
            self._restart(0, now_us)
        if self.value[CR1] & OPM and self.is_running:
            self.value[CR1] &= ~CEN
            self._restart(0, now_us)
        if self._trigger_output == ON_UPDATE:
            self._wires.trigger(now_us)

    def _update_line(self) -> None:
        is_high = bool(self.value[SR] & self.value[DIER] & INTERRUPTS)
        if is_high != self._is_line_high:
            self._is_line_high = is_high
            self._wires.interrupt(is_high)

    def _comparing(self) -> list[int]:
        """The units that compare, none here."""
        return []

    def _compare(self, unit: int) -> int:
        return self.value[CCR1 + 4 * (unit - 1)]

    def _has_output(self, unit: int) -> bool:  # noqa: ARG002 (there is none here)
        return False

    def _match(self, unit: int, now_us: int) -> None:
        raise NotImplementedError  # a timer without UNITS is never asked; one with them has its own


class GeneralTimer(Timer):
    """Four units of capture and compare in addition, 16 bits: TIM3, TIM4."""

    TABLE: ClassVar = BASIC | {
        CR1: Register("CR1", 0x0B8F),
        CR2: Register("CR2", 0xF8),
        SMCR: Register("SMCR", 0x0030_00F7),
        DIER: Register("DIER", 0x1E5F),
        SR: Register("SR", FLAGS),
        EGR: Register("EGR", 0x5F),
        CCMR1: Register("CCMR1", 0x0101_FFFF),
        CCMR2: Register("CCMR2", 0x0101_FFFF),
        CCER: Register("CCER", 0xBBBB),
        **{CCR1 + 4 * i: Register(f"CCR{i + 1}", 0xFFFF) for i in range(4)},
        0x5C: Register("TISEL", 0),
    }
    UNITS: ClassVar = UNITS

    def __init__(self, name: str, clock_hz: Callable[[], int], wires: Wires) -> None:
        super().__init__(name, clock_hz, wires)
        self.is_high = dict.fromkeys(UNITS, False)
        """The units' outputs."""
        self._comparing_units: list[int] = list(UNITS)

    def triggered(self, trigger: int, now_us: int) -> None:
        """The internal trigger of this number has risen."""
        mode = field(self.value[SMCR], 0, 3) | self.value[SMCR] >> 13 & 8
        selected = field(self.value[SMCR], 4, 3) | self.value[SMCR] >> 17 & 0x18
        if mode == TRIGGER_MODE and selected == trigger:
            self.start(now_us)
            self.value[SR] |= TRIGGER
            self._update_line()

    def edges(self, own_input: int, rising: bool, counts: Sequence[int]) -> None:
        """Edges at an input, each at its count; the oldest first."""
        for unit in UNITS:
            if self._input(unit) == own_input and rising in self._polarities(unit):
                self._capture(unit, [count & self._mask for count in counts])

    def read(self, offset: int, now_us: int) -> int:
        """Reading what was captured clears its flag."""
        if offset == CNT:
            return self.count(now_us)
        value = super().read(offset, now_us)
        unit = (offset - CCR1) // 4 + 1
        if unit in UNITS and self._input(unit):
            self.value[SR] &= ~(1 << unit)
            self._update_line()
        return value

    def write(self, offset: int, value: int, now_us: int) -> None:
        """RegisterError where a mode is asked for that is not modelled."""
        if offset in COMPARE_VALUES:
            self.step(now_us)
            self.value[offset] = value & self._mask
            self._is_known = False
            return
        super().write(offset, value, now_us)
        if offset in (CCMR1, CCMR2):
            self._check_modes(offset)
            self._comparing_units = [unit for unit in UNITS if not self._selection(unit)]
            for unit in self._comparing_units:
                mode = self._mode(unit)
                if mode in (FORCE_ACTIVE, FORCE_INACTIVE):
                    self._drive(unit, mode == FORCE_ACTIVE, now_us)
        elif offset == SMCR and value and field(value, 0, 3) not in (0, TRIGGER_MODE):
            raise self.error(SMCR, f"0x{value:08X}: of slave modes only trigger mode is modelled")
        elif offset == CR2 and self._trigger_output not in (ON_RESET, ON_ENABLE, ON_UPDATE):
            raise self.error(CR2, f"MMS is {self._trigger_output}: only 0 to 2 are modelled")

    def _check_modes(self, offset: int) -> None:
        for half in (0, 8):
            settings = self.value[offset] >> half
            selection = settings & 3
            is_unknown = (
                selection == 3
                or (selection and settings & 0xC)
                or (not selection and (settings & 0x8C or field(settings, 4, 3) > FORCE_ACTIVE))
                or settings & 1 << 16
            )
            if is_unknown:
                raise self.error(
                    offset, f"0x{self.value[offset]:08X}: a mode, preload or capture prescaler "
                    "that is not modelled"
                )  # fmt: skip

    def _settings(self, unit: int) -> int:
        """The byte of CCMRx that a unit has."""
        return self.value[CCMR1 if unit < 3 else CCMR2] >> 8 * ((unit - 1) % 2) & 0xFF

    def _selection(self, unit: int) -> int:
        return self._settings(unit) & 3

    def _mode(self, unit: int) -> int:
        return field(self._settings(unit), 4, 3)

    def _input(self, unit: int) -> int:
        """The input that a unit captures; 0 where it compares."""
        selection = self._selection(unit)
        return {DIRECT: unit, INDIRECT: unit + 1 if unit % 2 else unit - 1}.get(selection, 0)

    def _polarities(self, unit: int) -> tuple[bool, ...]:
        """The edges that an enabled unit captures: rising, falling, or both."""
        bits = field(self.value[CCER], 4 * (unit - 1), 4)
        if not bits & 1:
            return ()
        return {0: (True,), 0b0010: (False,), 0b1010: (True, False)}.get(bits & 0b1010, ())

    def _capture(self, unit: int, counts: Sequence[int]) -> None:
        flag, over = 1 << unit, 1 << unit + 8
        self.value[CCR1 + 4 * (unit - 1)] = counts[-1]
        if self.value[DIER] & CAPTURE_DMA << unit and self._wires.dma(unit, counts):
            return  # DMA reads the register each time, which clears the flag
        if self.value[SR] & flag or len(counts) > 1:
            self.value[SR] |= over
        self.value[SR] |= flag
        self._update_line()

    def _comparing(self) -> list[int]:
        return self._comparing_units

    def _has_output(self, unit: int) -> bool:
        return bool(self.value[CCER] >> 4 * (unit - 1) & 1) and self._mode(unit) in (
            ACTIVE, INACTIVE, TOGGLE,
        )  # fmt: skip

    def _match(self, unit: int, now_us: int) -> None:
        self.value[SR] |= 1 << unit
        mode = self._mode(unit)
        if mode in (ACTIVE, INACTIVE, TOGGLE) and not self._selection(unit):
            self._drive(unit, mode == ACTIVE or (mode == TOGGLE and not self.is_high[unit]), now_us)

    def _drive(self, unit: int, is_high: bool, now_us: int) -> None:
        is_inverted = bool(self.value[CCER] >> 4 * (unit - 1) + 1 & 1)
        is_enabled = bool(self.value[CCER] >> 4 * (unit - 1) & 1)
        if is_high != self.is_high[unit]:
            self.is_high[unit] = is_high
            if is_enabled:
                self._wires.output(unit, is_high != is_inverted, now_us)


class WideTimer(GeneralTimer):
    """The same with 32 bits: TIM2, TIM5."""

    TABLE: ClassVar = GeneralTimer.TABLE | {
        CNT: Register("CNT"),
        ARR: Register("ARR", reset=WORD),
        **{CCR1 + 4 * i: Register(f"CCR{i + 1}") for i in range(4)},
    }
