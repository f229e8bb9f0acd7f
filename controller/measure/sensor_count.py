"""By how many teeth a wheel was renumbered, bounded by the sensor's own running edge number.

The sensor goes on counting edges while the gate (`gate_kernels`) is not sure of tooth numbers:
while frames are lost, and while a wheel stops and starts again. It cannot count backwards, so each
of E edges may have been a tooth passing in reverse. The tooth that now has number t had number
t + k before, with k between a - 2 E and a, where a is the count if all edges went forward; some
teeth are added at both ends for edges that a sensor misses. Where there was no time to stop and
start again, no edge went backwards and k = a. With k modulo the wheel's teeth known from its tooth
pattern (`tooth_match`), the number of whole turns follows, or only a few are possible.

No bound is given after a loss at speed while all frames arrived (the sensor was blind and has not
counted), nor for a wheel with missing teeth, whose edges are not its teeth.
"""

from __future__ import annotations

from typing import Final, NamedTuple

LONGEST_GAP_US: Final = 5_000_000
"""Without a frame for longer, the 16 bits may have gone round: 120 teeth at 6,000 rpm: 5.4 s."""
LOST_FRAMES_US: Final = 50_000
SLACK: Final = 3
"""Teeth: edges that wait for their verdict, were left out, or were missed beside a stop."""
STOPPING: Final = 1.5
"""Up to this many times the least speed of a count a wheel may have come to a stop."""


class Renumbered(NamedTuple):
    """Old tooth number less new one, summed over all losses: the least and the most it can be."""

    least: int = 0
    most: int = 0
    uncounted: int = 0
    """Number of losses without a bound: two values are comparable only if this is equal."""


class _Count(NamedTuple):
    ahead: int
    """Tooth number less the sensor's running number."""
    rises: int
    falls: int
    time_us: int
    rate: float
    """Pitches a microsecond."""


class SensorCount:
    """The running numbers of both polarities of a wheel, unwrapped, beside its tooth numbers."""

    def __init__(self, most_bend: float, least_rate: float, whole: bool) -> None:
        """Half the largest acceleration, pitches/us2; the least speed of a count, pitches/us;
        whether the wheel has all its teeth."""
        self._most_bend, self._least_rate, self._whole = most_bend, least_rate, whole
        self._numbers = [0, 0]
        self._indices: list[int | None] = [None, None]
        self._read_us, self._stamps = [0, 0], [0, 0]
        self._last: _Count | None = None
        self._before: _Count | None = None
        """As it was when teeth were lost that are not numbered again yet."""
        self._gap_us = 0
        self._dragged = False
        self.anew = False
        """Whether the sensor has restarted its count after a loss of power; then call `restart`."""
        self.renumbered = Renumbered()

    def dragged(self) -> None:
        """A synchroniser may change the speed at once."""
        self._dragged = True

    def frame(self, falling: bool, index: int, stamps: int, read_us: int) -> None:
        """A frame: the running number of its newest edge, and how many stamps it holds."""
        before = self._indices[falling]
        if before is not None:
            gap_us = read_us - self._read_us[falling]
            self._gap_us = max(self._gap_us, gap_us)
            self._numbers[falling] += (index - before) & 0xFFFF
            if gap_us > LONGEST_GAP_US:
                self._doubt()
        if stamps < self._stamps[falling]:
            self.anew = True  # an array gets emptier in no other way
        self._indices[falling], self._read_us[falling] = index, read_us
        self._stamps[falling] = stamps

    def lost(self) -> None:
        """Teeth are not numbered any more."""
        before = self._before = self._before or self._last
        slow = before is not None and before.rate < STOPPING * self._least_rate
        if not self._whole or not (slow or self._gap_us > LOST_FRAMES_US):
            self._doubt()

    def counting(
        self, tooth: int, waiting: int, time_us: int, rate: float, turned: bool = False
    ) -> None:
        """Tooth of the last rising edge that has one (falling, where teeth begin with those:
        `turned`); how many newer edges wait for theirs; when the last tooth came, and the speed,
        pitches/us."""
        rises, falls = self._numbers[::-1] if turned else self._numbers
        now = _Count(tooth - (rises - waiting), rises, falls, time_us, rate)
        if self._before is not None:
            self._join(self._before, now)
        self._last, self._before = now, None
        self._gap_us, self._dragged = 0, False

    def restart(self) -> None:
        """Takes the sensor's restarted count."""
        self._indices, self._last, self._before = [None, None], None, None
        self.anew = False
        self._doubt()

    def _join(self, before: _Count, now: _Count) -> None:
        edges, falls = now.rises - before.rises, now.falls - before.falls
        if abs(edges - falls) > SLACK:
            self._doubt()
        stop_us = (before.rate + now.rate) / (2.0 * self._most_bend)
        if now.time_us - before.time_us < stop_us and not self._dragged:
            edges = 0
        forward, total = before.ahead - now.ahead, self.renumbered
        least = total.least + forward - 2 * edges - SLACK
        self.renumbered = Renumbered(least, total.most + forward + SLACK, total.uncounted)

    def _doubt(self) -> None:
        self.renumbered = self.renumbered._replace(uncounted=self.renumbered.uncounted + 1)
