"""Rising edges, three a frame: which of them a read sends, and the array of the last 27 again."""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Iterator
from typing import Any, Final, NamedTuple

WRAP: Final = 1 << 32
INDEX_WRAP: Final = 1 << 16
LOW: Final = 0xFFFF
STAMPS: Final = 27
A_FRAME: Final = 3
"""Edges that a frame holds."""
MOST_IN_FULL: Final = 9
"""Up to this many new edges are all sent with their read; of more, the one or two over whole frames
wait for the next read, which saves one frame in six at the highest speed."""
AHEAD_US: Final = 10_240
"""An edge may be so much younger than the newest read that was heard, whose frame may be lost."""
MOST_FILLED: Final = 3
"""A lost frame's edges are put evenly between their neighbours; of more, the array starts anew."""
FRAME_INDEX_WRAP: Final = 16
READ_INDEX_WRAP: Final = 256


class EdgeReport(NamedTuple):
    """An edge message of meshpoint.dbc, in the order of its fields."""

    read_time_us: int
    newest_index: int
    valid_stamps: int
    long_interval: bool
    stopped: bool
    sensor_fault: bool
    timestamp_low_us: tuple[int, ...]


class EdgeSender:
    """Cuts the reads of one wheel into frames."""

    def __init__(self, message_type: type[Any]) -> None:
        self._type = message_type
        self._sent: int | None = None
        self.index = 0
        """Running number of the newest edge sent."""

    def cut(self, read: EdgeReport) -> Iterator[Any]:
        """The messages of one read, oldest edges first; `index` is up to date when all are made."""
        valid, newest = read.valid_stamps, read.newest_index
        sent = self._sent
        fresh = valid if sent is None else (newest - sent) % INDEX_WRAP
        if valid < A_FRAME:
            fresh = 0
        elif fresh > valid:  # switched on anew, or more edges came than the array holds
            fresh = valid
        send = fresh if fresh <= MOST_IN_FULL else fresh - fresh % A_FRAME
        self.index = self._sent = (newest - fresh + send) % INDEX_WRAP
        first = fresh - send
        """Entries of the array that wait for the next read."""
        lows = (*read.timestamp_low_us, 0, 0)
        entries = range(first + max(0, send - A_FRAME), first - A_FRAME, -A_FRAME)
        for entry in entries if send else ():
            at = max(entry, first)
            number = (newest - at) % FRAME_INDEX_WRAP
            yield self._type(number, lows[at : at + A_FRAME])


class EdgeArray:
    """The last 27 edges of one wheel, from frames of three."""

    def __init__(self) -> None:
        self._times: deque[int] = deque(maxlen=STAMPS)
        """Newest first, 32 bits."""
        self._index: int | None = None
        self.filled = 0
        """Edges that were lost with a frame and put between their neighbours."""

    def restart(self) -> None:
        """The sensor has been switched on anew, or it is not known which edges were missed."""
        self._times.clear()
        self._index = None

    def take(self, message: Any, steps: int, read_us: int, target: int) -> None:
        """One frame. steps: of its counter; target: low bits of the number the read goes up to."""
        lows = message.timestamp_low_us
        if self._index is None:
            back = (target - message.newest_index) % FRAME_INDEX_WRAP
            index, fresh = (target - back) % READ_INDEX_WRAP, A_FRAME
        else:
            expected = self._index + A_FRAME * steps
            ahead = (message.newest_index - expected) % FRAME_INDEX_WRAP
            half = FRAME_INDEX_WRAP // 2
            index = expected + ((ahead + half) % FRAME_INDEX_WRAP - half)
            fresh = index - self._index
        if fresh <= 0:
            return
        latest_us = read_us + AHEAD_US
        newest_us = latest_us - ((latest_us - lows[0]) & LOW)
        times = [newest_us, 0, 0]
        for k in (1, 2):
            times[k] = times[k - 1] - ((times[k - 1] - lows[k]) & LOW)
        self._fill(fresh - A_FRAME, times[-1])
        for time_us in reversed(times[: min(fresh, A_FRAME)]):
            self._times.appendleft(time_us % WRAP)
        self._index = index

    def _fill(self, missing: int, next_us: int) -> None:
        if missing <= 0:
            return
        if missing > MOST_FILLED or not self._times:
            self._times.clear()
            return
        span_us = (next_us - self._times[0]) % WRAP
        last_us = self._times[0]
        for k in range(1, missing + 1):
            self._times.appendleft((last_us + span_us * k // (missing + 1)) % WRAP)
        self.filled += missing

    def is_up_to(self, target: int) -> bool:
        """Whether the newest edge is the one with these low bits of its number."""
        return self._index is not None and self._index % READ_INDEX_WRAP == target

    def report(self, read_us: int, stopped: bool, fault: bool) -> EdgeReport:
        """The array as meshpoint.dbc has it, at a read."""
        times = self._times
        spans = [(newer - older) % WRAP for newer, older in itertools.pairwise(times)]
        return _report(read_us, self._index or 0, (list(times), spans), stopped, fault)


def _report(
    read_us: int, index: int, edges: tuple[list[int], list[int]], stopped: bool, fault: bool
) -> EdgeReport:
    """An array as meshpoint.dbc has it. edges: their times, newest first, and the spans between
    them."""
    times, spans = edges
    lows = [time_us & LOW for time_us in times]
    return EdgeReport(
        read_time_us=read_us,
        newest_index=index % INDEX_WRAP,
        valid_stamps=len(lows),
        long_interval=any(span > LOW for span in spans),
        stopped=stopped,
        sensor_fault=fault,
        timestamp_low_us=(*lows, *(0,) * (STAMPS - len(lows))),
    )


class SpeedWheel:
    """The edges of a wheel of which the speed alone is known: evenly spaced, at any angle.

    What reads them takes from them that speed again. An angle they do not have, so no estimator may
    be given them. The array is never full, by
    which the guard knows that no teeth were counted."""

    def __init__(self) -> None:
        self._times: deque[float] = deque(maxlen=STAMPS - 1)
        """Newest first, in `_clock_us`."""
        self._clock_us = 0.0
        self._phase = 0.0
        self._count = 0
        self._read_us: int | None = None

    def report(self, read_us: int, edges_per_us: float) -> EdgeReport:
        """The array at a read, for a wheel that has turned at this speed since the read before."""
        passed_us = 0 if self._read_us is None else (read_us - self._read_us) % WRAP
        self._read_us = read_us
        if passed_us >= WRAP // 2:  # set back
            passed_us = 0
        begin_us, self._clock_us = self._clock_us, self._clock_us + passed_us
        turned = self._phase + min(passed_us, LOW) * edges_per_us
        whole = int(turned)
        for number in range(1, whole + 1):
            self._times.appendleft(begin_us + (number - self._phase) / edges_per_us)
        self._phase, self._count = turned - whole, self._count + whole
        since_us = self._clock_us - (self._times[0] if self._times else 0.0)
        ages = [round(self._clock_us - time_us) for time_us in self._times]
        times = [read_us - age for age in ages]
        spans = [older - newer for newer, older in itertools.pairwise(ages)]
        return _report(read_us, self._count, (times, spans), since_us > LOW, False)
