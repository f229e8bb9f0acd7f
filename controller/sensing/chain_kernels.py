"""The inner loop of reading edge frames: stamps of one frame to numbered times.

Compiled by numba; with NUMBA_DISABLE_JIT=1 the same code runs as plain Python.
"""

from __future__ import annotations

import struct
from typing import Final

import numpy as np
from numpy.typing import NDArray

from meshpoint.controller.jit import bare, compiled

Integers = NDArray[np.int64]
Floats = NDArray[np.float64]

INDEX: Final = 0
"""Indices into a chain: running number of the newest edge, unwrapped; its sensor time in us,
meaningless before the chain has started; whether it has started; the last of the edges after
power-up that may lie wrong."""
TIME: Final = 1
STARTED: Final = 2
UNTIL: Final = 3
CHAIN: Final = 4
BROKEN: Final = -1
STAMPS: Final = 27
pack_stamps: Final = struct.Struct(f"={STAMPS}q").pack_into
"""A tuple of them gets into an array fastest through the bytes that the array stands on."""
FIRST_WRONG: Final = 9
"""Edges after power-up that a Hall sensor may misplace while it finds its thresholds (ATS645)."""
SPAN_US: Final = 15_000
"""At least so long are the teeth of one speed, where the frame holds them."""
UNEVEN: Final = 1.7
"""Neighbouring intervals that differ by more than this factor hold a tooth too many or too few."""


@bare
def newest_teeth(low: Integers, valid: int) -> tuple[int, int]:
    """How long the newest teeth of one frame took, us, and how many they are.

    low: low 16 bits of the newest `valid` edge times, newest first. No teeth where fewer than two
    edges tell, or where neighbours are uneven."""
    span_us = teeth = last_us = 0
    for k in range(1, valid):
        interval_us = (low[k - 1] - low[k]) & 0xFFFF
        if teeth > 0 and not last_us < UNEVEN * interval_us < UNEVEN * UNEVEN * last_us:
            return 0, 0
        last_us = interval_us
        span_us += interval_us
        teeth += 1
        if span_us >= SPAN_US:
            break
    return (span_us, teeth) if span_us > 0 else (0, 0)


@compiled
def chain_edges(
    low: Integers,
    newest_index: int,
    valid: int,
    long_interval: bool,
    stopped: bool,
    read_us: int,
    chain: Integers,
    numbers: Integers,
    times_us: Integers,
    count: int,
) -> int:
    """Appends the edges since the last frame, oldest first, behind the first `count`.

    low: low 16 bits of the newest `valid` edge times, newest first; read_us: when the frame was
    read, unwrapped; chain (CHAIN,) is moved on. The first edges after power-up are left out: a
    frame that is not full shows that the sensor has just begun to count. Returns the new count, or
    BROKEN when numbers before and after cannot be tied together: the wheel stood still, or more
    edges came than a frame holds.
    """
    if valid == 0:
        return count
    fresh = (newest_index - chain[INDEX]) & 0xFFFF
    if chain[STARTED] == 0:
        # With a long interval in the array only the newest edge can be placed.
        fresh = 1 if long_interval else valid
        chain[INDEX] = newest_index - fresh
        chain[UNTIL] = newest_index - valid + (FIRST_WRONG if valid < STAMPS else 0)
    if fresh == 0:
        return count
    tied = not stopped and fresh <= valid
    if tied:
        time_us = read_us - ((read_us - low[0]) & 0xFFFF)
        number = chain[INDEX] + fresh
        newest_us = time_us
        kept = min(fresh, max(number - chain[UNTIL], 0))
        for k in range(fresh):
            if k > 0:
                time_us -= (low[k - 1] - low[k]) & 0xFFFF
            if k < kept:
                numbers[count + kept - 1 - k] = number - k
                times_us[count + kept - 1 - k] = time_us
        if chain[STARTED] == 1:
            # The edge before the oldest new one is known already: the chain must lead to it.
            if fresh < valid:
                tied = time_us - ((low[fresh - 1] - low[fresh]) & 0xFFFF) == chain[TIME]
            else:
                tied = not long_interval
    if not tied:
        had_begun = chain[STARTED] == 1
        chain[INDEX], chain[TIME], chain[STARTED] = 0, read_us, 0
        # A wheel that has not begun to count has nothing to lose.
        return BROKEN if had_begun else count
    chain[INDEX], chain[TIME], chain[STARTED] = number, newest_us, 1
    return int(count + kept)


def warm_up() -> None:
    """Compiles it, or loads what was compiled before."""
    low, chain, room = np.zeros(1, np.int64), np.zeros(CHAIN, np.int64), np.zeros(1, np.int64)
    chain_edges(low, 1, 1, False, False, 1, chain, room, room, 0)
    newest_teeth(low, 1)
