"""The inner loop of reading edge frames: stamps of one frame to numbered times.

Compiled by numba; with NUMBA_DISABLE_JIT=1 the same code runs as plain Python.
"""

from __future__ import annotations

import struct
from typing import Annotated, Final

import numpy as np

from meshpoint.kernels.jit import bare, compiled, record_on
from meshpoint.kernels.records import WORD_BYTES, Integers, Vector, layout_of

STAMPS: Final = 27
BROKEN: Final = -1


class EdgeChain:
    """The edges of one polarity over all frames: fields of the newest frame, then those kept from
    the frames before."""

    newest_index: int
    """Running number of the frame's newest edge, 16 bits."""
    valid: int
    """How many of its times are those of edges."""
    long_interval: int
    """1: an interval is too long to be chained."""
    stopped: int
    """1: the newest edge is too old to be placed."""
    read_us: int
    """When the frame was read, unwrapped."""
    low_us: Annotated[Integers, STAMPS]
    """Low 16 bits of the edges' times, newest first."""
    index: int
    """Running number of the newest edge, unwrapped."""
    time_us: int
    """Its sensor time; without a meaning before the chain has started."""
    started: int
    wrong_until: int
    """The last of the edges after power-up that may lie wrong."""


CHAIN: Final = layout_of(EdgeChain)
CHAIN_WORDS: Final = CHAIN.itemsize // WORD_BYTES
pack_frame: Final = struct.Struct(f"={5 + STAMPS}q").pack_into
"""The fields of a frame into an `EdgeChain`, from its first byte on."""
pack_stamps: Final = struct.Struct(f"={STAMPS}q").pack_into
"""Writes a tuple of stamps into an array's memory, which is faster than element by element."""
FIRST_WRONG: Final = 9
"""Edges after power-up that a Hall sensor may misplace while it finds its thresholds (ATS645)."""
SPAN_US: Final = 15_000
"""A speed is taken over at least this time, as far as the frame holds enough teeth."""
UNEVEN: Final = 1.7
"""Neighbouring intervals that differ by more than this factor hold a tooth too many or too few."""


@bare
def newest_teeth(low: Integers, valid: int) -> tuple[int, int]:
    """How long the newest teeth of one frame took, us, and how many they are.

    low: low 16 bits of the newest `valid` edge times, newest first. Returns no teeth with fewer
    than two edges, or if neighbouring intervals are uneven, the one before the last taken among
    them: a sensor that was silent for longer than the span looks like one slow tooth."""
    span_us = teeth = last_us = 0
    for k in range(1, valid):
        interval_us = (low[k - 1] - low[k]) & 0xFFFF
        if teeth > 0 and not last_us < UNEVEN * interval_us < UNEVEN * UNEVEN * last_us:
            return 0, 0
        if span_us >= SPAN_US:
            break
        last_us = interval_us
        span_us += interval_us
        teeth += 1
    return (span_us, teeth) if span_us > 0 else (0, 0)


@compiled
def chain_edges(memory: Vector, edges: Integers, count: int) -> int:
    """Appends the edges since the last frame, oldest first, behind the first `count`.

    memory: an `EdgeChain` with the new frame, moved on; edges (2, n): running numbers and
    times (us). The first edges after power-up are left out: a frame that is not full shows that
    the sensor has just begun to count. Returns the new count, or BROKEN when the numbers before
    and after cannot be joined: the wheel stood still, or more edges came than a frame holds.
    """
    chain = record_on(memory, CHAIN)
    low, valid, newest_index, read_us = chain.low_us, chain.valid, chain.newest_index, chain.read_us
    if valid == 0:
        return count
    fresh = (newest_index - chain.index) & 0xFFFF
    if chain.started == 0:
        # With a long interval in the array only the newest edge can be placed.
        fresh = 1 if chain.long_interval == 1 else valid
        chain.index = newest_index - fresh
        chain.wrong_until = newest_index - valid + (FIRST_WRONG if valid < STAMPS else 0)
    if fresh == 0:
        return count
    tied = chain.stopped == 0 and fresh <= valid
    if tied:
        time_us = read_us - ((read_us - low[0]) & 0xFFFF)
        number = chain.index + fresh
        newest_us = time_us
        kept = min(fresh, max(number - chain.wrong_until, 0))
        for k in range(fresh):
            if k > 0:
                time_us -= (low[k - 1] - low[k]) & 0xFFFF
            if k < kept:
                edges[0, count + kept - 1 - k] = number - k
                edges[1, count + kept - 1 - k] = time_us
        if chain.started == 1:
            # The edge before the oldest new one is known already: the chain must lead to it.
            if fresh < valid:
                tied = time_us - ((low[fresh - 1] - low[fresh]) & 0xFFFF) == chain.time_us
            else:
                tied = chain.long_interval == 0
    if not tied:
        had_begun = chain.started == 1
        chain.index, chain.time_us, chain.started = 0, read_us, 0
        # Before the chain has started there are no tooth numbers to lose.
        return BROKEN if had_begun else count
    chain.index, chain.time_us, chain.started = number, newest_us, 1
    return int(count + kept)


def warm_up() -> None:
    """Compiles it, or loads what was compiled before."""
    chain, room = np.zeros(CHAIN_WORDS), np.zeros((2, STAMPS), np.int64)
    chain_edges(chain, room, 0)
    newest_teeth(np.zeros(STAMPS, np.int64), 1)
