"""Reads the two text formats of logs: candump's (`candump -L`) and Vector's ASC."""

import re
from collections.abc import Iterator
from typing import BinaryIO, TextIO, cast

import can

from meshpoint.bus.frames import frame_of
from meshpoint.bus.logs.entry import DefectError, Entries, Skipped, checked
from meshpoint.dbc.frame import Frame

# The longest line of a real log has some 400 characters.
_MAX_LINE_BYTES = 4096

_CANDUMP_LINE = re.compile(
    r"\((?P<time>\d{1,12}\.\d{1,9})\) +(?P<channel>\S+) +(?P<id>[0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})"
    r"#(?:(?P<remote>[Rr]\w*)|#(?P<fd_flags>[0-9A-Fa-f])(?P<fd>[0-9A-Fa-f]*)|(?P<data>[0-9A-Fa-f]*))"
    r"(?: +[RT])?"
)
_ERROR_FLAG = 0x2000_0000  # linux/can.h: CAN_ERR_FLAG
_EXTENDED_DIGITS = 8

_ASC_LINE = re.compile(r"\d+\.\d+\s|date\s|base\s|(no\s+)?internal\s|begin\s|end\s|//", re.I)


def candump_entries(file: BinaryIO) -> Entries:
    """Every frame of a candump log, time in seconds as written; raises DefectError."""
    for number, line in _lines(file):
        position = f"line {number}"
        match = _CANDUMP_LINE.fullmatch(line)
        if match is None:
            raise DefectError(position, f"no candump line: {line[:60]!r}")
        can_id = int(match["id"], 16)
        # python-can's reader takes some error frames for data frames, for it drops this flag.
        if len(match["id"]) == _EXTENDED_DIGITS and can_id & _ERROR_FLAG:
            yield Skipped.ERROR
        elif match["remote"]:
            yield Skipped.REMOTE
        else:
            is_fd = match["fd_flags"] is not None
            digits = match["fd"] if is_fd else match["data"]
            if len(digits) % 2:
                raise DefectError(position, f"odd number of data digits: {len(digits)}")
            is_extended = len(match["id"]) == _EXTENDED_DIGITS
            frame = Frame(can_id, bytes.fromhex(digits), is_fd, is_extended)
            yield float(match["time"]), checked(frame, position)


def asc_entries(file: BinaryIO) -> Entries:
    """Every frame of an ASC log, time in seconds from its start; raises DefectError.

    Lines that begin as one of the format, but hold no frame, are passed over: there are too many
    kinds of them.
    """
    lines = _AscLines(file)
    reader = iter(can.ASCReader(cast(TextIO, lines)))
    while True:
        try:
            message = next(reader, None)
        except DefectError:
            raise
        except Exception as error:  # python-can lets ValueError, KeyError, IndexError ... through
            raise DefectError(lines.position, f"no ASC line: {error}") from error
        if message is None:
            return
        if message.is_error_frame:
            yield Skipped.ERROR
        elif message.is_remote_frame and not message.is_fd:
            yield Skipped.REMOTE
        else:
            # There are no remote frames in CAN FD: python-can means an FD frame without data.
            length = 0 if message.is_remote_frame else message.dlc
            if len(message.data) != length:
                raise DefectError(lines.position, f"{len(message.data)} of {length} data bytes")
            frame = frame_of(message)
            yield message.timestamp, checked(frame, lines.position)


class _AscLines:
    """A text file for python-can's reader, which knows its line and what a line may begin with."""

    def __init__(self, file: BinaryIO) -> None:
        self._lines = _lines(file)
        self.position = "line 1"

    def __iter__(self) -> Iterator[str]:
        for number, line in self._lines:
            self.position = f"line {number}"
            if not _ASC_LINE.match(f"{line} "):
                raise DefectError(self.position, f"no ASC line: {line[:60]!r}")
            yield line

    def close(self) -> None:
        """The file belongs to the caller."""


def _lines(file: BinaryIO) -> Iterator[tuple[int, str]]:
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
        if text:
            yield number, text
