"""Whether a bus is free for a rig: two of them would contradict each other."""

from __future__ import annotations

from time import monotonic
from typing import Final

import can

from meshpoint.base.errors import CommandError
from meshpoint.bus.frames import frame_of
from meshpoint.dbc.link import Receiver
from meshpoint.dbc.messages import ControllerStatus, ValveStatus
from meshpoint.dbc.node import Node

LISTEN_S: Final = 0.3
"""So long a bus is listened to before it counts as free."""
CLASSIC_RIG_ID: Final = 0x18FF8080
"""SensorRead: a rig of the classic profile is at work."""
CLASSIC_CONTROLLER_ID: Final = 0x0CFF9103
"""ValveOrders: a controller of the classic profile is."""


def check_no_nodes(bus: can.BusABC) -> None:
    """CommandError where a rig or a controller is at work."""
    _check_free(
        bus,
        (ControllerStatus, ValveStatus),
        (CLASSIC_RIG_ID, CLASSIC_CONTROLLER_ID),
        "other nodes are",
    )


def check_no_rig(bus: can.BusABC) -> None:
    """CommandError where a rig, or a gearbox, is at work."""
    _check_free(bus, (ValveStatus,), (CLASSIC_RIG_ID,), "a gearbox is")


def _check_free(
    bus: can.BusABC, messages: tuple[type, ...], can_ids: tuple[int, ...], who: str
) -> None:
    """Frames of others make the listening no longer."""
    receiver, until_s = Receiver(*Node), monotonic() + LISTEN_S
    while (left_s := until_s - monotonic()) > 0.0:
        message = bus.recv(left_s)
        if message is None:
            continue
        heard = receiver.receive(frame_of(message)).message
        if isinstance(heard, messages) or message.arbitration_id in can_ids:
            raise CommandError(
                f"{who} at work on {bus.channel_info}; `-c` chooses a bus of its own, as "
                "unix:/tmp/other.sock"
            )
