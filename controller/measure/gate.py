"""What an edge is to a wheel's gate (`gate_kernels`): the gate's memory and tuning, how it judges
an edge, and its search for the first tooth.

On a wheel with missing teeth every tooth is a candidate for the first edge, until the steps seen
since fit only one.
"""

from __future__ import annotations

from typing import Annotated, Final

import numpy as np

from meshpoint.kernels.jit import inlined
from meshpoint.kernels.records import Integers, RecordMemory, Vector, layout_of

SEEKING, SEARCHING, COUNTING = range(3)
"""Modes: no steady speed yet; a speed, but not yet the place of the missing teeth; each edge gets
its tooth."""
NONE, RIGHT, WRONG, GAP, DOUBT, GONE = range(6)
"""What an edge is: not there yet; one with a tooth; extra; one behind a gap; doubtful, unless it
has the tooth in `guess`; or the first after a stop."""
UNKNOWN: Final = -(1 << 62)
MOST_RAD_S: Final = 630.0
"""6,000 rpm, what a data sheet allows."""
RUN: Final = 4
"""Intervals in a row of about one length: then there is a speed."""
LONGER, LONGER_ERRATIC = 1.25, 1.5
"""One length: up to this factor between neighbours; more where missing teeth check the count."""
IN_TURN: Final = 0.4
"""An edge this near to where the next one is due is that one, pitches; less after a wrong edge."""
AFTER_REJECTED: Final = 0.25
OUT_OF_TURN: Final = 0.25
HOLE: Final = 0.75
"""Without an edge of either polarity for this much longer than expected, teeth are missing."""
MOST_MISSING: Final = 2
RATE_ERROR: Final = 0.03
"""Largest error of the filtered speed, as a share."""
GAP_RATIO: Final = 1.45
"""A gap may appear longer or shorter by up to this factor."""
GAPS_TO_TURN: Final = 2
"""This many gaps in a row that end with the other polarity: teeth begin with that one."""
ALONE: Final = 10
"""This many edges of one polarity, and none of the other: that one alone is used."""
EVEN, CALM = 1.5, 1.1
"""Neighbouring intervals of true edges differ by less than the first factor at any acceleration, by
less than the second if nothing has happened."""
MOST_REJECTED: Final = 60
LONG: Final = 2.0
"""At the least speed, a wheel may stop within this many pitches."""
FOLLOW, FOLLOW_RATE, MOST_ERROR = 0.6, 0.3, 0.15
"""Of the alpha-beta filter of an edge's place: alpha, beta, and the largest error that moves the
speed (pitches)."""
MOST_DRAGGED: Final = 0.4
"""The same in a shaft that is dragged, by over 2,000 rad/s2: its speed is that of the last edge."""
LONGEST_WAIT: Final = 1.5
"""An edge waits for the next of its polarity until the other one is this many pitches on."""
SURE, SURE_SCATTERS, BETTER = 0.02, 3.0, 0.02
SCATTER_SHARE, START_SCATTER, LEAST_SCATTER, MOST_SCATTER = 0.0625, 0.05, 0.002, 0.2
CLEAN, WIDER, ERRATIC, TWO_TEETH = 0.04, 6.0, 0.1, 0.6
"""From this scatter on an edge may be further off; above the third a whole wheel has no
count. On an erratic wheel edges so far apart (pitches) may be those of two teeth."""
DUTY_SHARE: Final = 0.02


class Gate:
    """State and wheel of an edge gate. Angles are in pitches; arrays of two hold one figure for
    rising and one for falling edges."""

    mode: int
    time_us: int
    tooth: int
    """Sensor time of the last edge that got a tooth, and its tooth."""
    falling: int
    """Polarity of that edge."""
    last: Annotated[Integers, 2]
    """Tooth of each polarity's last edge."""
    last_us: Annotated[Integers, 2]
    """Sensor time of it."""
    interval_us: Annotated[Vector, 2]
    """Time for a pitch before it, by the edge of its polarity before."""
    given: Annotated[Integers, 2]
    """How many edges there are to be judged."""
    used: Annotated[Integers, 2]
    """How many of them are used up."""
    rejected: int
    """Edges without a tooth since the last one with."""
    slot: int
    """The tooth that `judge` assigns to an edge."""
    guess: int
    """In doubt: the tooth that the newest rising edge has if the count is right."""
    gaps: int
    """Gaps seen since the search for the pattern of missing teeth began."""
    searched: int
    """Pitches since then."""
    gap_hits: int
    """Edges where the wheel has no tooth, since the last rising edge."""
    extra: int
    missed: int
    doubts: int
    lost: int
    """How many edges were left out, were missing, how often the tooth was in doubt and was lost."""
    stops: int
    """How often of `lost` the wheel was slow or stood."""
    found_us: int
    """When teeth were first numbered; 0 before."""
    turned: int
    """1: a tooth begins with its falling edge, so `rises` and `falls` have changed places: gaps end
    with a falling edge, or there is no rising one."""
    other_gaps: int
    """Gaps in a row that ended with the second edge of a tooth while the pattern was searched."""
    dragged: int
    """1 while a synchroniser changes the shaft's speed: edges cannot be predicted then, so each one
    is taken for the next."""
    widest: int
    """The widest gap of the wheel."""
    rate_per_us: float
    """Pitches a microsecond."""
    lag: float
    """Filtered angle less that of the last edge."""
    at: float
    """Place of the last edge in its pitch: 0 rising, the duty falling."""
    duty: float
    """Measured."""
    scatter: float
    """Mean distance of edges from where they were expected."""
    error: float
    """Of the edge that is judged, against its slot."""
    least_rate_per_us: float
    """Below it the wheel may stand still within three pitches."""
    most_rate_per_us: float
    """Edges that come faster are noise."""
    bend_per_us2: float
    """Half the largest acceleration."""
    duty_share: float
    """Of the data sheet."""
    pitch_rad: float


GATE: Final = layout_of(Gate)


class GateMemory(RecordMemory):
    """A gate's memory, and those of its parts that are asked for often; all are views."""

    def _name_parts(self) -> None:
        self.mode, self.last = self.part("mode"), self.part("last")
        self.time_us = self.part("time_us")
        self.given, self.used = self.part("given"), self.part("used")
        self.other_gaps = self.part("other_gaps")
        self.extra, self.lost = self.part("extra"), self.part("lost")
        self.rate_per_us, self.dragged = self.part("rate_per_us"), self.part("dragged")

    def forget(self) -> None:
        """Tooth numbers are lost, and the loss has been counted already."""
        self.mode[0], self.part("guess")[0], self.part("rejected")[0] = SEEKING, UNKNOWN, 0


def teeth_of(teeth: int, missing: tuple[int, ...]) -> Integers:
    """What the gate knows of a wheel's teeth (2, n): pitches from each to the next, 0 where there
    is none, one entry for a whole wheel; and a row for `edge_search.search` to work with."""
    if not missing:
        return np.array([[1], [0]])
    rows = np.zeros((2, teeth), np.int64)
    present = sorted(set(range(teeth)) - set(missing))
    following = [*present[1:], present[0] + teeth]
    rows[0, present] = np.array(following) - np.array(present)
    return rows


def new_gate(
    pitch_rad: float, duty_share: float, most_rad_s2: float, stopping_rad_s2: float, widest: int
) -> GateMemory:
    """The gate of a wheel not seen yet; the bounds are those of its acceleration, and of the one
    with which it may come to a stop; widest: its widest gap, pitches."""
    memory = GateMemory(GATE)
    memory.put(
        guess=UNKNOWN,
        widest=widest,
        # At omega^2 = 6 a pitch it takes three pitches to stop.
        least_rate_per_us=np.sqrt(6.0 * stopping_rad_s2 / pitch_rad) * 1e-6,
        most_rate_per_us=MOST_RAD_S / pitch_rad * 1e-6,
        bend_per_us2=0.5 * most_rad_s2 / pitch_rad * 1e-12,
        duty_share=duty_share,
        pitch_rad=pitch_rad,
    )
    return memory


@inlined
def error_at(gate: Gate, time_us: int, slot: int, share: float) -> float:
    """Predicted distance of the wheel past a slot at a time, pitches."""
    turned = gate.lag + (time_us - gate.time_us) * gate.rate_per_us
    return float(turned + (gate.tooth - slot) + (gate.at - share))


@inlined
def judge(gate: Gate, advance: Integers, time_us: int, falling: int) -> int:
    """What an edge is; its tooth into `slot`, its distance from there into `error`.

    advance (n,): the first row of `teeth_of`."""
    share = gate.duty if falling == 1 else 0.0
    last = gate.last[falling]
    slot = last + (advance[last % advance.size] if gate.mode == COUNTING else 1)
    error = error_at(gate, time_us, slot, share)
    expected = max((slot - gate.tooth) + (share - gate.at), 1.0)
    gate.slot, gate.error = slot, error
    if gate.dragged == 1:
        return RIGHT
    reach = IN_TURN if gate.rejected == 0 else AFTER_REJECTED
    if advance.size > 1 and gate.scatter > CLEAN:
        # Missing teeth show once a turn whether the count was right.
        reach += WIDER * (gate.scatter - CLEAN) * expected
    if error < -reach:
        return WRONG
    if error <= reach:
        return RIGHT
    return judge_late(gate, advance, time_us, falling)


@inlined
def judge_late(gate: Gate, advance: Integers, time_us: int, falling: int) -> int:
    """The same for an edge that lies behind the next one due: some are missing before it."""
    slot, share = gate.slot, gate.duty if falling == 1 else 0.0
    passed = time_us - gate.time_us
    turned = gate.lag + passed * gate.rate_per_us
    expected = (slot - gate.tooth) + (share - gate.at)
    gate.guess = slot if gate.mode == COUNTING and advance.size > 1 else gate.guess
    longest = gate.widest if gate.mode == SEARCHING else expected
    if passed * gate.least_rate_per_us > max(longest, 1.0):
        return DOUBT if advance.size > 1 and gate.mode == COUNTING else GONE
    hole = turned > max(expected, 0.0) + HOLE
    if gate.mode == SEARCHING and hole:
        return judge_gap(gate, advance, falling)
    skipped = int(np.floor(gate.error + 0.5))
    error = gate.error - skipped
    unsure = abs(error) + gate.bend_per_us2 * passed * passed + RATE_ERROR * turned
    clear = abs(error) < OUT_OF_TURN and unsure < 0.5
    exists = advance[(slot + skipped) % advance.size] > 0 or gate.mode == SEARCHING
    if not hole:
        if not (clear and exists):
            return WRONG
    else:
        clear = clear and exists and gate.rejected == 0 and skipped <= MOST_MISSING
        if clear and advance.size > 1:
            gate.guess = slot + skipped
        if not clear or advance.size > 1:
            return DOUBT
    if gate.mode == COUNTING:
        gate.missed += skipped
    gate.slot, gate.error = slot + skipped, error
    return RIGHT


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
def accept(gate: Gate, time_us: int, falling: int) -> None:
    """Accepts the edge as that of the tooth in `slot`, and updates the filter."""
    error, share = gate.error, gate.duty if falling == 1 else 0.0
    turned = max((gate.slot - gate.tooth) + (share - gate.at), 0.5)
    if gate.dragged == 1:
        bounded = min(max(error, -MOST_DRAGGED), MOST_DRAGGED)
        gate.rate_per_us *= turned / (turned + bounded)
        gate.lag = 0.0
    else:
        bounded = min(max(error, -MOST_ERROR), MOST_ERROR)
        gate.rate_per_us *= 1.0 - FOLLOW_RATE * bounded / turned
        gate.lag = error * (1.0 - FOLLOW)
    scatter = gate.scatter + SCATTER_SHARE * (abs(bounded) - gate.scatter)
    gate.scatter = min(max(scatter, LEAST_SCATTER), MOST_SCATTER)
    if falling == 1:
        gate.duty += DUTY_SHARE * bounded
    gate.interval_us[falling] = (time_us - gate.last_us[falling]) / max(
        gate.slot - gate.last[falling], 1
    )
    gate.last_us[falling] = time_us
    gate.time_us, gate.tooth, gate.at = time_us, gate.slot, share
    gate.last[falling], gate.falling = gate.slot, falling
    gate.rejected = 0


@inlined
def is_nearer(gate: Gate, next_us: int, falling: int) -> bool:
    """Whether the next edge of the polarity is nearer to the slot than the one just judged."""
    share = gate.duty if falling == 1 else 0.0
    error = error_at(gate, next_us, gate.slot, share)
    if gate.scatter > CLEAN and error - gate.error > TWO_TEETH:
        return False
    return bool(abs(error) + BETTER < abs(gate.error))


@inlined
def weigh_extra(
    gate: Gate, advance: Integers, own_us: Integers, other_us: Integers, falling: int
) -> int:
    """Whether an edge out of its place is extra, or a true one of a shaft that has changed its
    speed by more than was assumed: the two edges after it tell. NONE: wait for them.

    It is extra where another is nearer to its slot, and the intervals are uneven with it or calm
    without it. Otherwise the count is in doubt: `guess` has it as if the edge is true."""
    at, others, slot = gate.used[falling], gate.given[1 - falling], gate.slot
    time_us = own_us[at]
    if at + 2 >= gate.given[falling]:
        waited = others > 0 and other_us[others - 1] > time_us
        behind = (other_us[others - 1] - time_us) * gate.rate_per_us if waited else 0.0
        return WRONG if behind > LONGEST_WAIT + gate.widest else NONE
    step = max(slot - gate.last[falling], 1)
    next_step = after_step = 1
    if gate.mode == COUNTING:
        next_step = advance[slot % advance.size]
        after_step = advance[(slot + next_step) % advance.size]
    second = float(own_us[at + 1] - time_us)
    third = float(own_us[at + 2] - own_us[at + 1])
    first, joined = float(time_us - gate.last_us[falling]), own_us[at + 1] - gate.last_us[falling]
    if min(first, second, third) <= 0.0 or next_step == 0 or after_step == 0:
        return WRONG
    first, joined, before = first / step, joined / step, gate.interval_us[falling]
    extra = max(unlike(before, joined), unlike(joined, third / next_step))
    second, third = second / next_step, third / after_step
    true = max(unlike(before, first), unlike(first, second), unlike(second, third))
    nearer = abs(gate.error + second * next_step * gate.rate_per_us) < abs(gate.error)
    if nearer and (true >= EVEN or extra < min(true, CALM)):
        return WRONG
    if true < EVEN:
        gate.rate_per_us = 1.0 / second
    if gate.mode == SEARCHING:
        return RIGHT if true < EVEN else WRONG
    gate.guess = slot
    return DOUBT


@inlined
def unlike(a: float, b: float) -> float:
    """By which factor two lengths differ."""
    return float(max(a / b, b / a))


@inlined
def weigh(gate: Gate, advance: Integers, own_us: Integers, other_us: Integers, falling: int) -> int:
    """The verdict on a polarity's next edge, in view of the one after it; NONE: wait for that
    one."""
    at, others = gate.used[falling], gate.given[1 - falling]
    time_us = own_us[at]
    verdict = judge(gate, advance, time_us, falling)
    if verdict == WRONG and gate.dragged == 0:
        return weigh_extra(gate, advance, own_us, other_us, falling)
    if verdict != RIGHT or gate.dragged == 1:
        return verdict
    if abs(gate.error) < SURE + SURE_SCATTERS * gate.scatter:
        return verdict
    if at + 1 < gate.given[falling]:
        if is_nearer(gate, own_us[at + 1], falling):
            return weigh_extra(gate, advance, own_us, other_us, falling)
        return RIGHT
    if others == 0 or (other_us[others - 1] - time_us) * gate.rate_per_us < LONGEST_WAIT:
        return NONE
    return RIGHT


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
