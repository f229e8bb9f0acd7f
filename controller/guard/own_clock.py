"""The guard's own sensor clock, from the times of the frames it believes.

The offset between the controller's clock and the sensors' is the least that `now - stamp` was
lately: each second's least is kept for some seconds. Frames that come late, as after a node has
hung, are therefore old, not of a slower clock. It is written apart from the clock that the
commands are timed by, so that an error there shows as a difference (row 19).
"""

from __future__ import annotations

from collections import deque
from typing import Final

MODULUS: Final = 1 << 32
SECOND: Final = 1_000_000
SECONDS_KEPT: Final = 6
"""Seconds in which frames were heard: in silence nothing is forgotten."""
RESTARTED_US: Final = 500_000
"""A time so far from where the clock should be is that of another clock, unless it only comes late
(`GOES_ON_US`)."""
GOES_ON_US: Final = 100_000
"""A time comes only late if it is behind where the clock should be, but no further ahead of the
newest one than this."""
BACK_US: Final = 20_000
"""A time so far behind the newest is that of another clock too. A frame that only waited for the
bus does no harm: the next one that did not wait gives the least again."""
CAUGHT_UP_US: Final = 20_000
"""A second this much less late than the one before was one of catching up with what had waited:
the second before says nothing that it does not say better, and is not kept."""


def signed_us(difference: int) -> int:
    """A difference of 32-bit times as the shorter way round."""
    return (difference + MODULUS // 2) % MODULUS - MODULUS // 2


class GuardClock:
    """What the sensors' clock reads at a time of the controller's."""

    def __init__(self) -> None:
        self._least: deque[tuple[int, int]] = deque(maxlen=SECONDS_KEPT)
        """Each second of the controller's clock, and its least offset."""
        self._offset: int | None = None
        """The least offset of all seconds kept; None without any."""
        self._newest_us: int | None = None

    def restart(self) -> None:
        """The sensors have started anew, however near to the old clock the new one reads: with the
        next frame all before is forgotten."""
        self._offset = None

    def hear(self, time_us: int, now_us: int) -> bool:
        """The time of a frame that is consumed at `now_us` of the controller's clock. True: it is
        of another clock than those before it."""
        newest_us, self._newest_us = self._newest_us, time_us
        is_another = newest_us is not None and self._is_of_another_clock(
            time_us - newest_us, time_us, now_us
        )
        if is_another:
            self._least.clear()
        offset, second = now_us - time_us, now_us // SECOND
        if not self._least or self._least[-1][0] != second:
            self._drop_what_waited()
            self._least.append((second, offset))
        elif offset < self._least[-1][1]:
            self._least[-1] = (second, offset)
        else:
            return is_another
        self._offset = min([each for _, each in self._least])
        return is_another

    def _drop_what_waited(self) -> None:
        least = self._least
        if len(least) > 1 and least[-1][1] < least[-2][1] - CAUGHT_UP_US:
            del least[-2]

    def _is_of_another_clock(self, ahead_us: int, time_us: int, now_us: int) -> bool:
        expected_us = self.now_us(now_us)
        if ahead_us < -BACK_US or expected_us is None:
            return True
        is_late = time_us < expected_us and ahead_us <= GOES_ON_US
        return abs(time_us - expected_us) > RESTARTED_US and not is_late

    def now_us(self, now_us: int) -> int | None:
        """The sensor clock at `now_us` of the controller's; None before the first frame."""
        return None if self._offset is None else now_us - self._offset
