"""`meshpoint convert`: a capture of a logic analyser or oscilloscope as a log of the bus."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from meshpoint.bus.logs.recorder import LogWriter
from meshpoint.testbench.commands import arguments
from meshpoint.testbench.errors import CommandError
from meshpoint.testbench.exits import Exit
from meshpoint.testbench.logs.capture_files import (
    LEAST_TEETH,
    MOST_TEETH,
    FoundWheel,
    read_columns,
)
from meshpoint.testbench.logs.capture_log import SHAFTS, write_capture
from meshpoint.testbench.logs.capture_ways import POLARITIES, Asked, Choice, choose
from meshpoint.testbench.results.output import console, folder_for

LEAST_IN_A_ROW = 6
"""Teeth in a row that a wheel must have somewhere, as in a data sheet."""


def add_parser(commands: Any) -> None:
    """The command's arguments."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "convert",
        description="Writes the edges of a capture (a time, then one level or voltage a channel; "
        "docs/edges.md) as the edge frames of a shaft, one read each 10 ms, for `meshpoint "
        "replay`. What is not said is tried in turn, and what was chosen is told.",
    )
    parser.add_argument("file", type=Path, metavar="FILE", help="the capture, .csv")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="LOG", help="the log")
    parser.add_argument(
        "--column",
        type=arguments.whole(1, 64),
        metavar="N",
        help="the channel, 1 is the first behind the time",
    )
    parser.add_argument(
        "--teeth",
        type=arguments.whole(LEAST_TEETH, MOST_TEETH),
        metavar="N",
        help=f"teeth of the wheel, missing ones counted, {LEAST_TEETH} to {MOST_TEETH}",
    )
    parser.add_argument(
        "--missing",
        type=_teeth,
        default=(),
        metavar="N,N",
        help="numbers of the missing teeth, tooth 0 is the first behind the widest gap",
    )
    parser.add_argument(
        "--threshold", type=float, metavar="V", help="of a voltage (default: its usual middle)"
    )
    parser.add_argument(
        "--polarity",
        choices=POLARITIES,
        help="which edges are used; inverted: both, rising and falling ones exchanged",
    )
    parser.add_argument(
        "--shaft", choices=SHAFTS, default="main", help="whose frames (default: %(default)s)"
    )
    parser.set_defaults(run=run)


def run(namespace: argparse.Namespace) -> int:
    """Writes the log, and says what was chosen."""
    asked = Asked(namespace.column, namespace.polarity, namespace.threshold, _wheel(namespace))
    choice = choose(read_columns(namespace.file), asked)
    folder_for(namespace.output.parent)
    with LogWriter(namespace.output, channel="can0", by_frame_time=True) as log:
        frames = write_capture(log, choice.capture, namespace.shaft)
    out = console(None)
    for line in _told(choice, namespace, frames):
        out.print(line)
    return Exit.DONE


def _teeth(text: str) -> tuple[int, ...]:
    try:
        return tuple(sorted({int(word) for word in text.split(",") if word.strip()}))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r}, allowed are whole numbers: 58,59") from None


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


def _told(choice: Choice, namespace: argparse.Namespace, frames: int) -> list[str]:
    wheel, capture = choice.wheel, choice.capture
    missing = f"missing = {list(wheel.missing)}" if wheel.missing else "no missing teeth"
    tried = [f"tried: {line}" for line in choice.tried] if len(choice.tried) > 1 else []
    return [
        *tried,
        f"{namespace.file.name}: channel {choice.title!r}, edges: {choice.polarity}, wheel {wheel}",
        f"{choice.numbered.time_us.size} of {capture.edges} edges numbered; lost "
        f"{choice.numbered.lost}, in doubt {choice.numbered.doubts}",
        f"in the data sheet, [wheels.{namespace.shaft}]: teeth = {wheel.teeth}, {missing}",
        f"{frames} frames in {namespace.output}",
    ]
