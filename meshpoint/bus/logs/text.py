"""Reads candump's text logs (`candump -L`); and lines, for every format of lines."""

import re
from collections.abc import Iterator
from typing import BinaryIO

from meshpoint.bus.logs.buses import Buses
from meshpoint.bus.logs.entry import DefectError, Entries, Skipped, checked
from meshpoint.dbc.frame import Frame

# The longest line of a real log has some 400 characters.
_MAX_LINE_BYTES = 4096
# A hole of zeros must not pass for part of a comment or a date.
_CONTROL = re.compile(r"[^\t -~]")

_CANDUMP_LINE = re.compile(
    r"\((?P<time>\d{1,12}\.\d{1,9})\) +(?P<channel>\S+) +(?P<id>[0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})"
    r"#(?:(?P<remote>[Rr][0-8]?(?:_[9A-Fa-f])?)|#(?P<fd_flags>[0-9A-Fa-f])(?P<fd>[0-9A-Fa-f]*)|(?P<data>[0-9A-Fa-f]*))"
    r"(?: +[RT])?"
)
_ERROR_FLAG = 0x2000_0000  # linux/can.h: CAN_ERR_FLAG
_ERROR_CLASSES = 0x0000_03FF  # linux/can/error.h: CAN_ERR_TX_TIMEOUT to CAN_ERR_CNT
_ERROR_DIGITS = (0, 16)  # CAN_ERR_DLC is eight; python-can's writer leaves the data out
_EXTENDED_DIGITS = 8


def candump_entries(file: BinaryIO, buses: Buses) -> Entries:
    """Every frame of a candump log, time in seconds as written; raises DefectError."""
    for number, line in lines_of(file):
        position = f"line {number}"
        match = _CANDUMP_LINE.fullmatch(line)
        if match is None:
            raise DefectError(position, f"no candump line: {line[:60]!r}")
        can_id = int(match["id"], 16)
        # python-can's reader takes some error frames for data frames, for it drops this flag.
        if len(match["id"]) == _EXTENDED_DIGITS and can_id & _ERROR_FLAG:
            if (
                can_id & ~(_ERROR_FLAG | _ERROR_CLASSES)
                or len(match["data"] or "") not in _ERROR_DIGITS
            ):
                raise DefectError(position, f"no error frame: {line[:60]!r}")
            yield Skipped.ERROR
        elif match["remote"]:
            yield Skipped.REMOTE
        elif buses.keeps(match["channel"]):
            is_fd = match["fd_flags"] is not None
            digits = match["fd"] if is_fd else match["data"]
            if len(digits) % 2:
                raise DefectError(position, f"odd number of data digits: {len(digits)}")
            is_extended = len(match["id"]) == _EXTENDED_DIGITS
            frame = Frame(can_id, bytes.fromhex(digits), is_fd, is_extended)
            yield float(match["time"]), checked(frame, position)


def lines_of(file: BinaryIO) -> Iterator[tuple[int, str]]:
    """The lines that are not blank, stripped, with their numbers from 1."""
    number = 0
    while line := file.readline(_MAX_LINE_BYTES):
        number += 1
        position = f"line {number}"
        if not line.endswith(b"\n"):
            if len(line) == _MAX_LINE_BYTES:
                raise DefectError(position, f"longer than {_MAX_LINE_BYTES} characters")
            raise DefectError(position, "the log ends inside this line (interrupted or cut off)")
        try:
            text = line.decode("ascii").strip()
        except UnicodeDecodeError as error:
            raise DefectError(position, f"not text: byte 0x{line[error.start]:02X}") from error
        if _CONTROL.search(text):
            raise DefectError(position, "not text: a control character")
        if text:
            yield number, text
