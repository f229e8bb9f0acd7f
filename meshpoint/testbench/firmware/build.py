"""Builds the firmware for this machine, with the board of memory in `firmware/native`."""

from __future__ import annotations

import hashlib
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from meshpoint.kernels.folder import ENTRY, UnusableEntryError, kernel_folders
from meshpoint.testbench.errors import CommandError

PACKAGE: Final = "meshpoint.firmware"
EXTRA: Final = "firmware"
FLAGS: Final = (
    "-std=c11", "-O2", "-ffreestanding", "-Wall", "-Wextra", "-Werror", "-Wconversion",
)  # fmt: skip
SHARED: Final = ("-shared", "-fPIC")
BOTH_IMAGES: Final = ("-DIMAGE_SENSOR=1", "-DIMAGE_VALVE=1")
TEETH: Final = ("-DIMAGE_SENSOR=0", "-DIMAGE_VALVE=0", "-DIMAGE_TEETH=1")
FAILED_LINES: Final = 5
"""Of what the compiler said, as much is shown."""


def compiler() -> list[str]:
    """The C compiler of this machine, or that of the extra. CommandError where there is none."""
    found = shutil.which("cc")
    if found is not None:
        return [found]
    if find_spec("ziglang") is not None:
        return [sys.executable, "-m", "ziglang", "cc"]
    raise CommandError(
        "the firmware is built here, and there is no C compiler: neither cc nor ziglang is "
        f"installed; pip install 'meshpoint[{EXTRA}]'"
    )


def source_folder() -> Path:
    """Where the C sources are. CommandError where this installation has none, as a container's."""
    found = find_spec(PACKAGE)
    if found is None or found.origin is None:
        raise CommandError(f"{PACKAGE}: the firmware's sources are not part of this installation")
    return Path(found.origin).parent


def sources(folder: Path) -> list[Path]:
    """The C files of the board of memory, in a fixed order."""
    return [*sorted(folder.glob("*.c")), folder / "native" / "native.c"]


def compiled(
    files: Sequence[Path], output: Path, flags: Sequence[str] = SHARED,
    image: Sequence[str] = BOTH_IMAGES,
) -> None:  # fmt: skip
    """Compiles the files into `output`. CommandError where that fails, with the first lines of what
    the compiler said."""
    command = [*compiler(), *FLAGS, *image, *flags, "-o", str(output), *map(str, files)]
    try:
        done = subprocess.run(  # noqa: S603 (a compiler of this machine on files of the package)
            command, capture_output=True, text=True, check=False
        )
    except OSError as error:
        raise CommandError(f"{command[0]}: cannot be run: {error.strerror or error}") from error
    if done.returncode:
        said = "\n".join(done.stderr.splitlines()[:FAILED_LINES])
        raise CommandError(f"{command[0]}: the firmware was not compiled:\n{said}")


def library(folder: Path, image: Sequence[str] = BOTH_IMAGES) -> bytes:
    """The firmware as a shared library, from the cache of compiled code where it is there.

    folder: the sources. CommandError: it cannot be built."""
    name = f"firmware-{_digest(folder, image)}{ENTRY}"
    for cache in kernel_folders():
        with suppress(OSError, UnusableEntryError):
            kept = cache.read(name)
            if kept is not None:
                return kept
    with tempfile.TemporaryDirectory() as made:
        output = Path(made) / "firmware.so"
        compiled(sources(folder), output, image=image)
        content = output.read_bytes()
    for cache in kernel_folders():
        with suppress(OSError):
            cache.write(name, content)
            break
    return content


def _digest(folder: Path, image: Sequence[str]) -> str:
    """Of all that decides what is compiled."""
    digest = hashlib.sha256(repr([*compiler(), *FLAGS, *image, sys.platform]).encode())
    for path in sorted(folder.rglob("*.[ch]")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:32]
