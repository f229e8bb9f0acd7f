"""The guard's own speed of a shaft: the newest teeth over the time they took.

No filter, no model, no tooth numbers, and no code that the controller measures speeds with.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from typing import Final, NamedTuple

from meshpoint.controller.guard.listening import STAMPS, Edges

MEASURED_US: Final = 15_000
"""A speed is taken over at least this time, as far as the frame has teeth."""
UNLIKE: Final = 1.7
"""Neighbouring teeth never differ by more than this factor: else one is missing or too many."""
NO_EDGE_US: Final = 20_000
"""A sensor whose newest edge in a frame is older than this, and older than three teeth took, is
dead."""
NO_FRAME_US: Final = 25_000
"""A sensor without a frame for so long is dead."""
LATE_TEETH: Final = 3
HELD_US: Final = 45_000
"""So long an earlier speed stands in for frames with a tooth missing or too many."""
SLOWEST_RAD_S: Final = 5.0
"""A wheel that turns more slowly may only rock about one of its edges."""
READS_KEPT: Final = 4
"""The teeth that had passed are kept for this number of reads."""
LOW: Final = 0xFFFF


class ShaftSpeed(NamedTuple):
    """A mean speed, and the middle of the time it was measured over (sensor clock, us)."""

    time_us: int
    omega_rad_s: float


class TeethCounted(NamedTuple):
    """How many teeth have passed by the newest edge, and when that was (sensor clock, us)."""

    time_us: int
    teeth: int


class GuardSpeed:
    """One wheel."""

    def __init__(self, teeth: int) -> None:
        self._pitch_rad = 2.0 * math.pi / teeth
        self._measured: tuple[int, ShaftSpeed] | None = None
        """The newest speed, and when its newest edge was."""
        self._tooth_us = 0
        self._is_dead = False
        self.counted: TeethCounted | None = None
        """None before the first edge."""
        self._is_sure = False
        """The newest teeth are alike, none is missing, none too many; and the array is full, as one
        of edges that were made up from a speed never is (docs/wire.md, classic profile)."""
        self._reads: deque[tuple[int, TeethCounted | None]] = deque(maxlen=READS_KEPT)
        """When the sensor was read, and the teeth that had passed; None where they are not sure."""

    def forget(self) -> None:
        """The sensors' clock is another: nothing of before holds."""
        self._measured = self.counted = None
        self._is_sure = False
        self._reads.clear()

    def take(self, edges: Edges) -> None:
        """A believed frame."""
        self._measure(edges)
        self._reads.append((edges.time_us, self.counted if self._is_sure else None))

    def _measure(self, edges: Edges) -> None:
        self._is_sure = False
        if len(edges.lows_us) <= 1:
            self._measured = None
            return
        newest_us = edges.time_us - ((edges.time_us - edges.lows_us[0]) & LOW)
        before = self.counted
        if before is None:
            self.counted = TeethCounted(newest_us, edges.newest_index)
        elif teeth := (edges.newest_index - before.teeth) & LOW:
            self.counted = TeethCounted(newest_us, before.teeth + teeth)
        else:
            newest_us = before.time_us  # no new edge, however young its 16 bits make it look
        self._is_dead = edges.time_us - newest_us > max(NO_EDGE_US, LATE_TEETH * self._tooth_us)
        took_us = teeth_us(edges.lows_us)
        self._is_sure = bool(took_us) and len(edges.lows_us) == STAMPS
        if took_us and not self._is_dead:
            span_us = sum(took_us)
            omega_rad_s = len(took_us) * self._pitch_rad * 1e6 / span_us
            self._tooth_us = span_us // len(took_us)
            self._measured = newest_us, ShaftSpeed(newest_us - span_us // 2, omega_rad_s)

    def at(self, now_us: int) -> ShaftSpeed | None:
        """The newest speed; None where there is none, or edges have stopped coming."""
        if self._measured is None or self.counted is None or self._is_dead:
            return None
        measured_us, speed = self._measured
        limit_us = max(NO_FRAME_US, LATE_TEETH * self._tooth_us)
        if now_us - self.counted.time_us > limit_us:
            return None
        return speed if now_us - measured_us <= max(HELD_US, limit_us) else None

    @property
    def read_us(self) -> int | None:
        """When the sensor was last read; None before."""
        return self._reads[-1][0] if self._reads else None

    def turned(self, speed: ShaftSpeed | None, read_us: int | None = None) -> TeethCounted | None:
        """The teeth that had passed at a read, or at the newest where that one was not heard, if
        they are sure and the wheel turns at its newest speed."""
        if speed is None or speed.omega_rad_s < SLOWEST_RAD_S or not self._reads:
            return None
        heard: dict[int | None, TeethCounted | None] = dict(self._reads)
        return heard.get(read_us, self._reads[-1][1])


def teeth_us(lows_us: tuple[int, ...]) -> list[int]:
    """How long each of the newest teeth took, over `MEASURED_US`; none where they, or the last of
    them and the one before it, are unlike: a sensor that was silent for longer than that looks like
    one slow tooth."""
    took: list[int] = []
    span_us = 0
    for later, earlier in itertools.pairwise(lows_us):
        tooth_us = (later - earlier) & LOW
        if tooth_us == 0 or (took and not took[-1] / UNLIKE < tooth_us < took[-1] * UNLIKE):
            return []
        if span_us >= MEASURED_US:
            break
        took.append(tooth_us)
        span_us += tooth_us
    return took
