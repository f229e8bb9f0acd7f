"""A board that runs the firmware as it is asked for."""

from __future__ import annotations

from meshpoint.testbench.firmware.board import Board, Firmware
from meshpoint.testbench.firmware.build import (
    image,
    installed_cross_compiler,
    library,
    source_folder,
)
from meshpoint.testbench.firmware.cortex_m4.emulated_board import EmulatedBoard
from meshpoint.testbench.firmware.native_board import NativeBoard


def board_of(firmware: Firmware) -> Board:
    """One that is off. CommandError: the firmware cannot be built or run here."""
    folder = source_folder()
    if firmware is Firmware.NATIVE:
        return NativeBoard(library(folder))
    return EmulatedBoard(image(folder, "both", installed_cross_compiler()))
