"""Worker processes that never outlive the process that has started them.

Imports next to nothing of ours: whoever starts a worker imports this first.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import resource_tracker
from multiprocessing.connection import wait
from multiprocessing.context import SpawnContext, SpawnProcess
from typing import Final

from meshpoint.bus.light_can import load_can

ORPHANED: Final = 1


class _Worker(SpawnProcess):
    """A process that never hears of Ctrl-C, which in a terminal reaches every process of its group:
    the parent says what it means. A mask of signals is inherited, so that it holds before the
    worker's first line; `_follow_the_parent` does the same where there is none (Windows)."""

    def start(self) -> None:
        """Starts it."""
        if sys.platform == "win32":
            super().start()
            return
        resource_tracker.ensure_running()  # lifts the mask where it is the one to start it
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            super().start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


class _Workers(SpawnContext):
    """Spawned, not forked: the same on every system, and no thread is copied half alive."""

    Process = _Worker


@contextmanager
def worker_pool(workers: int) -> Iterator[Executor]:
    """This many processes. SIGTERM acts as Ctrl-C does: what is at work comes to its end, then they
    end. Where the parent is killed they end at once."""
    pool = ProcessPoolExecutor(workers, _Workers(), initializer=_follow_the_parent)
    try:
        with _sigterm_as_interrupt():
            yield pool
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def _sigterm_as_interrupt() -> Iterator[None]:
    """In the main thread alone: no other can have a signal handler."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _follow_the_parent() -> None:
    """Runs in a worker as it starts."""
    load_can()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_the_parent, daemon=True).start()


def _end_with_the_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(ORPHANED)
