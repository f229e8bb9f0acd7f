"""Programs of the folder `chip` on the emulated chip: what is put in, and what they say."""

from __future__ import annotations

import struct
import subprocess
import tempfile
from functools import cache
from pathlib import Path

from meshpoint.firmware.build import CROSS_COMPILERS, cross_compiler, source_folder
from meshpoint.firmware.cortex_m4.emulated_board import EmulatedBoard

FOLDER = Path(__file__).parent / "chip"
SAID, PART = 0x2000_8000, 0x2000_9000


@cache
def image(name: str, by: str) -> bytes:
    """A program, linked. CommandError where this compiler is not installed."""
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / name
        subprocess.run(
            [*cross_compiler(by), *CROSS_COMPILERS[by], "-std=c11", "-O2", "-ffreestanding",
             "-Wall", "-Wextra", "-Werror", f"-Wl,-T,{source_folder() / 'g474' / 'link.ld'}",
             "-Wl,-e,on_reset", "-o", str(output), str(FOLDER / f"{name}.c")],
            check=True,
        )  # fmt: skip
        return output.read_bytes()


class Program:
    """One that runs. `board` is the chip with its pins."""

    def __init__(self, name: str, by: str, part: int = 0) -> None:
        self.board = EmulatedBoard(image(name, by), is_free=True)
        self.board.processor.write_memory(PART, struct.pack("<I", part))
        self.board.power_on(0)

    @property
    def said(self) -> list[int]:
        """The words that it has said."""
        count = self.words(SAID, 1)[0]
        return self.words(SAID + 4, count)

    def words(self, address: int, count: int) -> list[int]:
        """Of its memory."""
        return list(
            struct.unpack(f"<{count}I", self.board.processor.read_memory(address, 4 * count))
        )

    def halfwords(self, address: int, count: int) -> list[int]:
        """Of its memory."""
        return list(
            struct.unpack(f"<{count}H", self.board.processor.read_memory(address, 2 * count))
        )
