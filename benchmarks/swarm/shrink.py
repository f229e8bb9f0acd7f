"""From a world that broke an invariant to the few events that do it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Final

from benchmarks.swarm.events import Event, World
from benchmarks.swarm.invariants import Broken

BUDGET_S: Final = 110.0
MARGIN_MS: Final = 200
AT_THE_END: Final = "not_back"

Fails = Callable[[World], Broken | None]
"""Runs a world; what of the kind looked for it breaks, or None."""


def shrink(world: World, broken: Broken, fails: Fails, budget_s: float = BUDGET_S) -> World:
    """The world with as few events as fit the budget (seconds of wall time) and still break it."""
    until_s = time.monotonic() + budget_s
    small = _cut_off(world, broken)
    if small != world and fails(small) is None:
        small = world
    parts = 2
    events = list(small.events)
    while events and parts <= len(events) and time.monotonic() < until_s:
        size = -(-len(events) // parts)
        for start in range(0, len(events), size):
            fewer = events[:start] + events[start + size :]
            if fails(replace(small, events=tuple(fewer))) is not None:
                events, parts = fewer, max(2, parts - 1)
                break
            if time.monotonic() >= until_s:
                break
        else:
            if parts == len(events):
                break
            parts = min(len(events), 2 * parts)
    if len(events) == 1 and fails(replace(small, events=())) is not None:
        events = []
    return replace(small, events=tuple(events))


def _cut_off(world: World, broken: Broken) -> World:
    """Nothing that happens after it broke had a part in it."""
    if broken.what == AT_THE_END or broken.at_ms > world.safety_ms:
        return world
    kept: tuple[Event, ...] = tuple(e for e in world.events if e.at_ms <= broken.at_ms)
    return replace(world, events=kept, safety_ms=min(world.safety_ms, broken.at_ms + MARGIN_MS))
