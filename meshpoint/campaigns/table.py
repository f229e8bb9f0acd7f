"""A campaign's figures as people read them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final

from rich.console import Console
from rich.table import Table

from meshpoint.campaigns.record import JudgedShift
from meshpoint.results.output import TRIES, broken, number, tries
from meshpoint.results.shift_parts import TITLES as PART_TITLES

MOST_COLUMNS: Final = 4
"""Strategies beside each other in 80 columns; more are a table below."""


def print_tables(out: Console, values: dict[str, Any], gearbox: str) -> None:
    """Strategies side by side, where their time went, then the ratios between them. gearbox: which
    ones, as the titles say it."""
    names = list(values["strategies"])
    blocks = [names[k : k + MOST_COLUMNS] for k in range(0, len(names), MOST_COLUMNS)]
    tables = [make(values, each, gearbox) for make in (_strategies, _parts) for each in blocks]
    if values["ratios"]:
        tables.append(_ratios(values["ratios"], names, gearbox))
    for k, table in enumerate(tables):
        if k > 0:
            out.print()
        out.print(table)
    if values["verdict"]:
        out.print(f"\n{values['verdict']}")


def _strategies(values: dict[str, Any], names: list[str], gearbox: str) -> Table:
    """A column a strategy, a line a figure."""
    table = Table(
        title=f"{values['runs']} runs, {gearbox}, 95 % intervals", title_justify="left",
        box=None, pad_edge=False,
    )  # fmt: skip
    table.add_column("", no_wrap=True)
    for name in names:
        table.add_column(broken(name), justify="right")
    for title, cell in CELLS.items():
        table.add_row(title, *(cell(values["strategies"][name]) for name in names))
    return table


def _parts(values: dict[str, Any], names: list[str], gearbox: str) -> Table:
    """Where the milliseconds go: mean of each part over the shifts that have it."""
    table = Table(
        title=f"mean ms by part of the shift, by the rig's truth,\n{gearbox}", title_justify="left",
        box=None, pad_edge=False,
    )  # fmt: skip
    table.add_column("", no_wrap=True)
    for name in names:
        table.add_column(broken(name), justify="right")
    for part, title in PART_TITLES.items():
        cells = [number(values["strategies"][name]["phases_ms"][part], 1) for name in names]
        if any(cell != "-" for cell in cells):
            table.add_row(title, *cells)
    return table


def _ratios(ratios: dict[str, Any], strategies: Sequence[str], gearbox: str) -> Table:
    """Each ratio has its interval below it: side by side they need more than 80 columns."""
    table = Table(
        title=f"ratios on the same draws, {gearbox}", title_justify="left", box=None,
        pad_edge=False,
    )  # fmt: skip
    table.add_column("of\n/ to", no_wrap=True)
    for column in ("gap\nrate", "mean\nduration", "p99\nduration", "mean\nimpact"):
        table.add_column(column, justify="right", no_wrap=True)
    keys = ("first_contact_gap_rate", "duration_ms_mean", "duration_ms_p99", "impact_j_mean")
    for name, figures in ratios.items():
        of, to = _pair(name, strategies)
        table.add_row(
            f"{broken(of)}\n/ {broken(to, 12)}", *(_ratio(figures.get(key)) for key in keys)
        )
    return table


def _pair(name: str, strategies: Sequence[str]) -> tuple[str, str]:
    """The two strategies of a ratio; the name of a user's own has slashes in it, too."""
    for of in strategies:
        if name.startswith(f"{of}/") and name[len(of) + 1 :] in strategies:
            return of, name[len(of) + 1 :]
    raise ValueError(f"{name}: no ratio of two of {', '.join(strategies)}")


def records_table(title: str, records: list[JudgedShift]) -> Table:
    """Every judged shift of one run."""
    table = Table(
        title=title, title_justify="left", box=None, pad_edge=False, collapse_padding=True
    )
    for column in ("strategy", "shift", "contact", "phase\nknown", "result"):
        table.add_column(column, no_wrap=True)
    for column in ("duration\nms", "slip\nrpm", "phase\nerror\ndeg", "impact\nJ", TRIES):
        table.add_column(column, justify="right", no_wrap=True)
    for record in records:
        table.add_row(
            broken(record.strategy, 12),
            f"{record.from_gear}-{record.to_gear}",
            record.contact or "-",
            "yes" if record.reference_known else "no",
            broken(record.result, 8),
            number(record.duration_ms, 0),
            number(record.slip_rpm, 1),
            number(record.phase_error_deg, 2),
            number(record.impact_j, 2),
            tries(record.attempts, record.aborts),
        )
    return table


def _rate(figure: dict[str, Any]) -> str:
    if figure["rate"] is None:
        return "-"
    low, high = (100 * bound for bound in figure["ci95"])
    return f"{100 * figure['rate']:.1f} % ({low:.1f}..{high:.1f})"


def _ratio(figure: dict[str, Any] | None) -> str:
    if figure is None or figure["ratio"] is None:
        return "-"
    low, high = figure["ci95"]
    interval = "" if low is None or high is None else f"\n({low:.2f}..{high:.2f})"
    return f"{figure['ratio']:.2f}{interval}"


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.1f} %"


CELLS: Final[dict[str, Callable[[dict[str, Any]], str]]] = {
    "shifts": lambda f: str(f["shifts"]),
    "first in gap": lambda f: _rate(f["first_contact_gap"]),
    "mean ms": lambda f: number(f["duration_ms"]["mean"], 0),
    "p50 ms": lambda f: number(f["duration_ms"]["p50"], 0),
    "p99 ms": lambda f: number(f["duration_ms"]["p99"], 0),
    "after ramp, mean": lambda f: number(f["after_ramp_ms"]["mean"], 0),
    "after ramp, p99": lambda f: number(f["after_ramp_ms"]["p99"], 0),
    "kinematic minimum": lambda f: number(f["bound_ms"], 0),
    "time over minimum": lambda f: number(f["over_minimum"], 2),
    "mean impact J": lambda f: number(f["impact_j"]["mean"], 2),
    "p99 impact J": lambda f: number(f["impact_j"]["p99"], 2),
    "impact incomplete": lambda f: str(f["impact_j"]["incomplete"]),
    "mean slip rpm": lambda f: number(f["slip_rpm_mean"], 1),
    "aborted": lambda f: _rate(f["aborted"]),
    "aborts a shift": lambda f: number(f["aborts_mean"], 2),
    "retries": lambda f: str(f["retries"]),
    "blocked": lambda f: str(f["blocked"]),
    "bounced off": lambda f: str(f["bounced_off"]),
    "outside window": lambda f: str(f["outside_window"]),
    "not engaged": lambda f: str(f["not_engaged"]),
    "refused": lambda f: str(f["refused"]),
    "phase sd deg": lambda f: number(f["phase_error_sd_deg"], 2),
    "reference known": lambda f: _percent(f["reference_known"]),
    "gap promised": lambda f: _percent(f["promise"]["said"]),
    "of these, met": lambda f: _percent(f["promise"]["kept"]),
}
"""A line of the table each, here and on the page."""
