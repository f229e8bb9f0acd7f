"""The sensor clock, as the controller knows it.

The controller steps in its own clock and plans in the sensor clock. The offset between them is the
least `now - stamp` seen lately: every frame says when it was read, and is consumed later than that,
so the least difference carries the least delay. It errs to the early side by that least delay,
which the activation lead covers.
"""

from __future__ import annotations

from collections import deque
from typing import Final

from meshpoint.dbc.sensor_time import unwrap

WINDOW: Final = 4000
"""Stamps the offset looks back over: about four seconds, in which 200 ppm of drift is 0.8 ms and
a shift is over."""
JUMP_US: Final = 500_000
"""A stamp this far from where the clock should be means that the sensor side has restarted."""
GOES_ON_US: Final = 100_000
"""The next stamp, ten lost frames later at most."""
ON_TIME_US: Final = 50_000
BACK_US: Final = 200_000
"""So does one this far behind the newest: frames keep their order, but for what a bus delays."""


class SensorClockEstimate:
    """Unwraps stamps, and estimates the present time of the sensor clock."""

    def __init__(self) -> None:
        self._offsets: deque[tuple[int, int]] = deque()
        """Of the last WINDOW stamps those than which no later one is less: number and offset. So
        the first is the least of all, and none has to be looked for."""
        self._stamps = 0
        self._least = 0
        self.latest_us = 0
        """The newest stamp seen, unwrapped."""
        self.jumps = 0
        """Number of jumps of the sensor clock."""
        self.late = 0
        """How often stamps have begun to come late: the bus or the machine is overloaded."""
        self._is_late = False

    def stamp(self, stamp: int, now_us: int) -> int:
        """The unwrapped time of a frame read just before `now_us` of the controller's clock."""
        if not self._offsets:
            time_us = self.latest_us = stamp
        else:
            expected_us = now_us - self._least
            time_us = unwrap(stamp, expected_us)
            if self._goes_on(time_us) and time_us < expected_us - JUMP_US:
                self._came_late()
            elif abs(time_us - expected_us) > JUMP_US or time_us < self.latest_us - BACK_US:
                self.jumps += 1
                self._offsets.clear()
                time_us = self.latest_us = unwrap(stamp, self.latest_us)
            elif time_us > expected_us - ON_TIME_US:
                self._is_late = False
        # Frames of a read come one after the other, so one of an older read may be the last seen.
        self.latest_us = max(self.latest_us, time_us)
        self._note(now_us - time_us)
        return time_us

    def _goes_on(self, time_us: int) -> bool:
        """Whether a stamp follows the newest as frames do, whenever it may come: then the clock has
        not jumped, and its frames have waited somewhere."""
        return -BACK_US <= time_us - self.latest_us <= GOES_ON_US

    def _came_late(self) -> None:
        if not self._is_late:
            self.late += 1
        self._is_late = True

    def restart(self) -> None:
        """The sensor side has restarted, however near to the old one its clock reads."""
        self.jumps += 1
        self._offsets.clear()

    def set_back(self, stamp: int, now_us: int) -> int:
        """As `stamp`, for one that is known to be of a clock that was set back by however little:
        the message's counter went on, its time did not. Frames of one identifier keep their
        order."""
        self.jumps += 1
        self._offsets.clear()
        self.latest_us = unwrap(stamp, self.latest_us)
        self._note(now_us - self.latest_us)
        return self.latest_us

    def _note(self, offset: int) -> None:
        while self._offsets and self._offsets[-1][1] >= offset:
            self._offsets.pop()
        self._offsets.append((self._stamps, offset))
        if self._offsets[0][0] <= self._stamps - WINDOW:
            self._offsets.popleft()
        self._stamps += 1
        self._least = self._offsets[0][1]

    def now_us(self, now_us: int) -> int:
        """The sensor clock now; 0 before the first stamp."""
        return now_us - self._least if self._offsets else 0
