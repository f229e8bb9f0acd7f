"""Ending a node by SIGINT or SIGTERM, or by the end of its standard input."""

import asyncio
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any


def _signals() -> list[signal.Signals]:
    wanted = [signal.SIGINT, signal.SIGTERM]
    if sys.platform == "win32":
        wanted.append(signal.SIGBREAK)
    return wanted


@contextmanager
def stop_on_signals(stop: asyncio.Event) -> Iterator[None]:
    """While this lasts, the first of each of SIGINT and SIGTERM sets `stop`; a second one of its
    kind acts as usual.

    For the main thread, with a running event loop.
    """
    loop = asyncio.get_running_loop()
    previous = {number: signal.getsignal(number) for number in _signals()}

    def on_signal(number: int, _frame: FrameType | None) -> None:
        # Its own alone: after Ctrl-C in a terminal the process that started this one may ask too.
        signal.signal(number, previous[signal.Signals(number)])
        loop.call_soon_threadsafe(stop.set)

    for number in previous:
        signal.signal(number, on_signal)
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def apart() -> dict[str, Any]:
    """Arguments of a child process which Ctrl-C in the terminal does not reach: it says to this
    process what it means. The child is to end with its standard input, which ends when this process
    does, however that comes."""
    if sys.platform == "win32":
        return {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
    return {"start_new_session": True}


def stop_at_end_of_input(stop: asyncio.Event) -> None:
    """Sets `stop` when standard input ends, as it does when the process at its other end is gone,
    however it went. Nobody else may read standard input."""
    loop = asyncio.get_running_loop()

    def wait() -> None:
        # Not by sys.stdin: a thread that waits in it would hold its lock when Python ends.
        while os.read(0, 4096):
            pass
        loop.call_soon_threadsafe(stop.set)

    threading.Thread(target=wait, daemon=True).start()
