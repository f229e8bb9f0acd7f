"""The files to flash: what the linker stored, from the first byte of flash on."""

from __future__ import annotations

import shutil
import struct
import subprocess
from pathlib import Path

import pytest

from meshpoint.base.errors import CommandError
from meshpoint.cli.main import main
from meshpoint.firmware.build import (
    CROSS_COMPILERS,
    IMAGES,
    cross_compiler,
    source_folder,
)
from meshpoint.firmware.build import image as linked
from meshpoint.firmware.elf import flash_content, segments

FLASH, RAM = range(0x0800_0000, 0x0808_0000), range(0x2000_0000, 0x2001_8000)


@pytest.fixture(params=CROSS_COMPILERS)
def by(request: pytest.FixtureRequest) -> str:
    try:
        cross_compiler(request.param)
    except CommandError as error:
        pytest.skip(str(error))
    return str(request.param)


@pytest.mark.parametrize("name", IMAGES)
def test_it_begins_with_the_end_of_memory_and_where_to_start(by: str, name: str) -> None:
    parts = segments(linked(source_folder(), IMAGES[name], by))
    content = flash_content(linked(source_folder(), IMAGES[name], by))
    stack_end, reset, nmi = struct.unpack_from("<3I", content)
    assert parts[0].address == FLASH.start
    assert stack_end == RAM.stop
    assert reset & 1, "machine code of a Cortex-M4 is Thumb"
    assert FLASH.start < reset < FLASH.start + len(content)
    assert nmi & 1


def test_it_is_what_objcopy_makes_of_the_image(by: str, tmp_path: Path) -> None:
    objcopy = shutil.which("arm-none-eabi-objcopy")
    if objcopy is None:
        pytest.skip("arm-none-eabi-objcopy is not installed (Debian: binutils-arm-none-eabi)")
    image = linked(source_folder(), IMAGES["both"], by)
    (tmp_path / "both.elf").write_bytes(image)
    subprocess.run([objcopy, "-O", "binary", "both.elf", "both.bin"], cwd=tmp_path, check=True)
    assert flash_content(image) == (tmp_path / "both.bin").read_bytes()


def test_the_files_are_written_where_they_are_asked_for(by: str, tmp_path: Path) -> None:
    assert main(["firmware", "-o", str(tmp_path / "made" / "here"), "--by", by]) == 0
    assert {path.stem for path in (tmp_path / "made" / "here").iterdir()} == set(IMAGES)


def test_for_a_classic_bus_it_is_one_image_by_a_sheet(by: str, tmp_path: Path) -> None:
    assert main(["firmware", "--classic", "truck12", "-o", str(tmp_path), "--by", by]) == 0
    assert [path.name for path in tmp_path.iterdir()] == ["classic.bin"]


def test_a_sheet_that_is_none_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["firmware", "--classic", "nosuch", "-o", str(tmp_path), "--by", "zig"]) == 2
    assert "--classic nosuch: nosuch: no such file" in capsys.readouterr().err


@pytest.mark.parametrize("content", [b"", b"\x7fELF", b"MZ" * 200])
def test_what_is_no_image_is_refused(content: bytes) -> None:
    with pytest.raises(ValueError, match="image"):
        segments(content)


def test_an_image_that_is_cut_short_is_refused(by: str) -> None:
    image = linked(source_folder(), IMAGES["both"], by)
    last = max(segments(image), key=lambda part: part.address)
    end = image.index(last.content) + len(last.content)
    with pytest.raises(ValueError, match="cut short"):
        segments(image[: end - 1])
