"""Worker processes that never outlive the process that has started them.

Imports next to nothing of ours: whoever starts a worker imports this first.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing.connection import wait
from typing import Final

from meshpoint.bus.light_can import load_can

ORPHANED: Final = 1


@contextmanager
def worker_pool(workers: int) -> Iterator[Executor]:
    """This many processes. SIGTERM acts as Ctrl-C does: what is at work comes to its end, then they
    end. Where the parent is killed they end at once."""
    # spawned, not forked: the same on every system, and threads are not copied half alive
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, context, initializer=_follow_the_parent)
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
    """Runs in a worker as it starts. Ctrl-C in a terminal reaches every process of its group: the
    parent says what it means."""
    load_can()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_the_parent, daemon=True).start()


def _end_with_the_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(ORPHANED)
