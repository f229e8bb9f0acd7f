"""What J1939 adds to an identifier: parameter group, destination, source; TSC1's checksum; and
torques in whole per cent and eighths.

The DBC has one identifier a message, with one source address. A truck's tools send the same
parameter group from addresses of their own, and to all.
"""

from __future__ import annotations

import math
from typing import Final

from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS

CONTROLLER: Final = 0x03
"""Source address of transmission 1."""
GLOBAL: Final = 0xFF
ADDRESS_CLAIM: Final = 0xEE00
"""Parameter group of J1939-81's address claimed."""
REQUEST: Final = 0xEA00
"""Parameter group of J1939-21's request for another group."""
PDU1_TOP: Final = 240
"""PDU formats below this have a destination in the identifier's second byte."""
XCP_COMMAND_ID: Final = 0x18EF03F9
XCP_RESPONSE_ID: Final = 0x18EFF903
"""Proprietary A (parameter group 0xEF00) between the controller and an off-board tool (0xF9). XCP
packets have any length and no fixed signals, so they are not in the DBC."""
REQUEST_ID: Final = CODECS["TC1"].spec.can_id
_GROUP: Final = 0x03FF_0000
_OF_REQUEST: Final = REQUEST_ID & _GROUP
COUNTER_MODULUS: Final = 8
"""TSC1's message counter runs from 0 to 7."""
PER_CENT: Final = 0.01
EIGHTH: Final = PER_CENT / 8.0
"""The steps of a torque without and with its fine part, as shares of the reference torque."""


def torque_parts(share: float) -> tuple[float, float]:
    """A torque (share of the reference torque) in whole per cent (SPN 513, 518), rounded down, and
    what is to be added to it in eighths of a per cent (SPN 4154, 4191)."""
    eighths = round(share / EIGHTH)
    return PER_CENT * math.floor(eighths / 8), EIGHTH * (eighths % 8)


def torque_share(whole: float | None, fine: float | None) -> tuple[float | None, float]:
    """A torque of two such parts, and the step that it is reported in; None where there is none.
    Who reports no fine part has rounded to whole per cent."""
    if whole is None:
        return None, PER_CENT
    return (whole, PER_CENT) if fine is None else (whole + fine, EIGHTH)


def group_of(can_id: int) -> int:
    """The parameter group number of a 29-bit identifier, its destination left out."""
    group = can_id >> 8 & 0x3FFFF
    return group & ~0xFF if group >> 8 & 0xFF < PDU1_TOP else group


def destination_of(can_id: int) -> int:
    """Whom a frame is for; 255: all."""
    return can_id >> 8 & 0xFF if can_id >> 16 & 0xFF < PDU1_TOP else GLOBAL


def canonical(frame: Frame) -> Frame:
    """A request for a gear (TC1) to the controller or to all, from any source address and of any
    priority, as the one that the DBC has; every other frame as it is."""
    can_id = frame[0]
    if can_id & _GROUP != _OF_REQUEST or can_id == REQUEST_ID or not frame.is_extended:
        return frame
    for_us = destination_of(can_id) in (CONTROLLER, GLOBAL)
    if not for_us or can_id & 0xFF == CONTROLLER:
        return frame
    return frame._replace(can_id=REQUEST_ID)


def checksum(can_id: int, data: bytes, counter: int) -> int:
    """SPN 4207, the checksum of a TSC1 frame: over the first seven bytes, the message counter and
    the identifier (J1939-71)."""
    total = sum(data[:7]) + (counter & 0x0F) + sum(can_id.to_bytes(4, "little"))
    return ((total >> 6 & 0x03) + (total >> 3) + total) & 0x07


def checked_request(frame: Frame, counter: int) -> Frame:
    """A TSC1 frame with its message counter (SPN 4206) and checksum in place."""
    counter %= COUNTER_MODULUS
    last = checksum(frame.can_id, frame.data, counter) << 4 | counter
    return frame._replace(data=frame.data[:7] + bytes([last]))


def is_intact(frame: Frame) -> bool:
    """Whether a TSC1 frame's checksum is right; one that carries none (all ones) is."""
    counter, reported = frame.data[7] & 0x0F, frame.data[7] >> 4
    if counter == reported == 0x0F:
        return True
    return reported == checksum(frame.can_id, frame.data, counter)
