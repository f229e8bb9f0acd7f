"""Logs of processes that were killed: a busy machine may have stopped one in the middle of a write,
so the last line or object may be cut. The log then says so, and all before it can be read. The last
part of a log may have been begun only."""

from __future__ import annotations

from collections.abc import Iterable

from meshpoint.bus.logs.reader import EmptyLogError, LogError
from meshpoint.dbc.frame import Frame

CUT = "cut off"
"""What is said of such a log."""


def read_until_cut(log: Iterable[tuple[float, Frame]]) -> list[tuple[float, Frame]]:
    """The frames of a log, with their times, up to where the kill may have cut it."""
    content = []
    try:
        for entry in log:
            content.append(entry)
    except EmptyLogError:
        pass
    except LogError as error:
        assert CUT in str(error), error
    return content
