"""A board that runs the firmware as it is asked for."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from meshpoint.bench.firmware_rig import FirmwareRig
from meshpoint.bus.core import Core
from meshpoint.bus.profile import WireProfile
from meshpoint.firmware.board import Board, Firmware
from meshpoint.firmware.build import (
    BOTH_IMAGES,
    image,
    installed_cross_compiler,
    library,
    source_folder,
)
from meshpoint.firmware.cortex_m4.emulated_board import EmulatedBoard
from meshpoint.firmware.native_board import NativeBoard
from meshpoint.gearbox import GearboxSheet


def board_of(firmware: Firmware, options: Sequence[str] = ()) -> Board:
    """One that is off, with sensors and valves. CommandError: the firmware cannot be built or run
    here.

    options: of the firmware, beyond those of the image."""
    folder, chosen = source_folder(), (*BOTH_IMAGES, *options)
    if firmware is Firmware.NATIVE:
        return NativeBoard(library(folder, chosen))
    return EmulatedBoard(image(folder, chosen, installed_cross_compiler()))


def around_rig(
    firmware: Firmware, sheet: GearboxSheet, wire: WireProfile
) -> Callable[[Core], Core]:
    """What puts a board with this firmware around a rig of this sheet. The board is made here:
    CommandError as of `board_of`."""
    if wire is WireProfile.FD:
        board = board_of(firmware)
        return lambda rig: FirmwareRig(rig, board)
    from meshpoint.bench.firmware_classic import COMMANDS, ORDERS, classic_options

    classic_board = board_of(firmware, classic_options(sheet))
    return lambda rig: FirmwareRig(rig, classic_board, COMMANDS, ORDERS)
