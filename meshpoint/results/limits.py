"""`--fail-if`: named figures of a run held against limits, and what CI servers and people read."""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, NamedTuple

from meshpoint.results.rows import ShiftRow, Summary

OPERATORS: Final[dict[str, Callable[[float, float], bool]]] = {
    "<=": operator.le,
    ">=": operator.ge,
    "<": operator.lt,
    ">": operator.gt,
}
MEANINGS: Final = {
    "first_contact_gap": "share of first contacts in a gap, of the shifts that could aim where the "
    "strategy aims",
    "engaged": "share of shifts that ended in their gear",
    "reference_known": "share of shifts whose phase reference was known when the sleeve was fired",
    "duration_ms_mean": "mean duration of the engaged shifts",
    "duration_ms_max": "longest of the engaged shifts",
    "phase_error_rms_deg": "RMS phase error at first contact, of the shifts with a known reference",
    "attempts_max": "most attempts of a shift",
    "aborted": "share of shifts whose sleeve was stopped short of the teeth, once or more",
    "aborts_max": "most such aborts of a shift",
    "blocked": "attempts in which sleeve and gear stuck tooth on tooth",
    "outside_window": "contacts of any gear at a slip outside the guard's window",
    "ratchets": "times a flank threw the sleeve back",
    "impact_j_max": "most energy lost in flank impacts of a shift",
}
"""The figures that may be named, each with its meaning."""
_FORM: Final = re.compile(r"\s*(\w+)\s*(<=|>=|<|>)\s*([-+.\deE]+)(%?)\s*")


class Limit(NamedTuple):
    """What must not be so."""

    figure: str
    operator: str
    value: float

    def __str__(self) -> str:
        return f"{self.figure} {self.operator} {self.value:g}"


class LimitResult(NamedTuple):
    """A limit, and what came of it."""

    limit: Limit
    value: float | None
    """None: the run has no such figure."""

    @property
    def failed(self) -> bool:
        """A figure that there is not keeps no limit."""
        if self.value is None:
            return True
        return OPERATORS[self.limit.operator](self.value, self.limit.value)

    @property
    def words(self) -> str:
        """In a line."""
        if self.value is None:
            figure = self.limit.figure
            return f"{figure} cannot be judged: the run has no {MEANINGS[figure]}"
        verdict = "failed" if self.failed else "passed"
        return f"{verdict}: {self.limit.figure} is {self.value:.6g} (fails if {self.limit})"

    def to_json(self) -> dict[str, Any]:
        """By name."""
        return {"fail_if": str(self.limit), "value": self.value, "failed": self.failed}


def parse_limit(text: str) -> Limit:
    """`FIGURE < LIMIT`, per cent where a % follows. ValueError says what is allowed."""
    found = _FORM.fullmatch(text)
    if found is None or found[1] not in MEANINGS:
        raise ValueError(
            f"{text!r}, allowed is FIGURE < LIMIT (or <=, >, >=) with a figure of "
            f"{', '.join(MEANINGS)}"
        )
    try:
        value = float(found[3])
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ValueError(f"{text!r}: {found[3]!r} is no number")
    return Limit(found[1], found[2], value / 100.0 if found[4] else value)


def figures(summary: Summary, rows: Sequence[ShiftRow]) -> Mapping[str, float | None]:
    """Every figure of a run."""
    engaged = [row.duration_ms for row in rows if row.result == "engaged"]
    return {
        "first_contact_gap": summary.gap_rate,
        "engaged": len(engaged) / len(rows) if rows else None,
        "reference_known": summary.reference_known,
        "duration_ms_mean": summary.mean_duration_ms,
        "duration_ms_max": max(engaged, default=None),
        "phase_error_rms_deg": summary.phase_error_rms_deg,
        "attempts_max": max((row.attempts for row in rows), default=None),
        "aborted": summary.aborted / len(rows) if rows else None,
        "aborts_max": max((row.aborts for row in rows), default=None),
        "blocked": sum(row.blocked for row in rows) if rows else None,
        "outside_window": sum(row.outside_window for row in rows) if rows else None,
        "ratchets": sum(row.ratchets for row in rows) if rows else None,
        "impact_j_max": max((row.impact_j for row in rows), default=None),
    }


def judge(limits: Sequence[Limit], summary: Summary, rows: Sequence[ShiftRow]) -> list[LimitResult]:
    """Each limit against the run."""
    values = figures(summary, rows)
    return [LimitResult(limit, values[limit.figure]) for limit in limits]


def markdown(
    title: str, summary: Summary, rows: Sequence[ShiftRow], judged: Sequence[LimitResult]
) -> str:
    """A run's summary for a pull request or a job's page."""
    lines = [f"# {title}", ""]
    if judged:
        lines += ["| fails if | value | |", "|---|---|---|"]
        for each in judged:
            value = "none" if each.value is None else f"{each.value:.6g}"
            lines.append(
                f"| `{each.limit}` | {value} | {'**failed**' if each.failed else 'passed'} |"
            )
        lines.append("")
    lines += ["| figure | value |", "|---|---|"]
    for name, found in figures(summary, rows).items():
        lines.append(f"| `{name}` | {'none' if found is None else f'{found:.6g}'} |")
    lines += ["", f"{len(rows)} shifts, {summary.known} of them with a known phase reference.", ""]
    lines += [
        "| shift | strategy | reference | contact | ms | phase error, deg | aborts | result |"
    ]
    lines += ["|---|---|---|---|---|---|---|---|"]
    for row in rows:
        error = "" if row.phase_error_deg is None else f"{row.phase_error_deg:+.2f}"
        lines.append(
            f"| {row.from_} to {row.to} | {row.strategy} | {row.reference} | {row.contact or ''} "
            f"| {row.duration_ms:.0f} | {error} | {row.aborts} | {row.result} |"
        )
    return "\n".join(lines) + "\n"
