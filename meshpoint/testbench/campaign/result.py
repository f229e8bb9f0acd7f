"""What has been run so far, and the campaign's JSON."""

from __future__ import annotations

from collections import Counter
from typing import Any

from meshpoint.testbench.campaign.record import JudgedShift
from meshpoint.testbench.campaign.run import RunResult
from meshpoint.testbench.campaign.spec import CampaignSpec, Job
from meshpoint.testbench.campaign.summary import curve_point, summarise
from meshpoint.testbench.campaign.sweep import BASE_POINT, SweepPoint


class Collected:
    """The results of a campaign's jobs, in any order of coming."""

    def __init__(self, spec: CampaignSpec, jobs: list[Job], records: list[JudgedShift]) -> None:
        self.jobs = jobs
        self._order = {name: k for k, name in enumerate(spec.names)}
        self._records: dict[Job, list[JudgedShift]] = {}
        wanted = set(jobs)
        for record in records:
            job = Job(record.seed, SweepPoint(record.sweep, record.sweep_value))
            if job in wanted:
                self._records.setdefault(job, []).append(record)
        self._failed: dict[Job, RunResult] = {}
        self.shifts = 0
        self.cpu_s = 0.0
        self.strategy_errors: Counter[str] = Counter()
        """What was wrong with a user's own strategy, in the runs made here."""

    @property
    def done(self) -> set[Job]:
        """Runs that came to their end."""
        return set(self._records)

    @property
    def records(self) -> list[JudgedShift]:
        """All judged shifts in order of job, strategy and shift."""
        return [
            record
            for job in self.jobs
            for record in sorted(
                self._records.get(job, []), key=lambda r: (self._order[r.strategy], r.shift)
            )
        ]

    @property
    def failed(self) -> list[RunResult]:
        """Runs that broke off, in order."""
        return [self._failed[job] for job in self.jobs if job in self._failed]

    def left(self, within: list[Job]) -> list[Job]:
        """Of these runs, those not made yet."""
        return [job for job in within if job not in self._records and job not in self._failed]

    def stop_at(self, jobs: list[Job]) -> None:
        """These are all runs there will be."""
        self.jobs = jobs

    def take(self, results: list[RunResult]) -> None:
        """Some more results."""
        for result in results:
            if result.error is None:
                self._records[result.job] = result.records
            else:
                self._failed[result.job] = result
            self.shifts += result.shifts
            self.cpu_s += result.cpu_s
            self.strategy_errors += result.strategy_errors

    def at(self, point: SweepPoint) -> list[JudgedShift]:
        """The records of one point of the sweep."""
        return [r for r in self.records if (r.sweep, r.sweep_value) == point]


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
        "runs": len({record.seed for record in base}),
        "failed": [{"seed": f.job.seed, "error": f.reason} for f in collected.failed],
        **summarise(base, spec.names),
        "sweep": curves,
        "campaign": spec.to_json(),
    }
