"""Reads recorded buses: candump text logs (`.log`), Vector's `.blf` and `.asc`."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from meshpoint.bus.logs.asc import asc_entries
from meshpoint.bus.logs.blf import blf_entries
from meshpoint.bus.logs.entry import DefectError, Entries, Skipped, Unfinished
from meshpoint.bus.logs.text import candump_entries
from meshpoint.dbc.frame import Frame
from meshpoint.gearbox.reading import UnreadableError, open_regular

FORMATS = (".log", ".blf", ".asc")
MAX_LOG_BYTES = 4 * 1024**3


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

    def __init__(self, path: Path, max_bytes: int = MAX_LOG_BYTES) -> None:
        self.path = path
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
                yield from self._frames_of(_entries(file, self.path, self._max_bytes))
        except UnreadableError as error:
            raise LogError(self.path, "", error.cause) from error
        except OSError as error:
            raise LogError(self.path, "", error.strerror or str(error)) from error
        except DefectError as defect:
            raise LogError(self.path, defect.position, defect.cause) from defect
        if self.frames + self.remote_frames + self.error_frames == 0:
            raise EmptyLogError(self.path, "", "holds no frames")

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


def read_log(path: str | os.PathLike[str], max_bytes: int = MAX_LOG_BYTES) -> LogReader:
    """Reads a log, its format told by its ending (`FORMATS`); one larger than `max_bytes` is
    refused. Errors are raised as LogError, when the reader is iterated."""
    return LogReader(Path(path), max_bytes)


def _entries(file: BinaryIO, path: Path, max_bytes: int) -> Entries:
    file_bytes = os.fstat(file.fileno()).st_size
    if file_bytes > max_bytes:
        raise DefectError("", f"has {file_bytes} bytes, the limit is {max_bytes}")
    match path.suffix.lower():
        case ".log":
            return candump_entries(file)
        case ".asc":
            return asc_entries(file)
        case ".blf":
            return blf_entries(file, file_bytes)
    raise DefectError("", f"unknown ending {path.suffix!r}; known are {', '.join(FORMATS)}")
