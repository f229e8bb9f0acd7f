"""Commissioning on drawn gearboxes whose data sheet is withheld, some of them miswired."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from benchmarks.studies.commission_run import Box, CommissionRun
from benchmarks.studies.record import (
    Finding,
    Given,
    Statement,
    Study,
    Table,
    ThesisVerdict,
)
from meshpoint.campaigns.intervals import rate_interval
from meshpoint.gearbox import load_sheet
from meshpoint.gearbox.sheet import SHEET_NAMES
from meshpoint.gearbox.tables import count, quantity, text

RESAMPLES: Final = 4000
STREAM: Final = 0xC0
COLUMNS: Final = ("seed", "wrong", "named", "found bad")


@dataclass(frozen=True)
class Settings:
    """How many gearboxes, and how far from the true sheet's the first contacts may be."""

    gearbox: str = text("gearbox", *SHEET_NAMES)
    """The data sheet that they are drawn around, whatever the other studies' is."""

    gearboxes: int = count("gearboxes", 1, 10_000)
    miswired: float = quantity("miswired_percent", 0.0, 100.0, 0.01)
    """Share of the gearboxes with one thing wrong."""
    learning_shifts: int = count("learning_shifts", 0, 100)
    """Of each gearbox with either sheet, before its shifts count."""
    shifts: int = count("shifts", 1, 1000)
    """Judged, of each gearbox with either sheet."""
    margin: float = quantity("margin_percent", 0.0, 100.0, 0.01)


def _jobs(given: Given[Settings]) -> tuple[CommissionRun, ...]:
    own, sheet = given.own, load_sheet(given.own.gearbox)
    return tuple(
        CommissionRun(
            sheet,
            given.common.seed + number,
            own.miswired,
            own.learning_shifts,
            own.shifts,
            given.profile,
        )
        for number in range(own.gearboxes)
    )


def _conclude(given: Given[Settings]) -> Finding:
    own, jobs = given.own, _jobs(given)
    boxes: list[tuple[int, Box]] = [(job.seed, given.results[job]) for job in jobs]
    wrong = [(seed, box) for seed, box in boxes if box.is_miswired]
    sound = [(seed, box) for seed, box in boxes if not box.is_miswired]
    named = sum(box.is_right for _, box in wrong)
    called = sum(box.is_right for _, box in sound)
    reported = sum(box.reported for _, box in sound)
    mistaken = sum(box.mistaken for _, box in sound)
    judged = [box for _, box in sound if box.gaps]
    with_true, with_own = _rate([b.true_gaps for b in judged]), _rate([b.gaps for b in judged])
    low, high = _difference(judged)
    difference = with_own[0] - with_true[0]
    statements = (
        Statement(
            "(not in the thesis) every miswiring is named, and nothing is named where nothing is "
            "wrong",
            f"{named} of {len(wrong)} miswirings named, {called} of {len(sound)} sound gearboxes "
            f"called sound; of {reported} tooth counts and ratios reported, {mistaken} wrong",
            _verdict(named == len(wrong) and called == len(sound) and not mistaken),
            "without a data sheet, by how shafts turn and sleeves move",
        ),
        Statement(
            "(not in the thesis) first contacts with the measured sheet are in the gap as often as "
            f"with the true one, within {own.margin:.2f}",
            f"{with_own[0]:.3f} ({with_own[1]:.3f} to {with_own[2]:.3f}) and {with_true[0]:.3f} "
            f"({with_true[1]:.3f} to {with_true[2]:.3f}); difference {difference:+.3f} "
            f"({low:+.3f} to {high:+.3f}) in {len(judged)} gearboxes of {own.shifts} shifts",
            _verdict(bool(judged) and abs(difference) <= own.margin),
            "the same gearbox makes the same shifts with either; the interval is by gearbox",
        ),
    )
    rows = tuple(
        (seed, box.wrong, "yes" if box.is_right else "no", "; ".join(box.said) or "-")
        for seed, box in boxes
        if box.is_miswired or not box.is_right
    )
    values: dict[str, Any] = {
        "gearboxes": len(boxes),
        "miswired": len(wrong),
        "named": named,
        "sound": len(sound),
        "called_sound": called,
        "reported": reported,
        "mistaken": mistaken,
        "judged": len(judged),
        "in_gap_true_sheet": list(with_true),
        "in_gap_measured": list(with_own),
        "difference": [difference, low, high],
        "by_gearbox": [
            [seed, sum(box.true_gaps), sum(box.gaps), box.reported, box.mistaken]
            for seed, box in sound
        ],
        "simulated_s": sum(box.simulated_s for _, box in boxes),
    }
    tables = (
        Table("boxes", "Miswired gearboxes, and those not called what they are", COLUMNS, rows),
    )
    return Finding(statements, values, (), tables)


def _verdict(agrees: bool) -> ThesisVerdict:
    return ThesisVerdict.AGREES if agrees else ThesisVerdict.DIFFERS


def _rate(met: list[tuple[bool, ...]]) -> tuple[float, float, float]:
    """A share and its interval; the shifts of a gearbox are a cluster."""
    hits = np.array([hit for one in met for hit in one])
    if not hits.size:
        return 0.0, 0.0, 1.0
    clusters = np.array([number for number, one in enumerate(met) for _ in one])
    low, high = rate_interval(hits, clusters)
    return float(hits.mean()), low, high


def _difference(boxes: list[Box]) -> tuple[float, float]:
    """The 95 % interval of the difference, by drawing gearboxes anew (bootstrap)."""
    each = np.array([np.mean(box.gaps) - np.mean(box.true_gaps) for box in boxes])
    if each.size < 2:
        return -1.0, 1.0
    rng = np.random.Generator(np.random.PCG64(STREAM))
    means = each[rng.integers(each.size, size=(RESAMPLES, each.size))].mean(axis=1)
    low, high = np.percentile(means, (2.5, 97.5))
    return float(low), float(high)


STUDY = Study(
    "commission",
    "Commissioning gearboxes whose data sheet is withheld",
    ("beyond",),
    Settings,
    _conclude,
    _jobs,
)
