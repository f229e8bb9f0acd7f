"""The edges of the truck's sensor wheels in one step, into the capture rings.

Within a step an angle is the cubic through its end angles and speeds; an edge lies where the cubic
meets it. A Hall sensor knows no direction: a wheel that turns backwards gives edges as well, and
they count up. The magnet then meets each tooth from its other side, so where the signal falls on
the way forward it rises on the way back: an edge of the one channel comes on the other.
"""

from __future__ import annotations

import math
from typing import Final

from meshpoint.rig_sim.jit import inlined, part
from meshpoint.rig_sim.shared.angle_kernels import TAU, Floats, Integers
from meshpoint.rig_sim.truck.layout import (
    ANGLE,
    COUNT,
    EXTRA,
    EXTRA_EDGE_US,
    FIRST_EDGES,
    INPUT,
    JITTERS,
    LAP,
    LASH,
    MISSING,
    RING,
    SILENT,
    SPEED,
    TOOTH,
    WHEELS,
)

SECOND_US: Final = 1e6
MAX_ITERATIONS: Final = 60
SETTLED: Final = 1e-9


@inlined
def _share_at(start: float, end: float, v0: float, v1: float, h: float, at: float) -> float:
    """When the cubic from `start` to `end` with end slopes v0, v1 reaches `at`: 0..1 of the way.

    Newton's method, kept inside a shrinking bracket."""
    way = end - start
    a = (v0 + v1) * h / way - 2.0
    b = 3.0 - (2.0 * v0 + v1) * h / way
    c = v0 * h / way
    wanted = (at - start) / way
    x, low, high = wanted, 0.0, 1.0
    for _ in range(MAX_ITERATIONS):
        error = x * (c + x * (b + x * a)) - wanted
        if error > 0.0:
            high = x
        else:
            low = x
        slope = c + x * (2.0 * b + 3.0 * x * a)
        change = error / slope if slope > 0.0 else 2.0
        if not low <= x - change <= high:
            change = x - 0.5 * (low + high)
        x -= change
        if abs(change) < SETTLED:
            break
    return min(max(x, 0.0), 1.0)


@inlined
def _turning_share(start: float, end: float, v0: float, v1: float, h: float) -> float:
    """Where the cubic's slope is zero, if its end slopes have opposite signs: 0..1 of the step."""
    way = end - start
    a = 3.0 * ((v0 + v1) * h - 2.0 * way)
    b = 3.0 * way - (2.0 * v0 + v1) * h
    c = v0 * h
    q = -(b + math.copysign(math.sqrt(max(b * b - a * c, 0.0)), b))
    share = c / q if q != 0.0 else 0.5
    if not 0.0 <= share <= 1.0:
        share = q / a
    return min(max(share, 0.0), 1.0)


@inlined
def _write(
    channel: int, tooth: int, time_us: float, pointers: Integers, faults: Integers, ring: Floats
) -> None:
    """An edge, unless the channel is silent there; and what a fault adds to it."""
    if faults[channel, SILENT] != 0 or faults[channel, MISSING] == tooth + 1:
        return
    for extra in range(1 + faults[channel, EXTRA]):
        ring[channel, pointers[channel, COUNT] % RING] = time_us + EXTRA_EDGE_US * extra
        pointers[channel, COUNT] += 1


@inlined
def _error_rad(channel: int, v0: float, count: int, first: Floats, jitter_s: Floats) -> float:
    """How far off the wheel's own edge the next edge of a channel is."""
    error: float = v0 * jitter_s[(count * 733 + channel * 509) % JITTERS]
    if count < FIRST_EDGES:
        error += first[channel, count]
    return error


@part
def _sweep(
    wheel: int,
    start: float,
    end: float,
    v0: float,
    v1: float,
    t_us: float,
    h: float,
    lap: int,
    teeth: Integers,
    table: Floats,
    first: Floats,
    jitter_s: Floats,
    pointers: Integers,
    faults: Integers,
    ring: Floats,
) -> None:
    """The edges of a wheel that turns one way from `start` to `end`, in the lap `lap`."""
    if end == start:
        return
    forward = end > start
    for row in range(2):
        edge = 2 * wheel + row
        channel = edge if forward else edge ^ 1
        while True:
            # a pointer stands at the next edge on the way forward
            tooth, turn = pointers[edge, TOOTH], pointers[edge, LAP]
            if not forward:
                tooth -= 1
                if tooth < 0:
                    tooth, turn = teeth[wheel] - 1, turn - 1
            at = table[edge, tooth] + TAU * (turn - lap)
            at += _error_rad(channel, v0, pointers[channel, COUNT], first, jitter_s)
            if (at > end) if forward else (at < end):
                break
            at = max(at, start) if forward else min(at, start)
            time_us = t_us + h * SECOND_US * _share_at(start, end, v0, v1, h, at)
            _write(channel, tooth, time_us, pointers, faults, ring)
            if forward:
                tooth += 1
                if tooth == teeth[wheel]:
                    tooth, turn = 0, turn + 1
            pointers[edge, TOOTH], pointers[edge, LAP] = tooth, turn


@inlined
def capture(
    y: Floats,
    after: Floats,
    laps: Integers,
    t_us: float,
    h: float,
    teeth: Integers,
    table: Floats,
    first: Floats,
    jitter_s: Floats,
    pointers: Integers,
    faults: Integers,
    ring: Floats,
) -> None:
    """All edges of a step from y to `after`, h seconds long, that begins at t_us.

    table    (channels, teeth) angle of each edge of the as-built wheel, rad
    first    (channels, FIRST_EDGES) error of the first edges after power-up, rad
    jitter_s (JITTERS,) times turned into angle at the present speed
    ring     (channels, RING) times of the newest edges, us since power-up
    """
    for wheel in range(WHEELS):
        body = INPUT + wheel
        start, end = y[ANGLE + body], after[ANGLE + body]
        v0, v1 = y[SPEED + body], after[SPEED + body]
        if body == INPUT:
            start += y[LASH]
            end += after[LASH]
            drift = (after[LASH] - y[LASH]) / h
            v0 += drift
            v1 += drift
        lap = laps[body]
        if v0 * v1 >= 0.0:
            _sweep(
                wheel, start, end, v0, v1, t_us, h, lap,
                teeth, table, first, jitter_s, pointers, faults, ring,
            )  # fmt: skip
            continue
        x = _turning_share(start, end, v0, v1, h)
        way = end - start
        a, b = (v0 + v1) * h - 2.0 * way, 3.0 * way - (2.0 * v0 + v1) * h
        turn = start + x * (v0 * h + x * (b + x * a))
        _sweep(
            wheel, start, turn, v0, 0.0, t_us, x * h, lap,
            teeth, table, first, jitter_s, pointers, faults, ring,
        )  # fmt: skip
        _sweep(
            wheel, turn, end, 0.0, v1, t_us + x * h * SECOND_US, (1.0 - x) * h, lap,
            teeth, table, first, jitter_s, pointers, faults, ring,
        )  # fmt: skip
