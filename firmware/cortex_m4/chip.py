"""The STM32G474: its peripherals at their addresses, and what connects them.

Memory map, requests, interrupts and triggers: RM0440, chapters on memory, DMAMUX, NVIC and ADC
(external triggers); the pins' functions: the data sheet's tables of alternate functions.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Final, NamedTuple, Protocol

from meshpoint.firmware.cortex_m4.adc import Adc, AdcCommon
from meshpoint.firmware.cortex_m4.dma import CHANNELS, Dma, Dmamux
from meshpoint.firmware.cortex_m4.fdcan import Fdcan, MessageRam
from meshpoint.firmware.cortex_m4.flash import Flash
from meshpoint.firmware.cortex_m4.gpio import Gpio, Mode
from meshpoint.firmware.cortex_m4.iwdg import LSI_HZ, Iwdg
from meshpoint.firmware.cortex_m4.nvic import SYSTICK, Nvic
from meshpoint.firmware.cortex_m4.pwr import Pwr
from meshpoint.firmware.cortex_m4.rcc import (
    AHB1ENR,
    AHB2ENR,
    APB1ENR1,
    IWDG_RESET,
    SOFTWARE_RESET,
    Rcc,
)
from meshpoint.firmware.cortex_m4.registers import Peripheral, RegisterError
from meshpoint.firmware.cortex_m4.systick import SysTick
from meshpoint.firmware.cortex_m4.timer import CCR1, GeneralTimer, Timer, WideTimer, Wires

PAGE: Final = 0x1000
PAGES: Final = (
    range(0x4000_0000, 0x4000_8000), range(0x4002_0000, 0x4002_3000),
    range(0x4800_0000, 0x4800_2000), range(0x5000_0000, 0x5000_1000),
    range(0xE000_E000, 0xE000_F000),
)  # fmt: skip
"""Where there are registers."""
SYSTEM: Final = 0xE000_E000
WORD_BYTES: Final = 4
ADC_DATA: Final = 0x40


class TimerPlace(NamedTuple):
    """A timer, and what its signals are elsewhere."""

    kind: type[Timer]
    base: int
    clock_bit: int
    interrupt: int
    request: int
    """DMAMUX: of unit 1; those of the others follow."""
    trigger: int
    """Internal trigger of the other timers (ITR) that its TRGO is."""
    converts: int
    """External trigger of the ADCs (EXTSEL) that its TRGO is."""
    update_request: int
    """DMAMUX: of its update."""


NO_TRIGGER: Final = -1
TIMERS: Final = {
    "TIM2": TimerPlace(WideTimer, 0x4000_0000, 0, 28, 56, 1, 11, 60),
    "TIM3": TimerPlace(GeneralTimer, 0x4000_0400, 1, 29, 61, 2, 4, 65),
    "TIM5": TimerPlace(WideTimer, 0x4000_0C00, 3, 50, 72, 4, NO_TRIGGER, 76),
    "TIM6": TimerPlace(Timer, 0x4000_1000, 4, 54, 0, NO_TRIGGER, 13, 8),
    "TIM7": TimerPlace(Timer, 0x4000_1400, 5, 55, 0, NO_TRIGGER, NO_TRIGGER, 9),
}
TIMER_PINS: Final = {
    ("A", 0, 1): ("TIM2", 1), ("A", 1, 1): ("TIM2", 2), ("B", 10, 1): ("TIM2", 3),
    ("B", 11, 1): ("TIM2", 4), ("A", 6, 2): ("TIM3", 1), ("A", 7, 2): ("TIM3", 2),
    ("B", 0, 2): ("TIM3", 3), ("B", 1, 2): ("TIM3", 4),
}  # fmt: skip
"""Port, pin and alternate function; the timer and its unit."""
SCANNED_BY: Final = "TIM6"
DMA_INTERRUPTS: Final = ((11, 12, 13, 14, 15, 16, 17, 96), (56, 57, 58, 59, 60, 97, 98, 99))
ADC_INTERRUPT: Final = 18
ADC_REQUESTS: Final = {"ADC1": 5, "ADC2": 36}
FDCAN_INTERRUPTS: Final = (21, 22)
FDCAN_PINS: Final = (("A", 11, 9), ("A", 12, 9))
PORTS: Final = "ABCDEFG"
ADC_PINS: Final = {
    "ADC1": {1: ("A", 0), 2: ("A", 1), 3: ("A", 2), 4: ("A", 3), 5: ("B", 14), 6: ("C", 0),
             7: ("C", 1), 8: ("C", 2), 9: ("C", 3), 11: ("B", 12), 12: ("B", 1), 14: ("B", 11),
             15: ("B", 0)},
    "ADC2": {1: ("A", 0), 2: ("A", 1), 3: ("A", 6), 4: ("A", 7), 5: ("C", 4), 6: ("C", 0),
             7: ("C", 1), 8: ("C", 2), 9: ("C", 3), 11: ("C", 5), 12: ("B", 2), 13: ("A", 5),
             14: ("B", 11), 15: ("B", 15), 17: ("A", 4)},
}  # fmt: skip


class Clocked(Protocol):
    """A peripheral that does something by itself."""

    @property
    def next_us(self) -> int | None:
        """When; None where it does not."""

    def step(self, now_us: int) -> None:
        """It is time."""


class Outside(NamedTuple):
    """What the chip has to do with beyond its pins."""

    load: Callable[[int, int], bytes]
    """Reads memory, from an address some bytes."""
    store: Callable[[int, bytes], None]
    """Writes memory."""
    voltages: dict[tuple[str, int], int]
    """At port and pin, 65,520 is full scale."""
    wrote: Callable[[str, int], None]
    """An output register of this port was written, with this value."""
    output: Callable[[tuple[str, int], bool, int], None]
    """A timer has switched this pin to a level, at this time in us."""
    is_free: bool = True
    """Whether TIM6 triggers the ADCs as it comes round; else `Chip.scan` alone does."""
    takes_time: bool = False
    """Whether conversions do."""
    lsi_hz: int = LSI_HZ
    """Of the watchdog's oscillator."""
    sources_ohm: Mapping[tuple[str, int], int] = MappingProxyType({})
    """Before analogue pins, at the most; none where it is not said."""


class Chip:
    """From one reset to the next. Pins and memories are others'."""

    def __init__(self, outside: Outside, now_us: int, why_reset: int) -> None:
        self._outside = outside
        self.now_us = now_us
        self.reset_by = 0
        """The flag of RCC.CSR that says what has asked for a reset since; 0 is nothing."""
        self.flash = Flash("FLASH")
        self.rcc = Rcc(lambda: self.flash.wait_states, why_reset)
        systick = SysTick(self._hclk_hz, lambda: self.nvic.pend(SYSTICK))
        self.nvic = Nvic(systick, lambda: self._ask_reset(SOFTWARE_RESET))
        self.iwdg = Iwdg(lambda: self._ask_reset(IWDG_RESET), outside.lsi_hz)
        self.ports = {name: self._port(name) for name in PORTS}
        self.timers = {name: self._timer(name) for name in TIMERS}
        self.dmamux = Dmamux("DMAMUX")
        self.dmas = tuple(self._dma(number) for number in (1, 2))
        self.adc_common = AdcCommon("ADC12")
        self.adcs = {name: self._adc(name) for name in ADC_REQUESTS}
        self.fdcan = Fdcan(
            "FDCAN1", MessageRam(outside.load, outside.store), lambda: self.rcc.fdcan_hz,
            lambda line, is_high: self.nvic.line(FDCAN_INTERRUPTS[line], is_high),
        )  # fmt: skip
        self._clocked: tuple[Clocked, ...] = (
            systick, self.iwdg, self.fdcan, *self.timers.values(), *self.adcs.values(),
        )  # fmt: skip
        self._map = self._places()
        self._found: dict[int, tuple[Peripheral, int]] = {}

    def read(self, address: int, size: int) -> int:
        """A register. RegisterError: none, or its peripheral has no clock."""
        peripheral, offset = self._found.get(address) or self._find(address)
        if size == WORD_BYTES:
            return peripheral.read(offset, self.now_us)
        if peripheral is not self.nvic:
            raise RegisterError(f"{peripheral.name}: {size} bytes are read; allowed is a word")
        return peripheral.read(offset & ~3, self.now_us) >> (offset & 3) * 8

    def write(self, address: int, size: int, value: int) -> None:
        """As `read`."""
        peripheral, offset = self._found.get(address) or self._find(address)
        if size == WORD_BYTES:
            peripheral.write(offset, value, self.now_us)
        elif peripheral is self.nvic and size == 1:
            self.nvic.write_byte(offset, value)
        else:
            raise RegisterError(f"{peripheral.name}: {size} bytes are written; allowed is a word")
        if peripheral is self.rcc:
            self._found.clear()  # a clock may be off

    @property
    def next_us(self) -> int | None:
        """When something happens without the processor."""
        return min((at for each in self._clocked if (at := each.next_us) is not None), default=None)

    def step(self) -> None:
        """What is due now."""
        for each in self._clocked:
            at_us = each.next_us
            if at_us is not None and at_us <= self.now_us:
                each.step(self.now_us)

    def edges(self, pin: tuple[str, int], *, rising: bool, counts: Sequence[int]) -> None:
        """Edges at a pin, at these counts of the timer that captures them; lost where the pin is
        no input of a timer."""
        found = self._timer_of(pin)
        if found is not None:
            timer, unit = found
            timer.edges(unit, rising, counts)

    def scan(self, at_us: int) -> None:
        """TIM6 has come round once, where it is running: by all clocks it was at this time."""
        if self.timers[SCANNED_BY].is_running:
            now_us, self.now_us = self.now_us, at_us
            self._fetch(SCANNED_BY)
            self.now_us = now_us
            self._convert(TIMERS[SCANNED_BY].converts)

    @property
    def has_can(self) -> bool:
        """Whether the CAN controller's pins are its own."""
        return all(self.ports[port].alternate(pin) == number for port, pin, number in FDCAN_PINS)

    def _fetch(self, timer: str) -> None:
        """A timer's update asks DMA for a value, where it may."""
        if self.timers[timer].asks_dma:
            for channel in self.dmamux.channels(TIMERS[timer].update_request):
                self.dmas[channel // CHANNELS].fetch(channel % CHANNELS)

    def _convert(self, trigger: int) -> None:
        for adc in self.adcs.values():
            adc.trigger(trigger, self.now_us)

    def _adc_hz(self) -> int:
        """The converters' clock; 0 where they have none. That of their own is HCLK's here."""
        divided = self.adc_common.divided_by or int(self.rcc.has_adc_clock)
        return self.rcc.hclk_hz // divided if divided else 0

    def _hclk_hz(self) -> int:
        return self.rcc.hclk_hz

    def _ask_reset(self, why: int) -> None:
        self.reset_by = why

    def _port(self, name: str) -> Gpio:
        return Gpio(f"GPIO{name}", lambda value: self._outside.wrote(name, value))

    def _timer(self, name: str) -> Timer:
        place = TIMERS[name]

        def request(unit: int, values: Sequence[int]) -> bool:
            address = place.base + CCR1 + 4 * (unit - 1)
            return self._request(place.request + unit - 1, address, values)

        def trigger(now_us: int) -> None:
            for other in self.timers.values():
                if isinstance(other, GeneralTimer):
                    other.triggered(place.trigger, now_us)
            if name != SCANNED_BY or self._outside.is_free:
                self._fetch(name)
                self._convert(place.converts)

        def output(unit: int, is_high: bool, now_us: int) -> None:
            for port, pin, number in TIMER_PINS:
                if (
                    TIMER_PINS[port, pin, number] == (name, unit)
                    and self.ports[port].alternate(pin) == number
                ):
                    self._outside.output((port, pin), is_high, now_us)

        wires = Wires(
            lambda is_high: self.nvic.line(place.interrupt, is_high), request, trigger, output
        )
        return place.kind(name, self._hclk_hz, wires)

    def _dma(self, number: int) -> Dma:
        interrupts = DMA_INTERRUPTS[number - 1]
        return Dma(
            f"DMA{number}", lambda address: self.read(address, WORD_BYTES), self._outside.store,
            lambda channel, is_high: self.nvic.line(interrupts[channel], is_high),
        )  # fmt: skip

    def _adc(self, name: str) -> Adc:
        data = 0x5000_0000 + 0x100 * list(ADC_REQUESTS).index(name) + ADC_DATA

        def pin_of(channel: int) -> tuple[str, int]:
            pin = ADC_PINS[name].get(channel)
            if pin is None or self.ports[pin[0]].mode(pin[1]) is not Mode.ANALOG:
                raise RegisterError(f"{name}.SQR1: channel {channel} is no pin in analogue mode")
            return pin

        return Adc(
            name, pin_of, self._outside.voltages,
            lambda values: self._request(ADC_REQUESTS[name], data, values),
            lambda is_high: self.nvic.line(ADC_INTERRUPT, is_high),
            lambda: self._adc_hz(), self._outside.takes_time,
            self._outside.sources_ohm,
        )  # fmt: skip

    def _request(self, request: int, address: int, values: Sequence[int]) -> bool:
        """A request to the channels that serve it."""
        taken = [
            self.dmas[channel // CHANNELS].take(channel % CHANNELS, address, values)
            for channel in self.dmamux.channels(request)
        ]
        return any(taken)

    def _timer_of(self, pin: tuple[str, int]) -> tuple[GeneralTimer, int] | None:
        number = self.ports[pin[0]].alternate(pin[1])
        found = None if number is None else TIMER_PINS.get((*pin, number))
        if found is None:
            return None
        timer = self.timers[found[0]]
        assert isinstance(timer, GeneralTimer)  # noqa: S101 (each of the table is one)
        return timer, found[1]

    def _places(self) -> dict[int, tuple[Peripheral, int, int, int]]:
        """By steps of 256 bytes: the peripheral, its base, and the register and bit of its clock;
        register 0 where it always has one."""
        found: dict[int, tuple[Peripheral, int, int, int]] = {}

        def at(
            peripheral: Peripheral, base: int, size: int, register: int = 0, bit: int = 0
        ) -> None:
            for step in range(base >> 8, base + size + 0xFF >> 8):
                found[step] = peripheral, base, register, bit

        for name, place in TIMERS.items():
            at(self.timers[name], place.base, 0x400, APB1ENR1, place.clock_bit)
        at(self.iwdg, 0x4000_3000, 0x400)
        at(self.fdcan, 0x4000_6400, 0x400, APB1ENR1, 25)
        at(Pwr("PWR"), 0x4000_7000, 0x400, APB1ENR1, 28)
        for i, dma in enumerate(self.dmas):
            at(dma, 0x4002_0000 + 0x400 * i, 0x400, AHB1ENR, i)
        at(self.dmamux, 0x4002_0800, 0x400, AHB1ENR, 2)
        at(self.rcc, 0x4002_1000, 0x400)
        at(self.flash, 0x4002_2000, 0x400)
        for i, port in enumerate(self.ports.values()):
            at(port, 0x4800_0000 + 0x400 * i, 0x400, AHB2ENR, i)
        for i, adc in enumerate(self.adcs.values()):
            at(adc, 0x5000_0000 + 0x100 * i, 0x100, AHB2ENR, 13)
        at(self.adc_common, 0x5000_0300, 0x100, AHB2ENR, 13)
        at(self.nvic, SYSTEM, PAGE)
        return found

    def _find(self, address: int) -> tuple[Peripheral, int]:
        found = self._map.get(address >> 8)
        if found is None:
            raise RegisterError(f"0x{address:08X}: no register of a peripheral that is modelled")
        peripheral, base, register, bit = found
        if register and not self.rcc.is_enabled(register, bit):
            raise RegisterError(f"{peripheral.name}: is used without its clock, bit {bit} of "
                                f"RCC.{self.rcc.TABLE[register].name}")  # fmt: skip
        self._found[address] = peripheral, address - base
        return self._found[address]
