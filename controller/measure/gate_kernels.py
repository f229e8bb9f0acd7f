"""Assigns a tooth to each edge: leaves out extra edges, skips missing ones, reports doubt.

The running number of an edge frame counts what the sensor saw, so one edge too many or too few
shifts it against the wheel. The gate keeps a tooth number of its own. It follows the wheel with an
alpha-beta filter of the angle, in pitches, over the edges of both polarities, and gives each edge
the tooth whose predicted place it is nearest to:

    x = lag + rate (t - t_last),   e = x - (slot - last slot)

An edge much before its slot is extra; of two for one slot the nearer counts. An edge far behind it
means that others are missing: the tooth number moves on by as many, if the motion since the last
good edge leaves no doubt even under the largest acceleration. A doubt ends the count: on a whole
wheel the tooth number is lost; on a wheel with missing teeth, edges are withheld until its gap has
shown whether the count was right. The tooth number is also lost when a wheel is so slow that it may
have reversed between two edges.

Compiled by numba; with NUMBA_DISABLE_JIT=1 the same code runs as plain Python.
"""

from __future__ import annotations

import numpy as np

from meshpoint.controller.measure.gate import (
    COUNTING,
    DOUBT,
    ERRATIC,
    GAP,
    GAPS_TO_TURN,
    GATE,
    GONE,
    LONG,
    LONGER,
    LONGER_ERRATIC,
    MOST_REJECTED,
    NONE,
    OUT_OF_TURN,
    RUN,
    SEEKING,
    START_SCATTER,
    UNKNOWN,
    WRONG,
    Gate,
    accept,
    begin_search,
    new_gate,
    search,
    teeth_of,
    weigh,
)
from meshpoint.kernels.jit import bare, inlined, record_on
from meshpoint.kernels.records import Integers, Vector


@inlined
def lose(gate: Gate) -> bool:
    """Gives the tooth number up: the wheel has to be found again. Returns whether there was one."""
    known = bool(gate.mode == COUNTING or gate.guess != UNKNOWN)
    gate.lost += int(known)
    gate.mode, gate.guess, gate.rejected = SEEKING, UNKNOWN, 0
    return known


@inlined
def seek(gate: Gate, rises: Integers, falls: Integers) -> bool:
    """Looks for intervals of about equal length, which give speed and duty; drops edges before
    them."""
    rise_number, rise_us, fall_us = rises[0], rises[1], falls[1]
    r, f = gate.used[0], gate.used[1]
    factor = LONGER if gate.widest == 1 else LONGER_ERRATIC
    found = False
    while not found and r + RUN < gate.given[0]:
        while f < gate.given[1] and fall_us[f] <= rise_us[r]:
            f += 1
        found = True
        between, at, duty = 0, f, 0.0
        for k in range(r, r + RUN):
            interval = rise_us[k + 1] - rise_us[k]
            before = rise_us[k] - rise_us[k - 1] if k > r else interval
            if not before < factor * interval < factor * factor * before:
                found = False
            if interval * gate.least_rate_per_us > 1.0 or interval * gate.most_rate_per_us < 1.0:
                found = False
            while found and at < gate.given[1] and fall_us[at] < rise_us[k + 1]:
                duty += (fall_us[at] - rise_us[k]) / interval
                between, at = between + 1, at + 1
        if found:
            gate.rate_per_us = 2.0 / (rise_us[r + 2] - rise_us[r])
            share = 1.0 - gate.duty_share if gate.turned == 1 else gate.duty_share
            gate.duty = duty / RUN if between == RUN else share
            gate.lag, gate.at, gate.scatter = 0.0, 0.0, START_SCATTER
            gate.time_us, gate.tooth, gate.falling = rise_us[r], rise_number[r], 0
            gate.last[0], gate.last[1] = rise_number[r], rise_number[r] - 1
            before_us = 1.0 / gate.rate_per_us
            gate.interval_us[0] = gate.interval_us[1] = before_us
            gate.last_us[0] = rise_us[r]
            gate.last_us[1] = rise_us[r] + np.int64((gate.duty - 1.0) * before_us)
        r += 1
    gate.used[0], gate.used[1] = r, f if r < gate.given[0] else gate.given[1]
    return found


@inlined
def settle(gate: Gate, teeth: Integers, time_us: int, falling: int, verdict: int) -> bool:
    """Draws the conclusions from a verdict; whether the edge has a tooth."""
    advance, counting = teeth[0], gate.mode == COUNTING
    if verdict == WRONG:
        gate.extra += 1
        gate.rejected += 1
        # An edge at a place where the wheel has no tooth speaks against the count.
        if falling == 0 and abs(gate.error - round(gate.error)) < OUT_OF_TURN:
            gate.gap_hits += int(counting and gate.error < -0.5)
        idle = (time_us - gate.time_us) * gate.least_rate_per_us > LONG
        if gate.rejected > MOST_REJECTED or idle:
            lose(gate)
        return False
    if verdict == GONE or (verdict == DOUBT and (advance.size == 1 or not counting)):
        gate.doubts += int(verdict == DOUBT)
        slow = (time_us - gate.time_us) * gate.least_rate_per_us > LONG
        gate.stops += int(lose(gate) and slow)
        return False
    before = gate.last[0]
    step = gate.slot - before
    if verdict == DOUBT:
        # Counted on as if nothing was missing; the next gap says whether that is true.
        gate.doubts += 1
        begin_search(gate, teeth)
        guess = gate.guess
        rate = gate.rate_per_us
        gate.error = 0.0
        accept(gate, time_us, falling)
        gate.rate_per_us = rate
        gate.guess = guess if falling == 0 else before
        return False
    accept(gate, time_us, falling)
    if falling == 0:
        hits, gate.gap_hits = gate.gap_hits, 0
        if not counting:
            search(gate, teeth, step, verdict == GAP)
        elif step > 1 and hits >= step - 1 and advance[before % advance.size] == step:
            gate.doubts += 1
            gate.guess = gate.slot
            begin_search(gate, teeth)
            return False
    if gate.rate_per_us < gate.least_rate_per_us:
        gate.stops += int(lose(gate))
    elif advance.size == 1 and gate.scatter > ERRATIC:
        lose(gate)
    return bool(gate.mode == COUNTING)


@inlined
def put(gate: Gate, n: int, edges: Vector, numbers: Integers) -> None:
    """The edge that was just accepted becomes the n-th."""
    second = int(gate.falling)
    edges[0, n] = gate.time_us
    if gate.turned == 1:
        share = 1.0 if second == 1 else gate.duty_share
        numbers[0, n], numbers[1, n] = gate.tooth + second, 1 - second
        edges[1, n] = (gate.tooth + share) * gate.pitch_rad
    else:
        numbers[0, n], numbers[1, n] = gate.tooth, second
        edges[1, n] = (gate.tooth + second * gate.duty_share) * gate.pitch_rad
    if gate.found_us == 0:
        gate.found_us = gate.time_us


@bare
def gate_edges(
    memory: Vector, teeth: Integers, rises: Integers, falls: Integers, edges: Vector,
    numbers: Integers,
) -> int:  # fmt: skip
    """Edges of both polarities in order of time with their teeth; returns how many.

    memory: a `Gate`, moved on; teeth: of `teeth_of`; rises and falls (2, n): running numbers and
    times (us) of the edges that are `given`, oldest first. Edges that are not `used` must be given
    again in front of the next ones: whether they are extra shows behind them. Edges not later than
    the last one with a tooth are left out: a polarity that was late must not turn time back in the
    filters. Where teeth are lost on the way, only edges after that are returned.

    Written: edges (2, n), times and angles; numbers (3, n), the tooth of each and whether it is
    falling, and in the third row the times of edges left out, as many as `extra` grew."""
    gate = record_on(memory, GATE)
    advance, rise_us, fall_us = teeth[0], rises[1], falls[1]
    risen, fallen = gate.given[0], gate.given[1]
    n, first_extra, lost = 0, gate.extra, gate.lost
    gate.used[0] = gate.used[1] = 0
    while True:
        if gate.mode == SEEKING:
            if not seek(gate, rises, falls):
                return n
            begin_search(gate, teeth)
            if advance.size == 1:
                gate.mode = COUNTING
            time_us, falls_here = gate.time_us, 0
            known = advance.size == 1
        else:
            r, f = gate.used[0], gate.used[1]
            if r >= risen and f >= fallen:
                return n
            falls_here = int(r >= risen or (f < fallen and fall_us[f] < rise_us[r]))
            time_us = fall_us[f] if falls_here == 1 else rise_us[r]
            if time_us <= gate.time_us:
                gate.used[falls_here] += 1
                continue
            own_us, other_us = rise_us, fall_us
            if falls_here == 1:
                own_us, other_us = fall_us, rise_us
            # One call: with 0 and 1 written out, all of it would be compiled twice.
            verdict = weigh(gate, advance, own_us, other_us, falls_here)
            if verdict == NONE:
                return n
            gate.used[falls_here] += 1
            if verdict == WRONG:
                numbers[2, gate.extra - first_extra] = time_us
            known = settle(gate, teeth, time_us, falls_here, verdict)
            if gate.lost > lost:
                n, lost = 0, gate.lost
        if known:
            put(gate, n, edges, numbers)
            n += 1


@bare
def turn(memory: Vector, alone: int) -> bool:
    """Whether rising and falling edges are to change places from the next call on, because gaps end
    with the other one, or (`alone` 1) only that one comes. The tooth number is lost then."""
    gate = record_on(memory, GATE)
    if alone == 0 and gate.other_gaps < GAPS_TO_TURN:
        return False
    lose(gate)
    gate.turned, gate.other_gaps = 1 - gate.turned, 0
    gate.given[0] = gate.given[1] = 0
    return True


@bare
def stand(memory: Vector) -> None:
    """The wheel of a `Gate` stands still: gives its tooth number up."""
    gate = record_on(memory, GATE)
    gate.stops += int(lose(gate))


def warm_up() -> None:
    """Compiles all, or loads what was compiled before."""
    gate, teeth, room = new_gate(1.0, 0.5, 1.0, 1.0, 1), teeth_of(1, ()), np.zeros((2, 8), np.int64)
    gate_edges(gate.flat, teeth, room, room, np.zeros((2, 8)), np.zeros((3, 8), np.int64))
    turn(gate.flat, 0)
    stand(gate.flat)
