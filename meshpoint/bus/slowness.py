"""How slowly this machine computes just now, for limits that are set in seconds.

An emulated machine does not know when it was kept from running, and is slow itself: what takes a
second elsewhere takes it a minute, and by its own clock it ran all the time.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final

USUAL_S: Final = 0.001
"""What `_a_little_work` takes of a processor on the machine that the limits were set on."""


def times_slower(clock: Callable[[], float] = time.process_time) -> float:
    """How many times as long as usual this machine computes; at least 1. By processor time: a busy
    machine is not slow."""
    begun_s = clock()
    _a_little_work()
    return max(1.0, (clock() - begun_s) / USUAL_S)


def _a_little_work() -> None:
    for _ in range(20_000):
        pass
