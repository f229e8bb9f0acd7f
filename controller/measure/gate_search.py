"""Which tooth is which on a wheel with missing teeth: pieces of the edge gate (`gate_kernels`).

Every tooth is a candidate for the first edge until the steps seen since fit only one.
"""

from __future__ import annotations

from meshpoint.controller.measure.gate_layout import (
    COUNTING,
    DOUBT,
    GAP,
    GAP_RATIO,
    SEARCHING,
    UNKNOWN,
    Gate,
)
from meshpoint.kernels.jit import inlined
from meshpoint.kernels.records import Integers


@inlined
def judge_gap(gate: Gate, advance: Integers, falling: int) -> int:
    """The same while the pattern of missing teeth is searched, behind a hole.

    One that ends with the second edge of a tooth is counted: after some of them in a row, the
    polarities change places (`turn` in `gate_kernels`)."""
    seen = gate.error + 1.0
    if gate.rejected > 0:
        return DOUBT
    nearest, ratio = 0, GAP_RATIO
    for gap in advance:
        if gap > 1 and max(seen / gap, gap / seen) < ratio:
            nearest, ratio = gap, max(seen / gap, gap / seen)
    if nearest == 0:
        return DOUBT
    if falling == 1:
        gate.other_gaps += 1
        return DOUBT
    gate.other_gaps = 0
    gate.slot += nearest - 1
    gate.error -= nearest - 1
    return GAP


@inlined
def search(gate: Gate, teeth: Integers, step: int, gap: bool) -> None:
    """A rising edge came `step` pitches after the last: which tooth can it be of?

    The second row of teeth says where the first edge of the search may be of that tooth. With one
    left, after a whole turn that fits, teeth are numbered again. A wrong guess counts as lost."""
    advance, candidates = teeth[0], teeth[1]
    size, left, tooth = advance.size, 0, 0
    for first in range(size):
        before = (first + gate.searched) % size
        now = (before + step) % size
        # Without a hole in time a longer step is an edge that the sensor has missed.
        fits = advance[before] == step if gap or step == 1 else advance[now] > 0
        if candidates[first] == 1 and fits:
            left, tooth = left + 1, now
        else:
            candidates[first] = 0
    guess = gate.guess
    if guess != UNKNOWN:
        whole = gap or step == 1
        guess += advance[guess % size] if whole else step
        gate.guess = guess
    gate.gaps += int(gap)
    gate.searched += step
    right = guess != UNKNOWN and guess % size == tooth
    if left == 0 or (left == 1 and gate.gaps > 0 and guess != UNKNOWN and not right):
        gate.lost += int(guess != UNKNOWN)
        gate.guess = UNKNOWN
    if left == 0:
        begin_search(gate, teeth)
        for tooth in range(size if gap else 0):
            # The gap that contradicts is the first of the new search: it ends before this edge.
            if advance[(tooth - step) % size] != step:
                candidates[tooth] = 0
    elif left == 1 and gate.searched > size:
        shift = guess - gate.last[0] if right else (tooth - gate.last[0]) % size
        gate.last[0] += shift
        gate.last[1] += shift
        gate.tooth += shift
        gate.mode, gate.gap_hits, gate.guess = COUNTING, 0, UNKNOWN


@inlined
def begin_search(gate: Gate, teeth: Integers) -> None:
    """Starts the search: every tooth is possible."""
    for k in range(teeth.shape[1]):
        teeth[1, k] = int(teeth[0, k] > 0)
    gate.gaps, gate.searched, gate.mode = 0, 0, SEARCHING
