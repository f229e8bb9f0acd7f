"""Which channel of a capture is the wheel, and which of its edges: as asked, or tried in turn."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from meshpoint.base.errors import CommandError
from meshpoint.logs.capture_files import (
    LEAST_TEETH,
    Capture,
    Columns,
    FoundWheel,
    find_wheel,
    read_columns,
)
from meshpoint.logs.captures import (
    CRANK_RAD_S2,
    CaptureRow,
    NumberedEdges,
    capture_row,
    number_edges,
)

POLARITIES: Final = ("both", "rising", "falling", "inverted")
"""Which edges are used; inverted: both, rising and falling ones exchanged."""
OF_LEVELS: Final = ("both", "rising", "falling")
OF_VOLTAGES: Final = ("falling", "rising", "both")
"""In the order in which they are tried. Of an inductive sensor one edge is the middle of a tooth,
and the other one of a gap lies anywhere in it."""
AS_GOOD: Final = 0.05
"""A way that numbers this much less than the best, as a share of its edges, is as good."""
GOOD: Final = 0.5
"""Where a channel has more than this numbered, no other one is tried."""
NONE_US: Final = np.empty(0, np.int64)


@dataclass(frozen=True)
class Asked:
    """What is known of a capture; None: to be found."""

    column: int | None = None
    """1 is the first behind the time."""
    polarity: str | None = None
    threshold_v: float | None = None
    wheel: FoundWheel | None = None


@dataclass(frozen=True)
class Choice:
    """A channel, its edges, and what the gate made of them."""

    capture: Capture
    wheel: FoundWheel
    numbered: NumberedEdges
    channel: int
    title: str
    polarity: str
    tried: tuple[str, ...] = ()

    @property
    def share(self) -> float:
        """Of its edges, how many have a tooth."""
        return self.numbered.time_us.size / max(self.capture.edges, 1)

    def row(self) -> CaptureRow:
        """Checked and predicted."""
        tried = list(self.tried)
        return capture_row(
            self.capture, self.wheel, self.numbered, self.title, self.polarity, tried
        )


@dataclass(frozen=True)
class Refused:
    """A file that gives no row, and why."""

    file: str
    reason: str


def capture_rows(paths: list[Path], asked: Asked) -> tuple[list[CaptureRow], list[Refused]]:
    """A row or a reason for each file, in their order."""
    rows, refused = [], []
    for path in paths:
        try:
            rows.append(choose(read_columns(path), asked).row())
        except CommandError as error:
            reason = str(error).removeprefix(f"{path}: ").removeprefix(f"{path.name}: ")
            refused.append(Refused(path.name, reason))
    return rows, refused


def choose(columns: Columns, asked: Asked) -> Choice:
    """The way that is asked for, or the one that numbers most. CommandError where none does, with
    the reason of each."""
    found: list[Choice] = []
    tried: list[str] = []
    for channel in _channels(columns, asked):
        for polarity in _polarities(columns, channel, asked):
            title = columns.titles[channel]
            try:
                choice = _way(columns, channel, polarity, asked)
            except CommandError as error:
                reason = str(error).removeprefix(f"{columns.name}: ")
                tried.append(f"{title}, {polarity}: {reason}")
                continue
            count = f"{choice.numbered.time_us.size} of {choice.capture.edges} edges numbered"
            tried.append(f"{title}, {polarity}: {choice.wheel}, {count}")
            found.append(choice)
        if any(choice.share > GOOD for choice in found):
            break
    if not found:
        raise CommandError(f"{columns.name}: " + "; ".join(_once(tried) or ["no channel changes"]))
    best = max(choice.share for choice in found)
    chosen = next(choice for choice in found if choice.share > best - AS_GOOD)
    return replace(chosen, tried=tuple(tried))


def capture_of(columns: Columns, channel: int, polarity: str, threshold_v: float | None) -> Capture:
    """The edges of one channel; of the others, the one whose rising edges come once a turn stays to
    be found."""
    rise_us, fall_us = columns.edges(channel, threshold_v)
    if polarity == "inverted":
        rise_us, fall_us = fall_us, rise_us
    elif polarity == "rising":
        fall_us = NONE_US
    elif polarity == "falling":
        rise_us = NONE_US
    return Capture(columns.name, rise_us, fall_us, NONE_US)


def why_none(capture: Capture, wheel: FoundWheel) -> str:
    """Why no tooth of a capture was numbered."""
    lead_us = capture.lead_us
    present = wheel.teeth - len(wheel.missing)
    turns = lead_us.size / present
    pitch_us = np.diff(lead_us)
    least_rad_s = np.sqrt(6.0 * CRANK_RAD_S2 * 2.0 * np.pi / wheel.teeth)
    slowest_us = 2.0 * np.pi / wheel.teeth / least_rad_s * 1e6
    if turns < 2.0:
        return f"{turns:.1f} turns, a whole one after the first teeth is needed"
    quick = float(np.quantile(pitch_us, 0.25))
    if quick > slowest_us:
        return (
            f"too slow: a tooth takes {quick * 1e-3:.1f} ms, from {slowest_us * 1e-3:.1f} ms on "
            "the wheel may have stopped and turned back"
        )
    return "its intervals are too uneven: no turn fits the wheel from gap to gap"


def _channels(columns: Columns, asked: Asked) -> list[int]:
    count = len(columns.titles)
    if asked.column is not None:
        if not 1 <= asked.column <= count:
            allowed = f"1 to {count} are allowed"
            raise CommandError(f"{columns.name}: column {asked.column}, {allowed}")
        return [asked.column - 1]
    edges = [sum(map(len, columns.edges(k, asked.threshold_v))) for k in range(count)]
    return sorted((k for k in range(count) if edges[k]), key=lambda k: -edges[k])


def _polarities(columns: Columns, channel: int, asked: Asked) -> tuple[str, ...]:
    if asked.polarity is not None:
        return (asked.polarity,)
    return OF_LEVELS if columns.is_level(channel) else OF_VOLTAGES


def _way(columns: Columns, channel: int, polarity: str, asked: Asked) -> Choice:
    capture = capture_of(columns, channel, polarity, asked.threshold_v)
    if capture.lead_us.size < LEAST_TEETH:
        raise CommandError(f"{columns.name}: {capture.edges} edges, too few for a wheel")
    wheel: FoundWheel | None = asked.wheel
    reason = ""
    for second in _seconds(columns, channel):
        with_second = replace(capture, second_us=second)
        try:
            wheel = asked.wheel or find_wheel(with_second)
        except CommandError as error:
            reason = reason or str(error)
            continue
        capture = with_second
        break
    if wheel is None:
        raise CommandError(reason)
    numbered = number_edges(capture, wheel)
    if not numbered.time_us.size:
        reason = why_none(capture, wheel)
        raise CommandError(f"{columns.name}: no tooth of a {wheel} wheel numbered: {reason}")
    return Choice(capture, wheel, numbered, channel, columns.titles[channel], polarity)


def _seconds(columns: Columns, channel: int) -> Iterator[np.ndarray]:
    """Rising edges of the other channels, and none."""
    for other in range(len(columns.titles)):
        if other != channel and columns.edges(other)[0].size:
            yield columns.edges(other)[0]
    yield NONE_US


def _once(lines: list[str]) -> list[str]:
    """Equal reasons of one channel, each once."""
    reported: dict[str, list[str]] = {}
    for line in lines:
        way, reason = line.split(": ", 1)
        reported.setdefault(reason, []).append(way)
    return [f"{' / '.join(ways)}: {reason}" for reason, ways in reported.items()]
