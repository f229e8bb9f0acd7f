"""The teeth of a capture by the whole file: what the node's numbers are checked against.

The node numbers edges one by one as they come and follows their speed. Here the most likely
trajectory over all intervals is sought, behind and ahead of each edge alike, from nothing but how
the lengths of neighbouring intervals compare (Viterbi's algorithm, state: the tooth of an edge). It
has no speed, no filter and no threshold in common with the node.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from meshpoint.kernels.records import Integers, Vector
from meshpoint.logs.capture_files import FoundWheel

UNSURE: Final = -1
"""No tooth can be determined: the count breaks near here, or nothing shows where a turn begins."""
BREAK_COST: Final = 5.0
"""What it costs to take the count as broken at an edge. A count that is wrong by one tooth costs
about four times the logarithm of the gap's length each turn."""
MOST_COST: Final = 1.5
"""The largest cost of one pair of intervals."""


def true_teeth(lead_us: Integers, wheel: FoundWheel, second_us: Integers) -> Integers:
    """The tooth of each edge of the polarity that teeth begin with, from 0 behind the widest gap;
    UNSURE where it cannot be determined.

    second_us: edges of a second channel; of a wheel with all its teeth they tell where turns begin,
    and a turn with another number of edges than teeth is not reported."""
    if wheel.missing:
        return _by_gaps(lead_us, wheel)
    return _by_marks(lead_us, wheel.teeth, second_us)


def _by_gaps(lead_us: Integers, wheel: FoundWheel) -> Integers:
    present = np.array([k for k in range(wheel.teeth) if k not in wheel.missing])
    steps = np.diff(np.append(present, present[0] + wheel.teeth)).astype(float)
    if lead_us.size < present.size + 2:
        return np.full(lead_us.size, UNSURE)
    intervals = np.log(np.maximum(np.diff(lead_us).astype(float), 1.0))
    seen = np.diff(intervals)
    # Interval k leads from edge k to k + 1; from place s it is steps[s] long.
    expected = np.log(np.roll(steps, -1)) - np.log(steps)
    places, breaks = _trajectory(seen, expected)
    teeth = present[places]
    behind_gaps = np.flatnonzero(np.append(False, steps[places[:-1]] > 1.0))
    for at in np.flatnonzero(breaks):
        # Between two gaps all teeth look alike: where between them it breaks cannot be determined.
        k = int(np.searchsorted(behind_gaps, at, "right"))
        begin = behind_gaps[k - 1] if k else 0
        end = behind_gaps[k] if k < behind_gaps.size else teeth.size
        teeth[min(begin, at) : end] = UNSURE
    return np.asarray(teeth)


def _trajectory(seen: Vector, expected: Vector) -> tuple[Integers, Integers]:
    """The likeliest place of every edge, and at which edges the count breaks.

    seen (n - 2,): change of the logarithm of the interval at edge 1 ... n - 2; expected (m,): the
    same between the interval that begins at place s and the next."""
    m, n = expected.size, seen.size + 2
    cost, back = np.zeros(m), np.zeros((n, m), np.int64)
    for k in range(1, n):
        gone_on = np.roll(cost, 1)
        if k < n - 1:
            # State s at edge k: intervals behind and ahead of it begin at s - 1 and s.
            change = np.minimum(np.abs(seen[k - 1] - np.roll(expected, 1)), MOST_COST)
        else:
            change = np.zeros(m)
        best = int(np.argmin(cost))
        broken = cost[best] + BREAK_COST < gone_on
        back[k] = np.where(broken, best, (np.arange(m) - 1) % m)
        cost = np.where(broken, cost[best] + BREAK_COST, gone_on) + change
    places, breaks = np.zeros(n, np.int64), np.zeros(n, np.int64)
    places[-1] = int(np.argmin(cost))
    for k in range(n - 1, 0, -1):
        places[k - 1] = back[k, places[k]]
        breaks[k] = int(places[k - 1] != (places[k] - 1) % m)
    return places, breaks


def _by_marks(lead_us: Integers, teeth: int, second_us: Integers) -> Integers:
    found = np.full(lead_us.size, UNSURE)
    at = np.searchsorted(lead_us, second_us)
    for begin, end in zip(at[:-1].tolist(), at[1:].tolist(), strict=True):
        if end - begin == teeth:
            found[begin:end] = np.arange(teeth)
    return found


def wrong_teeth(said: Integers, true: Integers, teeth: int, turn_is_known: bool) -> tuple[int, int]:
    """Numbers that can be checked, and how many of them are wrong.

    said: running numbers; turn_is_known: number 0 is the drawing's tooth 0, modulo `teeth`;
    otherwise any one, the same for the whole run."""
    known = true != UNSURE
    off = (said[known] - true[known]) % teeth
    if not off.size:
        return 0, 0
    right = 0 if turn_is_known else int(np.bincount(off).argmax())
    return int(off.size), int((off != right).sum())
