"""Of a recorded bus: how often its controller met a gap, and how often another one would have.

The first is seen by the sleeves' own positions (`sleeve_contacts`), for whichever controller. The
second is worked out shift by shift (`counterfactual`), which needs a run of our own controller that
can be repeated; where there is none, it is said that it cannot be decided, and why.
"""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass, field
from typing import Any, Final

from meshpoint.logs.seen_shift import SeenShift
from meshpoint.report.judged_rows import JudgedRow
from meshpoint.results.output import counted
from meshpoint.results.road_speed import span_us
from meshpoint.results.wilson import wilson

NUMBER: Final = re.compile(r"\d+(?:\.\d+)?")
LATE_US: Final = 50_000
"""A frame may show a sleeve in gear so long after the controller has said so."""


@dataclass
class Answer:
    """What the log says of both controllers."""

    shifts: int
    """Shifts whose first contact the sleeves show."""
    gaps: int
    """Of these, first contacts in a gap."""
    decided: int = 0
    """Shifts in which the other controller's landing could be worked out."""
    gaps_of_decided: int = 0
    """Recorded first contacts in a gap, of the same shifts."""
    expected: float = 0.0
    """The other controller's first contacts in a gap that are expected of these."""
    why_not: Counter[str] = field(default_factory=Counter)
    """Reasons for the other shifts, and in how many."""
    other: str = ""
    """The other controller, in words."""

    @property
    def rate(self) -> float | None:
        """The recorded share of first contacts in a gap; None without shifts."""
        return self.gaps / self.shifts if self.shifts else None

    @property
    def interval(self) -> tuple[float, float] | None:
        """Of the other controller's rate: 95 %, of this many shifts; None where none was
        decided."""
        return wilson(self.expected, self.decided) if self.decided else None

    @property
    def sentence(self) -> str:
        """The answer."""
        if not self.shifts:
            return "the log shows no shift with a contact: nothing can be said of either controller"
        was = f"{100 * self.gaps / self.shifts:.0f} %"
        bounds = self.interval
        reasons = "; ".join(f"{n} x {why}" for why, n in _alike(self.why_not).most_common())
        if bounds is None:
            return (
                f"met the gap in {self.gaps} of {self.shifts} ({was}); what {self.other} would "
                f"have met is not decidable: {reasons or 'no shift could be judged'}"
            )
        low, high = (100 * bound for bound in bounds)
        then = 100 * self.gaps_of_decided / self.decided
        text = (
            f"{self.other} would have met the gap in {100 * self.expected / self.decided:.0f} % "
            f"({low:.0f} to {high:.0f} %) of the {counted(self.decided)} that can be decided, "
            f"where {then:.0f} % were recorded (of all: {self.gaps} of {self.shifts}, {was})"
        )
        return f"{text}; not decidable: {reasons}" if reasons else text

    def to_json(self) -> dict[str, Any]:
        """As plain values; rates are shares."""
        bounds = self.interval
        return {
            "recorded": {"shifts": self.shifts, "gaps": self.gaps, "rate": self.rate},
            "other": self.other,
            "decided": self.decided,
            "recorded_gaps_of_decided": self.gaps_of_decided,
            "expected_gaps": round(self.expected, 4),
            "rate": round(self.expected / self.decided, 6) if self.decided else None,
            "ci95": None if bounds is None else [round(bound, 6) for bound in bounds],
            "not_decidable": dict(self.why_not),
            "sentence": self.sentence,
        }


def _alike(reasons: Counter[str]) -> Counter[str]:
    """Reasons that differ in their numbers alone as one, with the range of each number."""
    kinds: dict[str, list[str]] = {}
    for why in reasons:
        kinds.setdefault(NUMBER.sub("#", why), []).append(why)
    merged: Counter[str] = Counter()
    for members in kinds.values():
        columns = zip(*(NUMBER.findall(why) for why in members), strict=True)
        ranges = [_range(sorted(set(column), key=float)) for column in columns]
        words = NUMBER.split(members[0])
        text = words[0] + "".join(a + b for a, b in zip(ranges, words[1:], strict=True))
        merged[text] = sum(reasons[why] for why in members)
    return merged


def _range(numbers: list[str]) -> str:
    return numbers[0] if len(numbers) == 1 else f"{numbers[0]} to {numbers[-1]}"


def of_judged(rows: list[JudgedRow], seen: list[SeenShift], other: str) -> Answer:
    """Our own controller's run: each shift with the landing worked out for the other one."""
    contacts = [_contact(row, seen) for row in rows]
    reported = [contact for contact in contacts if contact is not None]
    answer = Answer(len(reported), reported.count("gap"), other=other)
    for row, contact in zip(rows, contacts, strict=True):
        found = row.judged.counterfactual if row.judged is not None else None
        if row.judged is not None and row.judged.parted is None and contact is not None:
            # It commands what was commanded, so what came of that is its own result too.
            answer.decided += 1
            answer.gaps_of_decided += contact == "gap"
            answer.expected += contact == "gap"
        elif found is None or found.contact_probability is None:
            why = "the recorded controller could not be repeated up to it"
            answer.why_not[why if found is None else found.why] += 1
        elif contact is None:
            answer.why_not["the sleeves show no contact"] += 1
        else:
            answer.decided += 1
            answer.gaps_of_decided += contact == "gap"
            answer.expected += found.contact_probability
    return answer


def of_another(seen: list[SeenShift], other: str, why: str) -> Answer:
    """A controller that is not ours: its contacts alone."""
    reported = [shift.contact for shift in seen if shift.contact is not None]
    answer = Answer(len(reported), reported.count("gap"), other=other)
    answer.why_not[why] += len(reported)
    return answer


def _contact(row: JudgedRow, seen: list[SeenShift]) -> str | None:
    """What the sleeves show of a recorded shift: one that was complete after its request and not
    later than its outcome, by 32-bit sensor times."""
    recorded = row.recorded
    for shift in seen:
        after = span_us(shift.there_us, recorded.request_us)
        if 0 <= after <= span_us(recorded.end_us, recorded.request_us) + LATE_US:
            return shift.contact
    return None
