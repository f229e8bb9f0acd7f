"""`meshpoint up --pace-only FILE`: keeps the bus time that nodes on a machine that stalls share."""

from __future__ import annotations

import asyncio
import threading
from pathlib import Path

from meshpoint.base.errors import CommandError
from meshpoint.bus.pace import PaceFile, keep_pace
from meshpoint.bus.signals import stop_on_signals
from meshpoint.results.output import complain


def keep_pace_alone(path: Path, speed: float) -> None:
    """Keeps pace in a file made anew until a signal; then it is removed."""
    try:
        PaceFile.create(path)
    except OSError as error:
        raise CommandError(f"{path}: {error.strerror}") from error
    complain(f"keeps bus time in {path}, until Ctrl-C or SIGTERM")
    ending = threading.Event()

    async def until_signal() -> str:
        stop = asyncio.Event()
        with stop_on_signals(stop):
            keeper = asyncio.create_task(asyncio.to_thread(keep_pace, path, speed, ending))
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
