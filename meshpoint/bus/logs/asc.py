"""Reads Vector's text logs (ASC): a header, then one event a line.

Written anew because python-can's reader passes over what it does not understand: a frame whose line
is damaged is missing then, and nothing is said.
"""

import re
from typing import BinaryIO

from meshpoint.bus.logs.buses import Buses
from meshpoint.bus.logs.entry import DefectError, Entries, Skipped, Unfinished, checked
from meshpoint.bus.logs.text import lines_of
from meshpoint.dbc.frame import Frame

_EVENT = re.compile(r"(?P<time>\d{1,12}\.\d{1,9})\s+(?P<event>\S.*)")
_HEADER = re.compile(
    r"date\s.*|(no\s+)?internal\s+events\s+logged|//.*"
    r"|base\s+(?P<base>hex|dec)(\s+timestamps\s+(absolute|relative))?"
    r"|(?P<begin>begin\s+triggerblock)(\s.*)?|(?P<end>end\s+triggerblock)",
    re.I,
)
_CLASSIC = re.compile(
    r"(?P<bus>\d+)\s+(?P<id>[0-9A-Fa-f]+)(?P<extended>[xX]?)\s+(?:Rx|Tx|TxRq)\s+"
    r"(?:(?P<remote>r(?:\s+[0-9A-Fa-f]+)?)|d\s+(?P<dlc>[0-9A-Fa-f]+)(?P<data>(?:\s+[0-9A-Fa-f]+)*))"
    r"(?:\s+(?:Length|BitCount|ID)\s*=\s*[0-9A-Fa-f]+x?)*"
)
_FD = re.compile(
    r"CANFD\s+(?P<bus>\d+)\s+(?:Rx|Tx|TxRq)\s+(?P<id>[0-9A-Fa-f]+)(?P<extended>[xX]?)\s+(?:(?![01]\s)\S+\s+)?"
    r"[01]\s+[01]\s+(?P<dlc>[0-9A-Fa-f])\s+(?P<length>\d+)(?P<rest>(?:\s+[0-9A-Fa-f]+)*)"
)
_ERROR = re.compile(r"(?:\d+|CANFD\s+\d+\s+(?:Rx|Tx|TxRq))\s+ErrorFrame(?:\s.*)?", re.I)
# Duration, length, flags, CRC and up to four bit timings: what stands behind the data of FD frames.
_FD_FIELDS = range(6, 9)
# Events that are no frames of CAN: states, statistics, transport protocols, texts, other buses.
_OTHER = re.compile(
    r"Start of measurement|(?:CAN\s+)?\d+\s+(?:Status:|Statistic:|OverloadFrame|J1939TP)"
    r"|(?:SV|Comment|AppText|GPS-Event|GM|TFS|TPI?|DIAG|Watermark|Li|LIN|L\d+|FR|ETH|MOST|WLAN|AFDX"
    r"|A429|log|previous|trigger)\b|//"
)
_LENGTH_OF_DLC = (*range(9), 12, 16, 20, 24, 32, 48, 64)
_MAX_CLASSIC_LENGTH = 8


def asc_entries(file: BinaryIO, buses: Buses) -> Entries:
    """Every frame of an ASC log, time in seconds from its start; raises DefectError.

    A line is a frame, one of the known events that are none, or a defect."""
    base, is_open = 16, False
    for number, line in lines_of(file):
        position = f"line {number}"
        event = _EVENT.fullmatch(line)
        if event is None:
            header = _HEADER.fullmatch(line)
            if header is None:
                raise DefectError(position, f"no ASC line: {line[:60]!r}")
            if header["base"]:
                base = 10 if header["base"].lower() == "dec" else 16
            is_open = bool(header["begin"]) or (is_open and not header["end"])
            continue
        entry = _entry(event["event"], base, position, buses)
        if isinstance(entry, Frame):
            yield float(event["time"]), entry
        elif entry is not None:
            yield entry
    if is_open:
        yield Unfinished("the log has no End TriggerBlock (interrupted or cut off)")


def _entry(event: str, base: int, position: str, buses: Buses) -> Frame | Skipped | None:
    """The frame of an event; None for one that has to do with something else."""
    try:
        if match := _FD.fullmatch(event):
            frame: Frame | Skipped = _fd_frame(match, base, position)
            return frame if buses.keeps(match["bus"]) else None
        if match := _CLASSIC.fullmatch(event):
            frame = _classic_frame(match, base, position)
            if frame is Skipped.REMOTE:
                return frame
            return frame if buses.keeps(match["bus"]) else None
    except ValueError as error:
        raise DefectError(position, f"no ASC line: {error}") from error
    if _ERROR.fullmatch(event):
        return Skipped.ERROR
    if _OTHER.match(event):
        return None
    raise DefectError(position, f"no event of CAN that is known: {event[:60]!r}")


def _classic_frame(match: re.Match[str], base: int, position: str) -> Frame | Skipped:
    if match["remote"]:
        return Skipped.REMOTE
    length = min(int(match["dlc"], base), _MAX_CLASSIC_LENGTH)
    data = match["data"].split()
    if len(data) != length:
        raise DefectError(position, f"{len(data)} of {length} data bytes")
    return _frame(match, data, base, False, position)


def _fd_frame(match: re.Match[str], base: int, position: str) -> Frame:
    length, rest = int(match["length"]), match["rest"].split()
    reported = _LENGTH_OF_DLC[int(match["dlc"], 16)]
    if length != reported:
        raise DefectError(position, f"{length} data bytes, its data length code says {reported}")
    if len(rest) - length not in _FD_FIELDS:
        raise DefectError(position, f"{len(rest)} fields from the data on, not {length} and 6 to 8")
    return _frame(match, rest[:length], base, True, position)


def _frame(match: re.Match[str], data: list[str], base: int, is_fd: bool, position: str) -> Frame:
    digits = 2 if base == 16 else 3
    for byte in data:
        if len(byte) > digits or (base == 16 and len(byte) != digits):
            raise DefectError(position, f"data byte {byte!r}")
    content = bytes(int(byte, base) for byte in data)
    frame = Frame(int(match["id"], base), content, is_fd, bool(match["extended"]))
    return checked(frame, position)
