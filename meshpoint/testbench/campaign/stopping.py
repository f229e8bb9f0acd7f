"""What ends a campaign before its `--runs`: a goal reached, a budget spent, a verdict given."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final, Protocol

from meshpoint.testbench.campaign.record import JudgedShift
from meshpoint.testbench.campaign.sequential import Estimate, Goal, estimate, looks
from meshpoint.testbench.campaign.store import SHIFTS_FILE, read_records
from meshpoint.testbench.campaign.verdict import Comparison, Verdict, compare_runs
from meshpoint.testbench.errors import CommandError

PAIRED_AT_A_TIME: Final = 8
"""Runs between two looks at the pairs: a verdict may come after any run, and counts up to it."""


class Stopping(Protocol):
    """Says when to look, and then whether to stop."""

    def looks(self, most_runs: int) -> Iterator[int]:
        """The numbers of runs at which to look, the last of them `most_runs`."""

    def enough(self, records: list[JudgedShift], /) -> bool:
        """Whether these are enough; `records` are those of the first so many runs."""

    def to_json(self) -> dict[str, Any]:
        """What came of it, by name."""


class AllRuns:
    """No reason to stop before the last run."""

    def looks(self, most_runs: int) -> Iterator[int]:
        """At the end alone."""
        yield most_runs

    def enough(self, _records: list[JudgedShift]) -> bool:
        """Never."""
        return False

    def to_json(self) -> dict[str, Any]:
        """Nothing to say."""
        return {}


class Until:
    """Stops when an interval is narrow enough, or the time for it is spent.

    pair: the strategy, and the one it is held against.
    budget_s: wall seconds; no look is begun that would, by the pace so far, end after them.
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

    def enough(self, records: list[JudgedShift]) -> bool:
        """Whether the interval is narrow enough."""
        self._estimate = estimate(self._goal, records, *self._pair)
        reached = self._estimate.half_width <= self._goal.half_width
        self._why = "goal" if reached else self._why
        return reached

    def to_json(self) -> dict[str, Any]:
        """The figure, its interval, and why it stopped there."""
        found = {} if self._estimate is None else self._estimate.to_json()
        return {
            "until": {
                "goal": str(self._goal),
                "strategies": list(self._pair),
                "stopped_by": self._why,
                **found,
            }
        }


class Against:
    """Stops when it is clear whether the shifts of a baseline have got worse."""

    def __init__(self, baseline: list[JudgedShift], strategy: str, margin: float) -> None:
        base = [record for record in baseline if record.strategy == strategy]
        if not base:
            raise CommandError(f"--against: the baseline has no shift with strategy {strategy}")
        self._baseline, self._strategy = base, strategy
        self.runs = len({record.seed for record in base})
        """That the baseline has."""
        misses = sum(record.contact != "gap" for record in base) / len(base)
        self.comparison = Comparison(misses, margin)
        self._taken = 0

    def looks(self, most_runs: int) -> Iterator[int]:
        """Every few runs."""
        yield from range(PAIRED_AT_A_TIME, most_runs, PAIRED_AT_A_TIME)
        yield most_runs

    def enough(self, records: list[JudgedShift]) -> bool:
        """Whether there is a verdict: the runs are taken in the order of their seeds."""
        runs = compare_runs(self._baseline, records, self._strategy)
        for run in runs[self._taken :]:
            self.comparison.take(run.worse, run.better, run.pairs)
        self._taken = len(runs)
        return self.comparison.verdict is not Verdict.OPEN

    def to_json(self) -> dict[str, Any]:
        """The verdict and what it rests on."""
        return {"against": {"strategy": self._strategy, **self.comparison.to_json()}}


def read_baseline(path: Path) -> list[JudgedShift]:
    """The judged shifts of a `--out` folder or its table. CommandError where they are not to be
    read."""
    table = path / SHIFTS_FILE if path.is_dir() else path
    if not table.is_file():
        raise CommandError(f"--against {path}: there is no {table.name}; make it with --out")
    return read_records(table)
