"""Reads recorded buses: candump text logs (`.log`), Vector's `.blf` and `.asc`, PEAK's `.trc`,
python-can's `.csv`, ASAM's `.mf4`; each also packed by gzip (`.gz` behind it)."""

import gzip
import io
import os
import shutil
import tempfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO, cast

from meshpoint.bus.logs.asc import asc_entries
from meshpoint.bus.logs.blf import blf_entries
from meshpoint.bus.logs.buses import Buses
from meshpoint.bus.logs.csv_log import csv_entries
from meshpoint.bus.logs.entry import DefectError, Entries, Skipped, Unfinished
from meshpoint.bus.logs.mf4 import mf4_entries
from meshpoint.bus.logs.text import candump_entries
from meshpoint.bus.logs.trc import trc_entries
from meshpoint.dbc.frame import Frame
from meshpoint.gearbox.reading import UnreadableError, open_regular

FORMATS = (".log", ".blf", ".asc")
"""What is written; all of these keep what a replay needs."""
READ_FORMATS = (*FORMATS, ".trc", ".csv", ".mf4")
PACKED = ".gz"
MAX_UNPACKED_BYTES = 16 * 1024**3
MAX_LOG_BYTES = 4 * 1024**3
UNQUESTIONED_BYTES = 16 * 1024**2
MOST_TIMES_PACKED = 200
"""Beyond the first of these bytes a packed log may unpack to this many times its size. gzip packs
one repeated byte to a 1000th, a log of one frame over and over to a 20th, one of our shifts in
`.asc` to an 8th."""
ROOM_LEFT_BYTES = 256 * 1024**2
_READ_ANYWHERE = (".blf", ".mf4")
_BLOCK_BYTES = 1024 * 1024


class LogError(Exception):
    """A log that cannot be read, or not to its end.

    file: the log; position: "line 7", "offset 144", or empty for the log as a whole;
    cause: what is wrong.
    """

    def __init__(self, file: Path, position: str, cause: str) -> None:
        super().__init__(": ".join(filter(None, (str(file), position, cause))))
        self.file = file
        self.position = position
        self.cause = cause


class EmptyLogError(LogError):
    """A log without a frame, but without a defect: a process killed just after it began one."""


class UnfinishedLogError(LogError):
    """A log that could be read to its end, but that its writer has not completed."""


class LogReader:
    """The data frames of a log, in its order, each with its time in seconds.

    The time is what the log says: since the epoch for candump and BLF, since the start of the log
    for ASC. Remote and error frames are left out and counted. To be iterated once.

    Raises LogError on iteration, after all good frames before the defect have been given out: a
    log that was interrupted can be used as far as it goes.
    """

    def __init__(self, path: Path, max_bytes: int = MAX_LOG_BYTES, bus: str | None = None) -> None:
        self.path = path
        self.buses = Buses(bus)
        """How many frames each bus has; `bus`: the one that is wanted, None: all."""
        self.frames = 0
        self.remote_frames = 0
        self.error_frames = 0
        self.unfinished = ""
        """Known after the last frame: by what it shows that a log was not completed by its writer,
        so that frames may be missing at its end. Empty also where the format cannot tell: a
        candump log has no mark of its end."""
        self._max_bytes = max_bytes

    def __iter__(self) -> Iterator[tuple[float, Frame]]:
        try:
            with open_regular(self.path) as file:
                if os.fstat(file.fileno()).st_size == 0:
                    raise EmptyLogError(self.path, "", "is empty")
                yield from self._frames_of(self._entries(file))
        except UnreadableError as error:
            raise LogError(self.path, "", error.cause) from error
        except OSError as error:
            raise LogError(self.path, "", error.strerror or str(error)) from error
        except DefectError as defect:
            raise LogError(self.path, defect.position, defect.cause) from defect
        if self.buses.only is not None and self.buses.frames and not self.frames:
            found = ", ".join(sorted(self.buses.frames))
            raise LogError(self.path, "", f"no frame of bus {self.buses.only!r}, there are {found}")
        if self.frames + self.remote_frames + self.error_frames == 0:
            raise EmptyLogError(self.path, "", "holds no frames")

    def _entries(self, file: BinaryIO) -> Entries:
        if self.path.suffix.lower() != PACKED:
            return _entries(file, self.path, self._max_bytes, self.buses)
        return self._unpacked(file)

    def _unpacked(self, file: BinaryIO) -> Entries:
        """The entries of a packed log; one that is cut off gives all before that."""
        inner = self.path.with_suffix("")
        if inner.suffix.lower() not in READ_FORMATS:
            raise DefectError("", _unknown(inner))
        _check_size(file, self._max_bytes)
        content = Unpacked(file)
        try:
            if inner.suffix.lower() in _READ_ANYWHERE:
                with tempfile.TemporaryFile() as whole:
                    fault = content.copy_to(whole)
                    whole.seek(0)
                    yield from _entries(whole, inner, MAX_UNPACKED_BYTES, self.buses)
                    if fault is not None:
                        raise fault
            else:
                yield from _lines_of(
                    inner, cast(BinaryIO, io.BufferedReader(content, _BLOCK_BYTES)), self.buses
                )
        except (EOFError, zlib.error, gzip.BadGzipFile) as error:
            raise DefectError("", content.damage(error)) from error

    def _frames_of(self, entries: Entries) -> Iterator[tuple[float, Frame]]:
        for entry in entries:
            if entry is Skipped.REMOTE:
                self.remote_frames += 1
            elif entry is Skipped.ERROR:
                self.error_frames += 1
            elif isinstance(entry, Unfinished):
                self.unfinished = entry.cause
            else:
                self.frames += 1
                yield entry


def read_log(
    path: str | os.PathLike[str], max_bytes: int = MAX_LOG_BYTES, bus: str | None = None
) -> LogReader:
    """Reads a log, its format known by its ending (`READ_FORMATS`, and `.gz` behind it); one larger
    than `max_bytes` is refused. bus: of a log of several, the one that is wanted. Errors are raised
    as LogError, when the reader is iterated."""
    return LogReader(Path(path), max_bytes, bus)


class Unpacked(io.RawIOBase):
    """What is in a gzip file, read once from its beginning. DefectError where it is far more than
    any log would be: a small file can hold more than there is disk or time for."""

    def __init__(self, packed: BinaryIO) -> None:
        super().__init__()
        self._packed = packed
        self._content = gzip.GzipFile(fileobj=packed)
        self._count = 0

    def readable(self) -> bool:
        """It is."""
        return True

    def readinto(self, buffer: Any) -> int:
        """EOFError, zlib.error or gzip.BadGzipFile where it is cut off, damaged or none."""
        block = self._content.read1(len(buffer))
        buffer[: len(block)] = block
        self._count += len(block)
        if self._count > max(UNQUESTIONED_BYTES, MOST_TIMES_PACKED * self._packed.tell()):
            raise DefectError(
                "",
                f"unpacked {self._count} bytes, over {MOST_TIMES_PACKED} times what it is packed",
            )
        if self._count > MAX_UNPACKED_BYTES:
            raise DefectError("", f"unpacked over {MAX_UNPACKED_BYTES} bytes")
        return len(block)

    def copy_to(self, file: BinaryIO) -> Exception | None:
        """Unpacks it into a file; what ended that before its end. DefectError where it finds no
        room, leaving some to others."""
        try:
            while block := self.read(_BLOCK_BYTES):
                if shutil.disk_usage(tempfile.gettempdir()).free < ROOM_LEFT_BYTES:
                    raise DefectError(
                        "", f"no room to unpack it in {tempfile.gettempdir()}: "
                        f"{self._count} bytes so far, {ROOM_LEFT_BYTES} are left to others"
                    )  # fmt: skip
                file.write(block)
        except (EOFError, zlib.error, gzip.BadGzipFile) as error:
            if not self._count:
                raise
            return error
        return None

    def damage(self, error: Exception) -> str:
        """In words, what is wrong with a file that could not be unpacked to its end."""
        if not self._count:
            return f"not a gzip file: {error}"
        return (
            f"the packed log ends early or is damaged behind {self._count} bytes (cut off): {error}"
        )


def _check_size(file: BinaryIO, max_bytes: int) -> int:
    file_bytes = os.fstat(file.fileno()).st_size
    if file_bytes > max_bytes:
        raise DefectError("", f"has {file_bytes} bytes, the limit is {max_bytes}")
    return file_bytes


def _entries(file: BinaryIO, path: Path, max_bytes: int, buses: Buses) -> Entries:
    file_bytes = _check_size(file, max_bytes)
    match path.suffix.lower():
        case ".blf":
            return blf_entries(file, file_bytes, buses)
        case ".mf4":
            return mf4_entries(file, buses)
    return _lines_of(path, file, buses)


def _lines_of(path: Path, file: BinaryIO, buses: Buses) -> Entries:
    """The entries of a log of lines, which is read once, from its beginning."""
    match path.suffix.lower():
        case ".log":
            return candump_entries(file, buses)
        case ".asc":
            return asc_entries(file, buses)
        case ".trc":
            return trc_entries(file, buses)
        case ".csv":
            return csv_entries(file)
    raise DefectError("", _unknown(path))


def _unknown(path: Path) -> str:
    return f"unknown ending {path.suffix!r}; known are {', '.join(READ_FORMATS)}, each also .gz"
