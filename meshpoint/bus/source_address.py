"""The controller under another J1939 address than the DBC's.

The DBC has identifiers with source address 3. On a bus where the controller has another one, 3 and
that one change places between the bus and everything of ours: as source of any frame, and as
destination where an identifier has one. So all nodes, tools and logs of ours know the DBC's
identifiers alone; a node of others that has address 3 on the bus is seen under the other address.
"""

from __future__ import annotations

import argparse
from typing import Any, Final

import can

from meshpoint.bus.local.plugin import MeshpointBus
from meshpoint.dbc.j1939 import CONTROLLER, PDU1_TOP, checksum, group_of
from meshpoint.dbc.layout import CODECS

MOST_ADDRESS: Final = 253
"""254 is the address of one that has none, 255 means all."""
TAKEN: Final = frozenset(codec.spec.can_id & 0xFF for codec in CODECS.values()) - {CONTROLLER}
"""Addresses of the other nodes of the DBC."""
SPEED_CONTROL_GROUP: Final = group_of(CODECS["TSC1"].spec.can_id)
CHECKED_LENGTH: Final = 8
CARRIES_NONE: Final = 0xFF
"""The last byte of a TSC1 frame without counter and checksum."""


def source_address(text: str) -> int:
    """An address for the controller, decimal or 0x..; argparse's error where it cannot be one."""
    try:
        address = int(text, 0)
    except ValueError:
        address = -1
    if not 0 <= address <= MOST_ADDRESS or address in TAKEN:
        others = ", ".join(str(one) for one in sorted(TAKEN))
        raise argparse.ArgumentTypeError(
            f"found {text!r}, allowed: 0..{MOST_ADDRESS}, but not {others}, those of other nodes"
        )
    return address


def exchanged(can_id: int, address: int) -> int:
    """A 29-bit identifier with the controller's two addresses in each other's place."""
    places = {CONTROLLER: address, address: CONTROLLER}
    source = can_id & 0xFF
    moved = can_id & ~0xFF | places.get(source, source)
    if can_id >> 16 & 0xFF < PDU1_TOP:
        destination = can_id >> 8 & 0xFF
        moved = moved & ~0xFF00 | places.get(destination, destination) << 8
    return moved


def use_address(bus: can.BusABC, address: int) -> None:
    """From here on this bus's controller has that address. TSC1's checksum covers the identifier:
    one that is right stays right, one that is wrong stays wrong."""
    if address == CONTROLLER:
        return
    inner: Any = bus
    send, receive = inner.send, inner.recv

    def send_moved(message: can.Message, timeout: float | None = None) -> None:
        send(_moved(message, address), timeout)

    def receive_moved(timeout: float | None = None) -> can.Message | None:
        message = receive(timeout)
        return None if message is None else _moved(message, address)

    inner.send, inner.recv = send_moved, receive_moved
    if isinstance(bus, MeshpointBus):
        drain, send_together = inner.drain, inner.send_together
        inner.drain = lambda: [_moved(message, address) for message in drain()]
        inner.send_together = lambda messages, timeout=None: send_together(
            [_moved(message, address) for message in messages], timeout
        )


def _moved(message: can.Message, address: int) -> can.Message:
    before = message.arbitration_id
    if not message.is_extended_id or message.is_error_frame:
        return message
    after = exchanged(before, address)
    if after == before:
        return message
    data = bytes(message.data)
    if group_of(before) == SPEED_CONTROL_GROUP and len(data) == CHECKED_LENGTH:
        data = _rechecked(before, after, data)
    moved = message.__copy__()
    moved.arbitration_id, moved.data = after, bytearray(data)
    return moved


def _rechecked(before: int, after: int, data: bytes) -> bytes:
    """The checksum is off by as much as it was."""
    if data[7] == CARRIES_NONE:
        return data
    counter, reported = data[7] & 0x0F, data[7] >> 4
    change = checksum(after, data, counter) - checksum(before, data, counter)
    return data[:7] + bytes([(reported & 0x08 | (reported + change) & 0x07) << 4 | counter])
