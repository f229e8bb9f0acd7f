"""Whether campaigns that stop by themselves are as certain as they say, on simulated records."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from benchmarks.studies.campaign_statistics_run import (
    Coverage,
    CoverageRun,
    Kind,
    VerdictRun,
    Verdicts,
)
from benchmarks.studies.record import (
    Chart,
    Finding,
    Given,
    Line,
    Panel,
    Statement,
    Study,
    Style,
    Table,
    ThesisVerdict,
)
from meshpoint.gearbox.tables import count, quantity

GOALS: Final = (
    ("first_contact_gap difference +-1%", (0.99, 0.22), True),
    ("first_contact_gap difference +-1%", (0.98, 0.22), True),
    ("first_contact_gap difference +-1%", (0.99, 0.22), False),
    ("first_contact_gap difference +-1%", (0.97, 0.96), False),
    ("first_contact_gap difference +-1%", (0.99, 0.99), False),
    ("first_contact_gap ratio +-0.3", (0.99, 0.22), False),
)
"""What is waited for, the rates of the two strategies, and whether that of the second is integrated
over the phase."""
HELD: Final = (0.93, 0.97)
"""Two standard deviations of chance around 0.95, over 500 campaigns."""
MOST_HELD_KNOWN: Final = 0.99
"""Against an integrated rate an interval may hold more than it says: where hardly a shift misses,
all that a campaign sees is whether none or one has."""
MOST_ERRORS: Final = 0.05
MOST_PAIRS: Final = 150
VERDICTS: Final = (
    "kind", "baseline", "misses before, %", "fall, %", "worse, %", "not worse, %", "open, %",
    "median pairs",
)  # fmt: skip
COVERED: Final = ("goal", "rates", "the second", "held", "median runs")


@dataclass(frozen=True)
class Settings:
    """Simulated campaigns and what they are like."""

    campaigns: int = count("campaigns", 2, 100_000)
    """Of each goal, and changes of each kind."""
    shifts: int = count("shifts", 1, 100)
    """Judged in each run."""
    correlation: float = quantity("correlation", 0.001, 0.9)
    """Intra-class, of the shifts of one run."""
    most_runs: int = count("most_runs", 32, 100_000)
    """With --until."""
    runs: int = count("runs", 32, 100_000)
    """With --against, and of the baseline."""
    misses: float = quantity("misses_percent", 0.1, 30.0, 0.01)
    """Before the change."""
    fall: float = quantity("fall_percent", 0.5, 30.0, 0.01)
    """Of the share of gaps; the margin is the same."""
    more_misses: float = quantity("more_misses_percent", 0.1, 30.0, 0.01)
    """A baseline that misses more often."""


def _coverage_jobs(given: Given[Settings]) -> tuple[CoverageRun, ...]:
    own, seed = given.own, given.common.seed
    return tuple(
        CoverageRun(
            goal, rates, own.correlation, own.shifts, own.most_runs, own.campaigns, seed, known
        )
        for goal, rates, known in GOALS
    )


def _verdict_jobs(given: Given[Settings]) -> tuple[VerdictRun, ...]:
    own, seed = given.own, given.common.seed
    return tuple(
        VerdictRun(
            kind, (misses, misses + fall), own.correlation, own.shifts, own.fall, own.runs,
            has_baseline, own.campaigns, seed,
        )
        for misses in (own.misses, own.more_misses)
        for has_baseline in (True, False)
        for kind in Kind
        for fall in (0.0, own.fall)
    )  # fmt: skip


def _jobs(given: Given[Settings]) -> tuple[CoverageRun | VerdictRun, ...]:
    return (*_coverage_jobs(given), *_verdict_jobs(given))


def _conclude(given: Given[Settings]) -> Finding:
    covered: dict[CoverageRun, Coverage] = {j: given.results[j] for j in _coverage_jobs(given)}
    judged: dict[VerdictRun, Verdicts] = {j: given.results[j] for j in _verdict_jobs(given)}
    coverage_rows = tuple(
        (
            job.goal,
            f"{job.hits[0]:g}, {job.hits[1]:g}",
            "integrated" if job.is_integrated else "counted",
            found.held,
            found.median_runs,
        )
        for job, found in covered.items()
    )
    verdict_rows = tuple(_row(job, found) for job, found in judged.items())
    values: dict[str, Any] = {
        "coverage": {f"{row[0]} of {row[1]} {row[2]}": row[3] for row in coverage_rows},
        "verdicts": [dict(zip(VERDICTS, row, strict=True)) for row in verdict_rows],
    }
    tables = (
        Table("coverage", "Intervals of --until, nominal 0.95", COVERED, coverage_rows),
        Table("verdicts", "Verdicts of --against", VERDICTS, verdict_rows),
    )
    return Finding(
        (_coverage_statement(covered), *_verdict_statements(given.own, judged)),
        values,
        (_verdict_chart(given.own, judged), _coverage_chart(covered)),
        tables,
    )


def _row(job: VerdictRun, found: Verdicts) -> tuple[Any, ...]:
    before, after = job.misses
    return (
        job.kind.value, "earlier campaign" if job.has_baseline else "commit", 100.0 * before,
        100.0 * (after - before), 100.0 * found.worse, 100.0 * found.not_worse,
        100.0 * (1.0 - found.worse - found.not_worse), found.median,
    )  # fmt: skip


def _coverage_statement(covered: dict[CoverageRun, Coverage]) -> Statement:
    low, high = HELD
    counted = [found.held for job, found in covered.items() if not job.is_integrated]
    known = [found.held for job, found in covered.items() if job.is_integrated]
    good = low <= min(counted + known) and max(counted) <= high and max(known) <= MOST_HELD_KNOWN
    return Statement(
        "(not in the thesis) intervals of --until with nominal 95 % hold the truth in "
        f"{low:.0%} to {high:.0%}, against an integrated rate in up to {MOST_HELD_KNOWN:.0%}",
        f"{min(counted):.1%} to {max(counted):.1%} of {next(iter(covered)).campaigns} campaigns of "
        f"each goal, against an integrated rate {min(known):.1%} to {max(known):.1%}",
        ThesisVerdict.AGREES if good else ThesisVerdict.DIFFERS,
        "looked at until narrow enough, at fixed numbers of runs that grow by 19 %",
    )


def _verdict_statements(own: Settings, judged: dict[VerdictRun, Verdicts]) -> tuple[Statement, ...]:
    asked = {j: v for j, v in judged.items() if j.has_baseline and j.misses[0] == own.misses}
    fallen = [v for j, v in asked.items() if j.misses[1] > j.misses[0]]
    alike = [v for j, v in asked.items() if j.misses[1] == j.misses[0]]
    missed, wrong = max(v.not_worse for v in fallen), max(v.worse for v in alike)
    found, pairs = min(v.worse for v in fallen), max(v.median for v in fallen)
    rates = f"{1.0 - own.misses:.0%} to {1.0 - own.misses - own.fall:.0%}"
    good = max(missed, wrong) <= MOST_ERRORS and pairs <= MOST_PAIRS
    along = [
        v
        for j, v in judged.items()
        if not j.has_baseline and j.misses == (own.misses, own.misses + own.fall)
    ]
    return (
        Statement(
            f"(not in the thesis) a change from {rates} is distinguished from none with "
            f"errors of 5 % at most, after {MOST_PAIRS} pairs at the median, "
            f"against a baseline of {own.runs} runs",
            f"found in {found:.1%} at least, called not worse in {missed:.1%} at most; no change "
            f"called worse in {wrong:.1%} at most; {pairs:.0f} pairs at most",
            ThesisVerdict.AGREES if good else ThesisVerdict.DIFFERS,
            f"the worst of {len(Kind)} ways in which before and after go together; the rest is not "
            "decided",
        ),
        Statement(
            "(not in the thesis) the same against a commit, whose runs are made along",
            f"called not worse in {max(v.not_worse for v in along):.1%} at most, "
            f"{min(v.median for v in along):.0f} to {max(v.median for v in along):.0f} pairs",
            ThesisVerdict.NOT_COMPARABLE,
            "how often the baseline misses is then known from the pairs alone",
        ),
    )


def _verdict_chart(own: Settings, judged: dict[VerdictRun, Verdicts]) -> Chart:
    """Share of the campaigns that have ended with `worse`, over pairs."""

    def lines(has_baseline: bool) -> tuple[Line, ...]:
        return tuple(
            _ended(job, found, own)
            for job, found in judged.items()
            if job.has_baseline is has_baseline and job.misses[0] == own.misses
        )

    levels, moments = {"5 %": 5.0}, {f"{MOST_PAIRS} pairs": float(MOST_PAIRS)}
    return Chart(
        "verdict_after_pairs",
        f"Simulated changes: lines, {100.0 * own.fall:g} % more misses; dashed, none",
        "pairs",
        (
            Panel("worse, %, earlier campaign", lines(True), levels, moments, (0.0, 100.0)),
            Panel("worse, %, commit", lines(False), levels, moments, (0.0, 100.0)),
        ),
    )


def _ended(job: VerdictRun, found: Verdicts, own: Settings) -> Line:
    pairs = np.arange(0, own.runs * own.shifts + 1, own.shifts)
    ended = np.searchsorted(np.array(found.worse_after), pairs, side="right")
    changed = job.misses[1] > job.misses[0]
    name = job.kind.value if changed else f"{job.kind.value}, no change"
    style = Style.LINE if changed else Style.DASHED
    return Line(name, pairs.tolist(), (100.0 * ended / job.changes).tolist(), style)


def _coverage_chart(covered: dict[CoverageRun, Coverage]) -> Chart:
    low, high = HELD
    names = tuple(
        f"{j.goal.split()[1]} of {j.hits[0]:g}, {j.hits[1]:g}{' known' * j.is_integrated}"
        for j in covered
    )
    held = [found.held for found in covered.values()]
    places = [float(k) for k in range(1, len(names) + 1)]
    levels = {"nominal": 0.95, f"{low:g}": low, f"{high:g}": high}
    panel = Panel("held", (Line("intervals", places, held, Style.POINTS),), levels, {}, (0.9, 1.0))
    title = "Intervals that were looked at until narrow enough"
    return Chart("held", title, "", (panel,), x_names=names)


STUDY = Study(
    "campaign_statistics",
    "How certain are campaigns that stop by themselves",
    ("beyond",),
    Settings,
    _conclude,
    _jobs,
)
