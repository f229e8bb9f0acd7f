"""The clutch's travel as its sensor shows it, and where it will be.

The actuator moves on at the rate of its newest two samples: what it will do in some hundredths of a
second. Further ahead nothing is said.
"""

from __future__ import annotations

from typing import Final

GAP_US: Final = 25_000
"""Samples further apart than this say nothing of how fast the clutch moves."""
AHEAD_US: Final = 100_000
"""Nothing is said of where the clutch will be after longer than this."""
STILL_PER_S: Final = 0.5
"""Slower than this, an end in 2 s, the clutch counts as standing still."""


class ClutchTrack:
    """Position of the clutch, 0 open to 1 closed, by time."""

    def __init__(self) -> None:
        self.closed: float | None = None
        """Its newest position; None before the first sample."""
        self.newest_us = 0
        self.rate_per_s = 0.0
        """How fast it closes; negative: opens."""
        self.before: tuple[int, float] | None = None
        """The sample before the newest, where it is not long ago."""

    def take(self, time_us: int, closed: float) -> None:
        """A sample at a sensor time (us)."""
        since_us = time_us - self.newest_us
        known = self.closed is not None and 0 < since_us <= GAP_US
        self.before = (self.newest_us, self.closed or 0.0) if known else None
        self.rate_per_s = 0.0
        if self.before is not None:
            rate = (closed - self.before[1]) / since_us * 1e6
            self.rate_per_s = rate if abs(rate) >= STILL_PER_S else 0.0
        self.closed, self.newest_us = closed, time_us

    def falls_to_us(self, level: float) -> float | None:
        """When the opening clutch passes, or has passed, a level; None where it does not get there
        at its present rate."""
        if self.closed is None:
            return None
        if self.closed <= level:
            return float(self.newest_us)
        if self.rate_per_s >= 0.0:
            return None
        ahead_us = (level - self.closed) / self.rate_per_s * 1e6
        return self.newest_us + ahead_us if ahead_us <= AHEAD_US else None
