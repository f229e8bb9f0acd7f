"""Logs of more than one file: how they are named, written by size, and read in order.

In a folder a log is named as `candump -l` does it, by the local time of its beginning:
`candump-2025-11-21_031245.log`. A log that is rotated by size has numbered parts: `run_001.blf`,
`run_002.blf`.
"""

import os
import re
from collections import Counter
from collections.abc import Iterable, Iterator
from datetime import datetime, timedelta
from pathlib import Path

import can

from meshpoint.bus.local.closing import Closing
from meshpoint.bus.logs.reader import (
    PACKED,
    READ_FORMATS,
    EmptyLogError,
    LogError,
    UnfinishedLogError,
    read_log,
)
from meshpoint.bus.logs.recorder import FLUSH_EVERY_S, LogWriter
from meshpoint.dbc.frame import Frame

MIN_PART_BYTES = 64 * 1024
DATED_NAME = "candump-%Y-%m-%d_%H%M%S"
_DATED_ENDING = ".log"
_PART_DIGITS = 3
FOLDER_FORMATS = tuple(ending for ending in READ_FORMATS if ending != ".csv")
"""What is taken for a log in a folder; a csv may be anything, so it must be named."""


class RotatingLog(Closing):
    """Writes a log in parts, none larger than `max_bytes`; the same use as a LogWriter.

    path: `run.blf` makes `run_001.blf`, `run_002.blf` ... Parts of an earlier log of that name are
        not replaced: those beyond the new end would be taken for its own.

    Raises LogError, here and on writing.
    """

    def __init__(
        self,
        path: Path,
        max_bytes: int,
        *,
        channel: str,
        flush_every_s: float | None = FLUSH_EVERY_S,
        by_frame_time: bool = False,
    ) -> None:
        if max_bytes < MIN_PART_BYTES:
            raise ValueError(f"parts of {max_bytes} bytes, allowed are {MIN_PART_BYTES} and more")
        there = [part for part in parts_of(path) if part.stat().st_size]
        if there:
            raise LogError(there[0], "", "is there already; a log in parts replaces no other")
        self.path = path
        self.paths: list[Path] = []
        self._max_bytes = max_bytes
        self._channel = channel
        self._flush_every_s = flush_every_s
        self._by_frame_time = by_frame_time
        self._frames_before = 0
        self._log = self._next()

    @property
    def frames(self) -> int:
        """Frames written, in all parts."""
        return self._frames_before + self._log.frames

    def write(self, time_s: float, frame: Frame, received: bool = True) -> None:
        """As LogWriter.write."""
        self._make_room()
        self._log.write(time_s, frame, received)

    def write_message(self, message: can.Message) -> None:
        """As LogWriter.write_message."""
        self._make_room()
        self._log.write_message(message)

    def flush(self) -> None:
        """As LogWriter.flush."""
        self._log.flush()

    def close(self) -> None:
        """Completes the last part."""
        self._log.close()

    def _make_room(self) -> None:
        if self._log.frames and not self._log.has_room(self._max_bytes):
            self._log.close()
            self._frames_before += self._log.frames
            self._log = self._next()

    def _next(self) -> LogWriter:
        path = part_path(self.path, len(self.paths) + 1)
        log = LogWriter(
            path,
            channel=self._channel,
            flush_every_s=self._flush_every_s,
            by_frame_time=self._by_frame_time,
        )
        self.paths.append(path)
        return log


def part_path(path: Path, number: int) -> Path:
    """The file of a part, counted from 1."""
    return path.with_name(f"{path.stem}_{number:0{_PART_DIGITS}}{path.suffix}")


def parts_of(path: Path) -> list[Path]:
    """The parts that there are of a log, in order."""
    name = re.compile(rf"{re.escape(path.stem)}_\d{{{_PART_DIGITS},}}{re.escape(path.suffix)}")
    return _in_order(other for other in _entries(path.parent) if name.fullmatch(other.name))


def dated_log(folder: Path, now: datetime, in_parts: bool) -> Path:
    """A new log's path in `folder`; its file, or first part, is made, so that no other process
    takes the same name. Raises LogError."""
    while True:
        path = folder / f"{now.strftime(DATED_NAME)}{_DATED_ENDING}"
        first = part_path(path, 1) if in_parts else path
        try:
            first.open("x").close()
        except FileExistsError:
            now += timedelta(seconds=1)
        except OSError as error:
            raise LogError(first, "", error.strerror or str(error)) from error
        else:
            return path


def open_log(
    target: str,
    *,
    channel: str,
    max_bytes: int | None = None,
    by_frame_time: bool = False,
) -> LogWriter | RotatingLog:
    """A log that is flushed every second.

    target: a file, its format known by its ending; or a folder, when it is one or ends with a
        slash: then the log is a candump log named by the time of now.
    max_bytes: rotate before a file grows over this.

    Raises LogError.
    """
    path = Path(target)
    if path.is_dir() or target.endswith(("/", os.sep)):
        path = dated_log(path, datetime.now().astimezone(), max_bytes is not None)
    if max_bytes is None:
        return LogWriter(path, channel=channel, by_frame_time=by_frame_time)
    return RotatingLog(path, max_bytes, channel=channel, by_frame_time=by_frame_time)


def log_files(paths: Iterable[Path]) -> list[Path]:
    """The files to read: each path itself, or all logs in a folder, parts by their number.

    Raises LogError for a folder without a log."""
    files: list[Path] = []
    for path in paths:
        if not path.is_dir():
            files.append(path)
            continue
        found = _in_order(other for other in _entries(path) if _is_log(other) and other.is_file())
        if not found:
            raise LogError(path, "", f"a folder without a log ({', '.join(FOLDER_FORMATS)})")
        files += found
    return files


def read_logs(
    files: Iterable[Path], bus: str | None = None, counts: Counter[str] | None = None
) -> Iterator[tuple[float, Frame]]:
    """The frames of several logs, one file after the other. Raises LogError as LogReader does, and
    does not go on behind a defect: what follows would not fit. The last of several may hold
    nothing: a process may be killed just after it has begun it. A log that its writer has not
    completed is a defect at its end, as frames may be missing there.

    bus: of logs of several, the one that is wanted; counts: frames of each bus are added there."""
    *before, last = files
    counts = Counter() if counts is None else counts
    for path in before:
        yield from _whole(path, bus, counts)
    try:
        yield from _whole(last, bus, counts)
    except EmptyLogError:
        if not before:
            raise


def _is_log(path: Path) -> bool:
    name = path.with_suffix("") if path.suffix.lower() == PACKED else path
    return name.suffix.lower() in FOLDER_FORMATS


def _whole(path: Path, bus: str | None, counts: Counter[str]) -> Iterator[tuple[float, Frame]]:
    reader = read_log(path, bus=bus)
    try:
        yield from reader
    finally:
        counts += reader.buses.frames
    if reader.unfinished:
        raise UnfinishedLogError(path, "", reader.unfinished)


def _entries(folder: Path) -> list[Path]:
    try:
        return list(folder.iterdir())
    except OSError as error:
        raise LogError(folder, "", error.strerror or str(error)) from error


def _in_order(paths: Iterable[Path]) -> list[Path]:
    """By name, numbers in it by their value: part 1000 comes behind part 999."""
    return sorted(paths, key=lambda path: [_rank(word) for word in _WORD.findall(path.name)])


_WORD = re.compile(r"\d+|\D+", re.ASCII)


def _rank(word: str) -> tuple[int, int, str]:
    return (0, int(word), "") if word.isdecimal() else (1, 0, word)
