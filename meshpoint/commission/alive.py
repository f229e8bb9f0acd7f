"""`meshpoint check --alive`: whether a node is at work, seen from the bus."""

from __future__ import annotations

import argparse
import time
from typing import Final

import can

from meshpoint.bus.frames import frame_of
from meshpoint.cli import arguments
from meshpoint.commission.finding import Finding, Verdict
from meshpoint.dbc.link import Receiver
from meshpoint.dbc.messages import ControllerStatus, Message, ValveStatus
from meshpoint.dbc.node import Node

SIGN_OF_LIFE: Final[dict[str, type[Message]]] = {
    "controller": ControllerStatus,
    "rig": ValveStatus,
}
"""The cyclic status frame of each node."""
FRAMES: Final = 3
"""One frame may have been on its way when the node died."""


def judge_alive(bus: can.BusABC, namespace: argparse.Namespace) -> Finding:
    """Listens until the node of --alive is heard, --seconds at most."""
    node, seconds = namespace.alive, namespace.seconds
    unpack = arguments.unpack_all_of(namespace, arguments.sheet_of(namespace))
    receiver, heard = Receiver(*Node), 0
    end_s = time.monotonic() + seconds
    while heard < FRAMES and (left_s := end_s - time.monotonic()) > 0.0:
        message = bus.recv(left_s)
        for frame in () if message is None else unpack(frame_of(message)):
            heard += type(receiver.receive(frame).message) is SIGN_OF_LIFE[node]
    if heard >= FRAMES:
        return Finding("nodes", node, Verdict.GOOD, "at work: its status frames are heard")
    text = (
        f"{heard} status frames within {seconds:g} s, {FRAMES} wanted: it does not run, or not on "
        "this bus"
    )
    return Finding("nodes", node, Verdict.BAD, text)
