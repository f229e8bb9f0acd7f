"""What the trials of a box say: wired as named, miswired and how, and the measured data."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations
from statistics import median
from typing import Final

from meshpoint.controller.valve_name import ValveName
from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.gears import Sleeve
from meshpoint.testbench.check.finding import Finding, Verdict
from meshpoint.testbench.check.shafts import (
    LEAST_EDGES,
    SLACK_EDGES,
    SLACK_SHARE,
    Coupled,
    Shaft,
    ShaftCounts,
)
from meshpoint.testbench.commission.core import CommissionCore
from meshpoint.testbench.commission.trial import BEGUN_M, EXPECTED, Trial
from meshpoint.units import BAR, MM, MS, US

GROUP: Final = "outputs"
WIRED: Final = {moved: valve for valve, moved in EXPECTED.items()}
AWAY_M: Final = 2.0 * MM
"""A sleeve this far from neutral stands at that side."""
NEAR_TOOTH: Final = 0.02
"""A tooth count that would explain what was counted is a whole number to within this share."""
NOT_FREE: Final = "the other main sleeve is not in neutral, or it was ended before"
NEARLY_THERE: Final = 0.94
"""Of the way to the gear: the last of it may be slowed by the faces."""
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


def measured_sheet(sheet: GearboxSheet, core: CommissionCore) -> tuple[GearboxSheet, list[str]]:
    """The sheet with what was measured at standstill in place of what it had, and which values
    these are. What cannot be measured at standstill stays the sheet's."""
    changed = []
    sleeve, brake, air = sheet.sleeve, sheet.brake, sheet.air
    good = [t for t in core.trials if t.valve in EXPECTED and t.moved == [EXPECTED[t.valve]]]
    trajectories = _trajectories_us(good, sheet.sleeve.to_contact_m)
    if trajectories:
        valve_s, delay_s = (median(us) * US for us in zip(*trajectories, strict=True))
        if 0.0 <= valve_s <= 0.050 and valve_s + sleeve.delay_limit_s < delay_s <= 0.200:
            sleeve = replace(sleeve, valve_delay_s=_in(MS, valve_s), delay_s=_in(MS, delay_s))
            changed += ["sleeve.valve_delay_ms", "sleeve.delay_ms"]
    braked = [t for t in core.trials if t.valve is ValveName.BRAKE and t.has_braked]
    if braked:
        delay_s, lag_s = _brake_trajectory(braked[0])
        if not math.isnan(lag_s):
            brake = replace(brake, valve_delay_s=_in(MS, delay_s), time_constant_s=_in(MS, lag_s))
            changed += ["brake.valve_delay_ms", "brake.time_constant_ms"]
    if core.supply_pa:
        gauge_pa = median(core.supply_pa) - air.atmosphere_pa
        air = replace(air, supply_gauge_pa=_in(BAR, gauge_pa))
        changed.append("air.supply_gauge_bar")
    return replace(sheet, sleeve=sleeve, brake=brake, air=air), changed


def _in(unit: float, value: float) -> float:
    """A measured value as a file's five digits give it back: a sheet holds what its file says."""
    return float(f"{value / unit:.5g}") * unit


def _trajectories_us(trials: list[Trial], to_contact_m: float) -> list[tuple[float, float]]:
    """From activation to the first movement and to the gear's faces, of each main sleeve that was
    pushed out of neutral. Behind the valve's delay the chamber's pressure grows linearly, and the
    way with the cube of time."""
    found = []
    late, early = math.cbrt(NEARLY_THERE), math.cbrt(BEGUN_M / to_contact_m)
    for trial in trials:
        sleeve = EXPECTED[trial.valve][0]
        if sleeve not in (Sleeve.FIRST_SECOND, Sleeve.CRAWL_THIRD):
            continue
        begun_us = trial.reaches_us(sleeve, BEGUN_M)
        there_us = trial.reaches_us(sleeve, NEARLY_THERE * to_contact_m)
        if begun_us is not None and there_us is not None:
            way_us = (there_us - begun_us) / (late - early)
            valve_us = begun_us - early * way_us
            found.append((valve_us, valve_us + way_us))
    return found


def _brake_trajectory(trial: Trial) -> tuple[float, float]:
    """Delay and time constant of the brake's pressure, from its samples of 10 ms on the way up."""
    top_pa = max(rise for _, rise in trial.pressure)
    points = []
    for after_us, rise_pa in trial.pressure:
        if after_us >= 0 and rise_pa > 0.9 * top_pa:
            break
        if after_us >= 0 and rise_pa > 0.05 * top_pa:
            points.append((after_us * US, -math.log(1.0 - rise_pa / top_pa)))
    if len(points) < 2 or points[-1][1] <= points[0][1]:
        return math.nan, math.nan
    (t0, y0), (t1, y1) = points[0], points[-1]
    lag_s = (t1 - t0) / (y1 - y0)
    return _clip(t0 - y0 * lag_s, 0.0, 0.050), _clip(lag_s, 0.001, 0.5)


def _clip(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)
