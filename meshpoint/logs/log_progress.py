"""Progress while a log is read."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from meshpoint.bus.logs.files import read_logs
from meshpoint.cli import arguments
from meshpoint.gearbox import GearboxSheet
from meshpoint.logs.log_clock import Entry, Unpack, clock_of
from meshpoint.logs.logged_frames import LoggedFrames, expected_frames
from meshpoint.results.output import complain
from meshpoint.results.progress import Shown


@contextmanager
def logged_frames(
    files: list[Path],
    bus: str | None,
    stop: Callable[[], bool],
    doing: str = "replaying",
    *,
    in_sensor_time: bool = False,
    unpack: Callable[[], Unpack] | None = None,
) -> Iterator[LoggedFrames]:
    """The frames of a log, shown on standard error as they are read. How many there are is an
    estimate: once more were read, their number is the total. Of one bus of several it is not known.
    in_sensor_time, unpack: as `LoggedFrames` has them."""
    expected = expected_frames(files) if bus is None else None
    with Shown(doing, "frames", expected) as shown:

        def tell(frames: int) -> None:
            shown.come_to(frames, None if expected is None else max(expected, frames))

        yield LoggedFrames(files, bus, tell, stop, in_sensor_time=in_sensor_time, unpack=unpack)


def read_in_sensor_time(
    namespace: argparse.Namespace, files: list[Path], sheet: GearboxSheet
) -> tuple[str, Callable[[], Iterator[Entry]]]:
    """A log of the profile that the arguments say: what is to be said of its clock, and what reads
    its entries in sensor time, as often as it is called. LogError where they end early."""
    unpacking = arguments.unpacking_of(namespace, sheet)
    clock = clock_of(files, unpack=unpacking)
    return clock.words, lambda: clock.in_sensor_time(read_logs(files), unpacking and unpacking())


def complain_of_interrupt(frames: int) -> None:
    """The report ends early, because Ctrl-C asked for it."""
    complain(f"interrupted: the report ends after {frames} frames of the log")


def log_name(files: list[Path]) -> str:
    """The first file's name, and how many there are beside it."""
    more = f" and {len(files) - 1} more" if len(files) > 1 else ""
    return f"{files[0].name}{more}"
