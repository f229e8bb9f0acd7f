"""A mark beside the compiled kernels of the rig: all that this source needs were compiled here.

To find that out by loading them takes a process of its own more than a second, at each start. The
mark names the source by its content, so that a changed file asks for another mark. Where kernels
are missing or damaged in spite of it, the cache compiles them at their first call, and says so.
"""

from __future__ import annotations

import hashlib
from contextlib import suppress
from typing import Any

from meshpoint import rig_sim
from meshpoint.kernels.cache import ABI, MACHINE_CODE, machine, takes_shipped
from meshpoint.kernels.digest import sources_of
from meshpoint.kernels.folder import (
    MARK,
    KernelFolder,
    UnusableEntryError,
    kernel_folders,
    shipped,
)


class CompiledMark:
    """One for each set of kernels."""

    def __init__(self, kernels: str) -> None:
        """kernels: the name of the set."""
        self._kernels = kernels
        self._folders = kernel_folders()

    def is_there(self) -> bool:
        """Whether they were compiled before, or came with the wheel."""
        if takes_shipped() and shipped(self._name(ABI)) is not None:
            return True
        for folder in self._folders:
            with suppress(OSError, UnusableEntryError):
                if folder.read(self._name(MACHINE_CODE)) is not None:
                    return True
        return False

    def set(self) -> None:
        """They have been compiled. Where nothing can be written they are looked for again at the
        next start."""
        for folder in self._folders:
            with suppress(OSError):
                folder.write(self._name(MACHINE_CODE), b"")
                return

    def ship(self, folder: KernelFolder) -> None:
        """They are in this folder of a wheel. OSError where it cannot be written."""
        folder.write(self._name(ABI), b"")

    def _name(self, code: tuple[Any, ...]) -> str:
        about = repr((machine(code), sources_of(rig_sim.__name__)))
        return f"{self._kernels}-{hashlib.sha256(about.encode()).hexdigest()[:24]}{MARK}"
