"""Builds the firmware: for this machine, with the board of memory in `firmware/native`, and as the
images of the board in `firmware/g474`."""

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

from meshpoint.base.errors import CommandError
from meshpoint.kernels.folder import ENTRY, UnusableEntryError, kernel_folders

PACKAGE: Final = "meshpoint.firmware"
EXTRA: Final = "firmware"
FLAGS: Final = (
    "-std=c11", "-O2", "-ffreestanding", "-Wall", "-Wextra", "-Werror", "-Wconversion",
)  # fmt: skip
SHARED: Final = ("-shared", "-fPIC")
IMAGES: Final = {
    "both": ("-DIMAGE_SENSOR=1", "-DIMAGE_VALVE=1"),
    "sensor": ("-DIMAGE_SENSOR=1", "-DIMAGE_VALVE=0"),
    "valve": ("-DIMAGE_SENSOR=0", "-DIMAGE_VALVE=1"),
    "teeth": ("-DIMAGE_SENSOR=0", "-DIMAGE_VALVE=0", "-DIMAGE_TEETH=1"),
}
"""Of one tree of sources."""
BOTH_IMAGES: Final = IMAGES["both"]
LINKED: Final = ("-ffunction-sections", "-fdata-sections", "-Wl,--gc-sections", "-Wl,-e,on_reset")
CROSS_COMPILERS: Final = {
    "gcc": ("-mcpu=cortex-m4", "-mthumb", "-nostdlib", "-Wl,--no-warn-rwx-segments"),
    "zig": ("-target", "thumb-freestanding-eabi", "-g0", "-mcpu=cortex_m4", "-mfloat-abi=soft"),
}
"""Debian's gcc-arm-none-eabi, and ziglang's clang, with what each alone wants."""
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


def cross_compiler(name: str) -> list[str]:
    """One of CROSS_COMPILERS. CommandError where it is not installed."""
    if name == "gcc" and shutil.which("arm-none-eabi-gcc") is not None:
        return ["arm-none-eabi-gcc"]
    if name == "zig" and find_spec("ziglang") is not None:
        return [sys.executable, "-m", "ziglang", "cc"]
    raise CommandError(
        {
            "gcc": "arm-none-eabi-gcc is not installed (Debian: gcc-arm-none-eabi)",
            "zig": f"ziglang is not installed: pip install 'meshpoint[{EXTRA}]'",
        }[name]
        + "; the firmware needs it for the board's image"
    )


def installed_cross_compiler() -> str:
    """The first of CROSS_COMPILERS that is installed. CommandError where none is."""
    for name in CROSS_COMPILERS:
        with suppress(CommandError):
            cross_compiler(name)
            return name
    raise CommandError(
        "the firmware needs a compiler for the board's image, and neither arm-none-eabi-gcc nor "
        f"ziglang is installed: pip install 'meshpoint[{EXTRA}]'"
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
    files: Sequence[Path],
    output: Path,
    flags: Sequence[str] = SHARED,
    options: Sequence[str] = BOTH_IMAGES,
) -> None:
    """Compiles the files into `output`, with these options of the firmware. CommandError where that
    fails, with the first lines of what the compiler said."""
    _run([*compiler(), *FLAGS, *options, *flags], files, output)


def _run(command: list[str], files: Sequence[Path], output: Path) -> None:
    try:
        done = subprocess.run(  # noqa: S603 (a compiler of this machine on files of the package)
            [*command, "-o", str(output), *map(str, files)],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
    except OSError as error:
        raise CommandError(f"{command[0]}: cannot be run: {error.strerror or error}") from error
    if done.returncode:
        said = "\n".join(done.stderr.splitlines()[:FAILED_LINES])
        raise CommandError(f"{command[0]}: the firmware was not compiled:\n{said}")


def library(folder: Path, options: Sequence[str] = BOTH_IMAGES) -> bytes:
    """The firmware as a shared library, from the cache of compiled code where it is there.

    folder: the sources; options: of the firmware, one of IMAGES. CommandError: it cannot be
    built."""
    return _kept(folder, [*compiler(), *FLAGS, *options, *SHARED], sources(folder))


def image(folder: Path, options: Sequence[str], by: str) -> bytes:
    """An image linked for the board, as an ELF file.

    folder: the sources; options: of the firmware, those of one of IMAGES among them; by: one of
    CROSS_COMPILERS. CommandError: it cannot be built."""
    board = folder / "g474"
    command = [
        *cross_compiler(by), *FLAGS, *CROSS_COMPILERS[by], *options, *LINKED,
        f"-Wl,-T,{board / 'link.ld'}",
    ]  # fmt: skip
    files = [*sorted(folder.glob("*.c")), *sorted(board.glob("*.c"))]
    return _kept(folder, command, files)


def _kept(folder: Path, command: list[str], files: Sequence[Path]) -> bytes:
    """What this command makes of these files, from the cache or into it."""
    name = f"firmware-{_digest(folder, command)}{ENTRY}"
    for cache in kernel_folders():
        with suppress(OSError, UnusableEntryError):
            kept = cache.read(name)
            if kept is not None:
                return kept
    with tempfile.TemporaryDirectory() as made:
        output = Path(made) / "firmware"
        _run(command, files, output)
        content = output.read_bytes()
    for cache in kernel_folders():
        with suppress(OSError):
            cache.write(name, content)
            break
    return content


def _digest(folder: Path, command: list[str]) -> str:
    """Of all that decides what is compiled."""
    digest = hashlib.sha256(repr([*command, sys.platform]).encode())
    for path in sorted((*folder.rglob("*.[ch]"), *folder.rglob("*.ld"))):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:32]
