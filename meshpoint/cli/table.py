"""The table of commands, and the parser made of it."""

from __future__ import annotations

import argparse
import importlib
from typing import Any, Final, NamedTuple

from meshpoint.base.version import product_version
from meshpoint.cli.parsing import Parser

DESCRIPTION: Final = """\
A transmission controller that fires a dog-clutch sleeve so that tooth meets gap, and a virtual
gearbox rig to prove it against, as two nodes on a CAN bus."""
EXIT_CODES: Final = """\
exit codes:
  0    done
  1    ran, but failed: a shift that did not end, a replay that differs, a log,
       a record or other output that could not be written (disk full)
  2    bad input: what was found and what is allowed is on standard error
  3    not verifiable (replay), with the reason
  4    not decided (campaign --against): more runs are needed
  130  interrupted"""


class Command(NamedTuple):
    """A command."""

    task: str
    """The heading that it stands below in the help."""
    summary: str
    """What it does, in a line of the help."""
    room: str
    """The package of `meshpoint` that holds it."""
    module: str = ""
    """Its module there; empty: `NAME_command`."""


TRY, LIVE, BENCH = "try it", "nodes on a CAN bus", "a gearbox on the bench"
LOGS, MANY, LOOK = "recorded logs", "many runs", "look up"
COMMANDS: Final = {
    "demo": Command(
        TRY, "both nodes live, both strategies; log checked by bit-exact replay", "run"
    ),
    "simulate": Command(TRY, "shifts in virtual time: one process, no waiting", "run"),
    "play": Command(TRY, "a page on which you fire the sleeve yourself", "run"),
    "fmu": Command(TRY, "the virtual gearbox as an FMU, for other simulators", "bridges"),
    "up": Command(LIVE, "rig and controller in one terminal, until Ctrl-C", "run", "up"),
    "controller": Command(
        LIVE, "the transmission controller as a node on a CAN bus", "run", "nodes"
    ),
    "rig": Command(LIVE, "the virtual gearbox as a node on a CAN bus", "run", "nodes"),
    "request": Command(LIVE, "ask for a gear over the bus", "run", "request"),
    "watch": Command(LIVE, "a bus, or a log, as a picture in the terminal", "logs"),
    "check": Command(BENCH, "is the bus ready for the controller, is a node at work", "commission"),
    "commission": Command(BENCH, "which output moves what, one at a time", "commission"),
    "firmware": Command(BENCH, "the board's images, as files to flash", "bench"),
    "replay": Command(LOGS, "a log through the same controller, or through another", "replays"),
    "tell": Command(LOGS, "a log in plain words, one line an event", "logs", "tell"),
    "identify": Command(LOGS, "a log's gearbox as a data sheet: brake, delays, teeth", "identify"),
    "compare": Command(LOGS, "two logs, two --json records, or two settings files", "replays"),
    "convert": Command(
        LOGS, "a log as time series: MCAP, MF4, Parquet; a bus live to viewers", "bridges"
    ),
    "captures": Command(LOGS, "edges captured from real sensors: the teeth, or a log", "logs"),
    "campaign": Command(MANY, "strategies compared on the same seeded draws", "campaigns"),
    "a2l": Command(LOOK, "what an XCP tool has to know of the controller", "bridges"),
    "show": Command(LOOK, "a data sheet, settings, calibration, or the bus's messages", "cli"),
    "help": Command(LOOK, "a command, which bus is opened, what a shell completes", "cli"),
}
"""Every command, in the order of the help."""
MOVED: Final = {
    "calibration": "`meshpoint show calibration`",
    "completion": "`meshpoint help completion`",
    "dbc": "`meshpoint show messages`",
    "gearbox": "`meshpoint show gearbox`",
    "health": "`meshpoint check --alive NODE`",
    "pace": "`meshpoint up --pace-only FILE`",
    "report": "`meshpoint replay LOG --gap-rate`",
    "settings": "`meshpoint show settings`",
    "study": "`python -m benchmarks.studies` in the repository",
}
"""What was a command of its own, and what does it now."""


def moved_words(name: str) -> str:
    """Where a command has gone."""
    return f"`meshpoint {name}` is now {MOVED[name]}"


def _epilog() -> str:
    """The commands by task, where to start, and the exit codes."""
    lines: list[str] = []
    for name, (task, summary, *_) in COMMANDS.items():
        if f"{task}:" not in lines:
            lines += ["", f"{task}:"] if lines else [f"{task}:"]
        lines.append(f"  {name:10}  {summary}")
    start = """\
start here:
  meshpoint demo                  both nodes, both strategies, a picture
  meshpoint simulate --shifts 20  the same in virtual time
  meshpoint up                    both nodes until Ctrl-C; in another terminal:
  meshpoint request 10            asks for gear 10
  meshpoint help bus              which bus a command opens"""
    return "\n\n".join(("\n".join(lines), start, EXIT_CODES))


def _module(name: str) -> str:
    """The module that holds a command."""
    command = COMMANDS[name]
    return f"meshpoint.{command.room}.{command.module or f'{name}_command'}"


class _Version(argparse.Action):
    """Prints the version, which is looked up only then."""

    def __call__(self, parser: argparse.ArgumentParser, *_given: object) -> None:
        parser.exit(0, f"meshpoint {product_version()}\n")


def _empty_parser() -> tuple[argparse.ArgumentParser, Any]:
    parser = Parser(
        prog="meshpoint",
        usage="%(prog)s [-h] [--version] [--debug] COMMAND ...",
        description=DESCRIPTION,
        epilog=_epilog(),
    )
    parser.add_argument(
        "--version", action=_Version, nargs=0, help="show program's version number and exit"
    )
    parser.add_argument("--debug", action="store_true", help="show the traceback of an error")
    commands = parser.add_subparsers(
        dest="command", metavar="COMMAND", required=True, prog="meshpoint", help=argparse.SUPPRESS
    )
    return parser, commands


def front_parser() -> argparse.ArgumentParser:
    """The parser for a line that names no command: help, version, errors. It knows the commands by
    name alone and loads none of them."""
    parser, commands = _empty_parser()
    for name in COMMANDS:
        commands.add_parser(name)
    return parser


def build_parser(command: str | None = None) -> argparse.ArgumentParser:
    """The parser with all commands, or with that of one command alone: loading all of them would
    take a node longer than all else that it does before its first step."""
    parser, commands = _empty_parser()
    names = COMMANDS if command not in COMMANDS else [command]
    for module in dict.fromkeys(map(_module, names)):
        importlib.import_module(module).add_parser(commands)
    return parser
