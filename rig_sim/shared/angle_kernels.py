"""Angles as whole turns and a rest, exact gearing, and the read of an edge ring, compiled."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final, TypeVar

import numpy as np
import numpy.typing as npt

from meshpoint.rig_sim import jit

Floats = npt.NDArray[np.float64]

Integers = npt.NDArray[np.int64]

Stamps = npt.NDArray[np.uint16]

Turned = tuple[int, float]

Kernel = TypeVar("Kernel", bound=Callable[..., Any])

TAU: Final = 2.0 * math.pi

WITHOUT_RUNTIME: Final[dict[str, Any]] = {"_nrt": False}


def compiled(function: Kernel) -> Kernel:
    """An entry point without numba's runtime, dividing as Python does."""
    return jit.entry(function, WITHOUT_RUNTIME)


@compiled
def settled(turns: int, rest: float) -> tuple[int, float]:
    """The same angle with its rest brought into [0, 2 pi)."""
    extra = math.floor(rest / TAU)
    rest -= extra * TAU
    if rest < 0.0:
        rest += TAU
        # A rest of next to nothing below zero rounds up to a whole turn.
        return (turns + extra - 1, rest) if rest < TAU else (turns + extra, 0.0)
    if rest >= TAU:
        return turns + extra + 1, rest - TAU
    return turns + extra, rest


@compiled
def geared(angle: Turned, teeth: int, other: int, offset: Turned) -> Turned:
    """An angle times teeth / other, and an offset: exact in the whole turns, however many."""
    whole = angle[0] * teeth
    quotient = whole // other
    remainder = whole - quotient * other
    rest = (remainder * TAU + angle[1] * teeth) / other
    return settled(quotient + offset[0], rest + offset[1])


@compiled
def wrapped(angle: float, pitch: float) -> float:
    """An angle brought into [-pitch/2, pitch/2)."""
    rest = angle - pitch * math.floor(angle / pitch + 0.5)
    return rest if rest < 0.5 * pitch else rest - pitch


@compiled
def _clock_before(clock: Floats, time_us: float) -> int:
    piece = clock.shape[0] - 1
    while piece > 0 and time_us < clock[piece, 0]:
        piece -= 1
    since, base, rate = clock[piece, 0], int(clock[piece, 1]), clock[piece, 2]
    shown: int = base + math.floor((time_us - since) * rate)
    return shown


@compiled
def read_ring(
    now_us: float,
    on_us: float,
    clock: Floats,
    counts: Integers,
    ring: Floats,
    stamps: Stamps,
    heads: Integers,
) -> None:
    """What the edge frames of one read hold, all channels at once.

    now_us  when it is read, and since when the sensor is on (on_us), us since power-up
    clock   (pieces, 3) the sensor clock, as `sensor_clock.SensorClock.pieces`
    counts  (channels,) edges captured so far; those still to come at now_us are left out
    ring    (channels, size) when they were captured, us since power-up
    stamps  (channels, 27) low 16 bits of the sensor clock, newest first, zero where there is none
    heads   (channels, 4) newest index, valid stamps, long interval, stopped
    """
    size = ring.shape[1]
    length = stamps.shape[1]
    newest = clock.shape[0] - 1
    since, base, rate = clock[newest, 0], int(clock[newest, 1]), clock[newest, 2]
    now = base + math.floor((now_us - since) * rate)
    for channel in range(ring.shape[0]):
        count = counts[channel]
        slot = count % size
        while count > 0 and ring[channel, (slot if slot > 0 else size) - 1] > now_us:
            count -= 1
            slot = (slot if slot > 0 else size) - 1
        valid = min(count, length)
        newer = now
        heads[channel, 2] = 0
        heads[channel, 3] = 1 if count == 0 and now_us - on_us > 0xFFFF else 0
        for entry in range(valid):
            slot = (slot if slot > 0 else size) - 1
            time_us = ring[channel, slot]
            stamp = base + math.floor((time_us - since) * rate)
            if time_us < since:
                stamp = _clock_before(clock, time_us)
            stamps[channel, entry] = stamp & 0xFFFF
            if newer - stamp > 0xFFFF:
                heads[channel, 3 if entry == 0 else 2] = 1
            newer = stamp
        for entry in range(valid, length):
            stamps[channel, entry] = 0
        heads[channel, 0] = count & 0xFFFF
        heads[channel, 1] = valid
