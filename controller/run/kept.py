"""What a node keeps on disk from run to run: its calibration, and what a log cannot hold.

The calibration file is read once at the start and replaced as a whole when more is learned. A file
that is refused is renamed, never overwritten: it may be the only copy of something that can be put
right by hand, or that belongs to another gearbox.

Of a link outage it is kept when each step was, and what it consumed. While its bus is away a
controller goes on deciding, but nothing that it sends reaches a log, and so a replay could not go
on after the hole. What the lost steps were made of is little: their times, and the frames that had
still arrived. They are written beside the run header, with those of two seconds before (what was
sent then may have got stuck on its way) and one second after.
"""

from __future__ import annotations

import json
import os
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final, NamedTuple

from meshpoint.bus.core import AroundCore, Core, Step
from meshpoint.bus.records import Records
from meshpoint.controller.settings.learned import Calibration, CalibrationError, read_calibration
from meshpoint.dbc.frame import Frame
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

BEFORE_STEPS: Final = 200
AFTER_STEPS: Final = 100
MOST_STEPS: Final = 720_000
"""Two hours; an outage that lasts longer is not kept to its end."""
RECORD_LIMIT_BYTES: Final = 200_000_000
MOST_STEP: Final = 1 << 32
LONGEST_BYTES: Final = 64


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


class OutageError(ValueError):
    """A record of an outage that cannot be used; names file, line and what is wrong."""


class StepInput(NamedTuple):
    """What one step was made of."""

    number: int
    time_us: int
    frames: list[Frame]


class OutageRecord(AroundCore[Core]):
    """A core with its memory of the newest steps, which it hands over to be written where frames
    were not sent."""

    def __init__(
        self, core: Core, records: Records, run_hash: int, discarded: Callable[[], int]
    ) -> None:
        """discarded: how many frames the driver could not send so far."""
        super().__init__(core)
        self._records, self._run_hash = records, run_hash
        self._discarded = discarded
        self._discarded_before = 0
        self._newest: deque[StepInput] = deque(maxlen=BEFORE_STEPS)
        self._heard: list[Frame] = []
        self._number = 0
        self._name = ""
        """Of the file of the outage that is recorded; empty: none is."""
        self._left = self._kept = 0
        self._sent = 0
        """Steps in a row that could be sent."""

    def receive(self, frame: Frame) -> None:
        """As the core does; kept."""
        self._heard.append(frame)
        self._core.receive(frame)

    def step(self, now_us: int) -> Step:
        """The core's step; a line of its own where a record begins."""
        lines = self._measure()
        heard, self._heard = self._heard, []
        self._take(StepInput(self._number, now_us, heard))
        self._number += 1
        step = self._core.step(now_us)
        return step if not lines else Step(step.frames, [*step.events, *lines])

    def shutdown(self, now_us: int) -> Step:
        """The core's last frames; ends the record."""
        lines = self._measure()
        self._end()
        step = self._core.shutdown(now_us)
        return Step(step.frames, [*step.events, *lines])

    def _measure(self) -> list[str]:
        """Whether the step before could be sent."""
        discarded = self._discarded()
        is_lost = discarded > self._discarded_before
        self._discarded_before = discarded
        self._sent = 0 if is_lost else self._sent + 1
        if self._sent > AFTER_STEPS:
            self._kept = 0  # that outage is over
        if not is_lost or self._kept >= MOST_STEPS:
            return []
        self._left = AFTER_STEPS
        return [] if self._name else self._begin()

    def _begin(self) -> list[str]:
        if not self._newest:
            return []
        self._name = record_name(self._run_hash, self._newest[0].number)
        self._kept = 0
        for each in self._newest:
            self._keep(each)
        return [f"outage: what its steps were made of goes to {self._name}"]

    def _take(self, step: StepInput) -> None:
        self._newest.append(step)
        if not self._name:
            return
        self._keep(step)
        self._left -= 1
        if self._left <= 0 or self._kept >= MOST_STEPS:
            self._end()

    def _keep(self, step: StepInput) -> None:
        frames = [[f.can_id, f.data.hex(), f.is_fd, f.is_extended] for f in step.frames]
        self._records.put(self._name, json.dumps([step.number, step.time_us, frames]))
        self._kept += 1

    def _end(self) -> None:
        if self._name:
            self._records.end(self._name)
        self._name = ""


def record_name(run_hash: int, first_step: int) -> str:
    """File name of the record of an outage."""
    return f"outage-{run_hash:016x}-{first_step}.jsonl"


def load_outages(folder: Path, run_hash: int) -> dict[int, StepInput]:
    """All steps of a run that its records hold, by number. OutageError for a file that is none; a
    last line that was cut off is left out."""
    found: dict[int, StepInput] = {}
    for path in sorted(folder.glob(record_name(run_hash, 0).replace("-0.", "-*."))):
        try:
            lines = read_text(path, RECORD_LIMIT_BYTES).split("\n")
        except (OSError, ValueError) as error:
            raise OutageError(f"{path}: {error}") from error
        for number, line in enumerate(lines[:-1], 1):
            try:
                step = _step(json.loads(line))
            except (ValueError, TypeError, RecursionError) as error:
                raise OutageError(f"{path}, line {number}: not a step: {error}") from error
            found[step.number] = step
    return found


def _step(values: Any) -> StepInput:
    number, time_us, frames = values
    if not (type(number) is int and 0 <= number < MOST_STEP):
        raise ValueError(f"step {number!r}")
    if not (type(time_us) is int and 0 <= time_us < 1 << 63):
        raise ValueError(f"time {time_us!r}")
    return StepInput(number, time_us, [_frame(each) for each in frames])


def _frame(values: Any) -> Frame:
    can_id, text, is_fd, is_extended = values
    if not (type(can_id) is int and 0 <= can_id < 1 << 29):
        raise ValueError(f"identifier {can_id!r}")
    data = bytes.fromhex(text)
    if len(data) > LONGEST_BYTES:
        raise ValueError(f"{len(data)} bytes of data")
    return Frame(can_id, data, bool(is_fd), bool(is_extended))
