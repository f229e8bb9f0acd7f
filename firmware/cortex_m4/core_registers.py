"""The processor's registers, all in one call: unicorn's own take 2 us each to find their type."""

from __future__ import annotations

import ctypes
from typing import Any, Final

from meshpoint.base.extra import needed
from meshpoint.firmware.build import EXTRA

NAMES: Final = ("R0", "R1", "R2", "R3", "R12", "LR", "PC", "XPSR", "SP", "PRIMASK")
R0, R1, R2, R3, R12, LR, PC, XPSR, SP, PRIMASK = range(len(NAMES))
FRAME: Final = slice(R0, XPSR + 1)
"""The eight that an exception pushes, in their order on the stack."""
WRITTEN: Final = (R0, R1, R2, R3, R12, LR, XPSR, SP, PRIMASK)
"""All but the program counter, which unicorn is given as it starts."""


class CoreRegisters:
    """What an exception has to do with. `values` is a copy between `load` and `store`."""

    def __init__(self, emulator: Any) -> None:
        arm = needed("unicorn.arm_const", EXTRA)
        self._library = needed("unicorn.unicorn_py3.unicorn", EXTRA).uclib
        self._handle = emulator._uch  # noqa: SLF001 (unicorn has no public name for it)
        self.values = (ctypes.c_uint64 * len(NAMES))()
        begin = ctypes.addressof(self.values)
        size = ctypes.sizeof(ctypes.c_uint64)
        ids = [getattr(arm, f"UC_ARM_REG_{name}") for name in NAMES]
        self._all = _batch(ids, [begin + size * i for i in range(len(NAMES))])
        self._counter = _batch([ids[PC]], [begin + size * PC])
        self._written = _batch([ids[i] for i in WRITTEN], [begin + size * i for i in WRITTEN])

    def load(self) -> None:
        """Takes over what the processor has."""
        self._library.uc_reg_read_batch(self._handle, *self._all)

    def store(self) -> None:
        """Gives it back, but for the program counter."""
        self._library.uc_reg_write_batch(self._handle, *self._written)

    def jump(self, address: int) -> None:
        """Goes on there, from a hook, without an end of what runs."""
        self.values[PC] = address | 1
        self._library.uc_reg_write_batch(self._handle, *self._counter)


def _batch(ids: list[int], places: list[int]) -> tuple[Any, Any, int]:
    return (ctypes.c_int * len(ids))(*ids), (ctypes.c_void_p * len(ids))(*places), len(ids)
