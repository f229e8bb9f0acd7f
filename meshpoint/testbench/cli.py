"""The command line of meshpoint."""

from __future__ import annotations

import argparse
import importlib
import os
import sys
from collections.abc import Sequence

from meshpoint.bus.logs.limits import LogError
from meshpoint.bus.options import BusOpenError
from meshpoint.bus.pace import PaceError
from meshpoint.controller.header import HeaderError
from meshpoint.gearbox.tables import TableError
from meshpoint.rig_sim.settings import SettingsError
from meshpoint.testbench.errors import CommandError
from meshpoint.testbench.exits import Exit
from meshpoint.testbench.provenance import product_version

DESCRIPTION = """\
A transmission controller that fires a dog-clutch sleeve so that tooth meets gap, and a virtual
gearbox rig to prove it against, as two nodes on a CAN bus."""
EPILOG = """\
start here:
  meshpoint demo                        both nodes as processes, both strategies, a plot
  meshpoint simulate --shifts 20        the same in virtual time
  meshpoint rig &  meshpoint controller &  meshpoint request 10

exit codes:
  0  done                               3  not verifiable (replay --verify), with the reason
  1  ran, but failed: a shift that did  130  interrupted
     not end, a replay that differs
  2  bad input: what was found and what is allowed is on standard error"""
USER_ERRORS = (
    BusOpenError,
    CommandError,
    HeaderError,
    LogError,
    PaceError,
    SettingsError,
    TableError,
)
MODULES = {
    "demo": "demo",
    "simulate": "simulate",
    "campaign": "campaign",
    "replay": "replay",
    "controller": "nodes",
    "rig": "nodes",
    "request": "request",
    "health": "health",
    "pace": "pace",
    "gearbox": "gearbox",
    "calibration": "calibration",
    "captures": "captures",
    "study": "study",
}
"""The module of `meshpoint.testbench.commands` that holds each command, in the order of the
help."""


def build_parser(command: str | None = None) -> argparse.ArgumentParser:
    """The parser with all commands, or with that of one command alone: loading all of them would
    take a node longer than all else that it does before its first step."""
    parser = argparse.ArgumentParser(
        prog="meshpoint",
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"meshpoint {product_version()}")
    parser.add_argument("--debug", action="store_true", help="show the traceback of an error")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    wanted = [MODULES[command]] if command in MODULES else dict.fromkeys(MODULES.values())
    for name in wanted:
        importlib.import_module(f"meshpoint.testbench.commands.{name}").add_parser(commands)
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs one command; returns its exit code."""
    given = sys.argv[1:] if arguments is None else list(arguments)
    parser = build_parser(next((word for word in given if not word.startswith("-")), None))
    namespace = parser.parse_args(given)
    try:
        code: int = namespace.run(namespace)
    except USER_ERRORS as error:
        if namespace.debug:
            raise
        print(f"meshpoint {namespace.command}: error: {error}", file=sys.stderr)
        return Exit.BAD_INPUT
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return Exit.INTERRUPTED
    except BrokenPipeError:
        # The reader of our output has gone (`| head`); Python would complain again at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return Exit.DONE
    return code
