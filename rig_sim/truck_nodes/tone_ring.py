"""A toothed ring and its sensor: speed from the times at which teeth have passed.

Tooth k of n passes where the shaft has turned by (k + error_k) / n. The speed is m teeth over the
time from the first of them to the last, the newest of all; so it is that of half this time ago, and
wrong by (error_first - error_last) / m.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from math import tau
from typing import Final

import numpy as np

from meshpoint.units import SECOND_US

KEPT: Final = 1024
"""Stamps that are looked back on: 0.4 s of a wheel at the 251 km/h that the bus carries."""


class ToneRing:
    """One ring on its shaft. Its sensor does not feel the direction."""

    def __init__(self, errors: Sequence[float], least_hz: float, place: float = 0.0) -> None:
        """errors: how far each tooth lies from its place, in pitches; less than a half.
        least_hz: fewer teeth a second read as standing. place: pitches turned at the start."""
        self._errors = errors
        self._patience_us = SECOND_US / least_hz
        self._place = place
        self._next = int(place)
        while self._passing <= place:
            self._next += 1
        self._begun_us: int | None = None
        self._time_us = 0
        self._pitches_s = 0.0
        self._stamps_us: list[int] = []

    @property
    def _passing(self) -> float:
        """Where the next tooth passes."""
        return self._next + self._errors[self._next % len(self._errors)]

    def turn(self, time_us: int, turns_s: float) -> None:
        """It has turned on until now, where its speed is `turns_s`. The first call starts it."""
        pitches_s = abs(turns_s) * len(self._errors)
        if self._begun_us is None:
            self._begun_us = time_us
        else:
            passed_us = time_us - self._time_us
            gone = 0.5 * (self._pitches_s + pitches_s) * passed_us / SECOND_US
            while (passing := self._passing) <= self._place + gone:
                share = (passing - self._place) / gone
                self._stamps_us.append(int(self._time_us + share * passed_us))
                self._next += 1
            self._place += gone
            if len(self._stamps_us) > 2 * KEPT:
                del self._stamps_us[:KEPT]
        self._time_us, self._pitches_s = time_us, pitches_s

    def turns_s(self, at_us: int, window_us: int) -> float | None:
        """The speed that is known at an instant up to now, of at least this time where teeth pass
        often enough, else from tooth to tooth. 0 where it reads as standing; None before it can
        know."""
        stamps = self._stamps_us
        newest = bisect_right(stamps, at_us) - 1
        if newest > 0 and at_us - stamps[newest] <= self._patience_us:
            before = bisect_right(stamps, stamps[newest] - window_us) - 1
            first = min(max(before, 0), newest - 1)
            teeth, taken_us = newest - first, stamps[newest] - stamps[first]
            if 0 < taken_us <= teeth * self._patience_us:
                return teeth * SECOND_US / taken_us / len(self._errors)
        is_known = self._begun_us is not None and at_us - self._begun_us > self._patience_us
        return 0.0 if is_known else None


def drawn_ring(
    rng: np.random.Generator, teeth: int, tooth_rad: float, runout_rad: float, least_hz: float
) -> ToneRing:
    """A ring as made: each tooth within `tooth_rad` of its place, the ring up to `runout_rad`
    (eccentricity over radius) off its axis, in any direction and at any angle at the start."""
    pitches = teeth / tau
    places = tau * np.arange(teeth) / teeth
    errors = pitches * tooth_rad * rng.uniform(-1.0, 1.0, teeth)
    off_axis = pitches * runout_rad * rng.uniform()
    errors += off_axis * np.sin(places + rng.uniform(0.0, tau))
    return ToneRing(errors.tolist(), least_hz, teeth * rng.uniform())
