"""A CAN adapter between the controller and the bus, in virtual time.

Frames come late, in bundles, with pauses; they go out late, through a queue that can be full, at
no more than the adapter's throughput; and the computer's clock runs a little faster or slower
than the sensors'. Profiles are in `adapter_profiles`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from meshpoint.bus.core import Core, Step
from meshpoint.bus.statistics import Histogram
from meshpoint.dbc.frame import Frame

NEVER: Final = 1 << 62
MILLION: Final = 1_000_000


@dataclass(frozen=True)
class AdapterProfile:
    """What an adapter and its driver do to frames. All zero: nothing."""

    name: str
    delay_us: int = 0
    """From the bus to the node, and from the node to the adapter's controller, at the least."""
    jitter_us: int = 0
    """What comes to that at the most; drawn for each bundle, evenly."""
    bundle_us: int = 0
    """Frames are handed over together, this often: USB's frame of 1 ms."""
    stall_every_us: int = 0
    """Mean time between pauses of driver or machine; 0: none."""
    stall_us: int = 0
    """How long such a pause is: nothing goes in or out."""
    queue_frames: int = NEVER
    """Frames that wait to be sent; what comes to a full queue is lost."""
    bytes_per_s: int = 0
    """Throughput between computer and adapter, each way; 0: no limit."""
    overhead_bytes: int = 0
    """Of each frame between computer and adapter, beside its data."""
    bytes_per_data_byte: int = 1
    """2 where data goes as hexadecimal text."""
    clock_ppm: float = 0.0
    """By which the computer's clock runs faster than the sensors'."""
    is_fd: bool = True
    source: str = ""
    """Where the figures are from, and which are assumed."""

    def transfer_us(self, frame: Frame) -> int:
        """How long a frame takes between computer and adapter."""
        if not self.bytes_per_s:
            return 0
        size = self.overhead_bytes + self.bytes_per_data_byte * len(frame.data)
        return -(-size * MILLION // self.bytes_per_s)


class AdapterCore:
    """A core behind an adapter, of the same call shape. `now_us` is the bus's time."""

    def __init__(self, core: Core, profile: AdapterProfile, seed: int) -> None:
        self._core = core
        self._profile = profile
        self._rng = np.random.Generator(np.random.PCG64([seed, 0xADA]))
        self.now_us: Callable[[], int] = lambda: 0
        self._inward: deque[tuple[int, int, Frame]] = deque()
        """When it is handed over, when it was on the bus, the frame."""
        self._outward: deque[tuple[int, int, Frame]] = deque()
        self._wire_in_us = 0
        self._wire_out_us = 0
        self._bundle = (-1, 0)
        self._stall = (NEVER, NEVER) if not profile.stall_every_us else self._next_stall(0)
        self.in_us = Histogram()
        """From the bus to the node."""
        self.out_us = Histogram()
        """From the node to the bus's arbitration."""
        self.dropped = 0
        """Frames of the node that a full queue has swallowed."""

    def receive(self, frame: Frame) -> None:
        """A frame that is through on the bus now; the node gets it later."""
        now_us = self.now_us()
        self._wire_in_us = max(now_us, self._wire_in_us) + self._profile.transfer_us(frame)
        due_us = self._after_stall(self._bundled(self._wire_in_us) + self._profile.delay_us)
        if self._inward:
            due_us = max(due_us, self._inward[-1][0])
        self._inward.append((due_us, now_us, frame))

    def _bundled(self, at_us: int) -> int:
        """When the bundle that a frame is in is handed over."""
        every_us = self._profile.bundle_us
        number = -(-at_us // every_us) if every_us else at_us
        if number != self._bundle[0]:
            jitter_us = self._profile.jitter_us
            self._bundle = (number, int(self._rng.integers(0, jitter_us + 1)))
        return (number * every_us if every_us else at_us) + self._bundle[1]

    def _next_stall(self, from_us: int) -> tuple[int, int]:
        begin_us = from_us + int(self._rng.exponential(self._profile.stall_every_us))
        return begin_us, begin_us + self._profile.stall_us

    def _after_stall(self, at_us: int) -> int:
        while at_us >= self._stall[1]:
            self._stall = self._next_stall(self._stall[1])
        return self._stall[1] if at_us >= self._stall[0] else at_us

    @property
    def next_step_us(self) -> int:
        """When the node is due by its own clock, or a frame is to be handed over either way."""
        due_us = self._outer_us(self._core.next_step_us)
        for queue in (self._inward, self._outward):
            if queue:
                due_us = min(due_us, queue[0][0])
        return due_us

    def _inner_us(self, now_us: int) -> int:
        return now_us + int(now_us * self._profile.clock_ppm // MILLION)

    def _outer_us(self, inner_us: int) -> int:
        """The least time of the bus at which the node's clock shows this."""
        outer_us = int(inner_us / (1.0 + self._profile.clock_ppm / MILLION))
        while self._inner_us(outer_us) < inner_us:
            outer_us += 1
        return outer_us

    def step(self, now_us: int) -> Step:
        """Hands over what is due either way; steps the node where that is due."""
        while self._inward and self._inward[0][0] <= now_us:
            _, was_us, frame = self._inward.popleft()
            self.in_us.add(now_us - was_us)
            self._core.receive(frame)
        events: list[str] = []
        inner_us = self._inner_us(now_us)
        if inner_us >= self._core.next_step_us:
            made = self._core.step(inner_us)
            events = made.events
            self._put(made.frames, now_us)
        frames = []
        while self._outward and self._outward[0][0] <= now_us:
            _, was_us, frame = self._outward.popleft()
            self.out_us.add(now_us - was_us)
            frames.append(frame)
        return Step(frames, events)

    def _put(self, frames: list[Frame], now_us: int) -> None:
        profile = self._profile
        jitter_us = int(self._rng.integers(0, profile.jitter_us + 1))
        for frame in frames:
            if len(self._outward) >= profile.queue_frames:
                self.dropped += 1
                continue
            self._wire_out_us = max(now_us, self._wire_out_us) + profile.transfer_us(frame)
            due_us = self._after_stall(self._wire_out_us + profile.delay_us + jitter_us)
            if self._outward:
                due_us = max(due_us, self._outward[-1][0])
            self._outward.append((due_us, now_us, frame))

    def shutdown(self, now_us: int) -> Step:
        """As the node does."""
        return self._core.shutdown(self._inner_us(now_us))

    def figures(self) -> dict[str, Any]:
        """What became of the frames, ms."""
        return {"profile": self._profile.name, "dropped": self.dropped} | {
            name: {
                "p50": histogram.quantile(0.5) / 1000,
                "p99": histogram.quantile(0.99) / 1000,
                "max": histogram.maximum / 1000,
            }
            for name, histogram in (("in_ms", self.in_us), ("out_ms", self.out_us))
        }
