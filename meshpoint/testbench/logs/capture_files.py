"""Captured edges of real sensors: files of level changes or voltages, and the wheel behind them.

Columns are a time in s, then one level (0 or 1) a channel after each change, or one voltage in V.
Edges of a voltage are found with hysteresis about its slow middle, and of these only the falling
ones are used: of an inductive sensor they are the middles of the teeth, while the rising ones of a
gap lie anywhere in it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from meshpoint.gearbox.reading import UnreadableError, read_text
from meshpoint.testbench.errors import CommandError
from meshpoint.units import SECOND_US

Integers = NDArray[np.int64]
Floats = NDArray[np.float64]

HYSTERESIS_SHARE: Final = 0.15
"""Half the hysteresis, as a share of the voltage's usual swing."""
CAPTURE_LIMIT_BYTES: Final = 64 << 20
GAP: Final = 1.5
"""An interval this many times the usual one is a gap of missing teeth."""
LEAST_TEETH, MOST_TEETH = 8, 130


@dataclass(frozen=True)
class Capture:
    """Edge times of one file in us: of the wheel's sensor, and of a second channel if it has one.

    Of an inductive sensor `fall_us` is empty."""

    name: str
    rise_us: Integers
    fall_us: Integers
    second_us: Integers


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


def read_capture(path: Path) -> Capture:
    """The edges of a file. CommandError names the file and what is wrong with it."""
    try:
        lines = read_text(path, CAPTURE_LIMIT_BYTES).splitlines()
    except UnreadableError as error:
        raise CommandError(str(error)) from error
    first = 0 if lines and _numbers(lines[0]) is not None else 1
    rows = [_numbers(line) for line in lines[first:] if line.strip()]
    width = 0 if not rows or rows[0] is None else len(rows[0])
    for number, row in enumerate(rows, first + 1):
        if row is None or len(row) != width or width < 2:
            found = lines[number - 1][:60]
            raise CommandError(f"{path}: line {number}: {found!r}, allowed is time, level ...")
    if len(rows) < LEAST_TEETH:
        raise CommandError(f"{path}: {len(rows)} lines, allowed are {LEAST_TEETH} or more")
    table = np.array(rows)
    time_s, channels = table[:, 0], table[:, 1:].T
    if not np.isfinite(table).all() or (np.diff(time_s) < 0.0).any():
        raise CommandError(f"{path}: a time or a level is not a number, or time goes back")
    if not np.isin(channels, (0.0, 1.0)).all():
        _, fall_us = _edges(time_s, schmitt(time_s, channels[0]))
        return Capture(path.name, fall_us, np.empty(0, np.int64), np.empty(0, np.int64))
    rise_us, fall_us = _edges(time_s, channels[0])
    second_us = _edges(time_s, channels[1])[0] if len(channels) > 1 else np.empty(0, np.int64)
    return Capture(path.name, rise_us, fall_us, second_us)


def _numbers(line: str) -> list[float] | None:
    try:
        return [float(word) for word in line.split(",")]
    except ValueError:
        return None


def _edges(time_s: Floats, level: Floats) -> tuple[Integers, Integers]:
    at = np.round(time_s * SECOND_US).astype(np.int64)
    change = np.diff(level)
    return at[1:][change > 0], at[1:][change < 0]


def schmitt(time_s: Floats, volt: Floats) -> Floats:
    """A comparator with hysteresis about the median: 1 while the voltage was last above."""
    low, middle, high = np.quantile(volt, (0.1, 0.5, 0.9))
    reach = HYSTERESIS_SHARE * (high - low)
    level = np.full(time_s.size, np.nan)
    level[volt > middle + reach], level[volt < middle - reach] = 1.0, 0.0
    known = np.flatnonzero(~np.isnan(level))
    if not known.size:
        return np.zeros(time_s.size)
    last = known[np.maximum(np.searchsorted(known, np.arange(time_s.size), "right") - 1, 0)]
    return np.asarray(level[last])


def local_ratio(rise_us: Integers) -> Floats:
    """Each interval over the median of those around it."""
    intervals = np.diff(rise_us).astype(float)
    around = 6
    padded = np.pad(intervals, around, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * around + 1)
    return np.asarray(intervals / np.median(windows, axis=1))


def find_wheel(capture: Capture) -> FoundWheel:
    """The wheel whose gaps come back every turn; of one without, as many teeth as there are edges
    between two of the second channel. CommandError where neither repeats."""
    ratio = local_ratio(capture.rise_us)
    gaps = np.flatnonzero(ratio > GAP)
    fits = {
        period: float(np.isin(inside + period, gaps).mean())
        for period in range(LEAST_TEETH, MOST_TEETH)
        if (inside := gaps[gaps + period < ratio.size]).size > 2
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
    return FoundWheel(teeth, tuple(sorted(set(range(teeth)) - set(present.tolist()))))


def _by_second(capture: Capture) -> FoundWheel:
    at = np.searchsorted(capture.rise_us, capture.second_us)
    between = np.diff(at[(at > 0) & (at < capture.rise_us.size)])
    if not between.size or (between != between[0]).any():
        raise CommandError(f"{capture.name}: no gap or second channel that comes once a turn")
    return FoundWheel(int(between[0]), ())
