"""What the rows of one or several runs of a plan come to: learning shifts apart from those in which
the phase reference was known.

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
from meshpoint.results.better import Outcome, by_pairs, named, sentence
from meshpoint.results.output import shown
from meshpoint.results.rows import LOCK_WAIT_US, ShiftRow, summarise
from meshpoint.results.wilson import wilson

LEARNING: Final = "learning"
KNOWN: Final = "known"
HEADERS: Final = (
    "shifts", "strategy", "into\nthe gap", "95 %\ninterval", "phase\nerror\nRMS, deg", "mean\nms",
    "with\nabort",
)  # fmt: skip


@dataclass(frozen=True)
class ShiftGroup:
    """The shifts of one strategy that belong together."""

    kind: str
    """`LEARNING` or `KNOWN`: whether the phase reference was."""
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
    impact_incomplete: int = 0
    """Shifts whose gear had not locked when their rows were closed: the mean may be too low."""
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
    known = _known(keyed)
    unknown = set().union(*(set(rows) for rows in keyed.values())) - known
    kinds = {name: summarise(name, list(rows)).aims for name, rows in runs.items()}
    groups = [
        _group(
            kind, name, [row for place, row in rows.items() if place in places], aims=kinds[name]
        )
        for kind, places in ((KNOWN, known), (LEARNING, unknown))
        for name, rows in keyed.items()
    ]
    return [group for group in groups if group.shifts]


Place = tuple[int, int, int]
"""In a plan: gears, and how often these came before."""


def _known(keyed: Mapping[str, Mapping[Place, ShiftRow]]) -> set[Place]:
    """Where the reference was known to every one of these runs."""
    known = [
        {place for place, row in rows.items() if row.reference == "known"}
        for rows in keyed.values()
    ]
    return set.intersection(*known) if known else set()


def _by_place(rows: Sequence[ShiftRow]) -> dict[Place, ShiftRow]:
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
    if aims and kind == KNOWN and errors:
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
        impact_incomplete=sum(not row.impact_complete for row in rows),
        aims=aims,
    )


def headline(groups: Sequence[ShiftGroup], sheet: GearboxSheet, better: str = "") -> str:
    """What happened and why it matters, against today's strategy where it ran too; `better`: the
    sentence of `verdict`."""
    known = [group for group in groups if group.kind == KNOWN]
    ours = next((group for group in known if group.aims), None)
    others = next((group for group in known if not group.aims), None)
    first = ours or others
    if first is None:
        return "No shift was aimed: a gear's first engagement learns where its teeth are."
    if not first.contacts:
        return "The log does not say where the teeth met: nothing can be said about gap or tooth."
    chance = f"by chance {100 * sheet.dog.backlash_share:.0f} %"
    met = f"Tooth met gap at first contact in {first.gap} of {first.shifts} shifts by "
    if ours is None:
        return f"{met}{named(first.strategy)}, which does not aim ({chance}){_cost(first)}."
    met += named(ours.strategy)
    if others is None:
        return f"{met} ({chance}){_cost(ours)}. {WHY}"
    met += f", in {others.gap} of {others.shifts} by {named(others.strategy)} ({chance})."
    return f"{met} {better} {WHY}"


WHY: Final = "Where tooth meets tooth the sleeve waits or bounces off, and the teeth wear."


def _cost(group: ShiftGroup) -> str:
    """Means of impact and time, a shift."""
    means = [(group.mean_impact_j, 2, "J of impact"), (group.mean_duration_ms, 0, "ms")]
    words = [f"{mean:.{digits}f} {unit}" for mean, digits, unit in means if mean is not None]
    return f"; {' and '.join(words)} a shift on average" if words else ""


def verdict(runs: Mapping[str, Sequence[ShiftRow]]) -> str:
    """Whether the run that aims was better than the other one, on the shifts of the plan in which
    both could; empty where there are no two such runs."""
    keyed = {name: _by_place(rows) for name, rows in runs.items()}
    aims = {name: summarise(name, list(rows)).aims for name, rows in runs.items()}
    ours, others = (next((n for n in runs if aims[n] is way), None) for way in (True, False))
    if ours is None or others is None:
        return ""
    both = [
        (Outcome.of(vars(keyed[ours][place])), Outcome.of(vars(keyed[others][place])))
        for place in sorted(_known(keyed))
    ]
    return sentence(named(ours), named(others), len(both), by_pairs(both))


STRATEGY_WORDS: Final = {
    "speed_window": "fires as soon as the speed difference is small enough, as gearboxes do today",
    "speed_window_anticipating": "fires so that the speed difference is small as the sleeve "
    "arrives; where the teeth are then is left to chance",
    "target_phase": "fires so that, as the sleeve arrives, tooth meets gap",
}


def strategies_explained(groups: Sequence[ShiftGroup]) -> list[str]:
    """Each strategy that the groups name, in a sentence."""
    names = dict.fromkeys(group.strategy for group in groups)
    own = "the strategy of this file"
    return [f"{shown(name)}: {STRATEGY_WORDS.get(name, own)}." for name in names]


def explain(groups: Sequence[ShiftGroup], sheet: GearboxSheet) -> list[str]:
    """What the groups are, and what chance alone would do."""
    lines = []
    several = len({group.strategy for group in groups}) > 1
    if any(group.kind == LEARNING for group in groups):
        unless = ", or not with every strategy" if several else ""
        lines.append(f"learning: the gear's phase reference was not known yet{unless}.")
    if several:
        lines.append("known: the reference was known to both strategies at this shift of the plan.")
    elif any(group.kind == KNOWN for group in groups):
        lines.append("known: the gear's phase reference was known.")
    chance = f"{100 * sheet.dog.backlash_share:.0f} %"
    lines.append(f"By chance a tooth meets a gap in {chance} of shifts: gap over pitch.")
    if waiting := sum(group.impact_incomplete for group in groups):
        lines.append(
            f"Of {waiting} shifts the impact is not complete: the gear had not locked "
            f"{LOCK_WAIT_US / 1e6:g} s after the shift's end."
        )
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
