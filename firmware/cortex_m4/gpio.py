"""Pins (RM0440, chapter GPIO)."""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum
from typing import ClassVar

from meshpoint.firmware.cortex_m4.registers import Peripheral, Register, field

MODER, IDR, ODR, BSRR, AFRL, AFRH, BRR = 0x00, 0x10, 0x14, 0x18, 0x20, 0x24, 0x28
PINS = 0xFFFF


class Mode(IntEnum):
    """MODER of a pin."""

    INPUT = 0
    OUTPUT = 1
    ALTERNATE = 2
    ANALOG = 3


class Gpio(Peripheral):
    """A port of 16 pins. `changed` is called at each write that may change an output."""

    TABLE: ClassVar = {
        MODER: Register("MODER", reset=0xFFFF_FFFF),
        0x04: Register("OTYPER", PINS),
        0x08: Register("OSPEEDR"),
        0x0C: Register("PUPDR"),
        IDR: Register("IDR", 0),
        ODR: Register("ODR", PINS),
        BSRR: Register("BSRR"),
        0x1C: Register("LCKR", 0),
        AFRL: Register("AFRL"),
        AFRH: Register("AFRH"),
        BRR: Register("BRR", PINS),
    }

    def __init__(self, name: str, changed: Callable[[int], None]) -> None:
        super().__init__(name)
        self._changed = changed
        if name == "GPIOA":  # the debugger's pins
            self.value |= {MODER: 0xABFF_FFFF, 0x08: 0x0C00_0000, 0x0C: 0x6400_0000}
        elif name == "GPIOB":
            self.value |= {MODER: 0xFFFF_FEBF, 0x0C: 0x0000_0100}
        self._outputs = 0
        self.levels = 0
        """Of inputs, from outside."""

    def mode(self, pin: int) -> Mode:
        """What a pin is set up as."""
        return Mode(field(self.value[MODER], 2 * pin, 2))

    def alternate(self, pin: int) -> int | None:
        """The number of the alternate function that a pin has; None where it has none."""
        if self.mode(pin) is not Mode.ALTERNATE:
            return None
        return field(self.value[AFRL if pin < 8 else AFRH], 4 * (pin % 8), 4)

    @property
    def driven(self) -> int:
        """The pins that are outputs and high."""
        return self.value[ODR] & self._outputs

    def read(self, offset: int, now_us: int) -> int:
        """IDR: outputs as they are driven, inputs as they are from outside."""
        if offset == IDR:
            return self.driven | (self.levels & ~self._outputs & PINS)
        return 0 if offset in (BSRR, BRR) else super().read(offset, now_us)

    def write(self, offset: int, value: int, now_us: int) -> None:
        """BSRR sets by its lower half and clears by its upper one; setting comes first."""
        if offset == BSRR:
            self.value[ODR] = self.value[ODR] & ~(value >> 16) | (value & PINS)
        elif offset == BRR:
            self.value[ODR] &= ~value
        else:
            super().write(offset, value, now_us)
        if offset == MODER:
            self._outputs = sum(1 << pin for pin in range(16) if self.mode(pin) is Mode.OUTPUT)
        if offset in (MODER, ODR, BSRR, BRR):
            self._changed(value)
