"""What a node keeps on disk from run to run: its calibration.

The calibration file is read once at the start and replaced as a whole when more is learned. A file
that is refused is renamed, never overwritten: it may be the only copy of something that can be put
right by hand, or that belongs to another gearbox.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Final, NamedTuple

from meshpoint.controller.settings.learned import Calibration, CalibrationError, read_calibration
from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.reading import UnreadableError, read_text
from meshpoint.gearbox.tables import TABLE_LIMIT_BYTES

REFUSED: Final = ".refused"
_NEW_FILE: Final = (
    os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)
)
MOST_KEPT: Final = 100
"""Refused files kept beside each other; then someone has to look."""

Keep = Callable[[Calibration], str | None]
"""Writes a calibration, or begins to; returns a line where something went wrong."""
LAST_S: Final = 5.0
"""The end of a node waits for its last writing no longer than this."""


class Loaded(NamedTuple):
    """What came of reading: the calibration, what to tell, and whether the file may be written."""

    calibration: Calibration | None
    line: str
    writable: bool


def read_file(path: Path, sheet: GearboxSheet | None) -> Calibration:
    """The calibration in a file. CalibrationError names file, key, found and allowed."""
    try:
        content = read_text(path, TABLE_LIMIT_BYTES)
    except UnreadableError as error:
        raise CalibrationError(str(error)) from error
    return read_calibration(content, str(path), sheet)


def load(path: Path, sheet: GearboxSheet) -> Loaded:
    """The calibration to start with; never raises. A file that is refused is put aside."""
    if not path.exists() and not path.is_symlink():
        return Loaded(None, f"calibration {path}: none yet, cold start", True)
    try:
        calibration = read_file(path, sheet)
    except CalibrationError as error:
        refusal = f"calibration refused: {error}"
        if path.exists() and not path.is_file():
            # A device or a folder is somebody else's: neither moved nor replaced.
            return Loaded(None, f"{refusal}; nothing will be written; cold start", False)
        try:
            kept = _put_aside(path)
        except OSError as failure:
            reason = failure.strerror or failure
            refusal = f"{refusal}; cannot be put aside ({reason}), so nothing will be written"
            return Loaded(None, f"{refusal}; cold start", False)
        return Loaded(None, f"{refusal}; kept as {kept}; cold start", True)
    shifts = calibration.provenance.shifts
    noun = "shift" if shifts == 1 else "shifts"
    return Loaded(calibration, f"calibration {path}: learned over {shifts} {noun}", True)


def _put_aside(path: Path) -> Path:
    for number in range(1, MOST_KEPT + 1):
        kept = path.with_name(f"{path.name}{REFUSED}" + (f"-{number}" if number > 1 else ""))
        if not kept.exists():
            path.rename(kept)
            return kept
    raise OSError(f"{MOST_KEPT} refused files are beside it already")


def save(path: Path, calibration: Calibration) -> None:
    """Replaces the file in one piece: who reads it, or the next start after a loss of power, finds
    the old one or the new one. OSError where it cannot be written."""
    beside = path.with_name(f".{path.name}.new")
    # What is there is left over, or was put there so that we write to where it points: a new file.
    beside.unlink(missing_ok=True)
    with os.fdopen(os.open(beside, _NEW_FILE, 0o666), "w", encoding="utf-8", newline="") as file:
        file.write(calibration.to_text())
        file.flush()
        os.fsync(file.fileno())
    beside.replace(path)
    _sync_folder(path.parent)


def _sync_folder(folder: Path) -> None:
    """Makes the rename itself last (POSIX); other systems cannot open a folder."""
    if os.name != "posix":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


class CalibrationWriter:
    """Writes calibrations to a file: at once, or in a thread so that no step waits for a disk."""

    def __init__(self, path: Path, sheet: GearboxSheet, threaded: bool) -> None:
        self._path = path
        self._sheet = sheet
        self._pool = ThreadPoolExecutor(1, "calibration") if threaded else None
        self._last: Future[str | None] | None = None
        self._reported: str | None = None

    def __call__(self, calibration: Calibration) -> str | None:
        """Writes it, or has it written; returns what went wrong, each thing once."""
        if self._pool is None:
            return self._new(self._write(calibration))
        line = self._last.result() if self._last is not None and self._last.done() else None
        self._last = self._pool.submit(self._write, calibration)
        return self._new(line)

    def close(self) -> str | None:
        """Waits for the last one; returns what went wrong with it."""
        if self._pool is None or self._last is None:
            return None
        try:
            line = self._last.result(LAST_S)
        except TimeoutError:
            line = f"calibration {self._path}: still not written after {LAST_S:.0f} s"
        self._pool.shutdown(wait=False)
        return self._new(line)

    def _new(self, line: str | None) -> str | None:
        reported, self._reported = self._reported, line
        return None if line == reported else line

    def _write(self, calibration: Calibration) -> str | None:
        """What would be refused at the next start is not written: the file before is better."""
        try:
            read_calibration(calibration.to_text(), "what was learned", self._sheet)
            save(self._path, calibration)
        except CalibrationError as error:
            return f"calibration not written: {error}"
        except OSError as error:
            return f"calibration {self._path}: cannot be written: {error.strerror or error}"
        return None
