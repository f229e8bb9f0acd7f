"""The frames of a log that a controller may have consumed, and which of them a step has."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import Final

from meshpoint.dbc.frame import Frame, crc_of
from meshpoint.dbc.j1939 import XCP_COMMAND_ID
from meshpoint.dbc.layout import CODECS

RIG_ADDRESSES: Final = frozenset({0x80, 0x81, 0x00})
CONSUMED_IDS: Final = frozenset(c.spec.can_id for c in CODECS.values()) | {XCP_COMMAND_ID}
"""What counts as consumed, whether or not the controller acts on it."""
LATE_FRAMES: Final = 12
"""How many frames around the end of a step may reach the logger in another order than the node."""
MOST_WAITING: Final = 65_536
"""Frames kept for a step to come: more than a controller takes in one. It bounds the memory where
no controller is on the bus."""
UNKNOWN_FRAME: Final = Frame(0x1FFF_FFFF, b"", is_fd=False)
"""Stands for a frame foreign to the DBC: only its number matters."""


class NotVerifiableError(Exception):
    """Why a session cannot be repeated from here on."""


class DiffersError(Exception):
    """The repeated step sent something else than the log holds."""


def compare(mine: Frame | None, theirs: Frame | None) -> None:
    """A frame of a repeated step with the log's; None where there is none. DiffersError."""
    if mine is None and theirs is not None:
        raise DiffersError(f"the log holds a frame {theirs.can_id:08X} that it did not send")
    if mine is None:
        return
    if theirs is None:
        raise DiffersError(f"it sent a frame {mine.can_id:08X} that the log does not hold")
    if mine.can_id != theirs.can_id:
        raise DiffersError(f"it sent {mine.can_id:08X} where the log holds {theirs.can_id:08X}")
    if mine.data != theirs.data:
        at = next(i for i, (a, b) in enumerate(zip(mine.data, theirs.data, strict=False)) if a != b)
        raise DiffersError(
            f"frame {mine.can_id:08X} byte {at}: {mine.data[at]:02X}, log {theirs.data[at]:02X}"
        )


class WaitingFrames:
    """Frames in the order of the log that no step has consumed yet."""

    def __init__(self, *, exact: bool) -> None:
        """exact: a step's frames must be those that it consumed; else one whose frames are not
        there takes the next ones."""
        self._exact = exact
        self._waiting: deque[Frame] = deque(maxlen=MOST_WAITING)
        self._aligned = False
        self._passed: list[Frame] = []

    @property
    def left(self) -> int:
        """How many no step has consumed yet."""
        return len(self._waiting)

    def add(self, frame: Frame) -> None:
        """The log's next one."""
        self._waiting.append(frame)

    def lose_place(self) -> None:
        """Where in the log the next step's frames begin is unknown: another run, or after a
        hole."""
        self._aligned, self._passed = False, []

    def take(self, count: int, crc: int) -> list[Frame]:
        """The `count` frames that a step has consumed, by their CRC. NotVerifiableError where the
        log does not hold them."""
        if count == 0:
            return []
        waiting = list(self._waiting)
        for fewer in range(len(self._passed) + 1):
            kept = len(self._passed) - fewer
            longer = self._passed[kept:] + waiting
            for skipped, chosen in self._candidates(longer, count):
                if crc_of(chosen) == crc:
                    self._passed = (
                        self._passed[:kept] if self._aligned else longer[:skipped][-LATE_FRAMES:]
                    )
                    self._aligned = True
                    self._take_away(longer, skipped, chosen)
                    return chosen
        if not self._exact and len(waiting) >= count:
            # What it commands is asked, not whether the log is whole.
            self._take_away(waiting, 0, waiting[:count])
            return waiting[:count]
        raise NotVerifiableError(
            f"the {count} frames it consumed are not in the log as it received them: frames were "
            "changed, or lost between bus and log"
        )

    def _candidates(self, waiting: list[Frame], count: int) -> Iterator[tuple[int, list[Frame]]]:
        """Ways in which the log may hold the frames of a step: (skipped before, frames).

        The first step that consumed anything may follow frames sent before the controller was on
        the bus: the latest place that fits is taken. Where the frames before it are equal (a
        request sent again and again) it may have been an earlier one, which shows when a step
        consumed more than is left; `take` then takes some of them back.

        Later, only senders on different processors may have overtaken each other."""
        if not self._aligned:
            for start in range(len(waiting) - count, -1, -1):
                yield start, waiting[start : start + count]
            return
        if len(waiting) >= count:
            yield 0, waiting[:count]
        near = waiting[: count + LATE_FRAMES]
        rig = [frame for frame in near if frame.can_id & 0xFF in RIG_ADDRESSES]
        others = [frame for frame in near if frame.can_id & 0xFF not in RIG_ADDRESSES]
        for from_others in range(min(count, len(others)) + 1):
            if count - from_others <= len(rig):
                yield 0, rig[: count - from_others] + others[:from_others]

    def _take_away(self, waiting: list[Frame], skipped: int, chosen: list[Frame]) -> None:
        taken = {id(frame) for frame in chosen}
        kept = (f for f in waiting[skipped:] if id(f) not in taken)
        self._waiting = deque(kept, maxlen=MOST_WAITING)
