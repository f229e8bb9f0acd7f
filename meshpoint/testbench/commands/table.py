"""The table of commands, and the parser made of it."""

from __future__ import annotations

import argparse
import importlib
from typing import Final

from meshpoint.testbench.commands.parsing import Parser
from meshpoint.testbench.provenance import product_version

DESCRIPTION: Final = """\
A transmission controller that fires a dog-clutch sleeve so that tooth meets gap, and a virtual
gearbox rig to prove it against, as two nodes on a CAN bus."""
EPILOG: Final = """\
start here:
  meshpoint demo                  both nodes, both strategies, a picture
  meshpoint simulate --shifts 20  the same in virtual time
  meshpoint up                    both nodes until Ctrl-C; in another terminal:
  meshpoint request 10            asks for gear 10
  meshpoint help bus              which bus a command opens

exit codes:
  0    done
  1    ran, but failed: a shift that did not end, a replay that differs
  2    bad input: what was found and what is allowed is on standard error
  3    not verifiable (replay --verify), with the reason
  130  interrupted"""
MODULES: Final = {
    "demo": "demo",
    "simulate": "simulate",
    "campaign": "campaign",
    "replay": "replay",
    "tell": "tell",
    "compare": "compare",
    "up": "up",
    "controller": "nodes",
    "rig": "nodes",
    "request": "request",
    "watch": "watch",
    "health": "health",
    "play": "play",
    "pace": "pace",
    "gearbox": "gearbox",
    "calibration": "calibration",
    "captures": "captures",
    "convert": "convert",
    "study": "study",
    "settings": "settings",
    "dbc": "dbc",
    "help": "help",
}
"""The module of `meshpoint.testbench.commands` that holds each command, in the order of the
help."""


def build_parser(command: str | None = None) -> argparse.ArgumentParser:
    """The parser with all commands, or with that of one command alone: loading all of them would
    take a node longer than all else that it does before its first step."""
    parser = Parser(prog="meshpoint", description=DESCRIPTION, epilog=EPILOG)
    parser.add_argument("--version", action="version", version=f"meshpoint {product_version()}")
    parser.add_argument("--debug", action="store_true", help="show the traceback of an error")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    wanted = [MODULES[command]] if command in MODULES else dict.fromkeys(MODULES.values())
    for name in wanted:
        importlib.import_module(f"meshpoint.testbench.commands.{name}").add_parser(commands)
    return parser
