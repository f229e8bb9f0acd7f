"""`meshpoint tell`: a log as a story, one line an event."""

from __future__ import annotations

import argparse
import json
import sys
import textwrap
from collections.abc import Iterator
from typing import Any

from rich.text import Text

from meshpoint.base.exits import Exit
from meshpoint.bus.logs.files import log_files
from meshpoint.bus.logs.reader import LogError
from meshpoint.cli import arguments
from meshpoint.logs.log_progress import read_in_sensor_time
from meshpoint.logs.story import Line, Story
from meshpoint.results.output import WordsConsole, complain

WORDS_AT = 35
"""Column in which the words begin."""
STYLES = {
    "driver": "bold",
    "controller": "",
    "gearbox": "cyan",
    "truth": "green",
    "bus": "red",
    "bench": "magenta",
}


def add_parser(commands: Any) -> None:
    """The command's arguments."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "tell",
        description="Reads a log and says what happened: who asked for which gear, what the "
        "controller decided, what the valves did, how the shift ended; what was lost on the bus. "
        "Columns: seconds of the log, milliseconds since the gear was asked for by the sensor "
        "clock, who, what. Lines marked `truth` come from the virtual rig alone; with `moved by "
        "the bench` they are no shift's: the bench puts the gearbox back by force before the next.",
    )
    arguments.add_logs(parser)
    parser.add_argument(
        "--only",
        choices=tuple(STYLES),
        nargs="+",
        metavar="WHO",
        help=f"only these: {', '.join(STYLES)} (default: all)",
    )
    arguments.add_gearbox(parser)
    arguments.add_wire(parser)
    parser.add_argument(
        "--json", action="store_true", help="one JSON object a line, on standard output"
    )
    parser.set_defaults(run=run)


def run(namespace: argparse.Namespace) -> int:
    """Says what the log holds, up to a defect in it."""
    out = WordsConsole(soft_wrap=True)
    # What is piped stays one line an event, for grep.
    width = out.width if out.is_terminal else None
    wanted = set(namespace.only or STYLES)
    reported = 0
    try:
        for line in _lines(namespace):
            if line.who not in wanted:
                continue
            reported += 1
            if namespace.json:
                sys.stdout.write(json.dumps(line.to_json()) + "\n")
            else:
                out.print(_text(line, width))
    except LogError as error:
        if not reported:
            raise
        complain(f"meshpoint tell: {error}; what is shown is all that stands before it")
        return Exit.BAD_INPUT
    if not reported:
        out.print("meshpoint tell: nothing to tell: no message of the DBC says an event")
    return Exit.DONE


def _lines(namespace: argparse.Namespace) -> Iterator[Line]:
    story, files, sheet = Story(), log_files(namespace.log), arguments.sheet_of(namespace)
    said, entries = read_in_sensor_time(namespace, files, sheet)
    unpack = arguments.unpack_all_of(namespace, sheet)
    for time_s, frame in entries():
        if said:
            yield Line(0.0, None, "bus", said)
            said = ""
        for inner in unpack(frame):
            yield from story.receive(time_s, inner)


def _text(line: Line, width: int | None) -> Text:
    """The event in lines of this width, its words below each other; None: in one line."""
    ms = "" if line.of_request_ms is None else f"{line.of_request_ms:+.0f} ms"
    text = Text(f"{line.at_s:9.3f} s {ms:>9}  ")
    text.append(f"{line.who:<10} ", style=STYLES[line.who])
    words = line.words
    if width is not None and width > 2 * WORDS_AT:
        words = f"\n{' ' * WORDS_AT}".join(textwrap.wrap(words, width - WORDS_AT))
    text.append(words)
    return text
