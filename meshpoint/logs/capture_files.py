"""Captured edges of real sensors: files of level changes, sampled levels or voltages, and the wheel
behind them.

Columns are a time in s (or what the header says in brackets: ms, us, ns), then one channel each: a
level, as of a logic analyser, one line a change or a sample; or a voltage in V. Columns are parted
by comma, semicolon or tab. Edges of a voltage are found with hysteresis about its slow middle, or
about a threshold.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from meshpoint.base.errors import CommandError
from meshpoint.gearbox.reading import UnreadableError, read_text
from meshpoint.kernels.records import Integers, Vector
from meshpoint.units import SECOND_US

HYSTERESIS_SHARE: Final = 0.15
"""Half the hysteresis, as a share of the voltage's usual swing."""
CAPTURE_LIMIT_BYTES: Final = 64 << 20
GAP: Final = 1.5
"""An interval this many times the usual one is a gap of missing teeth."""
LEAST_TEETH, MOST_TEETH = 8, 130
MOST_HEADER_LINES: Final = 20
"""Lines in front of the first one of numbers: names of columns, remarks of the instrument."""
UNIT: Final = re.compile(r"[\[(]\s*(ns|us|\u00b5s|ms|s|sec)\s*[\])]", re.I)
SECONDS: Final = {"ns": 1e-9, "us": 1e-6, "\u00b5s": 1e-6, "ms": 1e-3, "s": 1.0, "sec": 1.0}


@dataclass(frozen=True)
class Columns:
    """A file as it is: times and what each channel was then."""

    name: str
    time_s: Vector
    titles: tuple[str, ...]
    """Of each channel; its number where the file has no header."""
    values: Vector
    """(channels, n): levels or volts."""

    def is_level(self, channel: int) -> bool:
        """Whether a channel knows two values alone."""
        return bool(np.unique(self.values[channel]).size <= 2)

    def edges(self, channel: int, threshold_v: float | None = None) -> tuple[Integers, Integers]:
        """Times of its rising and its falling edges, us.

        threshold_v: of a voltage; without it, the middle of what the voltage usually is."""
        values = self.values[channel]
        if self.is_level(channel):
            return _edges(self.time_s, values)
        return _edges(self.time_s, schmitt(values, threshold_v))


@dataclass(frozen=True)
class Capture:
    """Edge times of one channel in us: of the wheel's sensor, and of another channel that shows
    where its turns begin, if there is one. A polarity that is not used is empty."""

    name: str
    rise_us: Integers
    fall_us: Integers
    second_us: Integers

    @property
    def lead_us(self) -> Integers:
        """The edges that teeth may begin with: rising ones, unless there are none."""
        return self.rise_us if self.rise_us.size else self.fall_us

    @property
    def edges(self) -> int:
        """How many there are of the sensor."""
        return int(self.rise_us.size + self.fall_us.size)


@dataclass(frozen=True)
class FoundWheel:
    """A wheel as its edges show it: tooth 0 stands behind the widest gap."""

    teeth: int
    missing: tuple[int, ...]

    def __str__(self) -> str:
        """As people write it: 60-2, 36-2-1; a whole wheel is its number of teeth."""
        runs: list[int] = []
        for tooth in self.missing:
            if tooth - 1 in self.missing:
                runs[-1] += 1
            else:
                runs.append(1)
        return "-".join(str(n) for n in (self.teeth, *sorted(runs, reverse=True)))


def read_columns(path: Path) -> Columns:
    """The content of a file. CommandError names the file, the line, and what is wrong with it."""
    try:
        text = read_text(path, CAPTURE_LIMIT_BYTES).removeprefix("\ufeff")
    except UnreadableError as error:
        raise CommandError(str(error)) from error
    lines = text.splitlines()
    first = next((n for n, line in enumerate(lines) if _numbers(line)), len(lines))
    if first > MOST_HEADER_LINES or first == len(lines):
        raise CommandError(f"{path}: line 1: no line of numbers, allowed is time, level ...")
    header = lines[first - 1] if first else ""
    rows: list[list[float]] = []
    for number, line in enumerate(lines[first:], first + 1):
        if not line.strip():
            continue
        row = _numbers(line)
        width = len(rows[0]) if rows else 2
        if row is None or len(row) < 2 or (rows and len(row) != width):
            allowed = f"{width} numbers" if rows else "time, level ..."
            raise CommandError(f"{path}: line {number}: {line[:60]!r}, allowed is {allowed}")
        if not np.isfinite(row).all():
            raise CommandError(f"{path}: line {number}: {line[:60]!r} is not finite")
        if rows and row[0] < rows[-1][0]:
            raise CommandError(f"{path}: line {number}: time goes back from {rows[-1][0]!r} s")
        rows.append(row)
    if len(rows) < LEAST_TEETH:
        raise CommandError(f"{path}: {len(rows)} lines, allowed are {LEAST_TEETH} or more")
    table = np.array(rows)
    titles = tuple(word.strip() for word in _words(header))[1:]
    if len(titles) != table.shape[1] - 1:
        titles = tuple(f"column {k}" for k in range(1, table.shape[1]))
    unit = UNIT.search(_words(header)[0]) if header else None
    scale = SECONDS[unit[1].lower()] if unit else 1.0
    return Columns(path.name, table[:, 0] * scale, titles, table[:, 1:].T)


def _words(line: str) -> list[str]:
    for mark in ("\t", ";"):
        if mark in line:
            return line.split(mark)
    return line.split(",")


def _numbers(line: str) -> list[float] | None:
    try:
        return [float(word) for word in _words(line)]
    except ValueError:
        return None


def _edges(time_s: Vector, level: Vector) -> tuple[Integers, Integers]:
    at = np.round(time_s * SECOND_US).astype(np.int64)
    change = np.diff(level)
    return at[1:][change > 0], at[1:][change < 0]


def schmitt(volt: Vector, threshold_v: float | None = None) -> Vector:
    """A comparator with hysteresis about the median, or a threshold: 1 while the voltage was last
    above."""
    low, middle, high = np.quantile(volt, (0.1, 0.5, 0.9))
    middle = middle if threshold_v is None else threshold_v
    reach = HYSTERESIS_SHARE * (high - low)
    level = np.full(volt.size, np.nan)
    level[volt > middle + reach], level[volt < middle - reach] = 1.0, 0.0
    known = np.flatnonzero(~np.isnan(level))
    if not known.size:
        return np.zeros(volt.size)
    last = known[np.maximum(np.searchsorted(known, np.arange(volt.size), "right") - 1, 0)]
    return np.asarray(level[last])


def local_ratio(rise_us: Integers) -> Vector:
    """Each interval over the median of those around it."""
    if rise_us.size < 2:
        return np.empty(0)
    intervals = np.diff(rise_us).astype(float)
    around = 6
    padded = np.pad(intervals, around, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * around + 1)
    return np.asarray(intervals / np.median(windows, axis=1))


def find_wheel(capture: Capture) -> FoundWheel:
    """The wheel whose gaps come back every turn; of one without, as many teeth as there are edges
    between two of the second channel. CommandError where neither repeats."""
    ratio = local_ratio(capture.lead_us)
    gaps = np.flatnonzero(ratio > GAP)
    fits = {
        period: float(np.isin(inside + period, gaps).mean())
        for period in range(LEAST_TEETH, MOST_TEETH)
        if (inside := gaps[gaps + period < ratio.size]).size > 2 and period < ratio.size
    }
    best = max(fits.values(), default=0.0)
    if best < 0.6:
        return _by_second(capture)
    period = min(p for p, share in fits.items() if share > 0.9 * best)
    turns = [ratio[k::period] for k in range(period)]
    steps = [max(1, round(float(np.median(turn)))) for turn in turns]
    widest = max(range(period), key=lambda k: (steps[k], float(np.median(turns[k]))))
    order = steps[widest + 1 :] + steps[: widest + 1]
    present = np.concatenate(([0], np.cumsum(order)))
    teeth = int(present[-1])
    if teeth > MOST_TEETH:
        raise CommandError(
            f"{capture.name}: {teeth} teeth a turn, at most {MOST_TEETH} are allowed"
        )
    return FoundWheel(teeth, tuple(sorted(set(range(teeth)) - set(present.tolist()))))


def _by_second(capture: Capture) -> FoundWheel:
    lead_us = capture.lead_us
    at = np.searchsorted(lead_us, capture.second_us)
    between = np.diff(at[(at > 0) & (at < lead_us.size)])
    if not between.size or (between != between[0]).any():
        raise CommandError(f"{capture.name}: no gap or second channel that comes once a turn")
    teeth = int(between[0])
    if not LEAST_TEETH <= teeth <= MOST_TEETH:
        allowed = f"{LEAST_TEETH} to {MOST_TEETH} are allowed"
        raise CommandError(f"{capture.name}: {teeth} teeth a turn, {allowed}")
    return FoundWheel(teeth, ())
