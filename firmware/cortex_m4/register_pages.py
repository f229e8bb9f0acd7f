"""Registers by callback, straight from unicorn's library: its own wrapper costs as much again."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any

from meshpoint.base.extra import needed
from meshpoint.firmware.build import EXTRA


def map_registers(
    emulator: Any,
    page: range,
    read: Callable[[int, int], int],
    write: Callable[[int, int, int], None],
) -> tuple[Any, Any]:
    """Each access to this page becomes a call, with address, size in bytes and value. What is
    returned has to be kept as long as the emulator. Nothing may be raised."""
    module = needed("unicorn.unicorn_py3.unicorn", EXTRA)
    base = page.start

    def on_read(_emulator: int, offset: int, size: int, _data: int) -> int:
        return read(base + offset, size)

    def on_write(_emulator: int, offset: int, size: int, value: int, _data: int) -> None:
        write(base + offset, size, value)

    kinds = (module.MMIO_READ_CFUNC, on_read), (module.MMIO_WRITE_CFUNC, on_write)
    reader, writer = (ctypes.cast(kind(function), kind) for kind, function in kinds)
    handle = emulator._uch  # noqa: SLF001 (unicorn has no public name for it)
    module.uclib.uc_mmio_map(handle, base, len(page), reader, 0, writer, 0)
    return reader, writer
