"""`meshpoint show`: what there is to look up."""

from __future__ import annotations

import argparse
from typing import Any

from meshpoint.testbench.show import calibration, gearbox, messages, settings


def add_parser(commands: Any) -> None:
    """The command's arguments, a parser for each thing that can be shown."""
    parser: argparse.ArgumentParser = commands.add_parser("show")
    things = parser.add_subparsers(dest="thing", metavar="WHAT", required=True)
    for shown in (gearbox, settings, calibration, messages):
        shown.add_parser(things)
