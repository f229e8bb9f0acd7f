"""Which tooth an edge is of: extra edges left out, missing ones stepped over, doubt declared.

The running number of an edge frame counts what the sensor saw, so one edge too many or too few
shifts it against the wheel. The gate keeps a tooth number of its own. It follows the wheel with an
alpha-beta filter of the angle, in pitches, over the edges of both polarities, and gives each edge
the tooth whose predicted place it is nearest to:

    x = lag + rate (t - t_last),   e = x - (slot - last slot)

An edge much before its slot is extra; of two for one slot the nearer counts. An edge far behind it
means that others are missing: the tooth number moves on by as many, if the motion since the last
good edge leaves no doubt, half the largest acceleration times its square included. What leaves a
doubt ends the count: on a whole wheel the tooth number is lost; on a wheel with missing teeth edges
are withheld until its gap has shown whether the count was right. A wheel so slow that it may have
turned back between two edges has lost its tooth number too.

Compiled by numba; with NUMBA_DISABLE_JIT=1 the same code runs as plain Python.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from meshpoint.controller.jit import bare, inlined
from meshpoint.controller.sensing.gate_layout import (
    AFTER_REJECTED,
    AT,
    BEND,
    BETTER,
    CLEAN,
    COUNTING,
    COUNTS,
    DOUBTS,
    DRAGGED,
    DUTY,
    DUTY_SHARE,
    ERRATIC,
    ERROR,
    EXTRA,
    FALLING,
    FOLLOW,
    FOLLOW_RATE,
    FOUND_US,
    GAP_HITS,
    GAP_RATIO,
    GAPS,
    GUESS,
    HOLE,
    IN_TURN,
    LAG,
    LAST,
    LEAST_RATE,
    LEAST_SCATTER,
    LONG,
    LONGER,
    LONGER_ERRATIC,
    LONGEST_WAIT,
    LOST,
    MISSED,
    MODE,
    MOST_DRAGGED,
    MOST_ERROR,
    MOST_MISSING,
    MOST_RAD_S,
    MOST_RATE,
    MOST_REJECTED,
    MOST_SCATTER,
    NEXT,
    OUT_OF_TURN,
    QUANTITIES,
    RATE,
    RATE_ERROR,
    REJECTED,
    RUN,
    SCATTER,
    SCATTER_SHARE,
    SEARCHED,
    SEARCHING,
    SEEKING,
    SLOT,
    START_SCATTER,
    STOPS,
    SURE,
    SURE_SCATTERS,
    TIME,
    TOOTH,
    TWO_TEETH,
    UNKNOWN,
    WIDER,
    WIDEST,
)

Integers = NDArray[np.int64]
Floats = NDArray[np.float64]

NONE, RIGHT, WRONG, GAP, DOUBT, GONE = range(6)
"""What an edge is: not there yet; one with a tooth; extra; one behind a gap; doubtful, unless it
has the tooth in GUESS; or the first after a stop."""


@inlined
def error_at(counts: Integers, floats: Floats, time_us: int, slot: int, share: float) -> float:
    """How far past a slot the wheel is at a time, pitches."""
    turned = floats[LAG] + (time_us - counts[TIME]) * floats[RATE]
    return float(turned + (counts[TOOTH] - slot) + (floats[AT] - share))


@inlined
def judge(counts: Integers, floats: Floats, advance: Integers, time_us: int, falling: int) -> int:
    """What an edge is; its tooth into SLOT, its distance from there into ERROR.

    advance (teeth,): pitches to the next tooth, 0 where there is none; of one entry for a whole
    wheel."""
    share = floats[DUTY] if falling == 1 else 0.0
    last = counts[LAST + falling]
    slot = last + (advance[last % advance.size] if counts[MODE] == COUNTING else 1)
    error = error_at(counts, floats, time_us, slot, share)
    expected = max((slot - counts[TOOTH]) + (share - floats[AT]), 1.0)
    counts[SLOT], floats[ERROR] = slot, error
    if counts[DRAGGED] == 1:
        return RIGHT
    reach = IN_TURN if counts[REJECTED] == 0 else AFTER_REJECTED
    if advance.size > 1 and floats[SCATTER] > CLEAN:
        # Missing teeth show every turn whether an erratic count was right.
        reach += WIDER * (floats[SCATTER] - CLEAN) * expected
    if error < -reach:
        return WRONG
    if error <= reach:
        return RIGHT
    return judge_late(counts, floats, advance, time_us, falling)


@inlined
def judge_late(
    counts: Integers, floats: Floats, advance: Integers, time_us: int, falling: int
) -> int:
    """The same for an edge that lies behind the next one due: some are missing before it."""
    slot, share = counts[SLOT], floats[DUTY] if falling == 1 else 0.0
    passed = time_us - counts[TIME]
    turned = floats[LAG] + passed * floats[RATE]
    expected = (slot - counts[TOOTH]) + (share - floats[AT])
    counts[GUESS] = slot if counts[MODE] == COUNTING and advance.size > 1 else counts[GUESS]
    longest = counts[WIDEST] if counts[MODE] == SEARCHING else expected
    if passed * floats[LEAST_RATE] > max(longest, 1.0):
        return DOUBT if advance.size > 1 and counts[MODE] == COUNTING else GONE
    hole = turned > max(expected, 0.0) + HOLE
    if counts[MODE] == SEARCHING and hole:
        return judge_gap(counts, floats, advance, falling)
    skipped = int(np.floor(floats[ERROR] + 0.5))
    error = floats[ERROR] - skipped
    unsure = abs(error) + floats[BEND] * passed * passed + RATE_ERROR * turned
    clear = abs(error) < OUT_OF_TURN and unsure < 0.5
    exists = advance[(slot + skipped) % advance.size] > 0 or counts[MODE] == SEARCHING
    if not hole:
        if not (clear and exists):
            return WRONG
    else:
        clear = clear and exists and counts[REJECTED] == 0 and skipped <= MOST_MISSING
        if clear and advance.size > 1:
            counts[GUESS] = slot + skipped
        if not clear or advance.size > 1:
            return DOUBT
    if counts[MODE] == COUNTING:
        counts[MISSED] += skipped
    counts[SLOT], floats[ERROR] = slot + skipped, error
    return RIGHT


@inlined
def judge_gap(counts: Integers, floats: Floats, advance: Integers, falling: int) -> int:
    """The same while the pattern of missing teeth is searched, behind a hole."""
    seen = floats[ERROR] + 1.0
    if falling == 1 or counts[REJECTED] > 0:
        return DOUBT
    nearest, ratio = 0, GAP_RATIO
    for gap in advance:
        if gap > 1 and max(seen / gap, gap / seen) < ratio:
            nearest, ratio = gap, max(seen / gap, gap / seen)
    if nearest == 0:
        return DOUBT
    counts[SLOT] += nearest - 1
    floats[ERROR] -= nearest - 1
    return GAP


@inlined
def accept(counts: Integers, floats: Floats, time_us: int, falling: int) -> None:
    """The edge has the tooth in SLOT: moves the filter on."""
    error, share = floats[ERROR], floats[DUTY] if falling == 1 else 0.0
    turned = max((counts[SLOT] - counts[TOOTH]) + (share - floats[AT]), 0.5)
    if counts[DRAGGED] == 1:
        bounded = min(max(error, -MOST_DRAGGED), MOST_DRAGGED)
        floats[RATE] *= turned / (turned + bounded)
        floats[LAG] = 0.0
    else:
        bounded = min(max(error, -MOST_ERROR), MOST_ERROR)
        floats[RATE] *= 1.0 - FOLLOW_RATE * bounded / turned
        floats[LAG] = error * (1.0 - FOLLOW)
    scatter = floats[SCATTER] + SCATTER_SHARE * (abs(bounded) - floats[SCATTER])
    floats[SCATTER] = min(max(scatter, LEAST_SCATTER), MOST_SCATTER)
    if falling == 1:
        floats[DUTY] += DUTY_SHARE * bounded
    counts[TIME], counts[TOOTH], floats[AT] = time_us, counts[SLOT], share
    counts[LAST + falling], counts[FALLING] = counts[SLOT], falling
    counts[REJECTED] = 0


@inlined
def is_nearer(counts: Integers, floats: Floats, next_us: int, falling: int) -> bool:
    """Whether the next edge of the polarity is nearer to the slot than the one just judged."""
    share = floats[DUTY] if falling == 1 else 0.0
    error = error_at(counts, floats, next_us, counts[SLOT], share)
    if floats[SCATTER] > CLEAN and error - floats[ERROR] > TWO_TEETH:
        return False
    return bool(abs(error) + BETTER < abs(floats[ERROR]))


@inlined
def search(counts: Integers, advance: Integers, candidates: Integers, step: int, gap: bool) -> None:
    """A rising edge came `step` pitches after the last: which tooth can it be of?

    candidates (teeth,): 1 where the first edge of the search may be of that tooth. With one left,
    after a whole turn that fits, teeth are numbered again. LOST counts a wrong guess."""
    teeth, left, tooth = advance.size, 0, 0
    for first in range(teeth):
        before = (first + counts[SEARCHED]) % teeth
        now = (before + step) % teeth
        # Without a hole in time a longer step is an edge that the sensor has missed.
        fits = advance[before] == step if gap or step == 1 else advance[now] > 0
        if candidates[first] == 1 and fits:
            left, tooth = left + 1, now
        else:
            candidates[first] = 0
    guess = counts[GUESS]
    if guess != UNKNOWN:
        whole = gap or step == 1
        guess += advance[guess % teeth] if whole else step
        counts[GUESS] = guess
    counts[GAPS] += int(gap)
    counts[SEARCHED] += step
    right = guess != UNKNOWN and guess % teeth == tooth
    if left == 0 or (left == 1 and counts[GAPS] > 0 and guess != UNKNOWN and not right):
        counts[LOST] += int(guess != UNKNOWN)
        counts[GUESS] = UNKNOWN
    if left == 0:
        begin_search(counts, advance, candidates)
    elif left == 1 and counts[SEARCHED] > teeth:
        shift = guess - counts[LAST] if right else (tooth - counts[LAST]) % teeth
        counts[LAST] += shift
        counts[LAST + 1] += shift
        counts[TOOTH] += shift
        counts[MODE], counts[GAP_HITS], counts[GUESS] = COUNTING, 0, UNKNOWN


@inlined
def begin_search(counts: Integers, advance: Integers, candidates: Integers) -> None:
    """Every tooth is possible."""
    for k in range(advance.size):
        candidates[k] = int(advance[k] > 0)
    counts[GAPS], counts[SEARCHED], counts[MODE] = 0, 0, SEARCHING


@bare
def lose(counts: Integers) -> bool:
    """Teeth cannot be numbered on: the next edges are those of a wheel not known yet. Whether there
    was a number to lose."""
    known = bool(counts[MODE] == COUNTING or counts[GUESS] != UNKNOWN)
    counts[LOST] += int(known)
    counts[MODE], counts[GUESS], counts[REJECTED] = SEEKING, UNKNOWN, 0
    return known


def forget(counts: Integers) -> None:
    """Teeth are not numbered any more, and that is known already."""
    counts[MODE], counts[GUESS], counts[REJECTED] = SEEKING, UNKNOWN, 0


@inlined
def seek(
    counts: Integers,
    floats: Floats,
    rise_number: Integers,
    rise_us: Integers,
    rises: int,
    fall_us: Integers,
    falls: int,
    duty_share: float,
) -> bool:
    """Looks for intervals of about one length; they give speed and duty. Drops what precedes."""
    r, f = counts[NEXT], counts[NEXT + 1]
    factor = LONGER if counts[WIDEST] == 1 else LONGER_ERRATIC
    found = False
    while not found and r + RUN < rises:
        while f < falls and fall_us[f] <= rise_us[r]:
            f += 1
        found = True
        between, at, duty = 0, f, 0.0
        for k in range(r, r + RUN):
            interval = rise_us[k + 1] - rise_us[k]
            before = rise_us[k] - rise_us[k - 1] if k > r else interval
            if not before < factor * interval < factor * factor * before:
                found = False
            if interval * floats[LEAST_RATE] > 1.0 or interval * floats[MOST_RATE] < 1.0:
                found = False
            while found and at < falls and fall_us[at] < rise_us[k + 1]:
                duty += (fall_us[at] - rise_us[k]) / interval
                between, at = between + 1, at + 1
        if found:
            floats[RATE] = 2.0 / (rise_us[r + 2] - rise_us[r])
            floats[DUTY] = duty / RUN if between == RUN else duty_share
            floats[LAG], floats[AT], floats[SCATTER] = 0.0, 0.0, START_SCATTER
            counts[TIME], counts[TOOTH], counts[FALLING] = rise_us[r], rise_number[r], 0
            counts[LAST], counts[LAST + 1] = rise_number[r], rise_number[r] - 1
        r += 1
    counts[NEXT], counts[NEXT + 1] = r, f if r < rises else falls
    return found


@inlined
def settle(
    counts: Integers,
    floats: Floats,
    advance: Integers,
    candidates: Integers,
    time_us: int,
    falling: int,
    verdict: int,
) -> bool:
    """Draws the conclusions from a verdict; whether the edge has a tooth."""
    counting = counts[MODE] == COUNTING
    if verdict == WRONG:
        counts[EXTRA] += 1
        counts[REJECTED] += 1
        # An edge at a place where the wheel has no tooth speaks against the count.
        if falling == 0 and abs(floats[ERROR] - np.round(floats[ERROR])) < OUT_OF_TURN:
            counts[GAP_HITS] += int(counting and floats[ERROR] < -0.5)
        idle = (time_us - counts[TIME]) * floats[LEAST_RATE] > LONG
        if counts[REJECTED] > MOST_REJECTED or idle:
            lose(counts)
        return False
    if verdict == GONE or (verdict == DOUBT and (advance.size == 1 or not counting)):
        counts[DOUBTS] += int(verdict == DOUBT)
        slow = (time_us - counts[TIME]) * floats[LEAST_RATE] > LONG
        counts[STOPS] += int(lose(counts) and slow)
        return False
    before = counts[LAST]
    step = counts[SLOT] - before
    if verdict == DOUBT:
        # Counted on as if nothing was missing; the next gap tells whether that is true.
        counts[DOUBTS] += 1
        begin_search(counts, advance, candidates)
        guess = counts[GUESS]
        rate = floats[RATE]
        floats[ERROR] = 0.0
        accept(counts, floats, time_us, falling)
        floats[RATE] = rate
        counts[GUESS] = guess if falling == 0 else before
        return False
    accept(counts, floats, time_us, falling)
    if falling == 0:
        hits, counts[GAP_HITS] = counts[GAP_HITS], 0
        if not counting:
            search(counts, advance, candidates, step, verdict == GAP)
        elif step > 1 and hits >= step - 1 and advance[before % advance.size] == step:
            counts[DOUBTS] += 1
            counts[GUESS] = counts[SLOT]
            begin_search(counts, advance, candidates)
            return False
    if floats[RATE] < floats[LEAST_RATE]:
        counts[STOPS] += int(lose(counts))
    elif advance.size == 1 and floats[SCATTER] > ERRATIC:
        lose(counts)
    return bool(counts[MODE] == COUNTING)


@inlined
def weigh(
    counts: Integers,
    floats: Floats,
    advance: Integers,
    own_us: Integers,
    owns: int,
    other_us: Integers,
    others: int,
    falling: int,
) -> int:
    """What the next edge of a polarity is, the one after it considered; NONE: wait for that one."""
    at = counts[NEXT + falling]
    time_us = own_us[at]
    verdict = judge(counts, floats, advance, time_us, falling)
    if verdict != RIGHT or counts[DRAGGED] == 1:
        return verdict
    if abs(floats[ERROR]) < SURE + SURE_SCATTERS * floats[SCATTER]:
        return verdict
    if at + 1 < owns:
        return WRONG if is_nearer(counts, floats, own_us[at + 1], falling) else RIGHT
    if others == 0 or (other_us[others - 1] - time_us) * floats[RATE] < LONGEST_WAIT:
        return NONE
    return RIGHT


@inlined
def put(
    counts: Integers,
    n: int,
    duty_share: float,
    pitch_rad: float,
    edge_us: Floats,
    edge_rad: Floats,
    tooth: Integers,
    falling: Integers,
) -> None:
    """The edge that was just accepted becomes the n-th."""
    falls_here = int(counts[FALLING])
    edge_us[n], tooth[n], falling[n] = counts[TIME], counts[TOOTH], falls_here
    edge_rad[n] = (counts[TOOTH] + falls_here * duty_share) * pitch_rad
    if counts[FOUND_US] == 0:
        counts[FOUND_US] = counts[TIME]


@bare
def gate_edges(
    counts: Integers,
    floats: Floats,
    advance: Integers,
    candidates: Integers,
    rise_number: Integers,
    rise_us: Integers,
    rises: int,
    fall_us: Integers,
    falls: int,
    duty_share: float,
    pitch_rad: float,
    edge_us: Floats,
    edge_rad: Floats,
    tooth: Integers,
    falling: Integers,
    extra_us: Integers,
) -> int:
    """Edges of both polarities in order of time with their teeth; returns how many.

    counts, floats, candidates: the gate's state, moved on. Edges that are not used up (counts NEXT)
    must be given again in front of the next ones: whether they are extra shows behind them. Edges
    not later than the last one with a tooth are left out: a polarity that was late must not turn
    time back in the filters. Where teeth are lost on the way, only edges after that are returned.
    extra_us: times of the edges left out as extra, as many as EXTRA grew.
    """
    n, first_extra, lost = 0, counts[EXTRA], counts[LOST]
    counts[NEXT] = counts[NEXT + 1] = 0
    while True:
        if counts[MODE] == SEEKING:
            if not seek(counts, floats, rise_number, rise_us, rises, fall_us, falls, duty_share):
                return n
            begin_search(counts, advance, candidates)
            if advance.size == 1:
                counts[MODE] = COUNTING
            time_us, falls_here = counts[TIME], 0
            known = advance.size == 1
        else:
            r, f = counts[NEXT], counts[NEXT + 1]
            if r >= rises and f >= falls:
                return n
            falls_here = int(r >= rises or (f < falls and fall_us[f] < rise_us[r]))
            time_us = fall_us[f] if falls_here == 1 else rise_us[r]
            if time_us <= counts[TIME]:
                counts[NEXT + falls_here] += 1
                continue
            if falls_here == 1:
                verdict = weigh(counts, floats, advance, fall_us, falls, rise_us, rises, 1)
            else:
                verdict = weigh(counts, floats, advance, rise_us, rises, fall_us, falls, 0)
            if verdict == NONE:
                return n
            counts[NEXT + falls_here] += 1
            if verdict == WRONG:
                extra_us[counts[EXTRA] - first_extra] = time_us
            known = settle(counts, floats, advance, candidates, time_us, falls_here, verdict)
            if counts[LOST] > lost:
                n, lost = 0, counts[LOST]
        if known:
            put(counts, n, duty_share, pitch_rad, edge_us, edge_rad, tooth, falling)
            n += 1


def advances(teeth: int, missing: tuple[int, ...]) -> Integers:
    """Pitches from each tooth to the next, 0 where there is none; one entry for a whole wheel."""
    if not missing:
        return np.ones(1, np.int64)
    steps = np.zeros(teeth, np.int64)
    present = sorted(set(range(teeth)) - set(missing))
    following = [*present[1:], present[0] + teeth]
    steps[present] = np.array(following) - np.array(present)
    return steps


def new_state(
    pitch_rad: float, most_rad_s2: float, stopping_rad_s2: float, advance: Integers
) -> tuple[Integers, Floats]:
    """Counts and quantities of a wheel not seen yet; the bounds are those of its acceleration, and
    of the one with which it may come to a stop."""
    counts, floats = np.zeros(COUNTS, np.int64), np.zeros(QUANTITIES)
    counts[GUESS], counts[WIDEST] = UNKNOWN, advance.max()
    # At omega^2 = 6 a pitch it takes three pitches to stop.
    floats[LEAST_RATE] = np.sqrt(6.0 * stopping_rad_s2 / pitch_rad) * 1e-6
    floats[MOST_RATE] = MOST_RAD_S / pitch_rad * 1e-6
    floats[BEND] = 0.5 * most_rad_s2 / pitch_rad * 1e-12
    return counts, floats


def warm_up() -> None:
    """Compiles all, or loads what was compiled before."""
    one, room = np.ones(1, np.int64), np.zeros(8, np.int64)
    counts, floats = new_state(1.0, 1.0, 1.0, one)
    edge = np.zeros(8)
    gate_edges(
        counts, floats, one, room, room, room, 0, room, 0, 0.5, 1.0, edge, edge, room, room, room
    )
