"""What a change is compared with: the judged shifts of an earlier campaign, read by columns."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple, Protocol

from meshpoint.base.errors import CommandError
from meshpoint.campaigns.record import GAP, JudgedShift
from meshpoint.campaigns.store import PARTS, SHIFTS_FILE
from meshpoint.campaigns.stored import column_names, read_columns
from meshpoint.campaigns.sweep import BASE_POINT
from meshpoint.campaigns.verdict import PairedRun

DRAWN: Final = (
    "from_gear", "to_gear", "layshaft_rpm", "oil_c", "slope_percent", "mass_kg",
    "supply_offset_bar",
)  # fmt: skip
"""What a run draws: the same before and after, or the two are no pair."""
IMPACT: Final = "impact_j"
RATIOS: Final = ("duration_ms", IMPACT)
"""Figures of a shift that are judged by their ratio, beside the share of gaps."""
TO_THE_LOCK: Final = "impact_complete"
"""Tables without this column have impacts up to the shift's outcome, not up to the gear's lock."""


class Outcome(NamedTuple):
    """Of one judged shift, what pairs need."""

    is_gap: bool
    duration_ms: float | None
    impact_j: float | None
    """None in a table of an older product, which counted impacts otherwise."""
    drawn: tuple[Any, ...]


Outcomes = Mapping[int, Mapping[int, Outcome]]
"""By seed and shift."""


class Baseline(Protocol):
    """Shifts made before the change."""

    name: str
    """For people."""

    def first(self, seeds: list[int]) -> Outcomes:
        """At least what there is of these runs."""


class FileBaseline:
    """An earlier campaign: its `--out` folder, or the table in it."""

    def __init__(self, path: Path, strategy: str) -> None:
        self.name = str(path)
        table = path / SHIFTS_FILE if path.is_dir() else path
        if not table.is_file():
            raise CommandError(f"--against {path}: there is no {table.name}; make it with --out")
        self.outcomes = read_outcomes([table], strategy)
        if not self.outcomes:
            raise CommandError(f"--against {path}: no shift with strategy {strategy}")

    def first(self, _seeds: list[int]) -> Outcomes:
        """All there is: shifts without a partner tell how often the baseline misses."""
        return self.outcomes


def read_outcomes(tables: Iterable[Path], strategy: str) -> dict[int, dict[int, Outcome]]:
    """The shifts of the base point by this strategy. CommandError where a table is none."""
    found: dict[int, dict[int, Outcome]] = {}
    for table in tables:
        columns = read_columns(
            table, ("sweep", "strategy", "seed", "shift", "contact", *RATIOS, *DRAWN)
        )
        counts_to_the_lock = TO_THE_LOCK in column_names(table)
        for sweep, name, seed, shift, contact, time_ms, j, *drawn in zip(*columns, strict=True):
            if (sweep, name) == (BASE_POINT.name, strategy):
                impact_j = j if counts_to_the_lock else None
                outcome = Outcome(contact == GAP, time_ms, impact_j, tuple(drawn))
                found.setdefault(seed, {})[shift] = outcome
    return found


def outcome_tables(folder: Path) -> list[Path]:
    """The tables of a campaign's folder, whether it is still at work or at its end."""
    whole = folder / SHIFTS_FILE
    return [whole] if whole.is_file() else sorted((folder / PARTS).glob("*.parquet"))


def paired_runs(before: Outcomes, after: Iterable[JudgedShift]) -> list[PairedRun]:
    """Each run that both have, in order of the seeds; `after`: by one strategy. CommandError where
    a shift was not drawn alike."""
    runs: dict[int, list[int]] = {}
    for record in after:
        was = before.get(record.seed, {}).get(record.shift)
        if was is None or (record.is_refused and not was.is_gap):
            continue  # no pair of shifts
        _check_draw(was, record)
        counts = runs.setdefault(record.seed, [0, 0, 0, 0])
        now = record.is_gap
        counts[0] += was.is_gap and not now
        counts[1] += now and not was.is_gap
        counts[2] += not now and not was.is_gap
        counts[3] += 1
    return [PairedRun(seed, *counts) for seed, counts in sorted(runs.items())]


def paired_sums(
    before: Outcomes, after: Iterable[JudgedShift]
) -> dict[str, list[tuple[float, float]]]:
    """Of each figure of `RATIOS`, for each run its sums before and after, over the pairs that have
    it both times; in order of the seeds."""
    runs: dict[str, dict[int, list[float]]] = {figure: {} for figure in RATIOS}
    for record in after:
        was = before.get(record.seed, {}).get(record.shift)
        for figure in RATIOS if was is not None else ():
            then, now = getattr(was, figure), getattr(record, figure)
            if then is not None and now is not None:
                sums = runs[figure].setdefault(record.seed, [0.0, 0.0])
                sums[0] += then
                sums[1] += now
    return {
        figure: [(sums[0], sums[1]) for _, sums in sorted(of.items())]
        for figure, of in runs.items()
    }


def _check_draw(was: Outcome, record: JudgedShift) -> None:
    for name, before in zip(DRAWN, was.drawn, strict=True):
        if (now := getattr(record, name)) != before:
            raise CommandError(
                f"--against: shift {record.shift} of run {record.seed} was not drawn alike: {name} "
                f"{before} before, {now} now; make both with the same arguments"
            )
