"""Whether one strategy was better than another on the same shifts, by how much, and whether that is
more than chance does: one sentence, whatever the figures say.

A share of gaps is judged by the shifts in which the two differ (exact sign test; McNemar 1947), a
mean by the paired differences (Student's t). Shifts of one gearbox are taken as independent.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

from meshpoint.results.output import counted, number, shown

ERROR: Final = 0.05
"""A difference that equal strategies show in this share of cases is no more than chance."""


MEANS: Final = (("duration_ms", "time", "ms", 0), ("impact_j", "impact", "J", 2))
"""Figures of which the mean is compared: as a row has it, its word, unit and digits."""


TITLES: Final = {
    "speed_window": "the speed window (today)",
    "speed_window_anticipating": "the anticipating speed window",
    "target_phase": "phase control",
    "true_state": "phase control, perfect state",
}
"""Strategies in the words of the field."""


def named(strategy: str) -> str:
    """A strategy in words; one of a user's own by its name."""
    return TITLES.get(strategy, shown(strategy))


class Outcome(NamedTuple):
    """Of one shift, what is compared; None: it has no such figure."""

    is_gap: bool | None
    duration_ms: float | None
    impact_j: float | None

    @classmethod
    def of(cls, row: Mapping[str, Any]) -> Outcome:
        """Of a row by name, as `--json` has it. The duration of an engaged shift alone counts."""
        contact, is_engaged = row.get("contact"), row.get("result") == "engaged"
        return cls(
            None if contact is None else contact == "gap",
            row.get("duration_ms") if is_engaged else None,
            row.get("impact_j"),
        )


class Judged(NamedTuple):
    """One figure of two strategies on the same shifts."""

    figure: str
    values: str
    """`0.02 instead of 0.83 J`."""
    is_better: bool | None
    """None: the two are equal."""
    is_beyond_chance: bool | None
    """None: it cannot be said."""

    def __str__(self) -> str:
        if self.is_better is None:
            return f"{self.figure} {self.values}"
        chance = {True: "beyond chance", False: "within chance", None: "chance not known"}
        which = "better" if self.is_better else "worse"
        return f"{self.figure} {self.values} ({which}, {chance[self.is_beyond_chance]})"


def by_pairs(pairs: Sequence[tuple[Outcome, Outcome]]) -> list[Judged]:
    """Each figure that the pairs have, the first of a pair against the second."""
    found = []
    gaps = [(a.is_gap, b.is_gap) for a, b in pairs if a.is_gap is not None and b.is_gap is not None]
    if gaps:
        mine, theirs = (sum(side) for side in zip(*gaps, strict=True))
        values = f"{mine} instead of {theirs} of {len(gaps)}"
        beyond = _sign_test(sum(a > b for a, b in gaps), sum(a < b for a, b in gaps)) < ERROR
        better = None if mine == theirs else mine > theirs
        found.append(Judged("first contact in a gap", values, better, beyond))
    for name, figure, unit, digits in MEANS:
        both = [(getattr(a, name), getattr(b, name)) for a, b in pairs]
        known = [(a, b) for a, b in both if a is not None and b is not None]
        if any(a or b for a, b in known):  # the preset thesis keeps no impacts
            found.append(_mean(figure, known, unit, digits))
    return found


def _mean(figure: str, pairs: list[tuple[float, float]], unit: str, digits: int) -> Judged:
    mine, theirs = (sum(side) / len(pairs) for side in zip(*pairs, strict=True))
    return less_is_better(figure, mine, theirs, unit, digits, _is_beyond(pairs))


def less_is_better(
    figure: str, mine: float, theirs: float, unit: str, digits: int, is_beyond: bool | None
) -> Judged:
    """A mean of which less is better; equal where it is to the digits shown."""
    value, beside = number(mine, digits), number(theirs, digits)
    better = None if value == beside else mine < theirs
    return Judged(figure, f"{value} instead of {beside} {unit}", better, is_beyond)


def sentence(name: str, other: str, shifts: int, judged: Sequence[Judged]) -> str:
    """Whether `name` was better than `other`; empty where nothing was compared."""
    if not judged or not shifts:
        return ""
    sure = [each for each in judged if each.is_beyond_chance and each.is_better is not None]
    ways = {way: [each.figure for each in sure if each.is_better is way] for way in (True, False)}
    if ways[True] and ways[False]:
        verdict = f"is better than {other} in {_and(ways[True])} and worse in {_and(ways[False])}"
    elif sure:
        verdict = f"is {'better' if ways[True] else 'worse'} than {other}"
    elif any(each.is_beyond_chance is None and each.is_better is not None for each in judged):
        verdict = f"cannot be judged against {other}, as chance is not known"
    else:
        verdict = f"differs from {other} by no more than chance"
    return f"On the same {counted(shifts)} {name} {verdict}: {'; '.join(map(str, judged))}."


def _and(figures: Sequence[str]) -> str:
    return " and ".join(figures)


def _sign_test(better: int, worse: int) -> float:
    """How often equal strategies would differ as much, either way."""
    n = better + worse
    tail = sum(math.comb(n, k) for k in range(min(better, worse) + 1))
    return min(1.0, 2.0 * tail / 2.0**n)


def _is_beyond(pairs: Sequence[tuple[float, float]]) -> bool:
    """Whether the 95 % interval of the mean difference leaves out zero."""
    n = len(pairs)
    if n < 2:
        return False
    from scipy.special import stdtrit

    differences = [a - b for a, b in pairs]
    mean = math.fsum(differences) / n
    sd = math.sqrt(math.fsum((d - mean) ** 2 for d in differences) / (n - 1))
    return abs(mean) > float(stdtrit(n - 1, 1.0 - ERROR / 2.0)) * sd / math.sqrt(n)
