"""Angles as whole turns and a rest, exact gearing, and the read of an edge ring, compiled."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from meshpoint.kernels.jit import bare
from meshpoint.kernels.structures import RecordArray
from meshpoint.rig_sim.shared.capture_records import (
    CHANNELS,
    PIECES,
    RING,
    STAMPS,
    Captured,
    ClockPieces,
    Reading,
)

Turned = tuple[int, float]

TAU: Final = 2.0 * math.pi


@bare
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


@bare
def geared(angle: Turned, teeth: int, other: int, offset: Turned) -> Turned:
    """An angle times teeth / other, and an offset: exact in the whole turns, however many."""
    whole = angle[0] * teeth
    quotient = whole // other
    remainder = whole - quotient * other
    rest = (remainder * TAU + angle[1] * teeth) / other
    return settled(quotient + offset[0], rest + offset[1])


@bare
def wrapped(angle: float, pitch: float) -> float:
    """An angle brought into [-pitch/2, pitch/2)."""
    rest = angle - pitch * math.floor(angle / pitch + 0.5)
    return rest if rest < 0.5 * pitch else rest - pitch


@bare
def _clock_before(clock: ClockPieces, time_us: float) -> int:
    index = PIECES - 1
    while index > 0 and time_us < clock.pieces[index].since_us:
        index -= 1
    piece = clock.pieces[index]
    return piece.base_us + math.floor((time_us - piece.since_us) * piece.rate)


@bare
def read_ring(
    now_us: float,
    on_us: float,
    clocks: Sequence[ClockPieces],
    edges: Sequence[Captured],
    readings: Sequence[Reading],
) -> None:
    """Fill in what the edge frames of one read hold, all channels at once.

    now_us is when it is read, on_us since when the sensor is on, both us since power-up. Edges that
    are still to come at now_us are left out."""
    clock, captured, reading = clocks[0], edges[0], readings[0]
    piece = clock.pieces[PIECES - 1]
    since, base, rate = piece.since_us, piece.base_us, piece.rate
    now = base + math.floor((now_us - since) * rate)
    for edge in range(CHANNELS):
        ring, head = captured.channels[edge].times_us, reading.heads[edge]
        stamps = reading.stamps[edge].low
        count = captured.channels[edge].count
        slot = count % RING
        while count > 0 and ring[(slot if slot > 0 else RING) - 1] > now_us:
            count -= 1
            slot = (slot if slot > 0 else RING) - 1
        valid = min(count, STAMPS)
        newer = now
        head.long_interval = 0
        head.stopped = 1 if count == 0 and now_us - on_us > 0xFFFF else 0
        for entry in range(valid):
            slot = (slot if slot > 0 else RING) - 1
            time_us = ring[slot]
            stamp = base + math.floor((time_us - since) * rate)
            if time_us < since:
                stamp = _clock_before(clock, time_us)
            stamps[entry] = stamp & 0xFFFF
            if newer - stamp > 0xFFFF:
                if entry == 0:
                    head.stopped = 1
                else:
                    head.long_interval = 1
            newer = stamp
        for entry in range(valid, STAMPS):
            stamps[entry] = 0
        head.newest_index = count & 0xFFFF
        head.valid_stamps = valid


def warm_up() -> None:
    """Compile all of it now, so that no live run stalls at its first shift."""
    angle = settled(0, 0.5)
    geared(angle, 2, 3, angle)
    wrapped(0.5, 1.0)
    edges, reading = RecordArray(Captured()).array, RecordArray(Reading()).array
    read_ring(0.0, 0.0, RecordArray(ClockPieces()).array, edges, reading)
