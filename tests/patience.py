"""How long a live test waits: never by the wall clock alone, which a busy machine takes away.

A test that must be live waits for a condition. The time that counts against it is the time in which
this process and those it has started could run: what any of them spent ready to run but without a
processor does not count. So patience is seconds on a quiet machine and minutes at load 8, and a
hang, in which nobody wants a processor, is still found in seconds. Nodes on a paced bus are waited
for by bus time instead: give `Patience` another meter.
"""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import Callable, Iterable
from pathlib import Path

PATIENCE_S = 60.0
"""For what takes a second or two on a quiet machine: a process that starts, a frame that comes."""
HANG_S = 900.0
"""For calls that block and take a limit of their own (`recv`, `wait`): none but a hang lasts so
long. Below pytest's own limit, so that the call is named."""
POLL_S = 0.01
_LOOK_EVERY_S = 0.2
"""Reading the stalls of all processes costs some milliseconds."""
_PROC = Path("/proc")

Meter = Callable[[], float]
"""Seconds since any start that count against patience; never goes back."""


def family(root: int, parents: Iterable[tuple[int, int]]) -> set[int]:
    """`root` and all that descend from it; parents: (process, its parent)."""
    children: dict[int, list[int]] = {}
    for process, parent in parents:
        children.setdefault(parent, []).append(process)
    found, unseen = set(), [root]
    while unseen:
        process = unseen.pop()
        found.add(process)
        unseen += children.get(process, [])
    return found


def _parents() -> Iterable[tuple[int, int]]:
    for entry in _PROC.glob("[0-9]*/stat"):
        try:
            # The name, in brackets, may hold anything; state and parent follow it.
            fields = entry.read_text(errors="replace").rpartition(")")[2].split()
            yield int(entry.parent.name), int(fields[1])
        except (OSError, IndexError, ValueError):
            continue  # it has ended meanwhile


def waited_s(process: int) -> dict[tuple[int, int], float]:
    """Seconds that each thread of a process has spent ready to run, but not running, so far."""
    found = {}
    for entry in _PROC.glob(f"{process}/task/[0-9]*/schedstat"):
        try:
            found[process, int(entry.parent.name)] = int(entry.read_text().split()[1]) / 1e9
        except (OSError, IndexError, ValueError):
            continue
    return found


def stalls_s() -> dict[tuple[int, int], float]:
    """The same of every thread of this process and its descendants; empty where no kernel
    reports."""
    stalls: dict[tuple[int, int], float] = {}
    for process in family(os.getpid(), _parents()):
        stalls |= waited_s(process)
    return stalls


class GrantedTime:
    """A meter: wall seconds less those in which one of ours was kept from running."""

    def __init__(self) -> None:
        self._seen_s, self._seen_stalls = time.monotonic(), stalls_s()
        self._granted_s = 0.0

    def __call__(self) -> float:
        now_s = time.monotonic()
        wall_s = now_s - self._seen_s
        if wall_s >= _LOOK_EVERY_S:
            stalls = stalls_s()
            # Several wait at once; one that is new may have waited since its birth.
            longest_s = max(
                (stall - self._seen_stalls.get(thread, 0.0) for thread, stall in stalls.items()),
                default=0.0,
            )
            self._granted_s += wall_s - min(wall_s, max(0.0, longest_s))
            self._seen_s, self._seen_stalls = now_s, stalls
        return self._granted_s


class Patience:
    """What is left of the time that a test gives to something live.

    limit_s: in the meter's seconds. meter: `GrantedTime`, or the time of a bus.
    """

    def __init__(self, limit_s: float = PATIENCE_S, meter: Meter | None = None) -> None:
        self.limit_s = limit_s
        self._meter = meter or GrantedTime()
        self._began_s = self._meter()
        self._wall_began_s = time.monotonic()

    def check(self, what: str, say: Callable[[], object] = lambda: "") -> None:
        """AssertionError once it is used up. what: what is awaited; say: what was seen instead."""
        if self._meter() - self._began_s <= self.limit_s:
            return
        wall_s = time.monotonic() - self._wall_began_s
        raise AssertionError(
            f"{what}: not within {self.limit_s:g} s of patience ({wall_s:.0f} s by the wall clock, "
            f"load {_load()}) {say()}".rstrip()
        )


def _load() -> str:
    return f"{os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else "unknown"


def until(
    condition: Callable[[], object],
    what: str,
    *,
    patience: Patience | None = None,
    say: Callable[[], object] = lambda: "",
    poll_s: float = POLL_S,
) -> None:
    """Waits until a condition holds; one that can never hold any more should raise."""
    patience = patience or Patience()
    while not condition():
        patience.check(what, say)
        time.sleep(poll_s)


async def until_async(
    condition: Callable[[], object],
    what: str,
    *,
    patience: Patience | None = None,
    say: Callable[[], object] = lambda: "",
    poll_s: float = POLL_S,
) -> None:
    """The same in an event loop, which goes on meanwhile."""
    patience = patience or Patience()
    while not condition():
        patience.check(what, say)
        await asyncio.sleep(poll_s)
