"""The bus between the nodes gone wrong: frames lost, doubled, damaged, late, out of order; a node
that hangs or is off the bus.

Each node sits behind a `Wire`, which changes what it hears and holds back what it sends. Chances
are drawn from the world's seed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from benchmarks.swarm.events import Group
from meshpoint.bus.core import Core, Step
from meshpoint.dbc.edges import EDGE_MESSAGES
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS

BABBLE_ID: Final = 0x0000_0003
OWN_ID: Final = CODECS["ValveCommand"].spec.can_id
OWN_LENGTH: Final = CODECS["ValveCommand"].spec.length
NAMES: Final[dict[Group, tuple[str, ...]]] = {
    Group.SLOW: ("GearboxSensors", "SleevesMain", "SleevesAux"),
    Group.EDGES: tuple(message.__name__ for message in EDGE_MESSAGES),
    Group.VALVE_STATUS: ("ValveStatus",),
    Group.COMMANDS: ("ValveCommand", "ClutchCommand"),
    Group.J1939: ("EEC1", "TSC1", "TC1"),
}
IDS: Final = {
    group: frozenset(CODECS[name].spec.can_id for name in names) for group, names in NAMES.items()
}
MOST_STALE: Final = 64
"""Frames that a node's queue holds while it is off the bus."""


@dataclass
class BusFault:
    """A fault of the bus that is active."""

    kind: str
    group: Group
    value: float

    def strikes(self, can_id: int) -> bool:
        """Whether it is about this frame."""
        return self.group is Group.ALL or can_id in IDS[self.group]


@dataclass
class Trouble:
    """What is wrong on the bus now; all wires look at it."""

    rng: np.random.Generator
    now_us: Callable[[], int]
    faults: list[BusFault] = field(default_factory=list)

    def hear(self, frame: Frame, late: list[tuple[int, Frame]]) -> list[Frame]:
        """What becomes of a frame on its way to a node; delayed ones are put into `late`."""
        frames = [frame]
        for fault in self.faults:
            if not fault.strikes(frame.can_id):
                continue
            if fault.kind == "bus_delay":
                due_us = self.now_us() + round(fault.value * 1000.0)
                late += [(due_us, heard) for heard in frames]
                return []
            if fault.kind == "bus_reorder":
                if self.rng.random() < fault.value:
                    late += [(0, heard) for heard in frames]  # with the next, behind it
                    return []
            elif self.rng.random() < fault.value:
                frames = self._strike(fault.kind, frames)
        return frames

    def _strike(self, kind: str, frames: list[Frame]) -> list[Frame]:
        if kind == "bus_drop" or not frames:
            return []
        if kind == "bus_duplicate":
            return frames + frames
        data = bytearray(frames[0].data)
        if data:
            bit = int(self.rng.integers(8 * len(data)))
            data[bit // 8] ^= 1 << bit % 8
        return [frames[0]._replace(data=bytes(data)), *frames[1:]]


class Wire:
    """A node behind a bus that may be in trouble."""

    def __init__(self, core: Core, trouble: Trouble, after: Callable[[int], None]) -> None:
        """after: called when the node has stepped, with the driver's time (us)."""
        self.core = core
        self._trouble = trouble
        self._after = after
        self._late: list[tuple[int, Frame]] = []
        self._stale: list[Frame] = []
        self.is_off = False
        """Bus-off: it hears and sends nothing."""
        self.stalled_until_us = 0

    @property
    def next_step_us(self) -> int:
        """A node that hangs is stepped when it goes on."""
        return max(self.core.next_step_us, self.stalled_until_us)

    def receive(self, frame: Frame) -> None:
        """A frame from the bus."""
        if self.is_off:
            return
        if not (self._trouble.faults or self._late):
            self.core.receive(frame)
            return
        waiting, self._late = self._late, []
        for heard in self._trouble.hear(frame, self._late):
            self.core.receive(heard)
        self._deliver(waiting)

    def _deliver(self, waiting: list[tuple[int, Frame]]) -> None:
        now_us = self._trouble.now_us()
        for due_us, frame in waiting:
            if due_us <= now_us:
                self.core.receive(frame)
            else:
                self._late.append((due_us, frame))

    def step(self, now_us: int) -> Step:
        """The node's step, if it does not hang."""
        if now_us < self.stalled_until_us:
            return Step([], [])
        if self._late:
            waiting, self._late = self._late, []
            self._deliver(waiting)
        frames, events = self.core.step(now_us)
        self._after(now_us)
        if self.is_off:
            self._stale = (self._stale + frames)[:MOST_STALE]
            return Step([], events)
        stale, self._stale = self._stale, []
        return Step(stale + frames, events)

    def shutdown(self, now_us: int) -> Step:
        """The node's last frames."""
        return self.core.shutdown(now_us)


class Stranger:
    """Another node on the bus: quiet until it babbles, or sends under the controller's name."""

    def __init__(self) -> None:
        self.babble_us = 0
        self.pretend_us = 0
        self._steps = 0
        self.next_step_us = 1

    def receive(self, frame: Frame) -> None:
        """It does not listen."""

    def step(self, now_us: int) -> Step:
        """One frame of each kind that it was made for."""
        every_us = min([each for each in (self.babble_us, self.pretend_us) if each], default=10_000)
        self.next_step_us = now_us + every_us
        self._steps += 1
        frames = []
        if self.babble_us:
            frames.append(Frame(BABBLE_ID, bytes(8), is_fd=False))
        if self.pretend_us:
            # No protection: an accident or a foreign tool, not an attacker who knows the CRC.
            frames.append(Frame(OWN_ID, bytes([self._steps & 0xFF]) * OWN_LENGTH))
        return Step(frames, [])

    def shutdown(self, now_us: int) -> Step:  # noqa: ARG002
        """Nothing to say."""
        return Step([], [])
