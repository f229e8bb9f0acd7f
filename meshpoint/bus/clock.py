"""The clock of a live node."""

from collections.abc import Callable
from time import perf_counter_ns
from typing import Protocol

NS_PER_US = 1_000
US_PER_S = 1_000_000


class NodeClock(Protocol):
    """What the driver needs of a clock: `Clock`, or `meshpoint.bus.pace.PacedClock`."""

    speed: float
    """Clock seconds per wall second on a machine that keeps up."""

    def now_us(self) -> int:
        """Clock time in microseconds."""

    def delay_s(self, until_us: int) -> float:
        """Wall seconds after which to look at the clock again for `until_us`; 0 if passed."""

    def wall_s(self, clock_us: int) -> float:
        """Wall seconds that a span of clock time takes."""

    def heard(self) -> None:
        """A frame of another node has arrived."""

    def begins(self, now_us: int) -> None:
        """The node looks at what has arrived and is due at this clock time."""

    def here(self) -> None:
        """The node has done all that was due when it began."""

    def leave(self) -> None:
        """The node ends."""


class Clock:
    """Integer microseconds since this clock was made, running `speed` times as fast as the wall.

    Monotonic. Both nodes of a bench are given the same `speed`, never one of them alone.

    speed: clock seconds per wall second, finite and > 0.
    source_ns: monotonic wall nanoseconds; `perf_counter_ns`, because `monotonic_ns` has a
        resolution of 16 ms on Windows.
    """

    def __init__(self, speed: float = 1.0, source_ns: Callable[[], int] = perf_counter_ns) -> None:
        if not 0.0 < speed < float("inf"):
            raise ValueError(f"speed is {speed!r}, allowed are finite values > 0")
        self.speed = speed
        self._source_ns = source_ns
        self._start_ns = source_ns()

    def now_us(self) -> int:
        """Clock time in microseconds, rounded down."""
        return int((self._source_ns() - self._start_ns) * self.speed) // NS_PER_US

    def delay_s(self, until_us: int) -> float:
        """Wall seconds from now until the clock shows `until_us`; 0 if it has passed."""
        return max(0.0, self.wall_s(until_us - self.now_us()))

    def wall_s(self, clock_us: int) -> float:
        """Wall seconds that a span of `clock_us` clock microseconds takes."""
        return clock_us / (self.speed * US_PER_S)

    def heard(self) -> None:
        """The wall does not listen."""

    def begins(self, now_us: int) -> None:
        """The wall goes on meanwhile."""

    def here(self) -> None:
        """The wall waits for nobody."""

    def leave(self) -> None:
        """And misses nobody."""
