"""Brake, drag and inertias out of runs in neutral: what was fitted, as figures with intervals."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np

from meshpoint.gearbox import GearboxSheet, Split
from meshpoint.identify.brake_fit import BrakeFit, fit
from meshpoint.identify.brake_trajectory import (
    BIN_S,
    BrakeTrajectories,
    P,
    Trajectory,
    make_trajectory,
    prior_of,
    time_constant_s,
)
from meshpoint.identify.held_out import check_runs
from meshpoint.identify.identified import (
    LEAST_RUNS,
    Figure,
    Identified,
    untold,
    why_no_runs,
)
from meshpoint.identify.jackknife import jackknife_sd, student
from meshpoint.identify.log_reader import LogContent
from meshpoint.identify.tooth_fit import teeth_by_model
from meshpoint.kernels.records import Vector
from meshpoint.units import MS, RPM

SENSOR_GAIN_SD: Final = 0.01
"""Of a pressure sensor: the log cannot tell it from the brake's."""
UNTOLD_SHARE: Final = 0.7
"""A figure that is known no better than this share of what it was before is not reported."""
FIRST_ORDER_FROM: Final = 2.0
"""Reduced chi-square of the choked valve from which a first-order one is tried too."""
MOST_REDUCED_CHI2: Final = 30.0
"""Of good logs it was 0.5 to 6.5, of those whose commands and edges do not belong together 1,500
and more (docs/replay.md)."""
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


def brake_figures(
    found: Identified, content: LogContent, sheet: GearboxSheet, zero_pa: float
) -> None:
    """Reports every figure of BRAKE_FIGURES, or why not; and the layshaft's teeth anew, by the
    brake's model."""
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
    trajectories = (
        [] if errors is None else _trajectories(content, sheet, errors.error_rad, zero_pa)
    )
    if not why and len(trajectories) < LEAST_RUNS:
        why = why_no_runs(content)
    fitted = None
    if not why:
        found.omega_ref_rad_s = _reference(trajectories)
        try:
            fitted = _fitted(trajectories, sheet, found.omega_ref_rad_s)
        except np.linalg.LinAlgError:
            why = "the runs contradict each other: their equations have no solution"
    if fitted is not None and fitted[0].reduced_chi2 > MOST_REDUCED_CHI2:
        found.refused = (
            "refused: the runs do not move as brake, drag and inertias would move them, "
            f"reduced chi-square {fitted[0].reduced_chi2:.0f}, 1 is expected and "
            f"{MOST_REDUCED_CHI2:.0f} allowed; valve commands are missing, "
            "or edges and commands are not of one gearbox and one clock"
        )
        found.notes.append(found.refused)
        why = "refused, no equations of motion fit the runs"
        fitted, found.omega_ref_rad_s = None, 0.0
    if fitted is None:
        untold(found, why, *((name, BRAKE_UNITS[name], of_sheet[name]) for name in BRAKE_FIGURES))
        return
    best, is_choked = fitted
    trajectories = [
        trajectory for trajectory, used in zip(trajectories, best.used, strict=True) if used
    ]
    model = BrakeTrajectories(trajectories, sheet, is_choked)
    model.omega_ref = found.omega_ref_rad_s
    if errors is not None:
        used = replace(best, omega_rad_s=best.omega_rad_s[best.used.astype(bool)])
        found.teeth["layshaft"] = teeth_by_model(errors, trajectories, model, used) or errors
    if len(best.used) > len(trajectories):
        left = len(best.used) - len(trajectories)
        found.notes.append(
            f"{left} of {len(best.used)} runs in neutral left out: a sleeve, the clutch or lost "
            "teeth moved the shaft"
        )
    law = "choked flow (ISO 6358)" if is_choked else "first order"
    found.notes.append(
        f"brake pressure: {law}; reduced chi-square {best.reduced_chi2:.2f}, 1 is expected"
    )
    of_sheet["drag"] = _drag(prior_of(sheet).mean[None], sheet, found.omega_ref_rad_s)[0]
    _tell_brake(found, best, is_choked, trajectories, sheet, of_sheet)
    found.held_out.append(check_runs(model, trajectories, best, sheet))


BRAKE_UNITS: Final = dict(
    zip(BRAKE_FIGURES, ("Nm", "%/1000 rpm", *["ms"] * 4, "bar", "Nm", "", "Nm"), strict=True)
)


def _trajectories(
    content: LogContent, sheet: GearboxSheet, error_rad: Vector, zero_pa: float
) -> list[Trajectory]:
    runs = list(content.runs)
    if len(runs) < LEAST_RUNS:
        return []
    first, last = runs[0].start_us, runs[-1].start_us
    span = max(last - first, 1)
    trajectories = (
        make_trajectory(run, sheet, error_rad, zero_pa, (run.start_us - first) / span - 0.5)
        for run in runs
    )
    return [trajectory for trajectory in trajectories if trajectory is not None]


def _reference(trajectories: list[Trajectory]) -> float:
    """The mean speed of the runs, in whole tens of rpm: from the middle of the first bin to that of
    the last."""
    speeds = [
        (trajectory.angle[-1] - trajectory.angle[0]) / (BIN_S * (trajectory.angle.size - 1))
        for trajectory in trajectories
    ]
    return float(round(np.median(speeds) / RPM / 10.0) * 10.0 * RPM)


def _fitted(
    trajectories: list[Trajectory], sheet: GearboxSheet, omega_ref: float
) -> tuple[BrakeFit, bool]:
    choked = fit(trajectories, sheet, True, omega_ref)
    if choked.reduced_chi2 < FIRST_ORDER_FROM:
        return choked, True
    first_order = fit(trajectories, sheet, False, omega_ref)
    return (
        (choked, True) if choked.reduced_chi2 <= first_order.reduced_chi2 else (first_order, False)
    )


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
    trajectories: list[Trajectory],
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
    freedom = len(trajectories) - 1
    one_split = len({trajectory.i_split for trajectory in trajectories}) == 1
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
                Figure(name, unit, None, None, None, of_sheet[name], len(trajectories), why)
            )
            continue
        half = student(freedom) * sd
        found.figures.append(
            Figure(name, unit, value, value - half, value + half, of_sheet[name], len(trajectories))
        )
