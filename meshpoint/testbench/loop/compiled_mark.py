"""A mark beside the compiled kernels of the rig: all that this source needs were compiled here.

To find that out by loading them takes a process of its own more than a second, at each start. The
mark names the source by its content, so that a changed file asks for another mark. Where kernels
are missing or damaged in spite of it, the cache compiles them at their first call, and says so.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Final

from meshpoint import rig_sim, units
from meshpoint.kernels.cache import machine
from meshpoint.kernels.folder import (
    MARK,
    KernelFolder,
    UnusableEntryError,
    kernel_folders,
    shipped,
)

SHARED: Final = ("units.py", "kernels", "gearbox")
"""What the rig's kernels use of the product beside its own source."""


class CompiledMark:
    """One for each set of kernels."""

    def __init__(self, kernels: str) -> None:
        """kernels: the name of the set."""
        self._name = f"{kernels}-{_digest(Path(rig_sim.__file__).parent)}{MARK}"
        self._folders = kernel_folders()

    def is_there(self) -> bool:
        """Whether they were compiled before, or came with the wheel."""
        if shipped(self._name) is not None:
            return True
        for folder in self._folders:
            with suppress(OSError, UnusableEntryError):
                if folder.read(self._name) is not None:
                    return True
        return False

    def set(self) -> None:
        """They have been compiled. Where nothing can be written they are looked for again at the
        next start."""
        for folder in self._folders:
            with suppress(OSError):
                self.put_into(folder)
                return

    def put_into(self, folder: KernelFolder) -> None:
        """They are in this folder. OSError where it cannot be written."""
        folder.write(self._name, b"")


def _digest(package: Path) -> str:
    hashed = hashlib.sha256(repr(machine()).encode())
    for path in sorted(_sources(package)):
        hashed.update(path.name.encode() + path.read_bytes())
    return hashed.hexdigest()[:24]


def _sources(package: Path) -> Iterator[Path]:
    yield from package.rglob("*.py")
    for name in SHARED:
        path = Path(units.__file__).parent / name
        yield from path.rglob("*.py") if path.is_dir() else (path,)
