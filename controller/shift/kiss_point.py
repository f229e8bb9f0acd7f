"""The kiss point: the clutch's position at which its plates touch, learned from shift to shift.

While the clutch closes after a shift the plates slip, and from the moment they touch the torque
between them grows with the clutch's travel: the engine's acceleration leaves its own straight line.
Where the line of the growing acceleration meets the one before, the plates touched. Until they have
been seen to, the data sheet's value stands; its tolerance bounds what is learned.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from typing import Final

from meshpoint.controller.sensing.clutch_track import ClutchTrack
from meshpoint.gearbox import GearboxSheet

GROWN_RAD_S2: Final = 60.0
"""The engine's acceleration has grown by this much at the end: some times what quantisation and the
engine's own torque do from one sample to the next."""
SAMPLES: Final = 5
"""Four intervals: one before the touch, one with it, two of growing torque."""
SEEN_SD: Final = 0.02
"""Standard deviation of one observation: 4 ms of a clutch that closes in 200 ms."""
MOST_SEEN: Final = 10.0
"""Weight of the past, in observations: linings wear, and the point moves."""


class KissPoint:
    """Where the plates touch, as a share of the clutch's travel from open."""

    def __init__(self, sheet: GearboxSheet) -> None:
        clutch = sheet.clutch
        self._low, self._high = clutch.surely_open_share, clutch.kiss_share + clutch.kiss_tolerance
        self.share = clutch.kiss_share
        """Expected."""
        self.sd = 0.5 * clutch.kiss_tolerance
        self._seen: deque[tuple[int, float, float]] = deque(maxlen=SAMPLES)
        """Time, position and engine speed of the newest samples of this closing."""

    @property
    def parted_share(self) -> float:
        """The plates are taken to be apart from here on."""
        return max(self._low, self.share - self.sd)

    def measure(self, track: ClutchTrack, engine_rad_s: float | None) -> None:
        """One step's newest sample of the clutch, and the engine's speed beside it."""
        if engine_rad_s is None or track.closed is None or track.rate_per_s <= 0.0:
            self._seen.clear()
            return
        if self._seen and self._seen[-1][0] == track.newest_us:
            return
        self._seen.append((track.newest_us, track.closed, engine_rad_s))
        if len(self._seen) == self._seen.maxlen:
            self._learn_kink()

    def _learn_kink(self) -> None:
        """The touch lies in the second of four intervals, if the accelerations say so."""
        seen = list(self._seen)
        middles, found = [], []
        for (t0, _, w0), (t1, _, w1) in itertools.pairwise(seen):
            middles.append(0.5 * (t0 + t1))
            found.append((w1 - w0) / (t1 - t0) * 1e6)
        own, _, growing, grown = found
        rise = grown - growing
        if abs(grown - own) < GROWN_RAD_S2 or rise * (growing - own) <= 0.0:
            return
        touch_us = middles[2] - (growing - own) / rise * (middles[3] - middles[2])
        (t1, p1, _), (t2, p2, _) = seen[1], seen[2]
        if not t1 <= touch_us <= t2:
            return
        self._take(p1 + (p2 - p1) * (touch_us - t1) / (t2 - t1))
        self._seen.clear()

    def _take(self, seen: float) -> None:
        if not self._low <= seen <= self._high:
            return
        weight = self.sd**2 / (self.sd**2 + SEEN_SD**2)
        self.share += weight * (seen - self.share)
        self.sd = max(self.sd * math.sqrt(1.0 - weight), SEEN_SD / math.sqrt(MOST_SEEN))
