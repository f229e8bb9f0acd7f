"""Records of the edge capture: channels, the sensor clock in pieces, and what a read holds."""

from __future__ import annotations

import ctypes
from typing import Annotated, Final

from meshpoint.gearbox.wheels import WHEEL_NAMES
from meshpoint.kernels.structures import Record, Row

WHEELS: Final = len(WHEEL_NAMES)
CHANNELS: Final = 2 * WHEELS

RING: Final = 64  # captured edges kept a channel

STAMPS: Final = 27  # of them in a read

PIECES: Final = 8  # of the sensor clock kept


class Channel(Record):
    """One capture channel."""

    tooth: int  # of the edge next on the way forward; preset thesis: of the newest edge
    lap: int  # the turn in which that is; preset thesis: not used, tooth counts on
    count: int  # edges since power-up
    times_us: Annotated[Row[float], RING]  # of the newest edges, since power-up


class Captured(Record):
    """The edges of all channels: a rising and a falling one for each wheel."""

    channels: Annotated[Row[Channel], CHANNELS]


class ClockPiece(Record):
    """A piece of the sensor clock (`sensor_clock`)."""

    since_us: float
    base_us: int  # what it showed then
    rate: float


class ClockPieces(Record):
    """The newest pieces of the sensor clock, the newest last."""

    pieces: Annotated[Row[ClockPiece], PIECES]


class Head(Record):
    """What the edge frames of one channel say beside the stamps."""

    newest_index: int
    valid_stamps: int
    long_interval: int
    stopped: int


class StampRow(Record):
    """Low 16 bits of the sensor clock, newest first, zero where there is none."""

    low: Annotated[Row[Annotated[int, ctypes.c_uint16]], STAMPS]


class Reading(Record):
    """What the edge frames of one read hold, all channels."""

    heads: Annotated[Row[Head], CHANNELS]
    stamps: Annotated[Row[StampRow], CHANNELS]
