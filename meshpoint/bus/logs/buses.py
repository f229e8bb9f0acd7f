"""Which bus of a log a frame is of: a logger may have recorded several."""

from __future__ import annotations

from collections import Counter


class Buses:
    """Counts the frames of each bus, and keeps those of one, or of all."""

    def __init__(self, only: str | None = None) -> None:
        self.only = only
        self.frames: Counter[str] = Counter()
        """By the bus's name in the log: can0, or its number."""

    def keeps(self, name: str) -> bool:
        """A frame of a bus has come; whether it is wanted."""
        self.frames[name] += 1
        return self.only is None or name == self.only
