"""What a log says of another strategy's landing, against the truth that only a rig has."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from benchmarks.studies.counterfactual_run import Compared, CounterfactualRun
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
from meshpoint.campaigns.intervals import rate_interval
from meshpoint.gearbox.tables import count, quantity
from meshpoint.units import DEG

DIRECTIONS: Final = (("speed_window", "target_phase"), ("target_phase", "speed_window"))
"""Recorded strategy and the one that is asked about, in turn."""
NUMBER: Final = re.compile(r"\d+(\.\d+)?")
COUNT_COLUMNS: Final = (
    "recorded, asked",
    "shifts",
    "reported",
    "covered",
    "half interval, deg",
    "same",
)


@dataclass(frozen=True)
class Settings:
    """How many shifts, and the share that the intervals shall cover."""

    shifts: int = count("shifts", 1, 100_000)
    learning_shifts: int = count("learning_shifts", 1, 100)
    """Of each truck, before its shifts count."""
    shifts_of_one: int = count("shifts_of_one", 1, 1000)
    """Of one truck; then another is drawn, and the strategies change places."""
    least: float = quantity("least_percent", 0.0, 100.0, 0.01)
    most: float = quantity("most_percent", 0.0, 100.0, 0.01)


def _jobs(given: Given[Settings]) -> tuple[CounterfactualRun, ...]:
    own = given.own
    return tuple(
        CounterfactualRun(
            given.sheet,
            given.common.seed + number,
            own.learning_shifts,
            min(own.shifts_of_one, own.shifts - first),
            *DIRECTIONS[number % len(DIRECTIONS)],
            given.profile,
        )
        for number, first in enumerate(range(0, own.shifts, own.shifts_of_one))
    )


def _conclude(given: Given[Settings]) -> Finding:
    own, jobs = given.own, _jobs(given)
    by_direction = {
        f"{recorded}, {asked}": [
            (number, shift)
            for number, job in enumerate(jobs)
            if (job.recorded, job.asked) == (recorded, asked)
            for shift in given.results[job]
        ]
        for recorded, asked in DIRECTIONS
    }
    every = [pair for pairs in by_direction.values() for pair in pairs]
    reported = [(number, shift) for number, shift in every if not shift.why]
    coverage, interval = _coverage(reported)
    reasons = Counter(
        "same commands as recorded" if shift.is_same else NUMBER.sub("n", shift.why)
        for _, shift in every
        if shift.why
    )
    agrees = own.least <= coverage <= own.most
    statements = (
        Statement(
            "(not in the thesis) 95 % intervals of a landing worked out from a log hold the true "
            f"one in {own.least:.0%} to {own.most:.0%}",
            f"{coverage:.1%} of {len(reported)} ({interval[0]:.1%} to {interval[1]:.1%}); of "
            f"{len(every)} shifts {len(every) - len(reported)} are not reported",
            ThesisVerdict.AGREES if agrees else ThesisVerdict.DIFFERS,
            "the truth is the same bench, copied at the request, with the other strategy",
        ),
    )
    rows = tuple((name, *_counts(pairs)) for name, pairs in by_direction.items())
    values: dict[str, Any] = {
        "shifts": len(every),
        "reported": len(reported),
        "coverage": coverage,
        "coverage_interval": list(interval),
        "not_reported": dict(sorted(reasons.items())),
        "expected_in_gap": _mean([shift.probability for _, shift in reported]),
        "in_gap": _mean([float(shift.in_gap) for _, shift in reported]),
        "by_direction": {
            row[0]: dict(zip(COUNT_COLUMNS[1:], row[1:], strict=True)) for row in rows
        },
    }
    tables = (
        Table("directions", "By recorded and asked strategy", COUNT_COLUMNS, rows),
        Table(
            "not_reported",
            "Why no landing is reported",
            ("reason", "shifts"),
            tuple(reasons.items()),
        ),
    )
    pitch_deg = given.sheet.dog.pitch_rad / DEG
    return Finding(statements, values, (_chart(reported, pitch_deg),), tables)


def _coverage(reported: list[tuple[int, Compared]]) -> tuple[float, tuple[float, float]]:
    """Share of intervals that hold the truth, and its interval; shifts of a truck are a cluster."""
    if not reported:
        return 0.0, (0.0, 1.0)
    clusters = np.unique([number for number, _ in reported], return_inverse=True)[1]
    hits = np.array([shift.covered for _, shift in reported])
    return float(hits.mean()), rate_interval(hits, clusters)


def _counts(pairs: list[tuple[int, Compared]]) -> tuple[int, int, int, float, int]:
    reported = [shift for _, shift in pairs if not shift.why]
    return (
        len(pairs),
        len(reported),
        sum(shift.covered for shift in reported),
        _mean([shift.half_deg for shift in reported]),
        sum(shift.is_same for _, shift in pairs),
    )


def _mean(values: list[float]) -> float:
    return sum(values) / len(values) if values else 0.0


def _chart(reported: list[tuple[int, Compared]], pitch_deg: float) -> Chart:
    """Errors over half the interval, in order."""
    share = sorted(shift.error_deg / shift.half_deg for _, shift in reported) or [0.0]
    place = [100.0 * (k + 0.5) / len(share) for k in range(len(share))]
    panel = Panel(
        "true landing less the one worked out, over half the interval",
        (Line("shifts", place, share, Style.LINE),),
        {"end of the interval": 1.0, "other end": -1.0},
    )
    title = f"Landings worked out from a log; pitch {pitch_deg:g} deg"
    return Chart("landings", title, "shifts, per cent", (panel,))


STUDY = Study(
    "counterfactual",
    "Where another strategy would have landed, as a log shows it",
    ("beyond",),
    Settings,
    _conclude,
    _jobs,
)
