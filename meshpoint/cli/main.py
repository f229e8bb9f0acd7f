"""The command line of meshpoint.

Loads what a command needs, and nothing for a line that names none (`--help`, `--version`, a
command that there is not).
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence

from meshpoint.base.exits import Exit
from meshpoint.bus.standard_error import OutputError, lasting_error, named_output
from meshpoint.cli.table import (
    COMMANDS,
    MOVED,
    build_parser,
    front_parser,
    moved_words,
)
from meshpoint.kernels.watch import WATCH, uncollected

ABOUT_ALL = frozenset({"-h", "--help", "--version"})
"""Said before a command, these end the line."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs one command; returns its exit code."""
    return run_parsed(lambda: _parsed(sys.argv[1:] if arguments is None else list(arguments)))


def run_parsed(parse: Callable[[], argparse.Namespace]) -> int:
    """Runs what was asked for on a command line; returns its exit code. Lines that
    cannot be written to standard error end nothing; that they are missing makes of exit code 0 a 1.

    The namespace has `run`, which is called with it, `program` for the errors, and `debug`."""
    with lasting_error() as said:
        try:
            with uncollected():  # what is loaded stays
                namespace = parse()
        except KeyboardInterrupt:
            from meshpoint.results.output import complain

            complain("interrupted")
            return Exit.INTERRUPTED
        from meshpoint.bench.compiling import Progress

        before = WATCH.compiling
        WATCH.compiling = Progress(rewrites=False).count
        try:
            code = _run(namespace)
        finally:
            WATCH.compiling = before
    return Exit.FAILED if code == Exit.DONE and said.found_no_room else code


def _parsed(given: list[str]) -> argparse.Namespace:
    command = next((word for word in given if not word.startswith("-")), None)
    about_all = bool(ABOUT_ALL & set(given[: given.index(command)])) if command else True
    if about_all or command not in COMMANDS:
        front = front_parser()
        if command in MOVED and not about_all:
            front.error(moved_words(command))
        front.parse_args(given)  # ends here, whatever it says
    from meshpoint.bus.light_can import load_can

    load_can()
    parser = build_parser(command)
    namespace, unknown = parser.parse_known_args(given)
    if unknown:
        parser.prog = f"{parser.prog} {namespace.command}"
        parser.error(f"unknown argument {' '.join(unknown)}")
    namespace.program = f"meshpoint {namespace.command}"
    return namespace


def _run(namespace: argparse.Namespace) -> int:
    """The command, and an exit code for whatever ends it."""
    from meshpoint.base.errors import RunError
    from meshpoint.results.output import check_apart, check_writable, complain

    try:
        check_apart(vars(namespace))
        for target in ("json", "report", "junit", "markdown"):
            path = getattr(namespace, target, None)
            made = getattr(namespace, "out", None)
            check_writable(None if path is None else str(path), made)
        with named_output():
            code: int = namespace.run(namespace)
            sys.stdout.flush()
    except _user_errors() as error:
        if namespace.debug:
            raise
        complain(f"{namespace.program}: error: {error}")
        return Exit.BAD_INPUT
    except RunError as error:
        complain(f"{namespace.program}: {error}")
        return Exit.FAILED
    except KeyboardInterrupt:
        complain("interrupted")
        return Exit.INTERRUPTED
    except OutputError as error:
        if error.reader_has_gone:
            return Exit.DONE
        complain(f"{namespace.program}: standard output cannot be written: {error.strerror}")
        return Exit.FAILED
    return code


def _user_errors() -> tuple[type[Exception], ...]:
    """What was wrong with the input: one line for the user, no traceback."""
    from meshpoint.base.errors import CommandError
    from meshpoint.bus.logs.reader import LogError
    from meshpoint.bus.options import BusOpenError
    from meshpoint.bus.pace import PaceError
    from meshpoint.controller.settings.header import HeaderError
    from meshpoint.controller.settings.strategy_file import StrategyError
    from meshpoint.gearbox.tables import TableError
    from meshpoint.rig_sim.settings import SettingsError

    return (
        BusOpenError, CommandError, HeaderError, LogError, PaceError, SettingsError, StrategyError,
        TableError,
    )  # fmt: skip
