"""The compilers of `make firmware-tools`: both build for a Cortex-M4, one of them natively too."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from meshpoint.firmware import build
from meshpoint.firmware.native_board import NativeBoard

pytestmark = pytest.mark.device

TARGETS = {
    "ziglang": ("-target", "thumb-freestanding-eabi", "-mcpu=cortex_m4", "-c"),
    "arm-none-eabi-gcc": ("-mcpu=cortex-m4", "-mthumb", "-c"),
}


@pytest.fixture(params=TARGETS)
def compiler(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """The only one that this machine has."""
    name = str(request.param)
    if name == "ziglang":
        pytest.importorskip(name, reason="not installed: `make firmware-tools`")
        monkeypatch.setattr(build.shutil, "which", lambda _: None)
        return name
    if shutil.which(name) is None:
        pytest.skip(f"no {name} here: `make firmware-tools`")
    monkeypatch.setattr(build, "compiler", lambda: [name])
    return name


def test_each_file_is_compiled_for_the_boards_processor_without_a_warning(
    compiler: str, tmp_path: Path
) -> None:
    for file in sorted(build.source_folder().glob("*.c")):
        build.compiled([file], tmp_path / f"{file.stem}.o", TARGETS[compiler])


@pytest.mark.parametrize("compiler", ["ziglang"], indirect=True)
def test_the_compiler_of_the_extra_builds_a_board_that_runs_here(
    compiler: str, tmp_path: Path
) -> None:
    build.compiled(build.sources(build.source_folder()), tmp_path / "firmware.so")
    board = NativeBoard((tmp_path / "firmware.so").read_bytes())
    board.power_on(sensor_us=0)
    board.advance(2_000)
    assert (board.memory.own_us, board.memory.resets) == (2_000, 0)
