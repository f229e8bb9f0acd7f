"""A virtual bus whose nodes are in several processes: each has a copy, and all copies agree.

Time goes on in windows no longer than the shortest frame. What a node hands over in a window cannot
be through in it: so at its begin the one frame that will be is known, and it is enough that the
processes tell each other after it what their nodes handed over. This is conservative parallel
simulation, with the shortest frame as lookahead (Chandy, Misra 1979)."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final, NamedTuple

from meshpoint.bench.virtual_bus import IDLE, VirtualBus, duration_us
from meshpoint.bus.core import Step
from meshpoint.dbc.frame import Frame

WINDOW_US: Final = min(duration_us(0, is_fd) for is_fd in (False, True))
"""118 us: no frame is shorter than an empty one."""
NEVER_US: Final = 1 << 62


class HandOver(NamedTuple):
    """Frames that a node handed over to the bus."""

    time_us: int
    node: int
    frames: list[Frame]


class SharedBus:
    """One process's copy, a bus for its `VirtualTime`."""

    def __init__(self) -> None:
        self._bus = VirtualBus()
        self._handed: list[HandOver] = []
        self.next_us: float = IDLE
        """When the frame on the bus is through, where that is in this window."""

    @property
    def busy_us(self) -> int:
        """Time with a frame on the bus, up to the begin of the window."""
        return self._bus.busy_us

    def send(self, sender: int, frames: list[Frame], now_us: int) -> None:
        """A node of this process hands over frames at `now_us`."""
        if frames:
            self._handed.append(HandOver(now_us, sender, frames))

    def take(self) -> tuple[int, Frame]:
        """Sender and frame that is through now. Call at `next_us`."""
        self.next_us = IDLE
        return self._bus.on_bus

    def handed(self) -> list[HandOver]:
        """What this process's nodes have handed over in this window."""
        return self._handed

    def begin(self, now_us: int, others: Iterable[HandOver]) -> None:
        """A window begins at `now_us`. others: what the other processes' nodes handed over in the
        last one."""
        for time_us, node, frames in sorted([*self._handed, *others]):
            self._pass(time_us)
            self._bus.send(node, frames, time_us)
        self._handed = []
        self._pass(now_us - 1)
        self.next_us = self._bus.next_us

    def _pass(self, now_us: int) -> None:
        """What is through by then was delivered in its window."""
        while self._bus.next_us <= now_us:
            self._bus.take()


class Elsewhere:
    """In the place of a core that another process runs: it hears and does nothing."""

    next_step_us: Final = NEVER_US

    def receive(self, frame: Frame) -> None:
        """Nothing: the other process delivers to it."""

    def step(self, now_us: int) -> Step:  # noqa: ARG002
        """Nothing."""
        return Step([], [])

    shutdown = step
