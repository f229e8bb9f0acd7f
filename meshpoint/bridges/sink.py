"""Where time series go: what a file or a viewer has to take."""

from __future__ import annotations

from collections.abc import Iterator
from heapq import heappop, heappush
from typing import Final, NamedTuple, Protocol

from meshpoint.bridges.series import Sample

HELD_S: Final = 0.1
"""A frame brings samples from before it: for so long they wait for those of other frames."""


class Event(NamedTuple):
    """Something that happened, in words."""

    time_s: float
    who: str
    words: str


class Sink(Protocol):
    """Takes rows and events, in the order of their times as far as the sensors' clock goes on."""

    def sample(self, sample: Sample) -> None:
        """A row of a topic."""

    def event(self, event: Event) -> None:
        """Something that happened."""


class InOrder:
    """Samples and events by their times."""

    def __init__(self) -> None:
        self._held: list[tuple[float, int, Sample | Event]] = []
        self._count = 0

    def add(self, one: Sample | Event) -> None:
        """One more."""
        heappush(self._held, (one.time_s, self._count, one))
        self._count += 1

    def until(self, time_s: float) -> Iterator[Sample | Event]:
        """Those that no later frame can come before, at this time of the bus."""
        while self._held and self._held[0][0] <= time_s - HELD_S:
            yield heappop(self._held)[2]

    def rest(self) -> Iterator[Sample | Event]:
        """All that are left."""
        while self._held:
            yield heappop(self._held)[2]
