"""What the readers of the log formats have in common."""

from collections.abc import Iterator
from enum import Enum, auto
from typing import NamedTuple

from meshpoint.bus.local.wire import CLASSIC_LENGTHS, FD_LENGTHS
from meshpoint.dbc.frame import Frame

MAX_EXTENDED_ID = (1 << 29) - 1
MAX_STANDARD_ID = (1 << 11) - 1


class Skipped(Enum):
    """An entry that is no data frame."""

    REMOTE = auto()
    ERROR = auto()


class Unfinished(NamedTuple):
    """The last entry of a log that its writer has not completed: all of it can be read, but
    there may have been more."""

    cause: str


Entries = Iterator[tuple[float, Frame] | Skipped | Unfinished]


class DefectError(Exception):
    """Where in a log it cannot be read, and why.

    position: "line 7", "offset 144"; empty when the log as a whole is meant.
    """

    def __init__(self, position: str, cause: str) -> None:
        super().__init__(f"{position}: {cause}")
        self.position = position
        self.cause = cause


def checked(frame: Frame, position: str) -> Frame:
    """`frame`, if there can be such a CAN frame; else DefectError."""
    limit = MAX_EXTENDED_ID if frame.is_extended else MAX_STANDARD_ID
    if not 0 <= frame.can_id <= limit:
        raise DefectError(position, f"identifier 0x{frame.can_id:X} is outside 0..0x{limit:X}")
    if len(frame.data) not in (FD_LENGTHS if frame.is_fd else CLASSIC_LENGTHS):
        kind, allowed = (
            ("CAN FD", "0..8, 12, 16, 20, 24, 32, 48 or 64") if frame.is_fd else ("classic", "0..8")
        )
        raise DefectError(position, f"{len(frame.data)} data bytes; a {kind} frame has {allowed}")
    return frame
