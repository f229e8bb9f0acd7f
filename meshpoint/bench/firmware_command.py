"""`meshpoint firmware`: the images of the board as files to flash."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from meshpoint.base.errors import CommandError, unwritten
from meshpoint.base.exits import Exit
from meshpoint.bench.firmware_classic import classic_options
from meshpoint.firmware.build import (
    BOTH_IMAGES,
    CROSS_COMPILERS,
    IMAGES,
    image,
    installed_cross_compiler,
    source_folder,
)
from meshpoint.firmware.elf import flash_content
from meshpoint.gearbox import SheetError, load_sheet
from meshpoint.results.output import folder_for, tell


def add_parser(commands: Any) -> None:
    """The command's arguments."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "firmware",
        description="Builds the firmware of the NUCLEO-G474RE, which reads a gearbox's sensors and "
        "switches its valves: the images sensor, valve, and both on one board, and teeth, which "
        "plays a rig's shafts as pulses; files for flash address 0x08000000. Never run on silicon. "
        "Pins, wiring, flashing: docs/bench.md",
    )
    parser.add_argument(
        "-o", "--output", type=Path, default=Path("board-images"), metavar="FOLDER",
        help="where the files go (default: %(default)s)",
    )  # fmt: skip
    parser.add_argument(
        "--by", choices=CROSS_COMPILERS,
        help="the compiler: Debian's gcc-arm-none-eabi, or ziglang's clang, which pip install "
        "'meshpoint[firmware]' brings (default: the first that is installed)",
    )  # fmt: skip
    parser.add_argument(
        "--classic", metavar="SHEET",
        help="for a bus without CAN FD: one image, both sides on one board, of the gearbox with "
        "this data sheet, whose wheels' teeth ETC1 counts (docs/wire.md)",
    )  # fmt: skip
    parser.set_defaults(run=run)


def run(namespace: argparse.Namespace) -> int:
    """Writes a file an image."""
    folder = folder_for(namespace.output)
    by = namespace.by or installed_cross_compiler()
    for name, options in _images(namespace.classic).items():
        content = flash_content(image(source_folder(), options, by))
        path = folder / f"{name}.bin"
        try:
            path.write_bytes(content)
        except OSError as error:
            raise unwritten(path, error) from error
        tell(f"{path}: {len(content)} bytes")
    return Exit.DONE


def _images(sheet: str | None) -> Mapping[str, tuple[str, ...]]:
    """By name; of a classic bus one, of this sheet. CommandError: the sheet cannot be read."""
    if sheet is None:
        return IMAGES
    try:
        return {"classic": (*BOTH_IMAGES, *classic_options(load_sheet(sheet)))}
    except SheetError as error:
        raise CommandError(f"--classic {sheet}: {error}") from error
