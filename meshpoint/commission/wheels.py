"""Tooth counts and gear ratios out of counted edges, with no data sheet.

A wheel's own errors come back every turn: the number of edges after which the intervals between
them repeat is its tooth count. In a mesh the angle of one wheel over whole turns of the other is
its ratio; the simplest fraction within what was measured is that of the gears' teeth, down to a
common factor, which no phase knows of.
"""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Final, NamedTuple

import numpy as np

from meshpoint.commission.edge_log import EdgeLog, State, Window
from meshpoint.commission.shafts import Shaft
from meshpoint.gearbox.gears import MAIN_GEARS, MainGear, Range, Split
from meshpoint.kernels.records import Vector

LEAST_TEETH, MOST_TEETH = 20, 90
"""Tooth counts that are looked for."""
LEAST_TURNS: Final = 4.0
LEAST_VARIANCE: Final = 1e-12
"""Of relative intervals: a hundredth of a per mille of a pitch is beyond any stamp."""
CLEARER, CLEARER_EDGES = 0.08, 60.0
"""Any other count leaves so much more of the intervals' scatter, by the logarithm of its variance,
and this over the number of intervals: few of them tell less."""
AS_GOOD, AS_GOOD_EDGES = 0.03, 30.0
"""A count that leaves no more than this over the least one's may be the true one, and the least
one a multiple of it."""
LEAST_TOLERANCE: Final = 3e-5
"""Share by which a measured ratio may at least differ from the true one."""
SPREADS: Final = 3.0
"""It may also differ by this many standard deviations of its parts' mean."""
PARTS: Final = 8
DEGREE_TURNS: Final = 0.25 / 360.0
"""By so much the end of a count may be wrong: teeth that are off, a flank that was left."""
MOST_WHEEL: Final = 150
"""Teeth of a gear wheel: a fraction that needs more is none of two wheels."""
SPLIT_STATES: Final = {split: State(split, MainGear.NEUTRAL, Range.HIGH) for split in Split}
GEAR_STATES: Final = {gear: State(Split.LOW, gear, Range.LOW) for gear in MAIN_GEARS}
HIGH_STATE: Final = State(Split.LOW, MainGear.THIRD, Range.HIGH)


class Measured(NamedTuple):
    """A ratio: speed of the second wheel over the first, how far it may be off, and as teeth."""

    value: float
    tolerance: float
    fraction: Fraction | None
    """None where no two wheels, or more than one pair of a kind, explain it."""


def tooth_count(*windows: Vector) -> int | None:
    """Teeth of a wheel by rising edges (us) in times of steady turning, of many turns all together;
    None where they do not tell it."""
    gaps = [np.diff(times) for times in windows if times.size > LEAST_TURNS * LEAST_TEETH]
    # The same intervals for each count, so that what they leave can be compared.
    long = [one for one in gaps if one.size >= LEAST_TURNS * MOST_TEETH] or gaps
    left = {}
    for teeth in range(LEAST_TEETH, MOST_TEETH + 1):
        if long and all(one.size >= LEAST_TURNS * teeth for one in long):
            rest = [one.size * math.log(_unexplained(one, teeth)) for one in long]
            left[teeth] = sum(rest) / sum(one.size for one in long)
    if not left:
        return None
    seen = sum(one.size for one in long)
    most = min(left.values()) + AS_GOOD + AS_GOOD_EDGES / seen
    teeth = min(count for count, rest in left.items() if rest <= most)
    others = [rest for count, rest in left.items() if count % teeth]
    clear = left[teeth] + CLEARER + CLEARER_EDGES / seen
    return teeth if not others or min(others) >= clear else None


def _unexplained(gaps: Vector, teeth: int) -> float:
    """Variance of the relative intervals that a pattern of this many teeth leaves."""
    past = np.concatenate(((0.0,), np.cumsum(gaps)))
    turn = (past[teeth:] - past[:-teeth]) / teeth
    first = teeth // 2
    share = gaps[first : first + turn.size] / turn - 1.0
    # A slow change of speed is none of the pattern's: the mean of a turn moves with it.
    place = np.arange(share.size) % teeth
    count = np.bincount(place, minlength=teeth)
    mean = np.bincount(place, share, minlength=teeth) / np.maximum(count, 1)
    freedom = max(1, share.size - int(np.count_nonzero(count)))
    return max(float(np.sum((share - mean[place]) ** 2)) / freedom, LEAST_VARIANCE)


def edges_a_turn(log: EdgeLog, of: Shaft, teeth: int, by: Shaft, window: Window) -> Measured | None:
    """Rising edges of wheel `by` for one turn of wheel `of`."""
    times, numbers = log.edges(of, window)
    other_times, other_numbers = log.edges(by, window)
    if times.size < 2 * teeth or other_times.size < 4:
        return None
    inside = (times >= other_times[0]) & (times <= other_times[-1])
    times, numbers = times[inside], numbers[inside]
    turns = int((numbers.size - 1) // teeth)
    if turns < 1 or np.any(np.diff(numbers) != 1) or np.any(np.diff(other_numbers) != 1):
        return None
    at = np.interp(times, other_times, other_numbers)
    rates = (at[turns * teeth :] - at[: at.size - turns * teeth]) / turns
    value = float(rates.mean())
    # Whether parts of the window say the same: a flank that was left in it shows here.
    few = max(1, turns // PARTS)
    parts = (at[few * teeth :: few * teeth] - at[: at.size - few * teeth : few * teeth]) / few
    wobble = float(parts.std(ddof=1)) / len(parts) if parts.size > 2 else float(np.ptp(rates))
    error = max(SPREADS * wobble / value, LEAST_TOLERANCE)
    return Measured(value, error, None)


def ratio(
    log: EdgeLog, pair: tuple[Shaft, Shaft], teeth: dict[Shaft, int], window: Window
) -> Measured | None:
    """Turns of the second shaft for one of the first."""
    of, by = pair
    if of not in teeth or by not in teeth:
        return None
    edges = edges_a_turn(log, of, teeth[of], by, window)
    if edges is None:
        return None
    value = edges.value / teeth[by]
    numbers = log.edges(of, window)[1]
    turns = (numbers.size - 1) / teeth[of] * min(1.0, value)
    tolerance = max(edges.tolerance, DEGREE_TURNS / turns)
    return Measured(value, tolerance, fraction_of(value, tolerance))


def fraction_of(value: float, tolerance: float) -> Fraction | None:
    """The simplest fraction within a share of a value; None where its wheels would be too large, or
    where another one in there is nearly as simple."""
    low, high = Fraction(value * (1.0 - tolerance)), Fraction(value * (1.0 + tolerance))
    found = _simplest(low, high)
    if max(found.numerator, found.denominator) > MOST_WHEEL:
        return None
    for one, other in ((low, found), (found, high)):
        if one < other:
            nudge = Fraction(1, 10**9)
            second = _simplest(
                one + (nudge if one == found else 0), other - (nudge if other == found else 0)
            )
            if max(second.numerator, second.denominator) <= MOST_WHEEL:
                return None
    return found


def _simplest(low: Fraction, high: Fraction) -> Fraction:
    """The fraction of the least denominator in low..high, by continued fractions."""
    whole = low.numerator // low.denominator
    if low == whole:
        return Fraction(whole)
    if whole + 1 <= high:
        return Fraction(whole + 1)
    return whole + 1 / _simplest(1 / (high - whole), 1 / (low - whole))
