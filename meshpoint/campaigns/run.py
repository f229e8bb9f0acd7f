"""One run: the learning shifts, then each judged one by every strategy from the same state."""

from __future__ import annotations

import itertools
import time
import traceback
from collections import Counter
from dataclasses import dataclass, field, replace
from functools import cache

from meshpoint.bus.settle import settle
from meshpoint.campaigns.draw import draw
from meshpoint.campaigns.loop import ClosedLoop
from meshpoint.campaigns.record import Conditions, JudgedShift
from meshpoint.campaigns.spec import TRUE_STATE, CampaignSpec, Job
from meshpoint.results.rows import ShiftRow


@dataclass(frozen=True)
class RunResult:
    """What came of a run. `error`: the run broke off, and this is its traceback."""

    job: Job
    records: list[JudgedShift] = field(default_factory=list)
    shifts: int = 0
    """Made in closed loop, the learning ones included."""
    cpu_s: float = 0.0
    error: str | None = None
    strategy_errors: Counter[str] = field(default_factory=Counter)
    """What was wrong with a user's own strategy, and how many shifts ended of it."""

    @property
    def reason(self) -> str:
        """The last line of the traceback."""
        return (self.error or "").strip().rpartition("\n")[2]


def run_one(spec: CampaignSpec, job: Job) -> RunResult:
    """Makes one run. A function of its arguments but for the time it takes. Any error is the
    result of the run, not of the campaign."""
    began_s = time.process_time()
    try:
        result = _shifts(spec.at(job.point), job)
    except Exception:  # noqa: BLE001  # whatever it is, it is reported with the run's seed
        return RunResult(job, error=traceback.format_exc())
    return replace(result, cpu_s=time.process_time() - began_s)


def run_many(spec: CampaignSpec, jobs: list[Job]) -> list[RunResult]:
    """Several runs one after the other: what a worker is given at a time."""
    _settle_once()
    return [run_one(spec, job) for job in jobs]


@cache
def _settle_once() -> None:
    settle()


def _shifts(spec: CampaignSpec, job: Job) -> RunResult:
    shifts = spec.learn + spec.judged
    drawn = draw(job.seed, spec.sheet, spec.preset, spec.pairs, shifts, spec.as_built, spec.profile)
    bench = ClosedLoop(
        spec.sheet, spec.settings, spec.preset, drawn, wire=spec.wire, rest_us=spec.rest_us
    )
    for _ in range(spec.learn):
        bench.shift()
    if drawn.judged:
        bench.change_conditions(drawn.judged)
    conditions = Conditions(spec.sheet, bench.as_built)
    records: dict[str, list[JudgedShift]] = {name: [] for name in spec.names}
    made, errors = spec.learn, Counter[str]()
    for k, planned in enumerate(drawn.plan[spec.learn :]):
        if k > 0 and spec.own not in spec.names:
            bench.shift()
            made += 1
        bench.prepare()
        for name, (row, refusal) in _judged(spec, spec.judges(k), bench, errors).items():
            key = {"sweep": job.point.name, "sweep_value": job.point.value, "seed": job.seed}
            record = conditions.record(planned, row, refusal, **key, shift=k, strategy=name)
            records[name].append(record)
    rows = list(itertools.chain.from_iterable(records.values()))
    return RunResult(job, rows, made + len(rows), strategy_errors=errors)


def _judged(
    spec: CampaignSpec, names: tuple[str, ...], bench: ClosedLoop, errors: Counter[str]
) -> dict[str, tuple[ShiftRow | None, str | None]]:
    """One shift by each of these strategies, on copies of the bench; that goes on by its own. Its
    row, and the fault for which it was refused."""
    rows: dict[str, tuple[ShiftRow | None, str | None]] = {}
    for name in names:
        if name != spec.own:
            copy = bench.fork()
            copy.use(spec.engagement(name), knows_all=name == TRUE_STATE)
            rows[name] = copy.shift(), copy.refusal
            errors += copy.strategy_errors
    if spec.own in spec.names:
        rows[spec.own] = bench.shift(), bench.refusal
    return rows
