"""Recorded shifts beside what the other strategy decides in them: rows, table and words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from rich.table import Table

from meshpoint.report.counterfactual import Counterfactual
from meshpoint.report.judged import Judged, rounded
from meshpoint.report.trajectory import Decision
from meshpoint.results.output import broken, counted, number
from meshpoint.results.rows import ShiftRow

SHOWN: Final = ("strategy", "reference", "fired_ms", "predicted_phase_deg")


@dataclass(frozen=True)
class JudgedRow:
    """A shift of the log: its own row, and the other strategy's decisions; None where the recorded
    controller could not be repeated up to it."""

    recorded: ShiftRow
    judged: Judged | None

    def to_json(self, asked: str) -> dict[str, Any]:
        """By name; what came of the shift stands under `recorded` alone. asked: the strategy."""
        row, judged = self.recorded, self.judged
        firing = judged.recorded if judged else None
        recorded = row.to_json() | rounded(
            {
                "release_ms": firing.release_ms if firing else None,
                "fired_ms": firing.fired_ms if firing else None,
            }
        )
        if judged is not None:
            return judged.to_json() | {"recorded": recorded}
        return {
            "from": row.from_,
            "to": row.to,
            "request_us": row.request_us,
            "strategy": asked,
            "status": "not judged",
            "contact": None,
            "contact_why": "the recorded controller could not be repeated up to this shift",
            "recorded": recorded,
        }


def commanded(row: dict[str, Any]) -> dict[str, Any]:
    """A row of `JudgedRow.to_json` in short: the two firings."""
    both = {name: row.get(name) for name in ("from", "to", *SHOWN)}
    return both | {"recorded": {name: row["recorded"][name] for name in SHOWN}}


def judged_table(title: str, rows: Sequence[JudgedRow]) -> Table:
    """One row a shift; `log:` columns are what was recorded."""
    table = Table(
        title=title, title_justify="left", box=None, pad_edge=False, collapse_padding=True
    )
    for column in ("from", "to"):
        table.add_column(column, justify="right")
    table.add_column("strategy", no_wrap=True)
    for column in ("fires\nms", "expects\ndeg", "differs\nms", "lands\ndeg", "gap\n%"):
        table.add_column(column, justify="right", no_wrap=True)
    table.add_column("log:\nstrategy", no_wrap=True)
    table.add_column("log:\ncontact", no_wrap=True)
    for row in rows:
        table.add_row(str(row.recorded.from_), str(row.recorded.to), *_cells(row))
    return table


def _cells(row: JudgedRow) -> list[str]:
    recorded, judged = row.recorded, row.judged
    was = ["-"] * 6
    if judged is not None:
        reported = judged.last if judged.fired_ms is not None else None
        parted = judged.parted.at_ms if judged.parted else None
        fires = judged.status if reported is None else number(reported.fired_ms, 1)
        was = [broken(judged.strategy), fires, _phase_text(reported), number(parted, 1)]
        was += _landing_cells(judged.counterfactual)
    return [*was, broken(recorded.strategy), recorded.contact or "-"]


def _landing_cells(found: Counterfactual | None) -> list[str]:
    """The landing worked out with its 95 % interval, and the chance of a gap."""
    if found is None or found.phase_deg is None:
        return ["-", "-"]
    half = ((found.phase_high_deg or 0.0) - (found.phase_low_deg or 0.0)) / 2.0
    return [f"{found.phase_deg:+.1f}±{half:.1f}", f"{100 * (found.contact_probability or 0.0):.0f}"]


def _phase_text(decision: Decision | None) -> str:
    """The phase it expects at contact, in degrees, with its standard deviation."""
    if decision is None or decision.predicted_phase_deg is None:
        return "-"
    return f"{decision.predicted_phase_deg:+.1f}±{decision.predicted_phase_sd_deg or 0.0:.1f}"


def judged_words(rows: Sequence[JudgedRow], asked: str) -> str:
    """What was judged, in one sentence or two."""
    judged = [row.judged for row in rows if row.judged is not None]
    fired = sum(shift.fired_ms is not None for shift in judged)
    parted = sum(shift.parted is not None for shift in judged)
    text = (
        f"{asked} judged in {len(judged)} of {len(rows)} recorded shifts: fires in {fired}, "
        f"differs from what was recorded in {parted}. Contacts are the log's; "
        f"{_landings(judged, asked)}."
    )
    strayed = [shift.strayed_at_step for shift in judged if shift.strayed_at_step is not None]
    if strayed:
        text += (
            f" From step {min(strayed)} on the recorded controller is not repeated exactly: later "
            "shifts are judged from a state like the recorded one, not from it."
        )
    return text


def _landings(judged: Sequence[Judged], asked: str) -> str:
    """Where the other strategy would have landed, in words."""
    landings = [shift.counterfactual for shift in judged if shift.counterfactual is not None]
    chances = [found.contact_probability for found in landings if found.decidable]
    reported = [chance for chance in chances if chance is not None]
    if not reported:
        return f"where {asked} would have met is not in it"
    return (
        f"where {asked} would have met is worked out for {counted(len(reported))} (95 % intervals)"
        f": {sum(reported):.1f} first contacts in a gap are expected of these"
    )
