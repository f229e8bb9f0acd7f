"""Why a campaign stopped, in words for people and as JUnit XML for a CI server."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from meshpoint.testbench.campaign.verdict import Verdict
from meshpoint.testbench.results import junit


def is_worse(values: dict[str, Any]) -> bool:
    """Whether the verdict is that shifts have got worse."""
    return bool(values.get("against", {}).get("verdict") == Verdict.WORSE.value)


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
    if (against := values.get("against")) is not None:
        lines.append(
            f"against the baseline: {_verdict(against)}; {against['pairs']} pairs, "
            f"{against['worse']} worse, {against['better']} better, margin "
            f"{100 * against['margin']:g} %"
        )
    return lines


def _verdict(against: dict[str, Any]) -> str:
    if against["verdict"] == Verdict.OPEN.value:
        return "not decided, more runs are needed"
    return str(against["verdict"])


def write_junit(path: Path, values: dict[str, Any]) -> None:
    """One test case a statement. CommandError where it cannot be written."""
    failed = [f"run {run['seed']}: {run['error']}" for run in values["failed"]]
    cases = [("every run came to its end", "; ".join(failed))]
    if "against" in values:
        worse = stopped_words(values)[-1] if is_worse(values) else ""
        cases.append(("first contact in a gap is not worse than before", worse))
    junit.write_junit(path, "campaign", cases, "; ".join(stopped_words(values)))
