"""`meshpoint play`: a page on which one fires the sleeve oneself."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from meshpoint.base.exits import Exit
from meshpoint.cli import arguments
from meshpoint.results.output import folder_for, tell
from meshpoint.run.play_page import write_play


def add_parser(commands: Any) -> None:
    """The command's arguments."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "play",
        description="Writes one HTML page that needs nothing but itself: teeth of sleeve and gear "
        "in slow motion, dials for slip, gap, delay and its scatter, a button to fire, and the "
        "score beside that of a controller that aims.",
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("play.html"),
        metavar="FILE",
        help="the page (default: play.html)",
    )
    arguments.add_gearbox(parser)
    parser.set_defaults(run=run)


def run(namespace: argparse.Namespace) -> int:
    """Writes the page."""
    folder_for(namespace.out.parent)
    write_play(namespace.out, arguments.sheet_of(namespace))
    tell(f"open {namespace.out} in a browser")
    return Exit.DONE
