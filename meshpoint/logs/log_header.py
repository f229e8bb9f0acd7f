"""The run header that a log names: its controller sends the header's hash in every status
frame."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import islice
from pathlib import Path
from typing import Final

from meshpoint.controller.settings.header import HeaderError, RunHeader, load_header, run_hash_of
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.link import read_alone
from meshpoint.dbc.messages import ControllerStatus

LOOKED_AT: Final = 20_000
"""A running controller reports its status every 10 ms, among some 15 other frames."""


def named_header(frames: Iterable[tuple[float, Frame]], folder: Path) -> RunHeader | None:
    """The header from `folder` that the first status frame names; None where no controller of ours
    speaks, or its header is not there or not of this version."""
    codec = CODECS[ControllerStatus.__name__]
    for _, frame in islice(frames, LOOKED_AT):
        status: ControllerStatus | None = read_alone(codec, frame)
        if status is not None:
            try:
                return load_header(folder, run_hash_of(status))
            except HeaderError:
                return None
    return None
