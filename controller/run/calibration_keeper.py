"""Keeps a controller's calibration file up to date: what a driver puts around the core.

The core says when it knows more (a shift has ended, a phase reference has come or gone); the
keeper takes the value then and at the end, and has it written.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Final

from meshpoint.bus.core import AroundCore, Step
from meshpoint.controller.core.core import ControllerCore
from meshpoint.controller.settings.calibration_file import save
from meshpoint.controller.settings.learned import Calibration, CalibrationError, read_calibration
from meshpoint.gearbox import GearboxSheet

Keep = Callable[[Calibration], str | None]
"""Writes a calibration, or begins to; returns a line where something went wrong."""
LAST_S: Final = 5.0
"""The end of a node waits for its last writing no longer than this."""


class CalibrationKeeper(AroundCore[ControllerCore]):
    """A controller core that hands its calibration out whenever it knows more."""

    def __init__(self, core: ControllerCore, keep: Keep, written: Callable[[int], str]) -> None:
        """`written` says in words when it is, of the driver's clock in microseconds."""
        super().__init__(core)
        self._keep = keep
        self._written = written
        self._knows = core.knows

    def step(self, now_us: int) -> Step:
        """The core's step; after it the calibration where more is known."""
        step = self._core.step(now_us)
        if self._core.knows != self._knows:
            self._knows = self._core.knows
            step.events.extend(self.keep(now_us))
        return step

    def shutdown(self, now_us: int) -> Step:
        """The core's last frames, and its last calibration."""
        step = self._core.shutdown(now_us)
        return Step(step.frames, [*step.events, *self.keep(now_us)])

    def keep(self, now_us: int) -> list[str]:
        """Hands the calibration out now; lines for the log."""
        line = self._keep(self._core.calibration(self._written(now_us)))
        return [] if line is None else [line]


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
