"""Gears and shifts by the ratio of two shafts' speeds, or by what the controller believes: when a
gear was left, and when the next one was there.
"""

from __future__ import annotations

from typing import Final

from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.gears import DRIVE_GEARS
from meshpoint.logs.seen_shift import SeenShift

LEAST_RPM: Final = 50.0
"""Slower, a ratio says nothing."""
NEAR: Final = 0.03
"""How far a ratio may be off a gear's, as a share: slip of a wheel, rounding of the bus."""
HELD_US: Final = 200_000
"""A gear that holds for so long is one; crossing a gear's ratio while shifting is none."""
STALE_US: Final = 250_000
"""A speed older than this makes no ratio."""


class GearTrack:
    """Takes gear numbers (None: none, or unknown) in order of time."""

    def __init__(self) -> None:
        self.shifts: list[SeenShift] = []
        self._gear: int | None = None
        self._left_us = 0
        self._new: int | None = None
        self._since_us = 0
        self.gears: dict[int, float] = {}
        """How long each gear was seen, s."""
        self._last_us: int | None = None

    def take(self, gear: int | None, now_us: int) -> None:
        """The gear of now."""
        if gear is not None and self._last_us is not None and gear == self._new:
            self.gears[gear] = self.gears.get(gear, 0.0) + (now_us - self._last_us) * 1e-6
        self._last_us = now_us
        if gear != self._new:
            if self._new == self._gear and self._gear is not None:
                self._left_us = now_us
            self._new, self._since_us = gear, now_us
        if gear is None or gear == self._gear or now_us - self._since_us < HELD_US:
            return
        if self._gear is not None:
            self.shifts.append(SeenShift(self._gear, gear, self._left_us, self._since_us))
        self._gear = gear


class RatioTrack:
    """Gears by the speeds of input and propeller shaft."""

    def __init__(self, sheet: GearboxSheet) -> None:
        self._ratios = {n: sheet.overall_ratio(gear) for n, gear in DRIVE_GEARS.items()}
        self._rpm: dict[str, tuple[int, float]] = {}
        self.track = GearTrack()
        self.ranges_rpm: dict[str, tuple[float, float]] = {}
        """Least and greatest speed of each shaft."""

    def take(self, shaft: str, rpm: float, now_us: int) -> None:
        """A speed of a shaft."""
        self._rpm[shaft] = now_us, rpm
        least, most = self.ranges_rpm.get(shaft, (rpm, rpm))
        self.ranges_rpm[shaft] = min(least, rpm), max(most, rpm)
        if shaft in ("input", "propeller"):
            self.track.take(self.gear(now_us), now_us)

    def gear(self, now_us: int) -> int | None:
        """The gear whose ratio the newest speeds have; None: none, or too slow to tell."""
        said = [self._rpm.get(shaft) for shaft in ("input", "propeller")]
        if None in said:
            return None
        (input_us, input_rpm), (out_us, out_rpm) = (s for s in said if s is not None)
        if min(input_rpm, out_rpm) < LEAST_RPM or now_us - min(input_us, out_us) > STALE_US:
            return None
        ratio = input_rpm / out_rpm
        number = min(self._ratios, key=lambda n: abs(ratio / self._ratios[n] - 1.0))
        return number if abs(ratio / self._ratios[number] - 1.0) < NEAR else None
