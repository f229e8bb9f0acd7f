"""Ending a node by SIGINT or SIGTERM, or by the end of its standard input."""

import asyncio
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


def _signals() -> list[signal.Signals]:
    wanted = [signal.SIGINT, signal.SIGTERM]
    if sys.platform == "win32":
        wanted.append(signal.SIGBREAK)
    return wanted


@contextmanager
def stop_on_signals(stop: asyncio.Event) -> Iterator[None]:
    """While this lasts, the first SIGINT or SIGTERM sets `stop`; a second one acts as usual.

    For the main thread, with a running event loop.
    """
    loop = asyncio.get_running_loop()
    previous = {number: signal.getsignal(number) for number in _signals()}

    def restore() -> None:
        for number, handler in previous.items():
            signal.signal(number, handler)

    def on_signal(_number: int, _frame: FrameType | None) -> None:
        restore()
        loop.call_soon_threadsafe(stop.set)

    for number in previous:
        signal.signal(number, on_signal)
    try:
        yield
    finally:
        restore()


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
