"""What a log's clock is to the sensors', and the log's frames in sensor time.

The edge frames say when they were read, by the sensors' clock; the log says when they came, by its
own. A frame comes later than it was read and never sooner, so the line below all points (time read,
time logged) is the clock, and what lies above it is the way of the frames. Where no line fits, as
in a log by the wall clock of a run whose bus time waited for its nodes, the frames between two
reads are put between these two by their share of the logged time.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshpoint.bus.logs.files import read_logs
from meshpoint.bus.logs.reader import LogError
from meshpoint.dbc.e2e import check_crc
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.results.road_speed import span_us

READS: Final = {
    codec.spec.can_id: codec.spec for name, codec in CODECS.items() if name.startswith("Edges")
}
READ_TIME: Final = slice(3, 7)
"""Bytes of the signal ReadTime, the low one first, in every edge frame."""
GOES_ON_S: Final = 0.1
"""Ten reads lost at most: the sensors' clock has gone on, however long its frames have waited."""
JUMP_S: Final = 0.5
"""Over a longer hole both clocks go on alike, or one of them was set."""
SET_FORWARD_S: Final = 5.0
"""No machine holds a bus up for so long."""
ORDER_S: Final = 0.2
"""A read this much older than the newest is a frame out of order."""
BACK_S: Final = 0.01
"""A log that goes back by more was set back."""
LEAST_READS: Final = 100
MOST_POINTS: Final = 50_000
MOST_PARTS: Final = 1_000
MOST_REPORTED: Final = 8
STOP_FRAMES: Final = 500
MOST_HELD: Final = 10_000
"""Entries that wait for the next read: more than a bus carries between two, also where a machine
has held it up. It bounds the memory where the sensors fall silent."""
WINDOW: Final = 50
"""Reads, half a second, of which one at least has come without waiting."""
LEAST_WINDOWS: Final = 20
"""For what a drift may be by delays alone: the line touches two reads, so of two or three windows
the usual one would always seem to wait for nothing."""
UNEVEN_S: Final = 0.005
UNEVEN_SHARE: Final = 0.1
"""A clock is uneven where in this share of the windows no read comes nearer to its line."""
RESOLUTION_S: Final = 2e-4
"""A frame's time on the bus, by which the least delay may differ."""
DOUBT: Final = 6.0
"""Times the usual distance of a window from the line: what a drift may be by delays alone."""

Entry = tuple[float, Frame]
Unpack = Callable[[Frame], Iterable[Frame]]


class Kind(StrEnum):
    """How the log's clock runs against the sensors'."""

    ALIKE = "alike"
    """No difference can be measured; the log's stamps are taken as they are."""
    STEADY = "steady"
    """At another rate."""
    UNEVEN = "uneven"
    UNKNOWN = "unknown"
    """Too few edge frames to tell; the log's stamps are taken as they are."""


@dataclass
class Part:
    """A part of a log in which neither clock was set and no node of the sensors has restarted."""

    first_frame: int
    kind: Kind = Kind.UNKNOWN
    rate: float = 1.0
    """Seconds of the log per second of the sensors."""
    seconds: float = 0.0
    """Its length by the sensors' clock."""

    @property
    def differs(self) -> bool:
        """Whether its frames are given other times than the log's."""
        return self.kind in (Kind.STEADY, Kind.UNEVEN)


class Read(NamedTuple):
    """The first frame of a read."""

    step_s: float
    """How far the sensors' clock has gone on since the read before."""
    is_break: bool
    """One of the clocks was set since, or the sensors have restarted."""


class _Reads:
    """Finds the reads in a log."""

    def __init__(self, unpack: Unpack | None) -> None:
        self._unpack = unpack
        self._newest_us: int | None = None
        self._logged_s = 0.0

    def take(self, time_s: float, frame: Frame) -> Read | None:
        """A frame of the log; a Read where a new one begins with it."""
        if self._unpack is None:
            return self._take(time_s, frame)
        found = [self._take(time_s, inner) for inner in self._unpack(frame)]
        return next(filter(None, found), None)

    def _take(self, time_s: float, frame: Frame) -> Read | None:
        spec = READS.get(frame.can_id) if frame.is_extended else None
        if spec is None or len(frame.data) != spec.length:
            return None
        read_us = int.from_bytes(frame.data[READ_TIME], "little")
        newest_us, logged_s = self._newest_us, self._logged_s
        step_s = 0.0 if newest_us is None else span_us(read_us, newest_us) * 1e-6
        if newest_us is not None and -ORDER_S <= step_s <= 0.0:
            return None
        if not check_crc(frame.data, spec.protected_id):
            return None
        self._newest_us, self._logged_s = read_us, time_s
        if newest_us is None:
            return Read(0.0, is_break=True)
        return Read(step_s, is_break(step_s, time_s - logged_s))


def is_break(step_s: float, passed_s: float) -> bool:
    """Whether one of the clocks was set, or the sensors have restarted: theirs has gone on by
    `step_s` while `passed_s` went by in the log."""
    goes_on = 0.0 < step_s <= GOES_ON_S or abs(step_s - passed_s) <= JUMP_S
    was_set = passed_s < -BACK_S or passed_s - step_s > SET_FORWARD_S
    return not goes_on or was_set


class _Points:
    """When the reads of one part were made and logged, s since its first; thinned when they are
    many, the sooner of two is kept."""

    def __init__(self) -> None:
        self.read_s = array("d")
        self.logged_s = array("d")
        self.count = 0

    def add(self, read_s: float, logged_s: float) -> None:
        self.read_s.append(read_s)
        self.logged_s.append(logged_s)
        self.count += 1
        if len(self.read_s) >= 2 * MOST_POINTS:
            read, logged = np.array(self.read_s), np.array(self.logged_s)
            late = logged - read * (logged[-1] / read[-1])
            sooner = 2 * np.arange(late.size // 2) + (late[1::2] < late[0::2])
            self.read_s, self.logged_s = array("d", read[sooner]), array("d", logged[sooner])


def _line_below(read_s: NDArray[np.float64], logged_s: NDArray[np.float64]) -> tuple[float, float]:
    """Slope and offset of the line that has no point below it and lies nearest to all: the side of
    the lower hull over their mean."""
    hull: list[tuple[float, float]] = []
    for x, y in zip(read_s.tolist(), logged_s.tolist(), strict=True):
        while len(hull) > 1:
            (x0, y0), (x1, y1) = hull[-2], hull[-1]
            if (x1 - x0) * (y - y0) - (x - x0) * (y1 - y0) > 0.0:
                break
            hull.pop()
        hull.append((x, y))
    middle = float(read_s.mean())
    right = next(k for k in range(1, len(hull)) if hull[k][0] >= middle or k == len(hull) - 1)
    (x0, y0), (x1, y1) = hull[right - 1], hull[right]
    rate = (y1 - y0) / (x1 - x0)
    return rate, y0 - rate * x0


def _nearest_s(late_s: NDArray[np.float64], windows: int) -> NDArray[np.float64]:
    """How far each of this many windows of reads stays from the line at least."""
    return np.array([window.min() for window in np.array_split(late_s, windows)])


class LogClockFit:
    """Takes a log's entries in their order; `finish` returns its clock."""

    def __init__(self, unpack: Unpack | None = None) -> None:
        """unpack: makes frames of meshpoint.dbc of those on the bus, of another profile."""
        self._reads = _Reads(unpack)
        self._frames = 0
        self._parts: list[Part] = []
        self._points = _Points()
        self._begun_s = 0.0
        self._read_s = 0.0

    def take(self, time_s: float, frame: Frame) -> None:
        """The next entry."""
        read = self._reads.take(time_s, frame)
        if read is not None:
            if read.is_break and len(self._parts) < MOST_PARTS:
                self._close()
                self._parts.append(Part(self._frames))
                self._points, self._begun_s, self._read_s = _Points(), time_s, 0.0
            else:
                self._read_s += read.step_s
            self._points.add(self._read_s, time_s - self._begun_s)
        self._frames += 1

    def finish(self) -> LogClock:
        """The log has ended."""
        self._close()
        return LogClock(self._parts)

    def _close(self) -> None:
        if not self._parts or self._points.count < LEAST_READS or len(self._parts) == MOST_PARTS:
            return
        part = self._parts[-1]
        read, logged = np.array(self._points.read_s), np.array(self._points.logged_s)
        part.seconds = float(read[-1])
        rate, offset = _line_below(read, logged)
        late = logged - offset - rate * read
        windows = max(1, late.size // WINDOW)
        if np.mean(_nearest_s(late, windows) > UNEVEN_S) > UNEVEN_SHARE:
            part.kind, part.rate = Kind.UNEVEN, float(logged[-1] / read[-1])
            return
        usual_s = float(np.median(_nearest_s(late, max(LEAST_WINDOWS, windows))))
        by_delay_s = RESOLUTION_S + DOUBT * usual_s
        is_seen = abs(rate - 1.0) * part.seconds > by_delay_s
        part.kind, part.rate = (Kind.STEADY, rate) if is_seen else (Kind.ALIKE, 1.0)


class LogClock:
    """A log's clock against the sensors'."""

    def __init__(self, parts: list[Part]) -> None:
        self.parts = parts

    @property
    def differs(self) -> bool:
        """Whether any frames are given other times than the log's."""
        return any(part.differs for part in self.parts)

    @property
    def words(self) -> str:
        """What was done about it, a sentence; empty where the clocks agree."""
        if not self.parts:
            return (
                "no edge frame reports the sensors' clock: the log's stamps are taken as they are"
            )
        apart = [part for part in self.parts if part.differs]
        if not apart:
            return ""
        longest = max(apart, key=lambda part: part.seconds)
        rate = f"{longest.rate:.{4 if abs(longest.rate - 1.0) >= 1e-3 else 6}f} x the sensors'"
        if longest.kind is Kind.UNEVEN:
            rate = f"unevenly, on average {rate}"
        where = f" in {len(apart)} of {len(self.parts)} parts" if len(self.parts) > 1 else ""
        return f"the log's clock runs {rate}{where}; its stamps are taken in sensor time"

    def to_json(self) -> dict[str, Any]:
        """As plain values."""
        return {
            "differs": self.differs,
            "said": self.words,
            "parts": [
                {
                    "first_frame": part.first_frame,
                    "kind": part.kind.value,
                    "rate": round(part.rate, 9),
                    "seconds": round(part.seconds, 3),
                }
                for part in self.parts[:MOST_REPORTED]
            ],
        }

    def in_sensor_time(
        self, entries: Iterable[Entry], unpack: Unpack | None = None
    ) -> Iterator[Entry]:
        """The log's entries once more, in seconds of the sensors' clock, counted from the first
        stamp of the log; the very stamps where the clocks agree."""
        if not self.differs:
            yield from entries
            return
        later = iter(self.parts)
        part, following = Part(0), next(later, None)
        shift = _Shift(unpack)
        for number, (time_s, frame) in enumerate(entries):
            if following is not None and number == following.first_frame:
                yield from shift.rest(part)
                part, following = following, next(later, None)
            yield from shift.take(part, time_s, frame)
        yield from shift.rest(part)


def clock_of(
    files: list[Path],
    bus: str | None = None,
    unpack: Callable[[], Unpack] | None = None,
    stop: Callable[[], bool] = lambda: False,
) -> LogClock:
    """The clock of these files, read as far as they can be, or until `stop` says so. unpack: makes
    one that makes frames of meshpoint.dbc of those on a bus of another profile. LogError where
    nothing of them can be read."""
    fit = LogClockFit(None if unpack is None else unpack())
    frames = 0
    try:
        for time_s, frame in read_logs(files, bus):
            fit.take(time_s, frame)
            if frames % STOP_FRAMES == 0 and stop():
                break
            frames += 1
    except LogError:
        if frames == 0:
            raise  # of a later defect it is said when the frames are read
    return fit.finish()


class _Shift:
    """Gives entries their times in sensor time, part by part."""

    def __init__(self, unpack: Unpack | None) -> None:
        self._reads = _Reads(unpack)
        self._logged_s: float | None = None
        """Up to this time of the log it is shifted; None at its start."""
        self._shifted_s = 0.0
        """That time by the sensors' clock."""
        self._held: list[Entry] = []

    def take(self, part: Part, time_s: float, frame: Frame) -> Iterator[Entry]:
        """An entry of this part; those whose times are known by now."""
        if self._logged_s is None:
            self._logged_s = self._shifted_s = time_s
        read = self._reads.take(time_s, frame)
        self._held.append((time_s, frame))
        if part.kind is not Kind.UNEVEN or (read is not None and read.is_break):
            yield from self.rest(part)
        elif read is not None:
            # Over a long hole both clocks have gone on.
            yield from self._give(time_s, read.step_s)
        elif len(self._held) >= MOST_HELD:
            yield from self.rest(part)

    def rest(self, part: Part) -> Iterator[Entry]:
        """Those whose times no later read gives."""
        if self._held and self._logged_s is not None:
            newest_s = self._held[-1][0]
            rate = part.rate if part.differs else 1.0
            yield from self._give(newest_s, (newest_s - self._logged_s) / rate)

    def _give(self, until_s: float, step_s: float) -> Iterator[Entry]:
        """All that are held: the log goes on to `until_s`, the sensors' clock by `step_s`."""
        begun_s, shifted_s = self._logged_s or 0.0, self._shifted_s
        held, self._held = self._held, []
        self._logged_s, self._shifted_s = until_s, shifted_s + step_s
        passed_s = until_s - begun_s
        for time_s, frame in held:
            share = 1.0 if passed_s == 0.0 else (time_s - begun_s) / passed_s
            yield shifted_s + share * step_s, frame
