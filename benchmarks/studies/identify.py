"""Whether the intervals of `meshpoint identify` hold the values of gearboxes as they were built."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from benchmarks.studies.identify_run import Gearbox, IdentifyRun, Reported
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
from meshpoint.gearbox import load_sheet
from meshpoint.gearbox.sheet import SHEET_NAMES
from meshpoint.gearbox.tables import count, quantity, text
from meshpoint.results.wilson import wilson
from meshpoint.rig_sim.settings import Profile

COLUMNS: Final = ("figure", "unit", "reported", "covered", "half interval", "error", "data sheet's")
DOG: Final = "truck12-dog"
CHECKS: Final = ("kept out", "unit", "identified", "data sheet")


@dataclass(frozen=True)
class Settings:
    """How many gearboxes, and the share that shall lie in the intervals."""

    gearbox: str = text("gearbox", *SHEET_NAMES)
    """The data sheet that they are drawn around, whatever the other studies' is."""
    gearboxes: int = count("gearboxes", 1, 10_000)
    dog_gearboxes: int = count("dog_gearboxes", 0, 10_000)
    """And of `truck12-dog`, for its splitter's figures."""
    shifts: int = count("shifts", 6, 1000)
    """In the log of each."""
    profile: str = text("profile", *Profile)
    """Of the gearboxes that are drawn."""
    least: float = quantity("least_percent", 0.0, 100.0, 0.01)
    most: float = quantity("most_percent", 0.0, 100.0, 0.01)
    """Of what 95 % intervals hold, between these: fewer are too narrow, more too wide."""


def _jobs(given: Given[Settings]) -> tuple[IdentifyRun, ...]:
    own, seed = given.own, given.common.seed
    return tuple(
        IdentifyRun(load_sheet(name), seed + number, own.shifts, Profile(own.profile))
        for name, boxes in ((own.gearbox, own.gearboxes), (DOG, own.dog_gearboxes))
        for number in range(boxes)
    )


def _conclude(given: Given[Settings]) -> Finding:
    own = given.own
    boxes: list[Gearbox] = [given.results[job] for job in _jobs(given)]
    by_name: dict[str, list[Reported]] = {}
    for box in boxes:
        for one in box.reported:
            by_name.setdefault(one.name, []).append(one)
    rows = tuple(_row(name, seen) for name, seen in by_name.items())
    reported = [
        (number, one.covered)
        for number, box in enumerate(boxes)
        for one in box.reported
        if one.value is not None
    ]
    hits = np.array([hit for _, hit in reported])
    share = float(hits.mean()) if reported else 0.0
    clusters = np.array([number for number, _ in reported])
    interval = rate_interval(hits, clusters) if reported else (0.0, 1.0)
    edges = _edges(boxes)
    outside = [name for name, seen in by_name.items() if not _may_be_honest(seen, own)]
    is_honest = own.least <= share <= own.most and not outside
    least = min((_share(seen) for seen in by_name.values()), default=0.0)
    statements = (
        Statement(
            "(not in the thesis) values as built lie in the 95 % intervals that a log of "
            f"{own.shifts} shifts gives, {own.least:.0%} to {own.most:.0%} of them and of each "
            f"figure's in {len(boxes)} gearboxes",
            f"{share:.1%} of {len(reported)} ({interval[0]:.1%} to {interval[1]:.1%}); least of a "
            f"figure {least:.0%}; outside: {', '.join(outside) or 'none'}",
            ThesisVerdict.AGREES if is_honest else ThesisVerdict.DIFFERS,
            "the truth is the rig's own, which the log does not hold; every figure that is printed "
            "has one",
        ),
    )
    checks = _checks(boxes)
    values: dict[str, Any] = {
        "gearboxes": len(boxes),
        "reported": len(reported),
        "coverage": share,
        "coverage_interval": list(interval),
        "edges_covered": edges,
        "outside": outside,
        "by_figure": {row[0]: dict(zip(COLUMNS[1:], row[1:], strict=True)) for row in rows},
        "held_out": {row[0]: dict(zip(CHECKS[1:], row[1:], strict=True)) for row in checks},
    }
    tables = (
        Table("figures", "Figure by figure, medians over the gearboxes", COLUMNS, rows),
        Table("held_out", "RMS errors of predictions, medians", CHECKS, checks),
    )
    return Finding(statements, values, (_chart(by_name),), tables)


def _share(seen: list[Reported]) -> float:
    reported = [one.covered for one in seen if one.value is not None]
    return sum(reported) / len(reported) if reported else 1.0


def _may_be_honest(seen: list[Reported], own: Settings) -> bool:
    """Whether a figure's intervals may hold `least` to `most` of its truths, by as few gearboxes as
    there are."""
    count = sum(one.value is not None for one in seen)
    if count == 0:
        return True
    low, high = wilson(_share(seen) * count, count)
    return high >= own.least and low <= own.most


def _row(name: str, seen: list[Reported]) -> tuple[Any, ...]:
    reported = [one for one in seen if one.value is not None]
    half = _median([0.5 * (one.high - one.low) for one in reported])
    error = _median([abs((one.value or 0.0) - one.truth) for one in reported])
    sheet = [abs(one.sheet - one.truth) for one in reported if one.sheet is not None]
    covered = sum(one.covered for one in reported)
    of_sheet = _median(sheet) if sheet else None
    return name, seen[0].unit, len(reported), covered, half, error, of_sheet


def _median(values: list[float]) -> float:
    return float(np.median(values)) if values else 0.0


def _edges(boxes: list[Gearbox]) -> dict[str, float]:
    """Share of single edges that lie in their own intervals, by wheel."""
    sums: dict[str, list[int]] = {}
    for box in boxes:
        for wheel, edges, inside in box.teeth:
            both = sums.setdefault(wheel, [0, 0])
            both[0] += edges
            both[1] += inside
    return {wheel: inside / edges for wheel, (edges, inside) in sums.items()}


def _checks(boxes: list[Gearbox]) -> tuple[tuple[Any, ...], ...]:
    seen: dict[tuple[str, str], list[tuple[float, float]]] = {}
    for box in boxes:
        for name, unit, identified, by_sheet in box.held_out:
            seen.setdefault((name, unit), []).append((identified, by_sheet))
    return tuple(
        (name, unit, _median([own for own, _ in pairs]), _median([sheet for _, sheet in pairs]))
        for (name, unit), pairs in seen.items()
    )


def _chart(by_name: dict[str, list[Reported]]) -> Chart:
    """Errors over half the interval, in order."""
    shares = sorted(
        (one.truth - 0.5 * (one.low + one.high)) / (0.5 * (one.high - one.low))
        for seen in by_name.values()
        for one in seen
        if one.value is not None and math.isfinite(one.low) and one.high > one.low
    ) or [0.0]
    place = [100.0 * (k + 0.5) / len(shares) for k in range(len(shares))]
    panel = Panel(
        "truth less the interval's middle, over half the interval",
        (Line("figures", place, shares, Style.LINE),),
        {"end of the interval": 1.0, "other end": -1.0},
    )
    return Chart("intervals", "What logs tell of gearboxes", "figures, per cent", (panel,))


STUDY = Study(
    "identify",
    "What a log says of its gearbox, against what was built",
    ("beyond",),
    Settings,
    _conclude,
    _jobs,
)
