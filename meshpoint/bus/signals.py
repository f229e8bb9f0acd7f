"""Ending a node by SIGINT or SIGTERM."""

import asyncio
import signal
import sys
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
