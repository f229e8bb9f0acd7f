"""`meshpoint captures -o LOG`: a capture of a real sensor as a log of the bus."""

from __future__ import annotations

import argparse
from pathlib import Path

from meshpoint.base.errors import CommandError
from meshpoint.bus import given_numbers
from meshpoint.bus.logs.recorder import LogWriter
from meshpoint.gearbox.wheels import WHEEL_NAMES
from meshpoint.logs.capture_files import (
    LEAST_TEETH,
    MOST_TEETH,
    FoundWheel,
    read_columns,
)
from meshpoint.logs.capture_log import write_capture
from meshpoint.logs.capture_ways import POLARITIES, Asked, Choice, choose
from meshpoint.logs.captures import CaptureRow
from meshpoint.results.output import console, folder_for

LEAST_IN_A_ROW = 6
"""Teeth in a row that a wheel must have somewhere, as in a data sheet."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What is known of the captures, and -o."""
    known = parser.add_argument_group("what is known of them; else it is tried in turn")
    known.add_argument(
        "--column",
        type=given_numbers.whole(1, 64),
        metavar="N",
        help="the channel, 1 is the first behind the time",
    )
    known.add_argument(
        "--teeth",
        type=given_numbers.whole(LEAST_TEETH, MOST_TEETH),
        metavar="N",
        help=f"teeth of the wheel, missing ones counted, {LEAST_TEETH} to {MOST_TEETH}",
    )
    known.add_argument(
        "--missing",
        type=_teeth,
        default=(),
        metavar="N,N",
        help="numbers of the missing teeth, tooth 0 is the first behind the widest gap",
    )
    known.add_argument(
        "--threshold",
        type=given_numbers.number(),
        metavar="V",
        help="of a voltage (default: its usual middle)",
    )
    known.add_argument(
        "--polarity",
        choices=POLARITIES,
        help="which edges are used; inverted: both, rising and falling ones exchanged",
    )
    log = parser.add_argument_group("a log of one of them")
    log.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="LOG",
        help="write its edges as the edge frames of a shaft, one read each 10 ms, and tell what "
        "was chosen",
    )
    log.add_argument(
        "--shaft", choices=WHEEL_NAMES, default="main", help="whose frames (default: %(default)s)"
    )


def asked_of(namespace: argparse.Namespace) -> Asked:
    """What is known of the captures. CommandError for a wheel that there cannot be."""
    return Asked(namespace.column, namespace.polarity, namespace.threshold, _wheel(namespace))


def write_log(namespace: argparse.Namespace, path: Path, asked: Asked) -> CaptureRow:
    """Writes the log, says what was chosen, and gives its row."""
    choice = choose(read_columns(path), asked)
    folder_for(namespace.output.parent)
    with LogWriter(namespace.output, channel="can0", by_frame_time=True) as log:
        frames = write_capture(log, choice.capture, namespace.shaft)
    out = console(namespace.json)
    for line in _reported(choice, namespace, path, frames):
        out.print(line)
    return choice.row()


def _teeth(text: str) -> tuple[int, ...]:
    tooth = given_numbers.whole(0, MOST_TEETH - 1)
    return tuple(sorted({tooth(word) for word in text.split(",") if word.strip()}))


def _wheel(namespace: argparse.Namespace) -> FoundWheel | None:
    """The wheel that is named; None: it is to be found."""
    teeth, missing = namespace.teeth, namespace.missing
    if teeth is None:
        if missing:
            raise CommandError("--missing without --teeth: how many teeth has the wheel")
        return None
    if missing and not (missing[0] >= 0 and missing[-1] < teeth):
        raise CommandError(f"--missing {missing}: allowed are 0 to {teeth - 1}")
    present = [k not in missing for k in range(teeth)] * 2
    row = longest = 0
    for there in present:
        row = row + 1 if there else 0
        longest = max(longest, row)
    if longest < LEAST_IN_A_ROW:
        raise CommandError(
            f"--missing leaves {longest} teeth in a row, {LEAST_IN_A_ROW} are needed"
        )
    return FoundWheel(teeth, missing)


def _reported(choice: Choice, namespace: argparse.Namespace, path: Path, frames: int) -> list[str]:
    wheel, capture = choice.wheel, choice.capture
    missing = f"missing = {list(wheel.missing)}" if wheel.missing else "no missing teeth"
    tried = [f"tried: {line}" for line in choice.tried] if len(choice.tried) > 1 else []
    return [
        *tried,
        f"{path.name}: channel {choice.title!r}, edges: {choice.polarity}, wheel {wheel}",
        f"{choice.numbered.time_us.size} of {capture.edges} edges numbered; lost "
        f"{choice.numbered.lost}, in doubt {choice.numbered.doubts}",
        f"in the data sheet, [wheels.{namespace.shaft}]: teeth = {wheel.teeth}, {missing}",
        f"{frames} frames in {namespace.output}",
    ]
