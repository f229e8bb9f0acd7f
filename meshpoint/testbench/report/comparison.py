"""What the rows of one or several runs of a plan come to: learning and aimed shifts apart.

A shift aims, or could, where its gear's phase reference was known when the sleeve was fired. The
first engagement of each gear learns it. Strategies are compared over the same shifts of the plan:
those in which the reference was known to every one of them.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from rich.table import Table

from meshpoint.gearbox import GearboxSheet
from meshpoint.testbench.results.output import shown
from meshpoint.testbench.results.rows import ShiftRow, summarise
from meshpoint.testbench.results.wilson import wilson

LEARNING: Final = "learning"
AIMED_KIND: Final = "aimed"
HEADERS: Final = (
    "shifts", "strategy", "into\nthe gap", "95 %\ninterval", "phase error\nRMS, deg", "mean\nms",
)  # fmt: skip


@dataclass(frozen=True)
class ShiftGroup:
    """The shifts of one strategy that belong together."""

    kind: str
    """`LEARNING` or `AIMED_KIND`."""
    strategy: str
    """As it was asked for."""
    shifts: int
    engaged: int
    contacts: int
    """Shifts whose first contact is known; none of another strategy than the recorded one."""
    gap: int
    phase_error_rms_deg: float | None
    """None for a strategy that does not aim, or where there is no contact."""
    mean_duration_ms: float | None
    """Of those that engaged."""

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the share into the gap (Wilson)."""
        return wilson(self.gap, self.shifts)

    def to_json(self) -> dict[str, Any]:
        """Figures by name."""
        return vars(self) | {"gap_ci95": list(self.interval)}


def compare(runs: Mapping[str, Sequence[ShiftRow]]) -> list[ShiftGroup]:
    """Learning shifts, then aimed ones, each strategy beside the other; empty groups left out.

    runs: rows by strategy as it was asked for; shifts pair by gears and how often these came."""
    keyed = {name: _by_place(rows) for name, rows in runs.items()}
    known = [
        {place for place, row in rows.items() if row.reference == "known"}
        for rows in keyed.values()
    ]
    aimed = set.intersection(*known) if known else set()
    unknown = set().union(*(set(rows) for rows in keyed.values())) - aimed
    kinds = {name: summarise(name, list(rows)).aims for name, rows in runs.items()}
    groups = [
        _group(
            kind, name, [row for place, row in rows.items() if place in places], aims=kinds[name]
        )
        for kind, places in ((LEARNING, unknown), (AIMED_KIND, aimed))
        for name, rows in keyed.items()
    ]
    return [group for group in groups if group.shifts]


def _by_place(rows: Sequence[ShiftRow]) -> dict[tuple[int, int, int], ShiftRow]:
    """Rows by their place in the plan, also where a shift before them has no row."""
    count: Counter[tuple[int, int]] = Counter()
    found = {}
    for row in rows:
        gears = row.from_, row.to
        found[*gears, count[gears]] = row
        count[gears] += 1
    return found


def _group(kind: str, strategy: str, rows: list[ShiftRow], *, aims: bool) -> ShiftGroup:
    errors = [row.phase_error_deg for row in rows if row.phase_error_deg is not None]
    durations = [row.duration_ms for row in rows if row.result == "engaged"]
    rms = None
    if aims and kind == AIMED_KIND and errors:
        rms = math.sqrt(sum(error * error for error in errors) / len(errors))
    return ShiftGroup(
        kind=kind,
        strategy=strategy,
        shifts=len(rows),
        engaged=len(durations),
        contacts=sum(row.contact is not None for row in rows),
        gap=sum(row.contact == "gap" for row in rows),
        phase_error_rms_deg=rms,
        mean_duration_ms=sum(durations) / len(durations) if durations else None,
    )


def explain(groups: Sequence[ShiftGroup], sheet: GearboxSheet) -> list[str]:
    """What the groups are, and what luck alone would do."""
    lines = []
    several = len({group.strategy for group in groups}) > 1
    if any(group.kind == LEARNING for group in groups):
        unless = ", or not with every strategy" if several else ""
        lines.append(f"learning: the gear's phase reference was not known yet{unless}.")
    if several:
        lines.append("aimed: the reference was known to both strategies at this shift of the plan.")
    elif any(group.kind == AIMED_KIND for group in groups):
        lines.append("aimed: the gear's phase reference was known.")
    luck = f"{100 * sheet.dog.backlash_share:.0f} %"
    lines.append(f"By luck a tooth meets a gap in {luck} of shifts: gap over pitch.")
    return lines


def cells(group: ShiftGroup) -> list[str]:
    """A group in figures, as tables show it, after its kind and strategy."""
    low, high = group.interval
    rms, mean = group.phase_error_rms_deg, group.mean_duration_ms
    return [
        f"{group.gap} of {group.shifts}" if group.contacts else "-",
        f"{100 * low:.0f} to {100 * high:.0f} %" if group.contacts else "-",
        "-" if rms is None else f"{rms:.2f}",
        "-" if mean is None else f"{mean:.0f}",
    ]


def comparison_table(groups: Sequence[ShiftGroup], gearbox: str) -> Table:
    """Groups under each other, in 80 columns. gearbox: which one, as the title says it."""
    table = Table(title=f"summary, {gearbox}", title_justify="left", box=None, pad_edge=False)
    for column in HEADERS:
        left = column in ("shifts", "strategy")
        table.add_column(
            column,
            justify="left" if left else "right",
            no_wrap=column != "strategy",
            overflow="fold",
        )
    for group in groups:
        table.add_row(group.kind, shown(group.strategy), *cells(group))
    return table
