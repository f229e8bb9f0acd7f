"""What commands print: rows, summaries, JSON."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from testbench.errors import CommandError
from testbench.rows import ShiftRow, Summary

COLUMNS = (
    "from", "to", "strategy", "reference", "duration ms", "slip rpm", "phase error deg",
    "% of pitch", "contact", "attempts", "result",
)  # fmt: skip


def write_json(target: str, values: dict[str, Any]) -> None:
    """Writes sorted JSON to a file, or to standard output for `-`."""
    text = json.dumps(values, indent=1, sort_keys=True, allow_nan=False) + "\n"
    if target == "-":
        sys.stdout.write(text)
        return
    path = Path(target)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise CommandError(f"{path}: cannot be written: {error.strerror or error}") from error


def console(json_target: str | None = None) -> Console:
    """Where people read: standard output, or standard error when JSON goes to standard output."""
    return Console(stderr=json_target == "-", soft_wrap=False, highlight=False)


def _number(value: float | None, digits: int, signed: bool = False) -> str:
    if value is None:
        return "-"
    return f"{value:+.{digits}f}" if signed else f"{value:.{digits}f}"


def cells(row: ShiftRow) -> list[str]:
    """A row as the table shows it."""
    contact = {"gap": "[green]gap[/]", "tooth": "[red]tooth[/]", None: "-"}[row.contact]
    return [
        str(row.from_),
        str(row.to),
        row.strategy,
        row.reference,
        f"{row.duration_ms:.0f}",
        _number(row.slip_rpm, 1, signed=True),
        _number(row.phase_error_deg, 2, signed=True),
        _number(row.phase_error_pct_of_pitch, 1, signed=True),
        contact,
        str(row.attempts),
        row.result,
    ]


def rows_table(title: str, rows: list[ShiftRow]) -> Table:
    """One row a shift."""
    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    for column in COLUMNS:
        right = column not in ("strategy", "reference", "contact", "result")
        table.add_column(column, justify="right" if right else "left", no_wrap=True)
    for row in rows:
        table.add_row(*cells(row))
    return table


def summary_table(summaries: list[Summary]) -> Table:
    """Strategies side by side."""
    table = Table(title="summary", title_justify="left", box=None, pad_edge=False)
    for column in (
        "strategy", "shifts", "reference known", "into the gap", "rate", "phase error RMS deg",
        "mean duration ms",
    ):  # fmt: skip
        table.add_column(column, justify="left" if column == "strategy" else "right")
    for summary in summaries:
        aims = summary.strategy == "target_phase"
        hits, shots = (
            (summary.gap_known, summary.known) if aims else (summary.gap, summary.shifts)
        )
        rate = summary.gap_rate
        table.add_row(
            summary.strategy,
            str(summary.shifts),
            str(summary.known),
            f"{hits} of {shots}",
            "-" if rate is None else f"{100 * rate:.0f} %",
            _number(summary.phase_error_rms_deg if aims else None, 2),
            _number(summary.mean_duration_ms, 0),
        )
    return table
