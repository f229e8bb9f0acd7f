"""The flash's access control (RM0440, chapter FLASH); nothing is programmed."""

from __future__ import annotations

from typing import ClassVar

from meshpoint.firmware.cortex_m4.registers import Peripheral, Register

ACR = 0x00


class Flash(Peripheral):
    """Wait states and caches."""

    TABLE: ClassVar = {ACR: Register("ACR", 0x0004_7F0F, reset=0x0004_0600)}

    @property
    def wait_states(self) -> int:
        """As they are set."""
        return self.value[ACR] & 0xF
