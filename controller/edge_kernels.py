"""The inner loops of tooth counting: stamps of one frame to numbered times, two polarities to one.

Compiled by numba; with NUMBA_DISABLE_JIT=1 the same code runs as plain Python.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from controller.jit import compiled

Integers = NDArray[np.int64]
Floats = NDArray[np.float64]

INDEX: Final = 0
"""Indices into a chain: running number of the newest edge, unwrapped; its sensor time in us,
meaningless before the chain has started; whether it has started."""
TIME: Final = 1
STARTED: Final = 2
BROKEN: Final = -1


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
    read, unwrapped; chain (3,) is moved on. Returns the new count, or BROKEN when numbers before
    and after cannot be tied together: the wheel stood still, or more edges came than a frame holds.
    """
    if valid == 0:
        return count
    fresh = (newest_index - chain[INDEX]) & 0xFFFF
    if chain[STARTED] == 0:
        # With a long interval in the array only the newest edge can be placed.
        fresh = 1 if long_interval else valid
        chain[INDEX] = newest_index - fresh
    if fresh == 0:
        return count
    tied = not stopped and fresh <= valid
    if tied:
        time_us = read_us - ((read_us - low[0]) & 0xFFFF)
        number = chain[INDEX] + fresh
        newest_us = time_us
        for k in range(fresh):
            if k > 0:
                time_us -= (low[k - 1] - low[k]) & 0xFFFF
            numbers[count + fresh - 1 - k] = number - k
            times_us[count + fresh - 1 - k] = time_us
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
    return int(count + fresh)


@compiled
def merge_edges(
    rise_number: Integers,
    rise_us: Integers,
    rises: int,
    fall_number: Integers,
    fall_us: Integers,
    falls: int,
    fall_shift: int,
    duty_share: float,
    pitch_rad: float,
    after_us: int,
    edge_us: Floats,
    edge_rad: Floats,
    tooth: Integers,
    falling: Integers,
) -> int:
    """Both polarities in order of time, with teeth and the angles they stand for; how many.

    Rising edge k is that of tooth k and stands for k pitches; falling edge k is that of tooth
    k + `fall_shift` and stands for `duty_share` of a pitch more. Edges not later than
    `after_us` are left out: a polarity that was late must not turn time back in the filters."""
    i = j = n = 0
    while i < rises or j < falls:
        if j == falls or (i < rises and rise_us[i] <= fall_us[j]):
            time_us, number, falls_here = rise_us[i], rise_number[i], 0
            i += 1
        else:
            time_us, number, falls_here = fall_us[j], fall_number[j] + fall_shift, 1
            j += 1
        if time_us > after_us:
            edge_us[n], tooth[n], falling[n] = time_us, number, falls_here
            edge_rad[n] = (number + falls_here * duty_share) * pitch_rad
            n += 1
    return n


def warm_up() -> None:
    """Compiles both, or loads what was compiled before."""
    low, chain, room = np.zeros(1, np.int64), np.zeros(3, np.int64), np.zeros(1, np.int64)
    chain_edges(low, 1, 1, False, False, 1, chain, room, room, 0)
    edge = np.zeros(1)
    merge_edges(room, room, 0, room, room, 0, 0, 0.5, 1.0, 0, edge, edge, room, room)
