"""All that a log tells of a gearbox: values with 95 % intervals, and what it does not tell and why.

Each run in neutral, stroke and closing of the log is kept out in turn: the rest gives the interval
(jackknife), and predicts what was kept out (held-out check).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from meshpoint.controller.identification.brake_course import (
    BrakeCourses,
    Course,
    P,
    make_course,
    prior_of,
    time_constant_s,
)
from meshpoint.controller.identification.brake_fit import BrakeFit, fit
from meshpoint.controller.identification.clutch_fit import touches
from meshpoint.controller.identification.held_out import HeldOut, check_runs, check_samples
from meshpoint.controller.identification.jackknife import (
    jackknife_sd,
    scatter_interval,
    student,
)
from meshpoint.controller.identification.log_reader import LogContent
from meshpoint.controller.identification.sleeve_fit import SleeveFit, sleeve_fit
from meshpoint.controller.identification.tooth_fit import (
    ToothFit,
    teeth_by_model,
    tooth_fit,
    wheel_figures,
)
from meshpoint.controller.records import Vector
from meshpoint.gearbox import GearboxSheet, Split
from meshpoint.gearbox.gears import MAIN_GEARS
from meshpoint.units import DEG, MS, RPM

LEAST_RUNS: Final = 5
SENSOR_GAIN_SD: Final = 0.01
"""Of a pressure sensor: the log cannot tell it from the brake's."""
ENGINE_AGE_S: Final = 0.002
"""Standard deviation of how old an engine speed is when it is sent: its message has no time."""
UNTOLD_SHARE: Final = 0.7
"""A figure that is known no better than this share of what it was before is not told."""
FIRST_ORDER_FROM: Final = 2.0
"""Misfit of the choked valve from which a first-order one is tried too."""


@dataclass(frozen=True)
class Figure:
    """One quantity. All values in `unit`; None where the log does not tell it."""

    name: str
    unit: str
    value: float | None
    low: float | None
    high: float | None
    """Ends of the 95 % interval."""
    sheet: float | None
    """What the data sheet says; None where it says nothing."""
    samples: int
    """Runs, strokes or closings that it comes from."""
    why: str = ""
    """Why it is not told."""


@dataclass
class Identified:
    """The result."""

    figures: list[Figure] = field(default_factory=list)
    held_out: list[HeldOut] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    omega_ref_rad_s: float = 0.0
    """Layshaft speed at which torque and drag are told."""
    supply_pa: float = 0.0
    """Mean absolute supply pressure at which the sleeves' delays are told."""
    teeth: dict[str, ToothFit] = field(default_factory=dict)

    def figure(self, name: str) -> Figure:
        """By its name. KeyError where there is none."""
        for figure in self.figures:
            if figure.name == name:
                return figure
        raise KeyError(name)

    def value(self, name: str) -> float | None:
        """Its value; None where it is not told."""
        return self.figure(name).value


Tell = Callable[[str], None]


def identify(content: LogContent, sheet: GearboxSheet, tell: Tell | None = None) -> Identified:
    """Everything that can be told. tell: is called with the name of each step."""
    found = Identified()
    tell = tell or _silent
    tell("teeth")
    zero_pa = _zero_pa(content, sheet)
    _fit_teeth(found, content, sheet, zero_pa)
    tell("brake")
    _brake(found, content, sheet, zero_pa)
    _teeth(found, content, sheet)
    tell("sleeves")
    _sleeves(found, sleeve_fit(content.strokes, sheet), content, sheet)
    tell("clutch")
    _clutch(found, content, sheet)
    _never(found)
    return found


def _silent(_step: str) -> None:
    """Nobody is told."""


def _zero_pa(content: LogContent, sheet: GearboxSheet) -> float:
    """What the pressure sensor shows of an empty brake."""
    return float(np.mean(content.empty_pa)) if content.empty_pa else sheet.air.atmosphere_pa


def _untold(found: Identified, why: str, *names_units: tuple[str, str, float | None]) -> None:
    for name, unit, of_sheet in names_units:
        found.figures.append(Figure(name, unit, None, None, None, of_sheet, 0, why))


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
            why = "the wheel has missing teeth" if wheel.missing else _why_no_runs(content)
            _untold(found, why, *names)
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


def _why_no_runs(content: LogContent) -> str:
    messages = content.messages
    for name, why in (
        ("EdgesLayshaftRise", "no layshaft edges in the log"),
        ("SleevesMain", "no sleeve positions in the log"),
        ("SleevesAux", "no positions of splitter and range in the log"),
        ("GearboxSensors", "no clutch position and pressures in the log"),
    ):
        if not messages[name]:
            return why
    return f"{len(content.runs)} runs in neutral with an open clutch, {LEAST_RUNS} are needed"


BRAKE_FIGURES: Final = (
    "brake torque",
    "brake torque by speed",
    "brake valve on delay",
    "brake valve off delay",
    "brake filling time",
    "brake emptying time",
    "brake touch pressure",
    "drag",
    "inertia ratio",
    "open clutch drag",
)


def _brake(found: Identified, content: LogContent, sheet: GearboxSheet, zero_pa: float) -> None:
    brake, shafts = sheet.brake, sheet.shafts
    ratio = shafts.input_inertia_kgm2 / shafts.layshaft_inertia_kgm2
    of_sheet = dict.fromkeys(BRAKE_FIGURES, None) | {
        "brake torque": brake.max_torque_nm,
        "brake valve on delay": brake.valve_delay_s / MS,
        "brake valve off delay": brake.valve_delay_s / MS,
        "brake filling time": brake.time_constant_s / MS,
        "brake emptying time": brake.time_constant_s / MS,
        "inertia ratio": ratio,
    }
    why = "" if content.messages["ValveCommand"] else "no valve commands in the log"
    errors = found.teeth.get("layshaft")
    courses = [] if errors is None else _courses(content, sheet, errors.error_rad, zero_pa)
    if not why and len(courses) < LEAST_RUNS:
        why = _why_no_runs(content)
    fitted = None
    if not why:
        found.omega_ref_rad_s = _reference(courses)
        try:
            fitted = _fitted(courses, sheet, found.omega_ref_rad_s)
        except np.linalg.LinAlgError:
            why = "the runs contradict each other: their equations have no solution"
    if fitted is None:
        _untold(found, why, *((name, BRAKE_UNITS[name], of_sheet[name]) for name in BRAKE_FIGURES))
        return
    best, is_choked = fitted
    courses = [course for course, used in zip(courses, best.used, strict=True) if used]
    model = BrakeCourses(courses, sheet, is_choked)
    model.omega_ref = found.omega_ref_rad_s
    if errors is not None:
        used = replace(best, omega_rad_s=best.omega_rad_s[best.used.astype(bool)])
        found.teeth["layshaft"] = teeth_by_model(errors, courses, model, used) or errors
    if len(best.used) > len(courses):
        left = len(best.used) - len(courses)
        found.notes.append(
            f"{left} of {len(best.used)} runs in neutral left out: a sleeve, the clutch or lost "
            "teeth moved the shaft"
        )
    law = "choked flow (ISO 6358)" if is_choked else "first order"
    found.notes.append(f"brake pressure: {law}; misfit {best.misfit:.2f}, 1 is expected")
    of_sheet["drag"] = _drag(prior_of(sheet).mean[None], sheet, found.omega_ref_rad_s)[0]
    _tell_brake(found, best, is_choked, courses, sheet, of_sheet)
    found.held_out.append(check_runs(model, courses, best, sheet))


BRAKE_UNITS: Final = dict(
    zip(BRAKE_FIGURES, ("Nm", "%/1000 rpm", *["ms"] * 4, "bar", "Nm", "", "Nm"), strict=True)
)


def _courses(
    content: LogContent, sheet: GearboxSheet, error_rad: Vector, zero_pa: float
) -> list[Course]:
    runs = list(content.runs)
    if len(runs) < LEAST_RUNS:
        return []
    first, last = runs[0].start_us, runs[-1].start_us
    span = max(last - first, 1)
    courses = (
        make_course(run, sheet, error_rad, zero_pa, (run.start_us - first) / span - 0.5)
        for run in runs
    )
    return [course for course in courses if course is not None]


def _reference(courses: list[Course]) -> float:
    """The mean speed of the runs, in whole tens of rpm."""
    speeds = [
        (course.angle[-1] - course.angle[0]) / (5e-3 * course.angle.size) for course in courses
    ]
    return float(round(np.median(speeds) / RPM / 10.0) * 10.0 * RPM)


def _fitted(courses: list[Course], sheet: GearboxSheet, omega_ref: float) -> tuple[BrakeFit, bool]:
    choked = fit(courses, sheet, True, omega_ref)
    if choked.misfit < FIRST_ORDER_FROM:
        return choked, True
    first_order = fit(courses, sheet, False, omega_ref)
    return (choked, True) if choked.misfit <= first_order.misfit else (first_order, False)


def _drag(parameters: Vector, sheet: GearboxSheet, omega_ref: float) -> Vector:
    """Torque (Nm) at the layshaft without brake, splitter high, input shaft included."""
    i2 = sheet.split_mesh(Split.HIGH).ratio ** -2
    viscous = parameters[:, P.VISCOUS] + parameters[:, P.INPUT_VISCOUS] * i2
    drag: Vector = parameters[:, P.DRAG] + viscous * omega_ref
    return drag


def _derived(
    parameters: Vector, is_choked: bool, sheet: GearboxSheet, omega_ref: float
) -> dict[str, Vector]:
    """The figures of many parameter vectors (lanes, COUNT), in their units."""
    brake, air, shafts = sheet.brake, sheet.air, sheet.shafts
    tau = brake.time_constant_s
    times = {}
    for name, parameter, on in (
        ("brake filling time", P.FILLING, True),
        ("brake emptying time", P.EMPTYING, False),
    ):
        rates = np.exp(parameters[:, parameter]) / tau
        critical = np.clip(parameters[:, P.CRITICAL], 0.0, 0.6)
        pressures = (air.supply_gauge_pa, air.atmosphere_pa)
        times[name] = (
            time_constant_s(rates, *pressures, critical, on) if is_choked else 1.0 / rates
        ) / MS
    return {
        "brake torque": brake.max_torque_nm * np.exp(parameters[:, P.GAIN]),
        "brake torque by speed": 100.0 * parameters[:, P.BY_SPEED],
        "brake valve on delay": parameters[:, P.ON_DELAY] / MS,
        "brake valve off delay": parameters[:, P.OFF_DELAY] / MS,
        **times,
        "brake touch pressure": parameters[:, P.TOUCH],
        "drag": _drag(parameters, sheet, omega_ref),
        "inertia ratio": np.exp(parameters[:, P.INERTIA])
        * shafts.input_inertia_kgm2
        / shafts.layshaft_inertia_kgm2,
        "open clutch drag": parameters[:, P.PLATES],
    }


def _tell_brake(
    found: Identified,
    best: BrakeFit,
    is_choked: bool,
    courses: list[Course],
    sheet: GearboxSheet,
    of_sheet: dict[str, float | None],
) -> None:
    omega_ref = found.omega_ref_rad_s
    values = _derived(best.parameters[None], is_choked, sheet, omega_ref)
    without = _derived(best.without, is_choked, sheet, omega_ref)
    draws = (
        best.parameters
        + np.random.Generator(np.random.PCG64(0)).standard_normal((400, best.parameters.size))
        @ np.linalg.cholesky(best.covariance).T
    )
    drawn = _derived(draws, is_choked, sheet, omega_ref)
    before = prior_of(sheet)
    wide = (
        before.mean
        + np.random.Generator(np.random.PCG64(1)).standard_normal((400, before.mean.size))
        * before.sd
    )
    known = _derived(wide, is_choked, sheet, omega_ref)
    freedom = len(courses) - 1
    one_split = len({course.i_split for course in courses}) == 1
    for name in BRAKE_FIGURES:
        value, unit = float(values[name][0]), BRAKE_UNITS[name]
        sd = max(float(jackknife_sd(without[name])), float(np.std(drawn[name])))
        if name == "brake torque":
            sd = math.hypot(sd, SENSOR_GAIN_SD * value)
        why = ""
        if name == "inertia ratio" and one_split:
            why = "all runs in one step of the splitter: inertias are seen as one"
        elif sd > UNTOLD_SHARE * float(np.std(known[name])):
            why = "the runs tell no more of it than the data sheet"
        if why:
            found.figures.append(
                Figure(name, unit, None, None, None, of_sheet[name], len(courses), why)
            )
            continue
        half = student(freedom) * sd
        found.figures.append(
            Figure(name, unit, value, value - half, value + half, of_sheet[name], len(courses))
        )


def _sleeves(
    found: Identified, fitted: SleeveFit | None, content: LogContent, sheet: GearboxSheet
) -> None:
    sleeve = sheet.sleeve
    spread = ("sleeve delay spread", "ms", sleeve.delay_sd_s / MS)
    names = [
        (f"sleeve delay {gear.name.lower()}", "ms", sleeve.delay_s / MS) for gear in MAIN_GEARS
    ]
    if fitted is None:
        why = "no stroke of a main sleeve in the log"
        if not content.messages["ValveCommand"]:
            why = "no valve commands in the log"
        elif content.inexact:
            why = "its valves were switched at once, not at a commanded time"
        _untold(found, why, *names, spread)
        return
    found.supply_pa = fitted.supply_pa
    correlation = fitted.correlation
    wider = math.sqrt((1.0 + correlation) / (1.0 - correlation))
    kept_out, of_sheet = [], []
    for gear, (name, unit, by_sheet) in zip(MAIN_GEARS, names, strict=True):
        delays = fitted.delays_s.get(gear)
        if delays is None or fitted.freedom < 2:
            _untold(found, "the log has no stroke into this gear", (name, unit, by_sheet))
            continue
        mean = float(delays.mean())
        half = student(fitted.freedom) * fitted.spread_s * wider / math.sqrt(delays.size)
        ends = ((mean - half) / MS, (mean + half) / MS)
        found.figures.append(Figure(name, unit, mean / MS, *ends, by_sheet, delays.size))
        if delays.size > 1:
            kept_out.append((delays - mean) * delays.size / (delays.size - 1) / MS)
            of_sheet.append((delays - sleeve.delay_s) / MS)
    if kept_out:
        found.held_out.append(
            check_samples("sleeve delay", "ms", np.concatenate(kept_out), np.concatenate(of_sheet))
        )
    if fitted.freedom < 2:
        _untold(found, "too few strokes into one gear", spread)
    else:
        low, high = scatter_interval(fitted.spread_s / MS, fitted.effective_freedom)
        found.figures.append(
            Figure(*spread[:2], fitted.spread_s / MS, low, high, spread[2], fitted.used)
        )


def _tell_mean(
    found: Identified, name: str, unit: str, by_sheet: float | None, samples: Vector, sd: float
) -> None:
    """A mean of independent samples, with another uncertainty beside their scatter."""
    if samples.size < 3:
        _untold(found, "too few samples of it in the log", (name, unit, by_sheet))
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
        _untold(found, why, (name, unit, by_sheet))
        return
    age = 100.0 * ENGINE_AGE_S / clutch.close_delay_s
    _tell_mean(found, name, unit, by_sheet, samples, age)
    kept_out = (samples - samples.mean()) * samples.size / (samples.size - 1)
    found.held_out.append(check_samples(name, unit, kept_out, samples - by_sheet))


def _never(found: Identified) -> None:
    _untold(
        found,
        "torques are not measured: a log shows them over inertias, so the layshaft's is taken from "
        "the data sheet",
        ("layshaft inertia", "kg m2", None),
    )
    _untold(
        found,
        "no angle beyond the propeller shaft is measured; the frequency with which the driveline "
        "swings in neutral is one of stiffness over inertias that the data sheet does not have, "
        "and is the lower the more backlash it has",
        ("driveline stiffness", "Nm/rad", None),
    )
