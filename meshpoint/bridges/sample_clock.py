"""When samples were taken, on one time axis: that of the log, or of the bus.

The frames of the sensors say when they were read, by the sensors' clock. They come later than that
and never sooner, so the least (came - read) ties that clock to the axis. No sample stands later
than its frame then; all of them stand too late by the shortest way of a frame, which cannot be
seen. A log is read once beforehand to find the least; on a live bus it is that of the last seconds.
"""

from __future__ import annotations

import contextlib
from collections import deque
from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple, Protocol

from meshpoint.bus.logs.reader import LogError
from meshpoint.dbc.e2e import check_crc
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.node import Node
from meshpoint.dbc.sensor_time import unwrap
from meshpoint.logs.log_clock import ORDER_S, READ_TIME, Entry, Unpack, is_break
from meshpoint.units import US

SENSOR_STAMPS: Final = ("read_time_us", "sample_time_us", "event_time_us")
SENSORS: Final = {
    codec.spec.can_id: codec.spec
    for codec in CODECS.values()
    if codec.spec.sender in (Node.GEARBOX_IO, Node.REFERENCE)
    and codec.fields[0].name in SENSOR_STAMPS
}
"""Messages whose stamps are the sensors' own, all in the same bytes."""
APART_S: Final = 0.5
"""A controller's stamp that lies so far before its frame is none of the sensors' clock: it has not
heard them yet, or they have restarted."""
AHEAD_S: Final = 0.02
"""It may lie so far behind its frame: the controller has a least way of its own."""
LIVE_STAMPS: Final = 4_000
"""Stamps that the least is looked for in, on a live bus: some three seconds, in which clocks do not
drift apart."""


class Chained(NamedTuple):
    """A stamp of the sensors' clock, as a time that does not wrap."""

    us: int
    way_s: float
    """How much later its frame came, by clocks that are not tied yet."""
    begins: bool
    """It is the first one, or the sensors' clock or the log's was set since the one before."""


class SensorStamps:
    """Takes frames in their order, and unwraps the sensors' stamps."""

    def __init__(self) -> None:
        self.newest_us: int | None = None
        self._came_s = 0.0

    def take(self, time_s: float, frame: Frame) -> Chained | None:
        """A frame that came at `time_s`; None where it has no stamp of the sensors, or is
        damaged."""
        spec = SENSORS.get(frame.can_id)
        if spec is None or len(frame.data) != spec.length:
            return None
        if not check_crc(frame.data, spec.protected_id):
            return None
        stamp = int.from_bytes(frame.data[READ_TIME], "little")
        us, begins = self._unwrapped(time_s, stamp)
        return Chained(us, time_s - us * US, begins)

    def _unwrapped(self, time_s: float, stamp: int) -> tuple[int, bool]:
        newest_us = self.newest_us
        if newest_us is not None:
            us = unwrap(stamp, newest_us)
            step_s = (us - newest_us) * US
            if -ORDER_S <= step_s <= 0.0:
                return us, False
            if step_s > 0.0 and not is_break(step_s, time_s - self._came_s):
                self.newest_us, self._came_s = us, time_s
                return us, False
        self.newest_us, self._came_s = stamp, time_s
        return stamp, True


class Ties(Protocol):
    """How far the axis is ahead of the sensors' clock."""

    def offset_s(self, stamp: Chained) -> float:
        """At this stamp; call it for each, in their order."""


class LogTies:
    """Of a log that was read beforehand: one for each time that a clock was set."""

    def __init__(self, offsets_s: Sequence[float]) -> None:
        self._offsets_s = offsets_s
        self._number = -1

    def offset_s(self, stamp: Chained) -> float:
        """As `Ties` has it."""
        self._number += stamp.begins
        return self._offsets_s[self._number]


def ties_of(entries: Iterable[Entry], unpack: Unpack) -> LogTies:
    """Reads a log as far as it can be read; a defect is said when it is read again."""
    stamps, offsets_s = SensorStamps(), list[float]()
    with contextlib.suppress(LogError):
        for time_s, frame in entries:
            for inner in unpack(frame):
                stamp = stamps.take(time_s, inner)
                if stamp is None:
                    continue
                if stamp.begins:
                    offsets_s.append(stamp.way_s)
                offsets_s[-1] = min(offsets_s[-1], stamp.way_s)
    return LogTies(offsets_s)


class LiveTies:
    """Of a live bus: the least of the last stamps."""

    def __init__(self) -> None:
        self._ways: deque[tuple[int, float]] = deque()
        """Number and way of those stamps than which no later one has a shorter way."""
        self._stamps = 0

    def offset_s(self, stamp: Chained) -> float:
        """As `Ties` has it."""
        if stamp.begins:
            self._ways.clear()
        while self._ways and self._ways[-1][1] >= stamp.way_s:
            self._ways.pop()
        self._ways.append((self._stamps, stamp.way_s))
        if self._ways[0][0] <= self._stamps - LIVE_STAMPS:
            self._ways.popleft()
        self._stamps += 1
        return self._ways[0][1]


class SampleClock:
    """Gives stamps their times on the axis."""

    def __init__(self, ties: Ties) -> None:
        self._ties = ties
        self._stamps = SensorStamps()
        self._offset_s = 0.0

    def of_sensors(self, time_s: float, frame: Frame) -> float | None:
        """The time of a sensor frame's stamp; None for all other frames. Call it for each frame, in
        their order."""
        stamp = self._stamps.take(time_s, frame)
        if stamp is None:
            return None
        self._offset_s = self._ties.offset_s(stamp)
        return stamp.us * US + self._offset_s

    def of_controller(self, time_s: float, stamp: int) -> float | None:
        """The time of a stamp that a controller has made by the sensors' clock as it knows it; None
        where it can be none of that clock."""
        newest_us = self._stamps.newest_us
        if newest_us is None:
            return None
        at_s = unwrap(stamp, newest_us) * US + self._offset_s
        return min(at_s, time_s) if -APART_S <= at_s - time_s <= AHEAD_S else None
