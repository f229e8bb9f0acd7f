"""What a file of time series does not have of a log, or not in its place: counted, for a reader to
know."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import Final

MOST_NAMED: Final = 8
MOST_IDENTIFIERS: Final = 10_000
"""A bus on which anything may come is not remembered by more."""


class LeftOut:
    """Counts frames and samples."""

    def __init__(self) -> None:
        self._unknown: Counter[int] = Counter()
        self._others = 0
        self._damaged: Counter[str] = Counter()
        self.unplaced = 0
        """Frames of a controller whose stamp is none of the sensors' clock."""
        self.early = 0
        """Samples that were taken before the first frame came."""

    def unknown(self, can_id: int) -> None:
        """A frame of an identifier that no message has."""
        if can_id in self._unknown or len(self._unknown) < MOST_IDENTIFIERS:
            self._unknown[can_id] += 1
        else:
            self._others += 1

    def damaged(self, message: str) -> None:
        """A frame of this message, of which nothing can be read."""
        self._damaged[message] += 1

    def words(self) -> list[str]:
        """A line each; none where all is in its place."""
        found = []
        frames = self._unknown.total() + self._others
        if frames:
            identifiers = _of(len(self._unknown), "identifier")
            more = " and more" if self._others else ""
            found.append(
                f"{_are(frames, 'frame', f'of {identifiers}{more} that no message here has')} left "
                f"out: {_named((f'0x{each:X}', n) for each, n in self._unknown.most_common())}"
            )
        if self._damaged:
            damaged = _are(self._damaged.total(), "frame", "of a wrong length, CRC or value")
            found.append(f"{damaged} left out: {_named(self._damaged.most_common())}")
        if self.early:
            found.append(
                f"{_are(self.early, 'sample', 'taken before the first frame came')} left out"
            )
        if self.unplaced:
            found.append(
                f"{_are(self.unplaced, 'frame', 'with a time of another clock than the sensors')} "
                "put where the frame came"
            )
        return found


def _of(count: int, what: str) -> str:
    return f"{count:,} {what}{'' if count == 1 else 's'}"


def _are(count: int, what: str, which: str) -> str:
    return f"{_of(count, what)} {which} {'is' if count == 1 else 'are'}"


def _named(counted: Iterable[tuple[str, int]]) -> str:
    names = [f"{name} ({count:,})" for name, count in counted]
    more = f" and {len(names) - MOST_NAMED} more" if len(names) > MOST_NAMED else ""
    return ", ".join(names[:MOST_NAMED]) + more
