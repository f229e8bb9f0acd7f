"""Why a campaign stopped, in words for people and as JUnit XML and Markdown for a CI server."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rich.table import Table

from meshpoint.base.exits import Exit
from meshpoint.campaigns.verdict import Verdict
from meshpoint.results import junit

NOT_WORSE = "first contact in a gap, time and impact are not worse than before"
FIGURES = {
    "first_contact_gap": "first contact in a gap",
    "duration_ms": "time",
    "impact_j": "impact at contact",
}
"""What is judged, in words."""


def exit_code(values: dict[str, Any]) -> Exit:
    """What the verdict comes to; DONE where none was asked for."""
    verdict = values.get("against", {}).get("verdict")
    if verdict == Verdict.WORSE.value:
        return Exit.FAILED
    return Exit.NOT_DECIDED if verdict == Verdict.OPEN.value else Exit.DONE


def stopped_words(values: dict[str, Any]) -> list[str]:
    """Lines for the end of the command; `values` as its JSON has them."""
    lines = []
    if (until := values.get("until")) is not None:
        low, high = until.get("ci95", (None, None))
        a, b = until["strategies"]
        found = "not known" if low is None else f"{until['value']:.4g} ({low:.4g} to {high:.4g})"
        lines.append(
            f"{until['goal']}, {a} against {b}: {found} after {until.get('runs', 0)} runs, "
            f"stopped by {until['stopped_by']}"
        )
        if (plain := until.get("plain", {}).get("value")) is not None:
            low, high = until["plain"]["ci95"]
            lines.append(
                f"{', '.join(until['integrated'])}: integrated over the phase, which it cannot "
                f"know; counted plainly it is {plain:.4g} ({low:.4g} to {high:.4g})"
            )
    if (against := values.get("against")) is not None:
        lines.append(
            f"against {against['reference']}: {_verdict(against)}; {against['pairs']} pairs, "
            f"{against['worse']} worse, {against['better']} better, margin "
            f"{100 * against['margin']:g} %; "
            + "; ".join(f"{title}: {cell}" for title, cell in _judged(against))
        )
    return lines


def against_table(against: dict[str, Any], gearbox: str) -> Table:
    """The verdict and what it rests on. gearbox: which ones, as the title says it."""
    title = f"shifts before and after, {gearbox}"
    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    table.add_column("", no_wrap=True)
    table.add_column("", overflow="fold")
    for title, cell in _lines(against):
        table.add_row(title, cell)
    return table


def markdown(values: dict[str, Any], gearbox: str) -> str:
    """The result for a pull request or a job's page."""
    against = values.get("against")
    head = "campaign" if against is None else against["verdict"]
    lines = [f"# meshpoint campaign: {head}", "", f"{values['runs']} runs, {gearbox}.", ""]
    if against is not None:
        lines += ["| shifts before and after | |", "|---|---|"]
        lines += [f"| {title} | {cell} |" for title, cell in _lines(against)]
        lines.append("")
    lines += ["| strategy | shifts | first contact in a gap | mean ms | mean impact J |"]
    lines += ["|---|---|---|---|---|"]
    for name, figures in values["strategies"].items():
        gap, shifts = figures["first_contact_gap"], figures["shifts"]
        low, high = gap["ci95"]
        share = "" if gap["rate"] is None else _percent(gap["rate"])
        share += f" ({_percent(low)} to {_percent(high)})" if share else ""
        mean, impact = figures["duration_ms"]["mean"], figures["impact_j"]["mean"]
        cells = ("" if v is None else f"{v:.{d}f}" for v, d in ((mean, 0), (impact, 2)))
        lines.append(f"| {name} | {shifts} | {share} | {' | '.join(cells)} |")
    lines += ["", *([values["verdict"]] if values["verdict"] else []), *stopped_words(values)]
    lines += [f"run {run['seed']} failed: {run['error']}" for run in values["failed"]]
    return "\n".join(lines) + "\n"


def write_junit(path: Path, values: dict[str, Any], gearbox: str) -> None:
    """One test case a statement. CommandError where it cannot be written."""
    failed = [f"run {run['seed']}: {run['error']}" for run in values["failed"]]
    cases = [("every run came to its end", "; ".join(failed))]
    if "against" in values:
        fine = exit_code(values) is Exit.DONE
        cases.append((NOT_WORSE, "" if fine else stopped_words(values)[-1]))
    said = [f"{values['runs']} runs, {gearbox}", *stopped_words(values)]
    junit.write_junit(path, "campaign", cases, "; ".join(said))


def _lines(against: dict[str, Any]) -> list[tuple[str, str]]:
    before, after = against["misses_before"], against["misses_after"]
    baseline, strategies = against["baseline"], [against["strategy_before"], against["strategy"]]
    pairs = f"{against['pairs']} of {against['runs']} runs"
    return [
        ("verdict", _verdict(against)),
        *_judged(against),
        ("before", against["reference"]),
        ("strategy", " / ".join(dict.fromkeys(strategies))),
        ("pairs", pairs),
        ("worse", str(against["worse"])),
        ("better", str(against["better"])),
        ("missed by both", str(against["missed_by_both"])),
        ("misses", "-" if before is None else f"{_percent(before)} before, {_percent(after)} now"),
        ("whole baseline", f"{baseline['misses']} misses in {baseline['shifts']} shifts"),
        ("margin of gaps", f"{100 * against['margin']:g} %"),
        ("evidence", f"{against['evidence']:+.2f}"),
    ]


def _judged(against: dict[str, Any]) -> list[tuple[str, str]]:
    """Each figure and its verdict."""
    lines = []
    for figure, found in against["judged"].items():
        text = found["verdict"]
        if (ratio := found.get("ratio")) is not None:
            low, high = found["interval"]
            text += f": {ratio:.3f} times that before ({low:.3f} to {high:.3f})"
            text += f", margin {100 * found['margin']:g} %"
        lines.append((FIGURES[figure], text))
    return lines


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %"


def _verdict(against: dict[str, Any]) -> str:
    if against["verdict"] == Verdict.OPEN.value:
        return "not decided, more runs are needed"
    return str(against["verdict"])
