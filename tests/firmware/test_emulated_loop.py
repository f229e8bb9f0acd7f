"""The linked image on the emulated board, between rig and bus: frames as the native build's."""

from __future__ import annotations

import sys
from dataclasses import replace

import pytest
from firmware_bench import emulated_board
from test_loop import SHEET, Driven, bus, idle

from meshpoint.bench.firmware_rig import FirmwareRig
from meshpoint.bench.setup import Setup
from meshpoint.cli.main import main
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.messages import ValveAction, ValveCommand
from meshpoint.firmware import build
from meshpoint.firmware.board import Firmware
from meshpoint.firmware.cortex_m4.emulated_board import EmulatedBoard
from meshpoint.firmware.native_board import NativeBoard
from meshpoint.rig_sim.core import RigCore
from meshpoint.rig_sim.settings import Profile, RigSettings


@pytest.mark.usefixtures("emulated", "built")
def test_every_frame_of_a_shift_is_that_of_the_native_build() -> None:
    """The sensor clock wraps in it; the valves are switched to the microsecond."""
    native = Setup(
        SHEET, ControllerSettings(), seed=2, shifts=1, profile=Profile.TYPICAL,
        firmware=Firmware.NATIVE,
    )  # fmt: skip
    assert bus(replace(native, firmware=Firmware.CORTEX_M4)) == bus(native)


def brake(now_us: int) -> ValveCommand | None:
    """Until 200 ms, and then nothing more is commanded."""
    return ValveCommand(brake_action=ValveAction.ON_NOW) if now_us < 200_000 else None


def frames(board: NativeBoard | EmulatedBoard) -> list[object]:
    """Of a rig that is brought to a speed, and of one that is commanded until it is not."""
    found: list[object] = []
    for command, main_rad_s in ((brake, None), (idle, 60.0)):
        driven = Driven(FirmwareRig(RigCore(SHEET, RigSettings(seed=1)), board))
        driven.run(0, 350_000, command, main_rad_s)
        found += driven.frames
    return found


@pytest.mark.parametrize("by", build.CROSS_COMPILERS)
def test_each_compilers_image_sends_what_the_native_build_sends(built: bytes, by: str) -> None:
    board, native = emulated_board(by), NativeBoard(built)
    assert frames(board) == frames(native)
    assert (board.resets, board.coils_together) == (0, 0)


def refused(capsys: pytest.CaptureFixture[str]) -> str:
    assert main(["simulate", "--shifts", "1", "--firmware", "cortex-m4"]) == 2
    return capsys.readouterr().err


@pytest.mark.usefixtures("emulated")
def test_without_unicorn_it_says_what_brings_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "unicorn", None)
    assert "unicorn is not installed: pip install 'meshpoint[firmware]'" in refused(capsys)


def test_without_a_compiler_for_the_board_it_says_what_brings_one(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(build.shutil, "which", lambda _: None)
    monkeypatch.setattr(build, "find_spec", lambda name: None if name == "ziglang" else find(name))
    said = refused(capsys)
    assert "neither arm-none-eabi-gcc nor ziglang" in said and "'meshpoint[firmware]'" in said


find = build.find_spec
