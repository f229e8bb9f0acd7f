"""The table of commands, and the parser made of it."""

from __future__ import annotations

import argparse
import importlib
from typing import Any, Final

from meshpoint.testbench.commands.parsing import Parser
from meshpoint.testbench.version import product_version

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
  1    ran, but failed: a shift that did not end, a replay that differs, a log, a
       record or words of a node for which there was no room
  2    bad input: what was found and what is allowed is on standard error
  3    not verifiable (replay), with the reason
  4    not decided (campaign --against): more runs are needed
  130  interrupted"""
MODULES: Final = {
    "demo": "demo",
    "simulate": "simulate",
    "campaign": "campaign",
    "replay": "replay",
    "report": "report",
    "identify": "identify",
    "tell": "tell",
    "compare": "compare",
    "up": "up",
    "controller": "nodes",
    "rig": "nodes",
    "request": "request",
    "watch": "watch",
    "health": "health",
    "check": "check",
    "commission": "commission",
    "play": "play",
    "pace": "pace",
    "gearbox": "gearbox",
    "calibration": "calibration",
    "captures": "captures",
    "convert": "convert",
    "settings": "settings",
    "dbc": "dbc",
    "completion": "completion",
    "help": "help",
}
"""The module of `meshpoint.testbench.commands` that holds each command, in the order of the
help."""
MOVED: Final = {"study": "`python -m benchmarks.studies` in the repository (docs/thesis.md)"}
"""Where that is which once was a command."""

SUMMARIES: Final = {
    "demo": "both nodes live, both strategies: a table, a picture, a report, a verified log",
    "simulate": "shifts in virtual time: one process, encoded frames, no waiting",
    "campaign": "many seeded runs: strategies compared on the same draws, with intervals",
    "replay": "a recorded log through the same controller",
    "report": "would another strategy have met the gap more often in a recorded log",
    "identify": "brake, drag, delays, teeth of the gearbox in a log, as a data sheet",
    "tell": "a log in plain words, one line an event",
    "compare": "two logs, two --json records, or two settings files, also on a log",
    "up": "rig and controller in one terminal, until Ctrl-C",
    "controller": "the transmission controller as a node on a CAN bus",
    "rig": "the virtual gearbox as a node on a CAN bus",
    "request": "ask for a gear over the bus",
    "watch": "what happens on a bus, or in a log, as a picture in the terminal",
    "health": "whether a node is at work: its status frame is heard on the bus",
    "check": "is a bus ready for the controller: interface, messages, stamps, sensors; yes or no",
    "commission": "which output moves what, one at a time, on a box that stands",
    "play": "a page on which you fire the sleeve yourself, then let the controller do it",
    "pace": "bus time that waits for nodes which the machine keeps from running",
    "gearbox": "show a data sheet: ratios, tooth counts, derived figures",
    "calibration": "show what a controller has learned of a gearbox",
    "captures": "edges captured from real sensors, through the node's edge gate",
    "convert": "a capture of a sensor as a log of edge frames",
    "settings": "show every setting of the controller: unit, range, default, meaning",
    "dbc": "the DBC: where it is, its messages, the signals of one",
    "completion": "what a shell needs to complete our command lines",
    "help": "help on a command, or on which bus (`help bus`)",
}
"""What each command does, in a line of the help."""


class _Version(argparse.Action):
    """Prints the version, which is looked up only then."""

    def __call__(self, parser: argparse.ArgumentParser, *_given: object) -> None:
        parser.exit(0, f"meshpoint {product_version()}\n")


class _Commands(argparse._SubParsersAction):  # type: ignore[type-arg]
    """The list of commands: each with its summary."""

    def add_parser(self, name: str, **options: Any) -> Any:
        return super().add_parser(name, **({"help": SUMMARIES.get(name, "")} | options))


def _empty_parser() -> tuple[argparse.ArgumentParser, Any]:
    parser = Parser(prog="meshpoint", description=DESCRIPTION, epilog=EPILOG)
    parser.add_argument(
        "--version", action=_Version, nargs=0, help="show program's version number and exit"
    )
    parser.add_argument("--debug", action="store_true", help="show the traceback of an error")
    commands = parser.add_subparsers(
        action=_Commands, dest="command", metavar="COMMAND", required=True
    )
    return parser, commands


def front_parser() -> argparse.ArgumentParser:
    """The parser for a line that names no command: help, version, errors. It knows the commands by
    name alone and loads none of them."""
    parser, commands = _empty_parser()
    for name in MODULES:
        commands.add_parser(name)
    return parser


def build_parser(command: str | None = None) -> argparse.ArgumentParser:
    """The parser with all commands, or with that of one command alone: loading all of them would
    take a node longer than all else that it does before its first step."""
    parser, commands = _empty_parser()
    wanted = [MODULES[command]] if command in MODULES else dict.fromkeys(MODULES.values())
    for name in wanted:
        importlib.import_module(f"meshpoint.testbench.commands.{name}").add_parser(commands)
    return parser
