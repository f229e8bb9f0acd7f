"""What a check has found, one thing each, and what follows of all of them."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from typing import Any, NamedTuple


class Verdict(StrEnum):
    """What one finding means for the answer."""

    GOOD = "good"
    BAD = "bad"
    """The answer is no."""
    UNKNOWN = "unknown"
    """It cannot be known here, or was not asked for; the text says why. No reason for a no."""
    NOTE = "note"
    """Worth knowing, neither good nor bad."""


class Finding(NamedTuple):
    """One thing that was looked at."""

    group: str
    """`interface`, `messages`, `nodes`, `stamps`, `sensors` or `shafts`."""
    subject: str
    verdict: Verdict
    text: str
    """What was seen, in words, with units."""
    why: str = ""
    """Of a bad one, what of it is wrong; empty: all of the text."""

    def to_json(self) -> dict[str, Any]:
        """As plain values."""
        return {
            "group": self.group,
            "subject": self.subject,
            "verdict": str(self.verdict),
            "text": self.text,
        }


def answer(findings: Sequence[Finding]) -> tuple[bool, str]:
    """Yes or no, and the reason: what is bad, each with all that it is so of; or what stays
    unknown."""
    bad = [f for f in findings if f.verdict is Verdict.BAD]
    if bad:
        subjects: dict[str, list[str]] = {}
        for finding in bad:
            subjects.setdefault(finding.why or finding.text, []).append(finding.subject)
        return False, "; ".join(f"{', '.join(who)}: {text}" for text, who in subjects.items())
    unknown = [f.subject for f in findings if f.verdict is Verdict.UNKNOWN]
    if unknown:
        items = "1 item" if len(unknown) == 1 else f"{len(unknown)} items"
        return True, f"{items} not checked: {', '.join(unknown)}"
    return True, "everything was checked"


def answer_words(is_ready: bool, reason: str) -> str:
    """The answer as a line; of `answer`."""
    return f"READY ({reason})" if is_ready else f"NOT READY: {reason}"
