"""What the trials of a box say: wired as named, miswired and how, and the measured data."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from itertools import combinations
from typing import Final

from meshpoint.commission.core import CommissionCore
from meshpoint.commission.finding import Finding, Verdict
from meshpoint.commission.shafts import (
    LEAST_EDGES,
    SLACK_EDGES,
    SLACK_SHARE,
    Coupled,
    Shaft,
    ShaftCounts,
)
from meshpoint.commission.trial import EXPECTED, Trial
from meshpoint.controller.settings.valve_name import ValveName
from meshpoint.gearbox.gears import Sleeve
from meshpoint.units import MM

GROUP: Final = "outputs"
WIRED: Final = {moved: valve for valve, moved in EXPECTED.items()}
AWAY_M: Final = 2.0 * MM
"""A sleeve this far from neutral stands at that side."""
NEAR_TOOTH: Final = 0.02
"""A tooth count that would explain what was counted is a whole number to within this share."""
NOT_FREE: Final = "the other main sleeve is not in neutral, or it was ended before"
SIDES: Final = {
    (Sleeve.FIRST_SECOND, -1): "first", (Sleeve.FIRST_SECOND, 1): "second",
    (Sleeve.CRAWL_THIRD, -1): "crawl", (Sleeve.CRAWL_THIRD, 1): "third",
    (Sleeve.SPLITTER, -1): "low", (Sleeve.SPLITTER, 1): "high",
    (Sleeve.RANGE, -1): "low", (Sleeve.RANGE, 1): "high",
}  # fmt: skip


def judge_outputs(core: CommissionCore) -> Iterator[Finding]:
    """A finding for each valve: what it moved, or that nothing came of it."""
    newest = {trial.valve: trial for trial in core.trials}
    newest |= {trial.valve: trial for trial in core.trials if not trial.cut_short}
    newest |= {trial.valve: trial for trial in core.trials if trial.is_conclusive}
    for valve in ValveName:
        if valve in core.declined:
            yield _of(valve, Verdict.UNKNOWN, "not driven: no consent")
        elif valve not in newest:
            yield _of(valve, Verdict.UNKNOWN, f"not driven: {core.stopped or NOT_FREE}")
        elif newest[valve].cut_short and not newest[valve].is_conclusive:
            text = f"its pulse was cut short, nothing had moved yet: {newest[valve].cut_short}"
            yield _of(valve, Verdict.UNKNOWN, text)
        elif valve is ValveName.BRAKE:
            yield _judge_brake(newest[valve])
        else:
            yield _judge_valve(newest[valve])


def _of(valve: ValveName, verdict: Verdict, text: str) -> Finding:
    return Finding(GROUP, valve.name.lower(), verdict, text)


def _judge_brake(trial: Trial) -> Finding:
    if trial.moved:
        return _of(
            trial.valve, Verdict.BAD, f"moves {_words(trial)}: wired in place of {_names(trial)}"
        )
    if trial.has_braked:
        return _of(trial.valve, Verdict.GOOD, "the brake's pressure rises")
    return _of(trial.valve, Verdict.BAD, "nothing came of it: not wired, no air, or no sensor")


def _judge_valve(trial: Trial) -> Finding:
    valve, moved = trial.valve, trial.moved
    extra = trial.driven - {valve}
    if extra:
        also = ", ".join(v.name.lower() for v in sorted(extra))
        return _of(valve, Verdict.BAD, f"the valve side says that it drives {also}, too or instead")
    if not moved:
        sleeve, direction = EXPECTED[valve]
        if trial.before_m[sleeve] * direction > AWAY_M and not trial.has_braked:
            text = "its sleeve stands there already, and nothing has moved it away"
            return _of(valve, Verdict.UNKNOWN, text)
        if trial.has_braked:
            return _of(valve, Verdict.BAD, "the brake's pressure rises: wired in place of brake")
        return _of(valve, Verdict.BAD, "nothing moved: not wired, no air, or a sleeve sticks")
    if moved == [EXPECTED[valve]]:
        return _of(valve, Verdict.GOOD, f"moves {_words(trial)}")
    if len(moved) > 1:
        return _of(valve, Verdict.BAD, f"moves {_words(trial)} at once: air or wires are crossed")
    return _of(
        valve, Verdict.BAD,
        f"moves {_words(trial)}: wired in place of {_names(trial)}, or its position sensor is "
        "exchanged or mounted the other way round",
    )  # fmt: skip


def _words(trial: Trial) -> str:
    return " and ".join(
        f"sleeve {sleeve.name.lower()} towards {SIDES[sleeve, way]}" for sleeve, way in trial.moved
    )


def _names(trial: Trial) -> str:
    return " and ".join(WIRED[moved].name.lower() for moved in trial.moved)


def judge_wheels(counts: ShaftCounts) -> Iterator[Finding]:
    """Each pair in mesh; where pairs do not fit, what would explain all of them."""
    findings = list(counts.findings())
    yield from findings
    pairs = {c: t for c, t in counts.together.items() if max(t.values()) >= LEAST_EDGES}
    if not any(f.verdict is Verdict.BAD and " to " in f.subject for f in findings):
        return
    teeth = {shaft: counts.edges_a_turn(shaft) for shaft in Shaft}
    reasons = [
        f"the sensors of {a} and {b} are exchanged"
        for a, b in combinations(Shaft, 2)
        if _fits(pairs, teeth, {a: b, b: a})
    ]
    for shaft in Shaft:
        count = _explaining_count(shaft, pairs, teeth)
        if count is not None:
            reasons.append(f"the {shaft} wheel has {count} teeth, the sheet {teeth[shaft]}")
    text = " or ".join(reasons) or "no exchange of two sensors and no one tooth count explains it"
    yield Finding("shafts", "explanation", Verdict.BAD, text)


def _fits(
    pairs: dict[Coupled, Counter[Shaft]], teeth: dict[Shaft, int], swapped: dict[Shaft, Shaft]
) -> bool:
    """Whether all pairs count as the data sheet says when sensors are exchanged so. Counts of a
    shaft outside of its pair are those of its own pairs: all pairs were in mesh together."""
    edges: dict[Shaft, int] = {}
    for turned in pairs.values():
        edges |= turned
    for coupled in pairs:
        a = swapped.get(coupled.driving, coupled.driving)
        b = swapped.get(coupled.driven, coupled.driven)
        if a not in edges or b not in edges:
            return False
        expected = float(coupled.ratio * teeth[coupled.driven] / teeth[coupled.driving])
        slack = SLACK_EDGES * (1.0 + expected) + SLACK_SHARE * edges[b]
        if abs(edges[b] - expected * edges[a]) > slack:
            return False
    return True


def _explaining_count(
    shaft: Shaft, pairs: dict[Coupled, Counter[Shaft]], teeth: dict[Shaft, int]
) -> int | None:
    """The tooth count of one wheel that makes all pairs fit; None where there is none."""
    for coupled, turned in pairs.items():
        if shaft not in (coupled.driving, coupled.driven):
            continue
        ratio = float(coupled.ratio)
        if shaft is coupled.driven:
            wanted = turned[shaft] / (turned[coupled.driving] * ratio) * teeth[coupled.driving]
        else:
            wanted = turned[shaft] * ratio / turned[coupled.driven] * teeth[coupled.driven]
        count = round(wanted)
        if count != teeth[shaft] and abs(wanted / count - 1.0) < NEAR_TOOTH:
            return count if _fits(pairs, {**teeth, shaft: count}, {}) else None
    return None
