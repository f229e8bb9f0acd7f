"""A sleeve that rests on a tooth of its gear: whether the gear still turns under it.

The face of a sleeve that is pushed rubs on the tooth. If that uses the slip up before a gap comes,
the two stick together: static friction holds more than drag can turn, and no gap comes.
"""

from __future__ import annotations

from collections import deque
from typing import Final

from meshpoint.gearbox import GearboxSheet

WATCHED_US: Final = 60_000
"""The slip is averaged over this, about a turn of a shaft, in which the errors of its wheel's teeth
cancel;"""
ENOUGH_US: Final = 45_000
"""and over no less."""


class FaceWatch:
    """The slip under a sleeve that has met a tooth."""

    def __init__(self, sheet: GearboxSheet) -> None:
        self._half_face_rad = (sheet.dog.pitch_rad - sheet.dog.backlash_rad) / 2.0
        self._slips: deque[tuple[int, float]] = deque()

    def begin(self) -> None:
        """A sleeve is fired: nothing has been seen of its contact yet."""
        self._slips.clear()

    def take(self, now_us: int, slip_rad_s: float | None) -> None:
        """The slip of a step after contact; None if a speed is missing."""
        if slip_rad_s is None:
            self._slips.clear()
            return
        self._slips.append((now_us, slip_rad_s))
        while self._slips[0][0] < now_us - WATCHED_US:
            self._slips.popleft()

    def sticks(self, patience_s: float) -> bool:
        """Whether the gear turns so slowly that half a tooth's face, the mean way to the next gap,
        takes longer than `patience_s`. False until the slip has been seen long enough to tell."""
        slips = self._slips
        if not slips or slips[-1][0] - slips[0][0] < ENOUGH_US:
            return False
        mean_rad_s = sum(slip for _, slip in slips) / len(slips)
        return abs(mean_rad_s) * patience_s < self._half_face_rad
