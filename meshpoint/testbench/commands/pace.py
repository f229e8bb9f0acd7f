"""`meshpoint pace`: keeps the bus time that nodes on a machine that stalls can share."""

from __future__ import annotations

import argparse
import asyncio
import threading
from pathlib import Path
from typing import Any

from meshpoint.bus.pace import PaceFile, keep_pace
from meshpoint.bus.signals import stop_on_signals
from meshpoint.testbench.commands import arguments
from meshpoint.testbench.errors import CommandError
from meshpoint.testbench.exits import Exit
from meshpoint.testbench.results.output import complain


def add_parser(commands: Any) -> None:
    """The command's arguments."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "pace",
        description="Writes a bus time to FILE until SIGINT or SIGTERM; give every node "
        "`--pace FILE` and the same --speed. Bus time goes with the wall clock, but waits wherever "
        "a node has not done its step yet. `demo` and `up` do this by themselves.",
    )
    parser.add_argument("file", type=Path, metavar="FILE", help="made anew; removed at the end")
    arguments.add_speed(parser)
    parser.set_defaults(run=run)


def run(namespace: argparse.Namespace) -> int:
    """Keeps pace until a signal."""
    path: Path = namespace.file
    try:
        PaceFile.create(path)
    except OSError as error:
        raise CommandError(f"{path}: {error.strerror}") from error
    complain(f"keeps bus time in {path}, until Ctrl-C or SIGTERM")
    ending = threading.Event()

    async def until_signal() -> str:
        stop = asyncio.Event()
        with stop_on_signals(stop):
            keeper = asyncio.create_task(
                asyncio.to_thread(keep_pace, path, namespace.speed, ending)
            )
            waiting = asyncio.create_task(stop.wait())
            await asyncio.wait((keeper, waiting), return_when=asyncio.FIRST_COMPLETED)
            waiting.cancel()
            ending.set()
            return await keeper

    try:
        fault = asyncio.run(until_signal())
    finally:
        ending.set()
        path.unlink(missing_ok=True)
    if fault:
        raise CommandError(fault)
    return Exit.DONE
