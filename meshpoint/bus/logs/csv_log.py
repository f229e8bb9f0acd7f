"""Reads python-can's csv logs: classic frames alone, for it does not say which are CAN FD."""

from __future__ import annotations

import binascii
from base64 import b64decode
from typing import BinaryIO, Final

from meshpoint.bus.logs.entry import DefectError, Entries, Skipped, checked
from meshpoint.bus.logs.text import lines_of
from meshpoint.dbc.frame import Frame

HEADER: Final = "timestamp,arbitration_id,extended,remote,error,dlc,data"
MOST_CLASSIC: Final = 8


def csv_entries(file: BinaryIO) -> Entries:
    """Every frame, time in seconds as written; raises DefectError."""
    for number, line in lines_of(file):
        position = f"line {number}"
        if number == 1:
            if line != HEADER:
                raise DefectError(position, f"not python-can's csv: {line[:60]!r}, not {HEADER}")
            continue
        try:
            time_s, can_id, extended, remote, error_frame, dlc, data = line.split(",")
            frame = Frame(int(can_id, 16), b64decode(data, validate=True), False, extended == "1")
            at_s, length = float(time_s), int(dlc)
        except (ValueError, binascii.Error) as error:
            raise DefectError(position, f"no csv line: {line[:60]!r}") from error
        if error_frame == "1":
            yield Skipped.ERROR
        elif remote == "1":
            yield Skipped.REMOTE
        elif length > MOST_CLASSIC:
            raise DefectError(
                position,
                f"a frame of {length} bytes: this csv has lost which frames are CAN FD; such a "
                "file cannot be used",
            )
        elif len(frame.data) != length:
            raise DefectError(position, f"{len(frame.data)} of {length} data bytes")
        else:
            yield at_s, checked(frame, position)
