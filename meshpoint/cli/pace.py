"""--speed and --pace: the time that a node goes by."""

from __future__ import annotations

import argparse
from pathlib import Path

from meshpoint.base.errors import CommandError
from meshpoint.bus.clock import Clock, NodeClock
from meshpoint.bus.pace import PacedClock, PaceFile
from meshpoint.cli import arguments


def add_pace(parser: argparse.ArgumentParser) -> None:
    """Both arguments."""
    arguments.add_speed(parser)
    parser.add_argument(
        "--pace",
        type=Path,
        metavar="FILE",
        help="bus time shared with the other nodes, as `meshpoint up --pace-only FILE` keeps it: "
        "waits for whoever the machine keeps from running (default: wall time)",
    )


def clock_of(namespace: argparse.Namespace, node: str) -> NodeClock:
    """The clock that is asked for. node: which of `PACED_NODES` bus time waits for in this one.
    CommandError where the file is none."""
    if namespace.pace is None:
        return Clock(namespace.speed)
    try:
        return PacedClock(PaceFile(namespace.pace), node, namespace.speed)
    except (OSError, ValueError) as error:
        raise CommandError(f"--pace {namespace.pace}: {error}") from error
