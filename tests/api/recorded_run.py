"""What the recorded run of this folder's tests came to."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import meshpoint


class Recorded(NamedTuple):
    """A learning shift and an aimed one, and the log of both."""

    log: Path
    learning: meshpoint.ShiftRow
    aimed: meshpoint.ShiftRow
    known: frozenset[int]
