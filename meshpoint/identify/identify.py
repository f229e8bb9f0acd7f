"""All that a log says of a gearbox: values with 95 % intervals, and what it does not show, and why.

Each run in neutral, stroke and closing of the log is kept out in turn: the rest gives the interval
(jackknife), and predicts what was kept out (held-out check).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

import numpy as np

from meshpoint.gearbox import GearboxSheet
from meshpoint.identify.brake_figures import brake_figures
from meshpoint.identify.clutch_fit import touches
from meshpoint.identify.held_out import HeldOut, check_samples
from meshpoint.identify.identified import (
    LEAST_RUNS,
    Figure,
    Identified,
    untold,
    why_no_runs,
)
from meshpoint.identify.jackknife import (
    jackknife_sd,
    scatter_interval,
    student,
)
from meshpoint.identify.log_reader import LogContent
from meshpoint.identify.sleeve_fit import SleeveFit, sleeve_fit
from meshpoint.identify.sleeve_law import SDS, sleeve_law
from meshpoint.identify.tooth_fit import (
    tooth_fit,
    wheel_figures,
)
from meshpoint.kernels.records import Vector
from meshpoint.units import DEG, MS

ENGINE_AGE_S: Final = 0.002
"""Standard deviation of how old an engine speed is when it is sent: its message has no time."""
Tell = Callable[[str], None]


def identify(content: LogContent, sheet: GearboxSheet, tell: Tell | None = None) -> Identified:
    """Everything that can be determined. tell: is called with the name of each step."""
    found = Identified()
    tell = tell or _silent
    tell("teeth")
    zero_pa = _zero_pa(content, sheet)
    _fit_teeth(found, content, sheet, zero_pa)
    tell("brake")
    brake_figures(found, content, sheet, zero_pa)
    _teeth(found, content, sheet)
    tell("sleeves")
    _sleeves(found, sleeve_fit(content), content, sheet)
    sleeve_law(found, content, sheet)
    tell("clutch")
    _clutch(found, content, sheet)
    _never(found)
    return found


def _silent(_step: str) -> None:
    """Reports nothing."""


def _zero_pa(content: LogContent, sheet: GearboxSheet) -> float:
    """What the pressure sensor shows of an empty brake."""
    return float(np.mean(content.empty_pa)) if content.empty_pa else sheet.air.atmosphere_pa


def _fit_teeth(found: Identified, content: LogContent, sheet: GearboxSheet, zero_pa: float) -> None:
    """Motion by polynomials: the first look, and that of a shaft without a model."""
    runs = list(content.runs)
    pressures = [np.array((run.pressure[0], run.pressure[1] - zero_pa)) for run in runs]
    for name, seen, wheel, beside in (
        ("layshaft", [run.layshaft for run in runs], sheet.wheels.layshaft, pressures),
        ("main", [run.main for run in runs], sheet.wheels.main, None),
    ):
        fitted = None if wheel.missing else tooth_fit(seen, wheel.teeth, beside)
        if fitted is not None:
            found.teeth[name] = fitted


def _teeth(found: Identified, content: LogContent, sheet: GearboxSheet) -> None:
    for name, wheel in (("layshaft", sheet.wheels.layshaft), ("main", sheet.wheels.main)):
        names = (
            (f"{name} wheel duty", "%", 100.0 * wheel.duty_share),
            (f"{name} wheel eccentricity", "deg", None),
            (f"{name} wheel pitch error RMS", "deg", None),
        )
        fitted = found.teeth.get(name)
        if fitted is None:
            why = "the wheel has missing teeth" if wheel.missing else why_no_runs(content)
            untold(found, why, *names)
            continue
        figures = np.array([_wheel(one, wheel.duty_share) for one in fitted.without])
        values = _wheel(fitted.error_rad, wheel.duty_share)
        half = student(len(fitted.without) - 1) * jackknife_sd(figures)
        for (title, unit, of_sheet), value, reach in zip(names, values, half, strict=True):
            ends = (max(value - reach, 0.0), value + reach)
            found.figures.append(Figure(title, unit, value, *ends, of_sheet, len(content.runs)))
        found.held_out.append(
            HeldOut(
                f"{name} wheel: angle of an edge",
                "deg",
                fitted.spans,
                fitted.held_out_rad / DEG,
                fitted.nominal_rad / DEG,
            )
        )


def _wheel(error_rad: Vector, duty_share: float) -> tuple[float, float, float]:
    figures = wheel_figures(error_rad, duty_share)
    return (
        100.0 * figures.duty_share,
        figures.eccentricity_rad / DEG,
        figures.pitch_rms_rad / DEG,
    )


def _sleeves(
    found: Identified, fitted: SleeveFit | None, content: LogContent, sheet: GearboxSheet
) -> None:
    sleeve = sheet.sleeve
    spread = ("sleeve delay spread", "ms", sleeve.delay_sd_s / MS)
    names = [
        (f"sleeve delay {gear.name.lower()}", "ms", sleeve.delay_s / MS) for gear in sheet.dog_gears
    ]
    if fitted is None:
        why = "no contact of a main sleeve in the log"
        if not content.messages["ValveCommand"]:
            why = "no valve commands in the log"
        elif content.inexact:
            why = "its valves were switched at once, not at a commanded time"
        elif content.late:
            why = f"{content.late} commands came after their activation, by the log's clock"
        untold(found, why, *names, spread)
        return
    found.supply_pa = sheet.air.supply_gauge_pa + sheet.air.atmosphere_pa
    correlation = fitted.correlation
    wider = math.sqrt((1.0 + correlation) / (1.0 - correlation))
    for gear, (name, unit, by_sheet) in zip(sheet.dog_gears, names, strict=True):
        delays = fitted.delays_s.get(gear)
        if delays is None:
            untold(found, "the log has no stroke into this gear", (name, unit, by_sheet))
            continue
        if fitted.freedom < 2:
            untold(found, "too few strokes into one gear", (name, unit, by_sheet))
            continue
        mean = float(delays.mean())
        half = math.hypot(
            student(fitted.freedom) * fitted.spread_s * wider / math.sqrt(delays.size),
            SDS * fitted.by_law_sd_s[gear],
        )
        ends = ((mean - half) / MS, (mean + half) / MS)
        found.figures.append(Figure(name, unit, mean / MS, *ends, by_sheet, delays.size))
    by_sheet_ms = (fitted.after_s - sleeve.delay_s) / MS
    found.held_out.append(check_samples("sleeve delay", "ms", fitted.errors_s / MS, by_sheet_ms))
    if fitted.freedom < 2:
        untold(found, "too few strokes into one gear", spread)
    else:
        low, high = scatter_interval(fitted.spread_s / MS, fitted.effective_freedom)
        found.figures.append(
            Figure(*spread[:2], fitted.spread_s / MS, low, high, spread[2], len(fitted.errors_s))
        )


def _tell_mean(
    found: Identified, name: str, unit: str, by_sheet: float | None, samples: Vector, sd: float
) -> None:
    """A mean of independent samples, with another uncertainty beside their scatter."""
    if samples.size < 3:
        untold(found, "too few samples of it in the log", (name, unit, by_sheet))
        return
    mean, count = float(samples.mean()), samples.size
    half = math.hypot(student(count - 1) * float(samples.std(ddof=1)) / math.sqrt(count), 1.96 * sd)
    found.figures.append(Figure(name, unit, mean, mean - half, mean + half, by_sheet, count))


def _clutch(found: Identified, content: LogContent, sheet: GearboxSheet) -> None:
    clutch = sheet.clutch
    name, unit, by_sheet = "clutch kiss point", "%", 100.0 * clutch.kiss_share
    samples = 100.0 * touches(content.closings, sheet)
    if samples.size < LEAST_RUNS:
        why = f"{samples.size} of {len(content.closings)} closings show where the plates touch"
        if not content.messages["EEC1"]:
            why = "no engine speed (EEC1) in the log"
        untold(found, why, (name, unit, by_sheet))
        return
    age = 100.0 * ENGINE_AGE_S / clutch.close_delay_s
    _tell_mean(found, name, unit, by_sheet, samples, age)
    kept_out = (samples - samples.mean()) * samples.size / (samples.size - 1)
    found.held_out.append(check_samples(name, unit, kept_out, samples - by_sheet))


def _never(found: Identified) -> None:
    untold(
        found,
        "torques are not measured: a log shows them over inertias, so the layshaft's is taken from "
        "the data sheet",
        ("layshaft inertia", "kg m2", None),
    )
    untold(
        found,
        "no angle beyond the propeller shaft is measured; the frequency with which the driveline "
        "swings in neutral is one of stiffness over inertias that the data sheet does not have, "
        "and is the lower the more backlash it has",
        ("driveline stiffness", "Nm/rad", None),
    )
