"""The boards whose firmware can stand between rig and bus, by the names that --firmware takes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from meshpoint.bus.core import Core
from meshpoint.dbc.messages import RigFault
from meshpoint.testbench.firmware.build import library, source_folder
from meshpoint.testbench.firmware.native_board import NativeBoard

NOT_OF_THE_GEARBOX: Final = frozenset(
    (RigFault.FROZEN_PAYLOAD, RigFault.CLOCK_STEP, RigFault.NODE_RESTART, RigFault.NODE_STALLED)
)
"""Faults of the board that the firmware stands in for."""


def _native() -> NativeBoard:
    return NativeBoard(library(source_folder()))


BOARDS: Final[dict[str, Callable[[], NativeBoard]]] = {"native": _native}


def around_rig(name: str | None) -> Callable[[Core], Core]:
    """What puts this board's firmware around a rig; of None, the rig stays as it is. The board is
    built here: CommandError where it cannot be."""
    if name is None:
        return lambda rig: rig
    from meshpoint.testbench.firmware.firmware_rig import FirmwareRig

    board = BOARDS[name]()
    return lambda rig: FirmwareRig(rig, board)
