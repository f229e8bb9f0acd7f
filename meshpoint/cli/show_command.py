"""`meshpoint show`: what there is to look up."""

from __future__ import annotations

import argparse
from typing import Any

from meshpoint.cli import show_calibration, show_gearbox, show_messages, show_settings


def add_parser(commands: Any) -> None:
    """The command's arguments, a parser for each thing that can be shown."""
    parser: argparse.ArgumentParser = commands.add_parser("show")
    things = parser.add_subparsers(dest="thing", metavar="WHAT", required=True)
    for shown in (show_gearbox, show_settings, show_calibration, show_messages):
        shown.add_parser(things)
