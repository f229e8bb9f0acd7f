"""`meshpoint help`: help on a command, the page on buses, and what a shell completes."""

from __future__ import annotations

import argparse
import sys
from typing import Any

from meshpoint.base.errors import CommandError
from meshpoint.base.exits import Exit
from meshpoint.bus.options import add_bus_arguments
from meshpoint.cli.completion import SHELLS, script
from meshpoint.cli.parsing import Parser, examples

BUS, COMPLETION = "bus", "completion"
BUS_TEXT = """\
Which bus a command opens, in this order:

  1. these arguments, which are python-can's own
  2. --config: a section of a python-can configuration file
  3. the environment: CAN_INTERFACE, CAN_CHANNEL, CAN_BITRATE, CAN_CONFIG
  4. can.conf and the other usual files of python-can
  5. without any of these the local bus of this user, which needs no CAN
     hardware and no kernel module; the first command on it starts it

CAN FD is on where an interface has it by itself (socketcan, udp_multicast,
kvaser, vector); give --fd elsewhere. Only the local bus is armed by itself: on
any other a controller commands nothing without --arm (docs/guard.md)."""
BUS_EXAMPLES = (
    "meshpoint rig                                  the local bus",
    "meshpoint rig -i socketcan -c vcan0            SocketCAN, mtu 72",
    "meshpoint rig -i udp_multicast                 between processes, by UDP",
    "meshpoint rig -c tcp:127.0.0.1:29600           a local bus by TCP",
    "meshpoint rig --config can.conf/bench          a section of a file",
)


def add_parser(commands: Any) -> None:
    """The command's arguments."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "help",
        description="Help on a command; on which bus a command opens (bus); or the script with "
        "which a shell completes commands, options and their values (completion). Where that "
        "goes: bash, ~/.local/share/bash-completion/completions/meshpoint; zsh, a file that "
        "~/.zshrc sources; fish, ~/.config/fish/completions/meshpoint.fish.",
    )
    parser.add_argument(
        "topic",
        nargs="?",
        metavar="COMMAND|bus|completion",
        help="what about; default: all commands",
    )
    parser.add_argument(
        "shell",
        nargs="?",
        metavar="SHELL",
        choices=SHELLS,
        help=f"with completion: {', '.join(SHELLS)}",
    )
    parser.set_defaults(run=run)


def bus_parser() -> argparse.ArgumentParser:
    """The page on buses, as a parser: a command's bus arguments with their explanation."""
    parser = Parser(
        prog="meshpoint COMMAND", description=BUS_TEXT, epilog=examples(*BUS_EXAMPLES),
        add_help=False,
    )  # fmt: skip
    add_bus_arguments(parser, explained=True)
    return parser


def run(namespace: argparse.Namespace) -> int:
    """Prints it."""
    from meshpoint.cli.table import COMMANDS, MOVED, build_parser, moved_words

    if (namespace.topic == COMPLETION) != (namespace.shell is not None):
        raise CommandError(f"allowed is `help completion SHELL`, SHELL one of {', '.join(SHELLS)}")
    if namespace.topic is None:
        build_parser().print_help()
    elif namespace.topic == BUS:
        bus_parser().print_help()
    elif namespace.topic == COMPLETION:
        summaries = {name: command.summary for name, command in COMMANDS.items()}
        sys.stdout.write(script(namespace.shell, build_parser(), summaries))
    elif namespace.topic in COMMANDS:
        try:
            build_parser(namespace.topic).parse_args([namespace.topic, "-h"])
        except SystemExit:
            return Exit.DONE
    elif namespace.topic in MOVED:
        raise CommandError(moved_words(namespace.topic))
    else:
        known = ", ".join((BUS, COMPLETION, *COMMANDS))
        raise CommandError(f"{namespace.topic!r}, allowed are {known}")
    return Exit.DONE
