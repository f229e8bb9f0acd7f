"""Errors of the simulated bus as messages, coded as SocketCAN does (linux/can/error.h)."""

from __future__ import annotations

from enum import IntFlag
from typing import Final

import can

from meshpoint.bus.simulated.confinement import BUS_OFF_FROM, PASSIVE_FROM, WARNING_FROM, ErrorState
from meshpoint.bus.simulated.events import Destroyed, ErrorKind, StateChanged


class ErrorClass(IntFlag):
    """The classes of an error frame: the bits of its identifier."""

    CONTROLLER = 0x04
    PROTOCOL = 0x08
    NO_ACK = 0x20
    BUS_OFF = 0x40
    BUS_ERROR = 0x80
    RESTARTED = 0x100
    COUNTERS = 0x200
    """Bytes 6 and 7 are the transmit and the receive error counter."""


_TYPES: Final = {
    ErrorKind.BIT: 0x01,
    ErrorKind.FORM: 0x02,
    ErrorKind.STUFF: 0x04,
    ErrorKind.CRC: 0x00,
    ErrorKind.ACK: 0x00,
    ErrorKind.COLLISION: 0x01,
}
_SENDING: Final = 0x80
_AT_CRC: Final = 0x08
_AT_ACK: Final = 0x19
_PLACES: Final = {ErrorKind.CRC: _AT_CRC, ErrorKind.ACK: _AT_ACK}


def of_destroyed(event: Destroyed, node: int) -> can.Message:
    """What a node reports of a frame that was destroyed."""
    classes = ErrorClass.PROTOCOL | ErrorClass.BUS_ERROR
    if event.kind is ErrorKind.ACK:
        classes |= ErrorClass.NO_ACK
    kind = _TYPES[event.kind] | (_SENDING if node in event.senders else 0)
    counters = event.counters.get(node, (0, 0))
    return _message(classes, counters, kind=kind, place=_PLACES.get(event.kind, 0))


def of_change(event: StateChanged, was_off: bool) -> can.Message:
    """What a node reports of its own change of state."""
    counters = event.transmit_errors, event.receive_errors
    if event.state is ErrorState.BUS_OFF:
        return _message(ErrorClass.BUS_OFF, counters)
    if was_off:
        return _message(ErrorClass.RESTARTED, counters)
    transmits = counters[0] >= counters[1]
    worst = max(counters)
    if worst >= PASSIVE_FROM:
        status = 0x20 if transmits else 0x10
    elif worst >= WARNING_FROM:
        status = 0x08 if transmits else 0x04
    else:
        status = 0x40
    return _message(ErrorClass.CONTROLLER, counters, status=status)


def _message(
    classes: ErrorClass, counters: tuple[int, int], status: int = 0, kind: int = 0, place: int = 0
) -> can.Message:
    transmit, receive = (min(count, BUS_OFF_FROM - 1) for count in counters)
    return can.Message(
        arbitration_id=int(classes | ErrorClass.COUNTERS),
        is_extended_id=False,
        is_error_frame=True,
        data=bytes([0, status, kind, place, 0, 0, transmit, receive]),
    )
