"""A board that runs the firmware as it is asked for."""

from __future__ import annotations

from collections.abc import Callable

from meshpoint.bus.core import Core
from meshpoint.testbench.firmware.board import Board, Firmware
from meshpoint.testbench.firmware.build import (
    image,
    installed_cross_compiler,
    library,
    source_folder,
)
from meshpoint.testbench.firmware.cortex_m4.emulated_board import EmulatedBoard
from meshpoint.testbench.firmware.firmware_rig import FirmwareRig
from meshpoint.testbench.firmware.native_board import NativeBoard


def board_of(firmware: Firmware) -> Board:
    """One that is off. CommandError: the firmware cannot be built or run here."""
    folder = source_folder()
    if firmware is Firmware.NATIVE:
        return NativeBoard(library(folder))
    return EmulatedBoard(image(folder, "both", installed_cross_compiler()))


def around_rig(firmware: Firmware | None) -> Callable[[Core], Core]:
    """What puts a board with this firmware around a rig; of None, the rig stays as it is. The board
    is made here: CommandError as of `board_of`."""
    if firmware is None:
        return lambda rig: rig
    board = board_of(firmware)
    return lambda rig: FirmwareRig(rig, board)
