"""Power control (RM0440, chapter PWR): range 1 with or without boost; no low-power mode."""

from __future__ import annotations

from typing import ClassVar

from meshpoint.firmware.cortex_m4.registers import Peripheral, Register


class Pwr(Peripheral):
    """Its voltages are there at once: SR2 says so."""

    TABLE: ClassVar = {
        0x00: Register("CR1", 0x300, reset=0x200),
        0x04: Register("CR2", 0),
        0x08: Register("CR3", 0, reset=0x8000),
        0x10: Register("SR1", 0),
        0x14: Register("SR2", 0, reset=0x100),
        0x80: Register("CR5", 0x100, reset=0x100),
    }
