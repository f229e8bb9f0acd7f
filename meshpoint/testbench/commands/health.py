"""`meshpoint health`: whether a node is at work, seen from the bus."""

from __future__ import annotations

import argparse
import sys
import time
from typing import Any, Final

from meshpoint.bus.frames import frame_of
from meshpoint.bus.options import add_bus_arguments, open_bus_from
from meshpoint.dbc.link import Receiver
from meshpoint.dbc.messages import ControllerStatus, Message, ValveStatus
from meshpoint.dbc.node import Node
from meshpoint.testbench.exits import Exit

SIGN_OF_LIFE: Final[dict[str, type[Message]]] = {
    "controller": ControllerStatus,
    "rig": ValveStatus,
}
FRAMES: Final = 3
"""One frame may have been on its way when the node died."""


def add_parser(commands: Any) -> None:
    """The command's arguments."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "health",
        description="Listens for the node's cyclic status frame. Exit code 0 when it comes, "
        "1 when it does not; for health checks of containers and services.",
    )
    parser.add_argument("node", choices=tuple(SIGN_OF_LIFE))
    parser.add_argument(
        "--timeout", type=float, default=3.0, metavar="S", help="wall seconds (default: 3)"
    )
    add_bus_arguments(parser)
    parser.set_defaults(run=run)


def run(namespace: argparse.Namespace) -> int:
    """Listens."""
    receiver, kind, heard = Receiver(*Node), SIGN_OF_LIFE[namespace.node], 0
    end_s = time.monotonic() + namespace.timeout
    with open_bus_from(namespace) as bus:
        while heard < FRAMES and (left_s := end_s - time.monotonic()) > 0.0:
            message = bus.recv(left_s)
            if message is None:
                continue
            frame = frame_of(message)
            heard += type(receiver.receive(frame).message) is kind
    if heard == FRAMES:
        print(f"{namespace.node} is at work")
        return Exit.DONE
    print(
        f"meshpoint health: {heard} status frames of the {namespace.node} within "
        f"{namespace.timeout:g} s, {FRAMES} wanted: it does not run, or not on this bus",
        file=sys.stderr,
    )
    return Exit.FAILED
