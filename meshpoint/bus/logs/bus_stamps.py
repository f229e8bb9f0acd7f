"""Stamps of a log in bus time, whatever the clock of the bus's interface is."""

from __future__ import annotations

from collections.abc import Callable

import can

from meshpoint.bus.clock import US_PER_S, NodeClock
from meshpoint.bus.pace import PacedClock


class BusStamps:
    """Hands messages on with their times on the bus, counted from the first one's own stamp.

    A bus time that waits for its nodes is read as a message arrives. One that runs by the wall at
    another speed is the stamp's, at that speed; at speed 1 the stamps stay as they came.
    """

    def __init__(self, clock: NodeClock, take: Callable[[can.Message], None]) -> None:
        """clock: of the nodes. take: gets each message, its stamp set."""
        self._clock, self._take = clock, take
        self._first_s: float | None = None
        self._begun_us = 0

    def __call__(self, message: can.Message) -> None:
        """The next message of the bus."""
        if self._first_s is None:
            self._first_s, self._begun_us = message.timestamp, self._clock.now_us()
        if isinstance(self._clock, PacedClock):
            passed_us = self._clock.now_us() - self._begun_us
            message.timestamp = self._first_s + passed_us / US_PER_S
        elif self._clock.speed != 1.0:
            passed_s = message.timestamp - self._first_s
            message.timestamp = self._first_s + passed_s * self._clock.speed
        self._take(message)
