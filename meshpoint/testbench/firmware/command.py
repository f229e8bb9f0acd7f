"""`meshpoint firmware`: the images of the board as files to flash."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from meshpoint.testbench.errors import CommandError
from meshpoint.testbench.exits import Exit
from meshpoint.testbench.firmware.build import CROSS_COMPILERS, IMAGES, image, source_folder
from meshpoint.testbench.firmware.elf import flash_content
from meshpoint.testbench.results.output import folder_for, tell


def add_parser(commands: Any) -> None:
    """The command's arguments."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "firmware",
        description="Builds the firmware of the NUCLEO-G474RE, which reads a gearbox's sensors and "
        "switches its valves: the images sensor, valve, or both on one board, as files for flash "
        "address 0x08000000. Never run on silicon. Pins, wiring, flashing: docs/bench.md",
    )
    parser.add_argument(
        "-o", "--output", type=Path, default=Path("board-images"), metavar="FOLDER",
        help="where the files go (default: %(default)s)",
    )  # fmt: skip
    parser.add_argument(
        "--by", choices=CROSS_COMPILERS, default="zig",
        help="the compiler: ziglang's clang, which pip install 'meshpoint[firmware]' brings, or "
        "Debian's gcc-arm-none-eabi (default: %(default)s)",
    )  # fmt: skip
    parser.set_defaults(run=run)


def run(namespace: argparse.Namespace) -> int:
    """Writes a file an image."""
    folder = folder_for(namespace.output)
    for name, options in IMAGES.items():
        content = flash_content(image(source_folder(), options, namespace.by))
        path = folder / f"{name}.bin"
        try:
            path.write_bytes(content)
        except OSError as error:
            raise CommandError(f"{path}: cannot be written: {error.strerror or error}") from error
        tell(f"{path}: {len(content)} bytes")
    return Exit.DONE
