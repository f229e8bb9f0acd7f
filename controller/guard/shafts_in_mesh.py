"""Speed wheels held against each other: shafts in mesh turn by the ratio of their teeth.

The input shaft turns the layshaft by the splitter's step, the layshaft the main shaft by the gear
that is in, the main shaft the propeller shaft by the range's step. Of each such pair the guard's
own counts of sensor teeth are compared for as long as the sleeve stands in; with three pairs it is
often clear which wheel is wrong. What was found is remembered while nothing is in mesh, until the
counts agree again.

Which wheels to believe is another question than which one to name. A wheel may read wrong for a
moment: then its neighbours agree with it again one after the other, and the one that is last has
not gone wrong meanwhile. So a wheel is proven right, and the other one of a contradiction named,
only by counts that agreed while the contradiction was made.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum, auto
from typing import Final

from meshpoint.controller.guard.limits import GuardLimits, end_of
from meshpoint.controller.guard.own_speed import TeethCounted
from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.wheels import Wheel

SLACK_TEETH: Final = 2.0
"""Counts may differ by so much, in teeth of the slower wheel: a tooth that gave no edge, backlash,
and pitch errors at either end; and by those that its wheel has left out by the sheet."""
SLACK_SHARE: Final = 0.02
"""And by this share of the count: the speed may change while one wheel's newest edge is waited
for."""
WHOLE_TEETH: Final = 150.0
"""Over this many teeth of the slower wheel without a contradiction the counts agree; a wheel that
reads wrong by less than 3.3 % is not found."""
AGAIN_US: Final = 1_000_000
"""After a contradiction they have to agree for at least this time as well."""
SPLITTER, RANGE = 2, 3
BESIDE: Final = ((1,), (0, 2), (1,))
"""Pairs that share a wheel with a pair."""
MAIN_PAIR: Final = 1

Counts = Sequence[TeethCounted | None]
Ratios = tuple[float | None, float | None, float | None]


class Verdict(Enum):
    """What the counts of two wheels say of each other."""

    NONE = auto()
    """Their shafts are not in mesh, or a wheel is not heard."""
    PENDING = auto()
    """They are, but not for long enough yet."""
    AGREED = auto()
    DENIED = auto()
    """They contradict each other, or did when they were last in mesh."""


class _Pair:
    """Two wheels whose shafts may be in mesh."""

    def __init__(self, a: Wheel, b: Wheel) -> None:
        self._teeth_ratio = b.teeth / a.teeth
        self._slack_teeth = SLACK_TEETH + max(len(a.missing), len(b.missing))
        self.verdict = Verdict.NONE
        self.in_mesh = False
        self._ratio: float | None = None
        self._step = 0
        self._agreed_from = self._agreed_at = self._denied_from = 0
        """Steps: at which those counts began that have agreed without a break since, at which the
        last of them agreed, and at which those of the newest contradiction began."""
        self.begin_anew()

    def proves(self, other: _Pair) -> bool:
        """Whether it has agreed in this step, and the newest contradiction of another pair was made
        while it did."""
        return (
            self.verdict is Verdict.AGREED
            and self._agreed_at == self._step
            and other.verdict is Verdict.DENIED
            and self._agreed_from <= other._denied_from
        )

    def ask_anew(self) -> None:
        """Another pair's contradiction is new: what agreed before it says nothing of it."""
        if self.verdict is Verdict.AGREED:
            self.verdict = Verdict.PENDING
        if self.verdict is Verdict.PENDING:
            self.begin_anew()

    def begin_anew(self) -> None:
        """Another window."""
        self._begun = self._step
        self._before: tuple[TeethCounted, TeethCounted] | None = None
        self._teeth = [0, 0]
        self._took_us = [0, 0]

    def take(self, ratio: float | None, a: TeethCounted | None, b: TeethCounted | None) -> None:
        """ratio: speed of b over that of a; None where they are not in mesh. A count is None where
        a wheel stands, or its newest teeth are not to be believed."""
        self._step += 1
        if ratio is None or ratio != self._ratio:
            self.begin_anew()
        self._ratio = ratio
        self.in_mesh = ratio is not None and a is not None and b is not None
        if ratio is None or a is None or b is None:
            self._before = None
            if self.verdict is not Verdict.DENIED:
                self.verdict = Verdict.NONE
            return
        if self.verdict is Verdict.NONE:
            self.verdict = Verdict.PENDING
        if self._add(a, b):
            self._judge(ratio * self._teeth_ratio)

    def _add(self, a: TeethCounted, b: TeethCounted) -> bool:
        """Adds what both have turned since they were last seen to turn; False without an edge."""
        before = self._before
        if before is None:
            self._before = a, b
            return False
        if a.time_us <= before[0].time_us or b.time_us <= before[1].time_us:
            return False
        for k, (late, early) in enumerate(zip((a, b), before, strict=True)):
            self._teeth[k] += late.teeth - early.teeth
            self._took_us[k] += late.time_us - early.time_us
        self._before = a, b
        return True

    def _judge(self, pace: float) -> None:
        """pace: teeth of b for one of a."""
        counted_a, counted_b = self._teeth
        took_a, took_b = self._took_us
        if pace > 1.0:
            expected, counted = counted_b / pace * took_a / took_b, counted_a
        else:
            expected, counted = counted_a * pace * took_b / took_a, counted_b
        most = max(expected, counted)
        if abs(expected - counted) > self._slack_teeth + SLACK_SHARE * most:
            self.verdict, self._denied_from = Verdict.DENIED, self._begun
            self.begin_anew()
        elif most >= WHOLE_TEETH and (self.verdict is not Verdict.DENIED or took_a >= AGAIN_US):
            if self.verdict is not Verdict.AGREED:
                self._agreed_from = self._begun
            self.verdict, self._agreed_at = Verdict.AGREED, self._step
            self.begin_anew()


class ShaftsInMesh:
    """All pairs, and which wheels they leave in doubt."""

    def __init__(self, sheet: GearboxSheet, limits: GuardLimits) -> None:
        wheels = sheet.wheels
        each = (wheels.input_, wheels.layshaft, wheels.main, wheels.propeller)
        self._pairs = [_Pair(each[k], each[k + 1]) for k in range(3)]
        self._limits = limits
        self._proven: list[set[int]] = [set(), set(), set()]
        """Wheels of each pair that are proven right while it is denied."""
        self._is_news = False
        """A contradiction is new since the doubt was last settled."""
        self.in_doubt: tuple[int, ...] = ()
        """Wheels that read wrong, 0 input, 1 layshaft, 2 main, 3 propeller: one where the others
        agree without it, else all that it may be."""

    @property
    def denies_gear(self) -> bool:
        """Whether layshaft and main shaft contradict each other by the gear that is measured in,
        and each agrees with its other neighbour: the gear's position is wrong."""
        pair = self._pairs[MAIN_PAIR]
        return (
            pair.in_mesh
            and pair.verdict is Verdict.DENIED
            and not self.in_doubt
            and not self._has_to_wait()
        )

    def forget_counts(self) -> None:
        """The sensors have started anew: their counts do not go on. What was found holds."""
        for pair in self._pairs:
            pair.begin_anew()

    def take(self, positions_m: tuple[float, ...] | None, counts: Counts) -> None:
        """One step; positions None where they are not to be believed."""
        pairs, before = self._pairs, [pair.verdict for pair in self._pairs]
        ratios = self._ratios(positions_m)
        for k, pair in enumerate(pairs):
            pair.take(ratios[k], counts[k], counts[k + 1])
        for k, pair in enumerate(pairs):
            if before[k] is not Verdict.DENIED and pair.verdict is Verdict.DENIED:
                self._is_news = True
                for other in pairs:
                    other.ask_anew()
                for proven in self._proven:
                    proven.clear()
        for k, pair in enumerate(pairs):
            for other_k in BESIDE[k]:
                if pair.proves(pairs[other_k]):
                    self._proven[other_k].add(max(k, other_k))
        if not self._has_to_wait():
            self._settle()

    def _settle(self) -> None:
        """What is in doubt from now on. Without a new contradiction no wheel comes into doubt that
        was not, and those that were stay until all that is in mesh agrees again."""
        found, known = self._accused(self._proven), set(self.in_doubt)
        if known and not self._is_news:
            settled = not any(
                pair.verdict is Verdict.DENIED and pair.in_mesh for pair in self._pairs
            )
            if settled and not known & self._accused([self._agreeing()] * 3):
                found = set()
            else:
                found = found & known or known
        self.in_doubt, self._is_news = tuple(sorted(found)), False
        if not self.in_doubt:
            self._forgive()

    def _ratios(self, positions_m: tuple[float, ...] | None) -> Ratios:
        """Speed over speed of each pair by the sleeves that stand in."""
        if positions_m is None:
            return None, None, None
        limits = self._limits
        side = [end_of(position, limits.engaged_m) for position in positions_m]
        gears = [each.ratio for each in limits.main.values() if side[each.sleeve] == each.direction]
        return (
            limits.split_ratio.get(side[SPLITTER]),
            gears[0] if len(gears) == 1 else None,
            limits.range_ratio.get(side[RANGE]),
        )

    def _forgive(self) -> None:
        """No wheel is in doubt any more: what two contradicted that are out of mesh since is
        settled too."""
        for pair in self._pairs:
            if pair.verdict is Verdict.DENIED and not pair.in_mesh:
                pair.verdict = Verdict.NONE

    def _has_to_wait(self) -> bool:
        """With a gear in, the pairs beside a single contradiction tell within a moment which wheel
        it is, or that none is and the gear's position is wrong; nothing is engaged meanwhile."""
        pairs = self._pairs
        denied = [k for k in range(3) if pairs[k].verdict is Verdict.DENIED]
        return (
            pairs[MAIN_PAIR].in_mesh
            and len(denied) == 1
            and any(pairs[other].verdict is Verdict.PENDING for other in BESIDE[denied[0]])
        )

    def _agreeing(self) -> set[int]:
        """Wheels that agree with a neighbour now."""
        pairs = self._pairs
        return {w for k in range(3) if pairs[k].verdict is Verdict.AGREED for w in (k, k + 1)}

    def _accused(self, cleared: Sequence[set[int]]) -> set[int]:
        """The wheels that every contradiction has in common; else, two being wrong, those of each.
        cleared: for each pair the wheels that are none of them."""
        pairs = self._pairs
        denied = [{k, k + 1} - cleared[k] for k in range(3) if pairs[k].verdict is Verdict.DENIED]
        if not denied:
            return set()
        return set.intersection(*denied) or set.union(*denied)
