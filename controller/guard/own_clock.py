"""The guard's own sensor clock, from the raw stamps of the frames it believes.

The offset between the controller's clock and the sensors' is the least that `now - stamp` was
lately: each second's least is kept for some seconds. It is written apart from the clock that the
commands are timed by, so that an error there shows as a difference (row 19).
"""

from __future__ import annotations

from collections import deque
from typing import Final

MODULUS: Final = 1 << 32
SECOND: Final = 1_000_000
SECONDS_KEPT: Final = 4
RESTARTED_US: Final = 500_000
"""An offset that changes by more is that of another clock."""
BACK_US: Final = 20_000
"""So is one with a stamp so far behind the newest. A frame that only waited for the bus does no
harm: the next one that did not wait gives the least again."""


def signed_us(difference: int) -> int:
    """A difference of 32-bit times as the shorter way round."""
    return (difference + MODULUS // 2) % MODULUS - MODULUS // 2


class GuardClock:
    """The sensors' time, unwrapped."""

    def __init__(self) -> None:
        self._least: deque[tuple[int, int]] = deque()
        """Each second of the controller's clock, and its least offset."""
        self._newest_us: int | None = None

    def hear(self, stamp: int, now_us: int) -> None:
        """A stamp of a frame that is consumed at `now_us` of the controller's clock."""
        newest_us = self._newest_us
        if newest_us is None:
            time_us = stamp
        else:
            ahead_us = signed_us(stamp - newest_us)
            time_us = newest_us + ahead_us
            expected_us = self.now_us(now_us)
            is_other = expected_us is not None and abs(time_us - expected_us) > RESTARTED_US
            if is_other or ahead_us < -BACK_US:
                self._least.clear()
        self._newest_us = time_us
        offset, second = now_us - time_us, now_us // SECOND
        if not self._least or self._least[-1][0] != second:
            self._least.append((second, offset))
        elif offset < self._least[-1][1]:
            self._least[-1] = (second, offset)
        while self._least[0][0] <= second - SECONDS_KEPT:
            self._least.popleft()

    def now_us(self, now_us: int) -> int | None:
        """The sensor clock at `now_us` of the controller's; None before the first stamp."""
        if not self._least:
            return None
        return now_us - min([offset for _, offset in self._least])
