"""The table for people: a line a row, below the conditions that it was made under."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from rich.table import Table

from benchmarks.envelope.making import OWN, Made
from benchmarks.envelope.rows import GROUPS, Group, Row
from benchmarks.envelope.verdict import WORDS
from meshpoint.campaigns.spec import TRUE_STATE

COLUMNS: Final = (
    "shifts", "first in gap", "true state", "after ramp, ms", "99 of 100", "from request, ms", "J",
    "outside window", "not engaged", "refused", "reference known", "promised", "met",
)  # fmt: skip
HEAD: Final = (
    "# The envelope",
    "",
    "Every kind of shift, sheet and sensor in one table: each row is a [campaign](campaign.md) of "
    "gearboxes drawn by seed, with one thing changed. A change of the controller is held against "
    "all of it ([the rule](change.md)). `make envelope` writes this page "
    "(`python -m benchmarks.envelope -h`); the rows are in `benchmarks/envelope/rows.py`.",
    "",
)
AGAINST: Final = (
    "the same draws by the product of that commit; *fell* in first contacts in a gap, shifts not "
    "engaged, time or impact by more than chance, with the number of rows counted."
)
ON_SCREEN: Final = (
    "shifts", "first in gap", "after\nramp\nms", "J",
    "outside/\nnot in/\nrefused", "ref.\nknown",
)  # fmt: skip
ABOUT: Final = (
    "**first in gap**: share of first contacts in a gap, 95 % interval by gearbox; **true state**: "
    "of the same draws with the rig's true state.",
    "**after ramp**: from the end of the torque ramp to the shift's end, mean, and what 99 of 100 "
    "take at most. **from request**: the whole shift, mean, with the ramp and what it waits for. "
    "**J**: lost in flank impacts until the gear has locked, mean.",
    "**outside window**: contacts outside the guard's slip window. **refused**: requests that the "
    "controller did not begin; they are no shifts.",
    "**promised**, **met**: of the shifts fired once at a known phase, the probability of the gap "
    "when the sleeve was fired, mean, and how often it was met.",
)


def figures(made: Made) -> dict[str, Any]:
    """What a row comes to; None where there is no such figure, as in an older product."""
    strategies = made.values["strategies"]
    own, promise = strategies[OWN], strategies[OWN].get("promise", {})
    true = strategies.get(TRUE_STATE)
    return {
        "shifts": own["shifts"],
        "gap": own["first_contact_gap"],
        "true_state": true and true["first_contact_gap"]["rate"],
        "after_ramp_ms": {key: own["after_ramp_ms"][key] for key in ("mean", "p99")},
        "duration_ms": own["duration_ms"]["mean"],
        "impact_j": own["impact_j"]["mean"],
        "outside_window": own.get("outside_window"),
        "not_engaged": own.get("not_engaged", own.get("given_up")),
        "refused": own.get("refused"),
        "reference_known": own["reference_known"],
        "promised": promise.get("said"),
        "met": promise.get("kept"),
        "failed_runs": len(made.values["failed"]),
        "seconds": made.seconds,
    }


def cells(found: Mapping[str, Any]) -> list[str]:
    """A row's figures as `COLUMNS` has them."""
    gap, time_ms = found["gap"], found["after_ramp_ms"]
    share = _share(gap["rate"])
    if gap["rate"] is not None:
        share += f" ({gap['ci95'][0]:.2f} to {gap['ci95'][1]:.2f})"
    return [
        str(found["shifts"]), share, _share(found["true_state"]), _number(time_ms["mean"]),
        _number(time_ms["p99"]), _number(found["duration_ms"]), _number(found["impact_j"], 2),
        *(_number(found[key]) for key in ("outside_window", "not_engaged", "refused")),
        *(_share(found[key]) for key in ("reference_known", "promised", "met")),
    ]  # fmt: skip


def _share(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def _number(value: float | None, digits: int = 0) -> str:
    return "-" if value is None else f"{value:,.{digits}f}"


def on_screen(rows: Mapping[str, Any], title: str) -> Table:
    """The rows made, for a terminal: the page has more."""
    table = Table(
        title=title, title_justify="left", box=None, pad_edge=False, collapse_padding=True
    )
    table.add_column("row", no_wrap=True)
    judged = any("against" in found for found in rows.values())
    for column in (*ON_SCREEN, *(["against"] if judged else [])):
        table.add_column(column, justify="right", no_wrap=True)
    for name, found in rows.items():
        verdict = [_verdict(found)] if judged else []
        shifts, gap, _, time_ms, _, _, impact, *failures, known, _, _ = cells(found)
        gap, failed = gap.replace(" to ", ".."), "/".join(failures)
        table.add_row(name, shifts, gap, time_ms, impact, failed, known, *verdict)
    return table


def _verdict(found: Mapping[str, Any]) -> str:
    against = found.get("against")
    return "-" if against is None else WORDS[against["verdict"]]


def markdown(values: Mapping[str, Any]) -> str:
    """The whole table as a page."""
    conditions, rows = values["conditions"], values["rows"]
    lines = [*HEAD, conditions["words"], "", *(f"- {line}" for line in ABOUT), ""]
    if "against" in values:
        lines[-1:] = [f"- **against** {values['against']}: {AGAINST}", ""]
    for group in GROUPS:
        chosen = [row for row in group.rows if row.name in rows]
        lines += _group(group, chosen, rows) if chosen else []
    return "\n".join(lines)


def _group(group: Group, chosen: list[Row], rows: Mapping[str, Any]) -> list[str]:
    judged = any("against" in found for found in rows.values())
    head = ["row", "what is changed", *COLUMNS, *(["against"] if judged else [])]
    lines = [f"## {group.title}", "", group.about, "", _line(head), "|---" * len(head) + "|"]
    for row in chosen:
        found = rows[row.name]
        verdict = [_verdict(found)] if judged else []
        lines.append(_line([f"`{row.name}`", f"{row.changed}: {row.why}", *cells(found), *verdict]))
    return [*lines, ""]


def _line(words: list[str]) -> str:
    return "| " + " | ".join(words) + " |"
