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
    "shifts", "strategy", "into\nthe gap", "95 %\ninterval", "phase\nerror\nRMS, deg", "mean\nms",
    "with\nabort",
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
    aborted: int = 0
    """Shifts whose sleeve was stopped short of the teeth, once or more."""
    mean_impact_j: float | None = None
    """Lost in flank impacts a shift; None where the gearbox keeps no tally, as preset thesis."""
    aims: bool = True
    """Whether the strategy aims at a phase."""

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the share into the gap (Wilson)."""
        return wilson(self.gap, self.shifts)

    def to_json(self) -> dict[str, Any]:
        """Figures by name."""
        return vars(self) | {"gap_ci95": list(self.interval)}


def compare(runs: Mapping[str, Sequence[ShiftRow]]) -> list[ShiftGroup]:
    """Aimed shifts, then those that learn, each strategy beside the other; empty groups left out.

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
        for kind, places in ((AIMED_KIND, aimed), (LEARNING, unknown))
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
    impact_j = sum(row.impact_j for row in rows)
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
        aborted=sum(row.aborts > 0 for row in rows),
        mean_impact_j=impact_j / len(rows) if impact_j > 0.0 else None,
        aims=aims,
    )


def headline(groups: Sequence[ShiftGroup], sheet: GearboxSheet) -> str:
    """What happened and why it matters, against today's strategy where it ran too."""
    known = [group for group in groups if group.kind == AIMED_KIND]
    ours = next((group for group in known if group.aims), None)
    others = next((group for group in known if not group.aims), None)
    first = ours or others
    if first is None:
        return "No shift was aimed: a gear's first engagement learns where its teeth are."
    if not first.contacts:
        return "The log does not say where the teeth met: nothing can be said about gap or tooth."
    luck = f"by luck {100 * sheet.dog.backlash_share:.0f} %"
    met = f"Tooth met gap at first contact in {first.gap} of {first.shifts} "
    if ours is None:
        return f"{met}shifts of {shown(first.strategy)}, which does not aim ({luck}){_cost(first)}."
    met += f"shifts aimed by {shown(ours.strategy)}"
    if others is None:
        return f"{met} ({luck}){_cost(ours)}. {WHY}"
    return (
        f"{met}, in {others.gap} of {others.shifts} by {shown(others.strategy)}, which fires as "
        f"gearboxes do today ({luck}){_cost(ours, others)}. {WHY}"
    )


WHY: Final = "Where tooth meets tooth the sleeve waits or is thrown back, and the teeth wear."


def _cost(ours: ShiftGroup, others: ShiftGroup | None = None) -> str:
    """Means of impact and time, a shift, beside another strategy's."""
    means = []
    for name, digits, unit in (("mean_impact_j", 2, "J of impact"), ("mean_duration_ms", 0, "ms")):
        mine, theirs = getattr(ours, name), others and getattr(others, name)
        if mine is None and theirs is None:
            continue
        words = f"{mine or 0.0:.{digits}f}"
        words += "" if theirs is None else f" instead of {theirs:.{digits}f}"
        means.append(f"{words} {unit}")
    return f"; {' and '.join(means)} a shift on average" if means else ""


STRATEGY_WORDS: Final = {
    "speed_window": "fires as soon as the speed difference is small enough, as gearboxes do today",
    "speed_window_anticipating": "fires so that the speed difference is small as the sleeve "
    "arrives; where the teeth are then is left to luck",
    "target_phase": "fires so that, as the sleeve arrives, tooth meets gap",
}


def strategies_explained(groups: Sequence[ShiftGroup]) -> list[str]:
    """Each strategy that the groups name, in a sentence."""
    names = dict.fromkeys(group.strategy for group in groups)
    own = "the strategy of this file"
    return [f"{shown(name)}: {STRATEGY_WORDS.get(name, own)}." for name in names]


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
        str(group.aborted),
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
