"""What a box that stands shows of its valves: figures with 95 % intervals, and bounds where one
stroke does not tell two things apart."""

from __future__ import annotations

import math
from statistics import median
from typing import Final

from meshpoint.commission.core import CommissionCore
from meshpoint.commission.finding import Finding, Verdict
from meshpoint.commission.trial import BEGUN_M, EXPECTED, Trial
from meshpoint.commission.verdict import GROUP
from meshpoint.controller.settings.valve_name import ValveName
from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.gears import Sleeve
from meshpoint.identify.overlay import Entry
from meshpoint.units import BAR, MS, US

NEARLY_THERE: Final = 0.94
"""Of the way to the gear: the last of it may be slowed by the faces."""
SENSOR_BAR: Final = 0.18
"""Half the interval: a pressure sensor's offset, 0.16 bar at most, and its noise."""
MOST_DELAY_S: Final = 0.2


def standing_figures(
    sheet: GearboxSheet, core: CommissionCore
) -> tuple[list[Entry], list[Finding]]:
    """Keys of the sheet that were measured at standstill; and, by key, bounds of those that were
    not: they stay the sheet's."""
    measured: list[Entry] = []
    good = [t for t in core.trials if t.valve in EXPECTED and t.moved == [EXPECTED[t.valve]]]
    bounds = _sleeves(measured, good, sheet)
    braked = [t for t in core.trials if t.valve is ValveName.BRAKE and t.has_braked]
    if braked:
        bounds += _brake(braked[0])
    if core.supply_pa:
        gauge = _digits((median(core.supply_pa) - sheet.air.atmosphere_pa) / BAR)
        ends = gauge - SENSOR_BAR, gauge + SENSOR_BAR
        measured.append(Entry("air", "supply_gauge_bar", gauge, "at standstill", *ends))
    return measured, bounds


def _digits(value: float) -> float:
    """A measured value as a file's five digits give it back: a sheet holds what its file says."""
    return float(f"{value:.5g}")


def _sleeves(measured: list[Entry], trials: list[Trial], sheet: GearboxSheet) -> list[Finding]:
    """One stroke, after a rest, stands for all gears: it is off their mean by what the sheet allows
    a stroke."""
    strokes_us = _strokes_us(trials, sheet.sleeve.to_contact_m)
    if not strokes_us:
        return []
    begun_us, delay_us = (median(us) for us in zip(*strokes_us, strict=True))
    limit_s, delay_s = sheet.sleeve.delay_limit_s, delay_us * US
    if sheet.sleeve.valve_delay_s + limit_s < delay_s <= MOST_DELAY_S:
        ends = (delay_s - limit_s) / MS, (delay_s + limit_s) / MS
        why = "one stroke at standstill"
        measured.append(Entry("sleeve", "delay_ms", _digits(delay_s / MS), why, *ends))
    text = (
        f"at most {begun_us * US / MS:.1f} ms, when the sleeve moved: the pressure that breaks its "
        "friction is in it"
    )
    return [Finding(GROUP, "sleeve.valve_delay_ms", Verdict.UNKNOWN, text)]


def _strokes_us(trials: list[Trial], to_contact_m: float) -> list[tuple[float, float]]:
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
            found.append((begun_us, begun_us + (1.0 - early) * way_us))
    return found


def _brake(trial: Trial) -> list[Finding]:
    """Bounds of its delay and time constant, by the pressure's samples of 10 ms on the way up. The
    sensor's lag is in both and is not known: the pressure itself begins sooner, and of the same
    curve more is the chamber's."""
    top_pa = max(rise for _, rise in trial.pressure)
    points = []
    for after_us, rise_pa in trial.pressure:
        if after_us >= 0 and rise_pa > 0.9 * top_pa:
            break
        if after_us >= 0 and rise_pa > 0.05 * top_pa:
            points.append((after_us * US, -math.log(1.0 - rise_pa / top_pa)))
    if len(points) < 2 or points[-1][1] <= points[0][1]:
        return []
    (t0, y0), (t1, y1) = points[0], points[-1]
    lag_s = (t1 - t0) / (y1 - y0)
    return [
        Finding(GROUP, f"brake.{key}", Verdict.UNKNOWN, f"{text}; `--turn` measures it")
        for key, text in (
            (
                "valve_delay_ms",
                f"at most {max(t0 - y0 * lag_s, 0.0) / MS:.1f} ms, the pressure sensor's lag "
                "included",
            ),
            (
                "time_constant_ms",
                f"at least {lag_s / MS:.1f} ms, by the pressure's steepest part",
            ),
        )
    ]
