"""What has been run so far, and the campaign's JSON."""

from __future__ import annotations

from array import array
from collections import Counter
from typing import Any

import numpy as np

from meshpoint.campaigns.columns import ShiftColumns, Shifts
from meshpoint.campaigns.record import JudgedShift
from meshpoint.campaigns.run import RunResult
from meshpoint.campaigns.spec import CampaignSpec, Job
from meshpoint.campaigns.summary import curve_point, summarise
from meshpoint.campaigns.sweep import BASE_POINT, SweepPoint
from meshpoint.kernels.records import Integers


class Collected:
    """The results of a campaign's jobs, in any order of coming."""

    def __init__(
        self, spec: CampaignSpec, jobs: list[Job], stored: ShiftColumns | None = None
    ) -> None:
        """`stored`: shifts made before; they are gone on with here."""
        self.jobs = jobs
        self._names = spec.names
        self._columns = ShiftColumns() if stored is None else stored
        self._numbers: dict[Job, int] = {}
        """Of each run that came to its end, in order of coming."""
        self._runs = array("q", self._stored_runs().tobytes())
        """To which run each row belongs."""
        self._failed: dict[Job, RunResult] = {}
        self.shifts_made = 0
        self.cpu_s = 0.0
        self.strategy_errors: Counter[str] = Counter()
        """What was wrong with a user's own strategy, in the runs made here."""

    @property
    def done(self) -> set[Job]:
        """Of the runs that there will be, those that came to their end."""
        return {job for job in self.jobs if job in self._numbers}

    @property
    def left_out(self) -> int:
        """How many runs were made before that there will not be."""
        return len(self._numbers.keys() - set(self.jobs))

    @property
    def shifts(self) -> Shifts:
        """All judged shifts in order of job, strategy and shift."""
        return self.within(self.jobs)

    @property
    def records(self) -> list[JudgedShift]:
        """The same as objects."""
        return list(self.shifts)

    def within(self, jobs: list[Job]) -> Shifts:
        """Those of these runs, in order of job, strategy and shift."""
        runs = np.array(self._runs)
        places = np.full(len(self._numbers) + 1, -1)
        for place, job in enumerate(jobs):
            places[self._numbers.get(job, -1)] = place
        places[-1] = -1  # where those went that are not made yet
        ranks = np.full(len(self._columns.words) + 1, -1)
        every = self._columns.all()
        strategies = every.column("strategy")
        for rank, name in enumerate(self._names):
            ranks[self._columns.code(name)] = rank
        keys = np.stack([places[runs], ranks[strategies], every.column("shift")])
        order = np.lexsort(keys[::-1])
        keys = keys[:, order]
        # what a folder has twice, as in a table and in the parts that it was made of, counts once
        again = np.zeros(order.size, dtype=bool)
        again[1:] = (keys[:, 1:] == keys[:, :-1]).all(axis=0)
        return Shifts(self._columns, order[(keys[0] >= 0) & ~again])

    @property
    def failed(self) -> list[RunResult]:
        """Runs that broke off, in order."""
        return [self._failed[job] for job in self.jobs if job in self._failed]

    def left(self, within: list[Job]) -> list[Job]:
        """Of these runs, those not made yet."""
        return [job for job in within if job not in self._numbers and job not in self._failed]

    def stop_at(self, jobs: list[Job]) -> None:
        """These are all runs there will be."""
        self.jobs = jobs

    def take(self, results: list[RunResult]) -> None:
        """Some more results."""
        for result in results:
            if result.error is None:
                number = self._numbers.setdefault(result.job, len(self._numbers))
                self._columns.extend(result.records)
                self._runs.extend([number] * len(result.records))
            else:
                self._failed[result.job] = result
            self.shifts_made += result.shifts
            self.cpu_s += result.cpu_s
            self.strategy_errors += result.strategy_errors

    def at(self, point: SweepPoint) -> Shifts:
        """The judged shifts of one point of the sweep."""
        return self.within([job for job in self.jobs if job.point == point])

    def _stored_runs(self) -> Integers:
        """Numbers the runs that were made before."""
        stored = self._columns.all()
        seeds, sweeps = stored.column("seed"), stored.column("sweep")
        values = stored.column("sweep_value")
        runs = np.empty(len(stored), dtype=np.int64)
        points = {
            (sweep, value)
            for sweep in np.unique(sweeps).tolist()
            for value in np.unique(values[sweeps == sweep]).tolist()
        }
        for sweep, value in points:
            point = SweepPoint(str(self._columns.words[sweep]), value)
            chosen = (sweeps == sweep) & (values == value)
            found, run_of = np.unique(seeds[chosen], return_inverse=True)
            numbers = [
                self._numbers.setdefault(Job(seed, point), len(self._numbers))
                for seed in found.tolist()
            ]
            runs[chosen] = np.array(numbers)[run_of]
        return runs


def to_json(spec: CampaignSpec, collected: Collected) -> dict[str, Any]:
    """As `campaign --json` prints it: a function of the spec and the number of runs alone."""
    base = collected.at(BASE_POINT)
    curves = [
        {
            "name": point.name,
            "value": point.value,
            "strategies": curve_point(collected.at(point), spec.names),
        }
        for point in spec.sweep
    ]
    return {
        "runs": int(np.unique(base.column("seed")).size),
        "failed": [{"seed": f.job.seed, "error": f.reason} for f in collected.failed],
        **summarise(base, spec.names),
        "sweep": curves,
        "campaign": spec.to_json(),
    }
