"""Runs a coroutine on an asyncio loop whose timers are finer than a millisecond.

The loop that asyncio takes on Linux waits with epoll, for whole milliseconds rounded up: cyclic
frames came up to 2.5 ms late on an idle machine. select waits for the time it is given. It can
watch no descriptor above 1,023; a node has a handful.
"""

from __future__ import annotations

import asyncio
import selectors
import sys
from collections.abc import Coroutine
from typing import Any, TypeVar

T = TypeVar("T")


def run(main: Coroutine[Any, Any, T]) -> T:
    """As `asyncio.run`."""
    with asyncio.Runner(loop_factory=_loop) as runner:
        return runner.run(main)


def _loop() -> asyncio.AbstractEventLoop:
    if sys.platform == "win32":  # its own loop is the one that has subprocesses
        return asyncio.new_event_loop()
    return asyncio.SelectorEventLoop(selectors.SelectSelector())
