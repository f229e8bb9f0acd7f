"""The road speed of a run, kept for as long as a shift may take, to see what a shift has lost."""

from __future__ import annotations

from collections import deque
from itertools import pairwise
from typing import Final

from meshpoint.dbc.messages import ReferencePhase

SPEEDS_KEPT: Final = 3000
"""Samples, 10 ms apart: a shift is over within this time."""
HALF_WRAP_US: Final = 1 << 31


def span_us(later: int, earlier: int) -> int:
    """Signed difference of two 32-bit sensor times."""
    return ((later - earlier + HALF_WRAP_US) & 0xFFFF_FFFF) - HALF_WRAP_US


class RoadSpeed:
    """Samples of the truth, newest last; times are 32-bit sensor times."""

    def __init__(self) -> None:
        self._samples: deque[tuple[int, float]] = deque(maxlen=SPEEDS_KEPT)

    def take(self, truth: ReferencePhase) -> None:
        """One sample."""
        self._samples.append((truth.sample_time_us, truth.road_speed_m_s))

    def lost_m_s(self, from_us: int, to_us: int) -> float | None:
        """Speed at the first time less that at the second; None where a time is not covered, or
        there is no vehicle."""
        before, after = self._at(from_us), self._at(to_us)
        if before is None or after is None or before == after == 0.0:
            return None
        return before - after

    def _at(self, time_us: int) -> float | None:
        for late, early in pairwise(reversed(self._samples)):
            ahead_us = span_us(time_us, early[0])
            if ahead_us < 0:
                continue
            way_us = span_us(late[0], early[0])
            if way_us <= 0 or ahead_us > 2 * way_us:
                return None
            # Up to a sample beyond the newest, where the shift's end has just been reported.
            return early[1] + (late[1] - early[1]) * ahead_us / way_us
        return None
