"""--firmware of the commands that have a rig."""

from __future__ import annotations

import argparse
from typing import Final

from meshpoint.base.errors import CommandError
from meshpoint.cli import arguments
from meshpoint.dbc.messages import RigFault
from meshpoint.firmware.board import Firmware

NOT_OF_THE_GEARBOX: Final = frozenset(
    (RigFault.FROZEN_PAYLOAD, RigFault.CLOCK_STEP, RigFault.NODE_RESTART, RigFault.NODE_STALLED)
)
"""Faults of the board that the firmware stands in for."""


def add_firmware(parser: arguments.Arguments) -> None:
    """The argument."""
    parser.add_argument(
        "--firmware",
        choices=[str(each) for each in Firmware],
        help="the board's firmware (docs/firmware.md) between rig and bus, native: built for this "
        "machine by its C compiler, or that of meshpoint[firmware]; cortex-m4: its linked image on "
        "an emulated board, which meshpoint[firmware] brings (default: the rig's own board)",
    )


def firmware_of(namespace: argparse.Namespace) -> Firmware | None:
    """The board that is asked for; CommandError where the run is none for it."""
    if namespace.firmware is None:
        return None
    for fault in arguments.faults_of(namespace):
        if fault.order.kind in NOT_OF_THE_GEARBOX:
            found = RigFault(fault.order.kind).name
            raise CommandError(
                f"--faults: found {found}, a fault of the board that --firmware stands in for; "
                "allowed are faults of the gearbox and its sensors"
            )
    return Firmware(namespace.firmware)
