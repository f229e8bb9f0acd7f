"""How far a long command is, on standard error: a bar on a terminal, elsewhere now and then a
line."""

from __future__ import annotations

from time import monotonic
from typing import Final, Self

from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeRemainingColumn

from meshpoint.bus.local.closing import Closing
from meshpoint.results.output import complain, console

EVERY_S: Final = 30.0
"""Between two lines, where there is no terminal."""


class Shown(Closing):
    """Work that takes long, while it is entered. doing: in a word or two; unit: what is counted, in
    the plural."""

    def __init__(
        self, doing: str, unit: str, total: int | None, completed: int = 0, every_s: float = EVERY_S
    ) -> None:
        self._unit, self._every_s = unit, every_s
        shown_on = console("-")
        self._is_drawn = shown_on.is_terminal
        self._progress = Progress(
            SpinnerColumn(),
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            TextColumn("{task.fields[counted]}", markup=False),
            TimeRemainingColumn(),
            console=shown_on,
            transient=True,
            disable=not self._is_drawn,  # else an empty line stands before what is said next
        )
        counted = self._counted(completed, total)
        self._task = self._progress.add_task(
            doing, total=total, completed=completed, counted=counted
        )
        self._said_s = monotonic()

    def __enter__(self) -> Self:
        self._progress.start()
        return self

    def close(self) -> None:
        """The bar goes."""
        self._progress.stop()

    def advance(self, by: int = 1) -> None:
        """This number more is done."""
        task = self._progress.tasks[0]
        total = None if task.total is None else int(task.total)
        self.come_to(int(task.completed) + by, total)

    def begin(self, doing: str) -> None:
        """One more is begun, which is this."""
        self._progress.update(self._task, description=doing)
        self.advance()

    def come_to(self, completed: int, total: int | None) -> None:
        """How much is done, and of how much; None: nobody knows."""
        counted = self._counted(completed, total)
        self._progress.update(self._task, completed=completed, total=total, counted=counted)
        if not self._is_drawn and monotonic() - self._said_s >= self._every_s:
            self._said_s = monotonic()
            complain(f"{self._progress.tasks[0].description}: {counted}{self._left}")

    def _counted(self, completed: int, total: int | None) -> str:
        return f"{completed:,}{'' if total is None else f' of {total:,}'} {self._unit}"

    @property
    def _left(self) -> str:
        """How long it takes yet, in words, where that is known."""
        left_s = self._progress.tasks[0].time_remaining
        if left_s is None:
            return ""
        return f", some {left_s / 60.0:.0f} min left" if left_s > 90.0 else f", {left_s:.0f} s left"
