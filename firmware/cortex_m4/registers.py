"""A peripheral's registers: 32 bits each, at offsets, with the bits that may be written."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Final, NamedTuple

WORD: Final = 0xFFFF_FFFF


class RegisterError(Exception):
    """A use that silicon would take without a word, and that does not do what was meant."""


class Register(NamedTuple):
    """One register of a table."""

    name: str
    writable: int = WORD
    """Bits that can be written. Others keep their value; to change one of them is an error."""
    reset: int = 0
    volatile: int = 0
    """Bits that the hardware changes: what is written to them is of no effect, and no error."""


class Peripheral:
    """Registers that keep what is written. A peripheral adds what they do."""

    TABLE: ClassVar[Mapping[int, Register]]

    def __init__(self, name: str) -> None:
        self.name = name
        self.value = {offset: register.reset for offset, register in self.TABLE.items()}

    def read(self, offset: int, now_us: int) -> int:  # noqa: ARG002 (clocks need the time)
        """What the processor reads there. RegisterError: there is no register."""
        if offset not in self.value:
            raise RegisterError(f"{self.name}: no register at offset 0x{offset:03X}")
        return self.value[offset]

    def write(self, offset: int, value: int, now_us: int) -> None:  # noqa: ARG002 (as `read`)
        """What the processor writes there. RegisterError: no register, or bits that are none."""
        register = self.TABLE.get(offset)
        if register is None:
            raise RegisterError(f"{self.name}: no register at offset 0x{offset:03X}")
        old = self.value[offset]
        wrong = (value ^ old) & ~(register.writable | register.volatile) & WORD
        if wrong:
            raise self.error(
                offset,
                f"0x{value:08X} is written; bits 0x{wrong:08X} are reserved, "
                "read-only or not modelled",
            )
        self.value[offset] = (value & register.writable) | (old & ~register.writable)

    def error(self, offset: int, found: str) -> RegisterError:
        """An error that names the register."""
        return RegisterError(f"{self.name}.{self.TABLE[offset].name}: {found}")


def field(value: int, low: int, bits: int) -> int:
    """A field of a register, from its lowest bit."""
    return value >> low & (1 << bits) - 1
