"""What happens on a simulated bus, and what can be done to it."""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum
from typing import NamedTuple

from meshpoint.bus.simulated.confinement import ErrorState
from meshpoint.bus.simulated.frame_bits import WireFrame


class ErrorKind(IntEnum):
    """Why a frame was destroyed."""

    BIT = 0
    """Its sender saw another bit on the bus than it sent."""
    STUFF = 1
    """A receiver saw six equal bits."""
    CRC = 2
    FORM = 3
    ACK = 4
    """No other node acknowledged."""
    COLLISION = 5
    """Two nodes sent different frames of one identifier at once."""


class Attempt(NamedTuple):
    """A frame that has won the bus and is about to be sent."""

    start_ns: int
    senders: tuple[int, ...]
    """One node, or several that send the same frame at once."""
    frame: WireFrame


class Fault(NamedTuple):
    """What is to go wrong with an attempt: an error of a kind at a share (0 to 1) of the frame.

    `seen_by`: the receiver that sees it before the others do; None where all see it at once."""

    kind: ErrorKind = ErrorKind.BIT
    share: float = 0.5
    seen_by: int | None = None


Disturb = Callable[[Attempt], Fault | None]
"""Called once for each attempt, in order of time; None lets it pass."""


class Delivered(NamedTuple):
    """A frame is through."""

    time_ns: int
    """Its end of frame; the bus is free an intermission later."""
    senders: tuple[int, ...]
    frame: WireFrame
    queued_ns: int
    """When the first of its senders handed it over."""
    missed_by: int | None = None
    """An error-passive receiver that saw an error nobody else did."""


class Destroyed(NamedTuple):
    """A frame was broken off; its senders try again unless they are bus-off."""

    time_ns: int
    senders: tuple[int, ...]
    frame: WireFrame
    kind: ErrorKind
    counters: dict[int, tuple[int, int]]
    """Each node's transmit and receive error counter afterwards."""
    seen_by: int | None = None


class StateChanged(NamedTuple):
    """A node's error state or warning has changed."""

    time_ns: int
    node: int
    state: ErrorState
    is_warning: bool
    transmit_errors: int
    receive_errors: int


class Purged(NamedTuple):
    """Frames of a node that went bus-off, thrown away with its queue."""

    time_ns: int
    node: int
    frames: int


BusEvent = Delivered | Destroyed | StateChanged | Purged
