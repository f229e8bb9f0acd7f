"""Progress while a log is read."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from rich.progress import (
    BarColumn,
    Progress,
    SpinnerColumn,
    TextColumn,
    TimeRemainingColumn,
)

from meshpoint.testbench.logs.logged_frames import LoggedFrames, expected_frames
from meshpoint.testbench.results.output import complain, console


@contextmanager
def logged_frames(
    files: list[Path], bus: str | None, stop: Callable[[], bool], doing: str = "replaying"
) -> Iterator[LoggedFrames]:
    """The frames of a log, shown on standard error as they are read. How many there are is an
    estimate: once more were read, their number is the total. Of one bus of several it is not known.
    """
    expected = expected_frames(files) if bus is None else None
    shown_on = console("-")
    with Progress(
        SpinnerColumn(),
        TextColumn(doing, markup=False),
        BarColumn(),
        TextColumn("{task.completed} frames"),
        TimeRemainingColumn(),
        console=shown_on,
        transient=True,
        disable=not shown_on.is_terminal,  # else an empty line stands before what is said next
    ) as progress:
        task = progress.add_task("frames", total=expected)

        def tell(frames: int) -> None:
            total = None if expected is None else max(expected, frames)
            progress.update(task, completed=frames, total=total)

        yield LoggedFrames(files, bus, tell, stop)


def complain_of_interrupt(frames: int) -> None:
    """What is told ends early, because Ctrl-C asked for it."""
    complain(f"interrupted: what is told ends after {frames} frames of the log")
