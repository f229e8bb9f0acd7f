"""What ends a campaign before its `--runs`: a goal reached, a budget spent, a verdict given."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final, Protocol

import numpy as np

from meshpoint.campaigns.baseline import IMPACT, Baseline, paired_runs, paired_sums
from meshpoint.campaigns.columns import Shifts
from meshpoint.campaigns.paired_ratio import PairedRatio, paired_ratio
from meshpoint.campaigns.sequential import (
    GAP,
    Estimate,
    Goal,
    estimate,
    looks,
)
from meshpoint.campaigns.spec import is_blind
from meshpoint.campaigns.verdict import Comparison, Verdict
from meshpoint.campaigns.verdict import looks as paired_looks

NOT_JUDGED: Final = (
    "not judged: the version before counted impacts up to the shift's end, not to the gear's lock"
)


class Stopping(Protocol):
    """Says when to look, and then whether to stop."""

    def looks(self, most_runs: int) -> Iterator[int]:
        """The numbers of runs at which to look, the last of them `most_runs`."""

    def enough(self, shifts: Shifts, /) -> bool:
        """Whether these are enough; `shifts` are those of the first this many runs."""

    def may_begin(self, done: int, at_once: int, /) -> bool:
        """Whether there is time for one more run, after `done`, with `at_once` at a time."""

    def to_json(self) -> dict[str, Any]:
        """What came of it, by name."""


class AllRuns:
    """No reason to stop before the last run."""

    def looks(self, most_runs: int) -> Iterator[int]:
        """At the end alone."""
        yield most_runs

    def enough(self, _shifts: Shifts) -> bool:
        """Never."""
        return False

    def may_begin(self, _done: int, _at_once: int) -> bool:
        """Always."""
        return True

    def to_json(self) -> dict[str, Any]:
        """Nothing to say."""
        return {}


class Until:
    """Stops when an interval is narrow enough, or the time for it is spent.

    pair: the strategy, and the one it is held against.
    budget_s: wall seconds; no look and no run is begun that would, by the pace so far, end after
    them.
    """

    def __init__(
        self,
        goal: Goal,
        pair: tuple[str, str],
        budget_s: float | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._goal, self._pair, self._budget_s, self._clock = goal, pair, budget_s, clock
        self._began_s: float | None = None
        self._estimate: Estimate | None = None
        self._plain: Estimate | None = None
        self._why = "runs"

    def looks(self, most_runs: int) -> Iterator[int]:
        """At growing numbers of runs, as long as the time is there."""
        self._began_s = self._clock()
        done = 0
        for runs in looks(most_runs):
            if self._budget_s is not None and done:
                spent_s = self._clock() - self._began_s
                if spent_s * runs / done > self._budget_s:
                    self._why = "budget"
                    return
            yield runs
            done = runs

    def may_begin(self, done: int, at_once: int) -> bool:
        """Whether one more run would, by the pace so far, end within the budget; the first ones
        always, as nothing is known of the pace."""
        if self._budget_s is None or self._began_s is None or not done:
            return True
        spent_s = self._clock() - self._began_s
        has_time = spent_s * (1.0 + at_once / done) <= self._budget_s
        self._why = self._why if has_time else "budget"
        return has_time

    def enough(self, shifts: Shifts) -> bool:
        """Whether the interval is narrow enough."""
        self._estimate = estimate(self._goal, shifts, *self._pair)
        self._plain = estimate(self._goal, shifts, *self._pair, plain=True)
        reached = self._estimate.half_width <= self._goal.half_width
        self._why = "goal" if reached else self._why
        return reached

    def to_json(self) -> dict[str, Any]:
        """The figure, its interval, and why it stopped there."""
        found = {} if self._estimate is None else self._estimate.to_json()
        integrated = [name for name in self._pair if self._goal.figure == GAP and is_blind(name)]
        if integrated and self._plain is not None:
            found |= {"integrated": integrated, "plain": self._plain.to_json()}
        return {
            "until": {
                "goal": str(self._goal),
                "strategies": list(self._pair),
                "stopped_by": self._why,
                **found,
            }
        }


class Against:
    """Stops when it is clear whether the shifts of a baseline have got worse: fewer first contacts
    in a gap, more time, or more impact."""

    def __init__(
        self,
        baseline: Baseline,
        strategies: tuple[str, str],
        margin: float,
        margins: Mapping[str, float],
        seeds: list[int],
    ) -> None:
        """`strategies`: the controller's own before and now; `margin`: of the share of gaps;
        `margins`: of the figures judged by their ratio; `seeds`: of all runs, in order."""
        self._baseline, self._own = baseline, strategies
        self._seeds, self._margins = seeds, dict(margins)
        self.comparison = Comparison(margin)
        self.ratios: dict[str, PairedRatio] = {}
        self._taken = 0

    def looks(self, most_runs: int) -> Iterator[int]:
        """Every few runs (`verdict.looks`)."""
        yield from paired_looks(most_runs)

    def may_begin(self, _done: int, _at_once: int) -> bool:
        """Always."""
        return True

    def enough(self, shifts: Shifts) -> bool:
        """Whether there is a verdict: the runs are taken in the order of their seeds."""
        made = np.unique(shifts.column("seed")).size
        before = self._baseline.first(self._seeds[:made])
        outcomes = [outcome for run in before.values() for outcome in run.values()]
        self.comparison.shifts = len(outcomes)
        self.comparison.misses = sum(not outcome.is_gap for outcome in outcomes)
        own = shifts.by(self._own[1])
        runs = paired_runs(before, own)
        for run in runs[self._taken :]:
            self.comparison.take(run)
        self._taken = len(runs)
        self.comparison.look()
        sums = paired_sums(before, own)
        if all(outcome.impact_j is None for outcome in outcomes):
            self._margins.pop(IMPACT, None)
        self.ratios = {
            figure: paired_ratio(sums[figure], margin) for figure, margin in self._margins.items()
        }
        return self.verdict is not Verdict.OPEN

    @property
    def verdict(self) -> Verdict:
        """Worse where anything is; not worse where nothing is."""
        found = {self.comparison.verdict, *(ratio.verdict for ratio in self.ratios.values())}
        order = (Verdict.WORSE, Verdict.OPEN, Verdict.NOT_WORSE)
        return next(verdict for verdict in order if verdict in found)

    def to_json(self) -> dict[str, Any]:
        """The verdict and what it rests on."""
        before, after = self._own
        judged = {GAP: {"verdict": self.comparison.verdict.value}}
        judged |= {figure: ratio.to_json() for figure, ratio in self.ratios.items()}
        if IMPACT not in self._margins:
            judged[IMPACT] = {"verdict": NOT_JUDGED}
        return {
            "against": {
                "reference": self._baseline.name,
                "strategy": after,
                "strategy_before": before,
                **self.comparison.to_json(),
                "verdict": self.verdict.value,
                "judged": judged,
            }
        }
