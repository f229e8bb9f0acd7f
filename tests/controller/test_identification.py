"""Parameters out of a log: each fit finds what a motion made by other means was made with."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from meshpoint.controller.records import Vector
from meshpoint.dbc.messages import ValveAction, ValveCommand
from meshpoint.gearbox import MainGear, Range, Split, load_sheet
from meshpoint.gearbox.sheet import SheetError
from meshpoint.testbench.identify.brake_course import P, make_course
from meshpoint.testbench.identify.brake_fit import fit
from meshpoint.testbench.identify.clutch_fit import touch_of
from meshpoint.testbench.identify.identified import Figure, Identified
from meshpoint.testbench.identify.identify import identify
from meshpoint.testbench.identify.jackknife import jackknife_sd, scatter_interval
from meshpoint.testbench.identify.log_reader import (
    Closing,
    FreeRun,
    LogContent,
    Stroke,
    Wheel,
)
from meshpoint.testbench.identify.overlay import overlay
from meshpoint.testbench.identify.sleeve_fit import contact_of, sleeve_fit
from meshpoint.testbench.identify.thinning import Thinned
from meshpoint.testbench.identify.tooth_fit import tooth_fit, wheel_figures
from meshpoint.testbench.identify.valve_switches import BRAKE, Switch, ValveSwitches
from meshpoint.units import RPM

SHEET = load_sheet("truck12")
TEETH = SHEET.wheels.layshaft.teeth
STEP_S = 2e-5
GAIN, DELAY_S, TAU_S, DRAG_NM = 0.9, 0.0135, 0.038, 6.0
SENSOR_LAG_S = 0.004


def crossings(theta: Vector, errors: Vector, start_us: int) -> Wheel:
    """Every edge of a wheel whose angle is `theta` each `STEP_S`."""
    half = math.pi / TEETH
    edges = np.arange(1, int(theta[-1] / half))
    nominal = edges * half
    true = nominal + errors[edges % (2 * TEETH)]
    seconds = np.interp(true, theta, np.arange(theta.size) * STEP_S)
    return Wheel(start_us + seconds * 1e6, nominal, edges % (2 * TEETH))


def braked(start_us: int, rpm: float, on_s: float, split: Split) -> FreeRun:
    """The layshaft of another gearbox than the sheet's: brake on at once, off after `on_s`."""
    steps = int(0.25 / STEP_S)
    theta, omega, pressure, felt, supply = np.zeros(steps), rpm * RPM, 0.0, 0.0, 8.2e5
    samples = []
    for k in range(steps - 1):
        since = k * STEP_S
        on = DELAY_S <= since < on_s + DELAY_S
        if k % 500 == 0:
            samples.append((start_us + since * 1e6, felt + SHEET.air.atmosphere_pa))
        felt += STEP_S / SENSOR_LAG_S * (pressure - felt)
        pressure += STEP_S / TAU_S * ((supply if on else 0.0) - pressure)
        torque = GAIN * SHEET.brake_nm_per_pa * pressure + DRAG_NM
        theta[k + 1] = theta[k] + STEP_S * omega
        omega -= STEP_S * torque / SHEET.inertia_kgm2(split)
    end_us = start_us + 250_000
    wheel = crossings(theta, np.zeros(2 * TEETH), start_us)
    switches = (Switch(start_us, True, True), Switch(start_us + int(on_s * 1e6), False, True))
    return FreeRun(
        start_us, end_us, split, Range.HIGH, wheel, wheel, switches, np.array(samples).T,
        supply + SHEET.air.atmosphere_pa, np.empty((2, 0)),
    )  # fmt: skip


def test_the_brake_is_found_by_its_effect_on_the_layshaft() -> None:
    runs = [
        braked(1_000_000 * (k + 1), 1100.0 + 40.0 * k, 0.09 + 0.01 * k, Split(k % 2))
        for k in range(6)
    ]
    none = np.zeros(2 * TEETH)
    courses = [
        course
        for k, run in enumerate(runs)
        if (course := make_course(run, SHEET, none, SHEET.air.atmosphere_pa, k / 5 - 0.5))
    ]
    assert len(courses) == 6
    found = fit(courses, SHEET, False, 900.0 * RPM)
    assert found.used.all()
    value = found.parameters
    assert math.exp(value[P.GAIN]) == pytest.approx(GAIN, rel=0.02)
    assert value[P.ON_DELAY] == pytest.approx(DELAY_S, abs=4e-4)
    assert value[P.OFF_DELAY] == pytest.approx(DELAY_S, abs=4e-4)
    filling = SHEET.brake.time_constant_s * math.exp(-value[P.FILLING])
    assert filling == pytest.approx(TAU_S, rel=0.03)
    assert abs(value[P.INERTIA]) < 0.15


def test_the_teeth_are_found_whatever_the_motion() -> None:
    rng = np.random.default_rng(1)
    errors = 2e-3 * rng.standard_normal(2 * TEETH)
    errors[1::2] += 3e-3
    errors -= errors.mean()
    wheels = []
    for _ in range(8):
        seconds = np.arange(int(0.3 / STEP_S)) * STEP_S
        theta = rng.uniform(100.0, 140.0) * seconds - rng.uniform(0.0, 60.0) * seconds**2
        wheels.append(crossings(theta, errors, 0))
    found = tooth_fit(wheels, TEETH)
    assert found is not None
    assert np.std(found.error_rad - errors) < 2e-4
    assert found.held_out_rad < 0.2 * found.nominal_rad
    share = wheel_figures(found.error_rad, 0.5).duty_share
    assert share == pytest.approx(wheel_figures(errors, 0.5).duty_share, abs=1e-3)
    assert tooth_fit(wheels[:1], TEETH) is None


def stroke(delay_s: float, held_s: float = 0.0) -> Stroke:
    """A sleeve under a constant force; `held_s`: for so long something stops it half-way."""
    at = np.arange(0.0, 0.1, 1e-3)
    valve = SHEET.sleeve.valve_delay_s
    since = np.where(at < 0.035, at, np.maximum(at - held_s, 0.035))
    way = SHEET.sleeve.to_contact_m * np.maximum((since - valve) / (delay_s - valve), 0.0) ** 2
    noise = 3e-5 * np.random.default_rng(2).standard_normal(at.size)
    supply = SHEET.air.supply_gauge_pa + SHEET.air.atmosphere_pa
    way = np.minimum(way, SHEET.sleeve.to_contact_m)
    return Stroke(MainGear.SECOND, 0, at * 1e6, way + noise, supply, None)


def test_a_sleeve_s_contact_is_seen_though_a_tooth_stops_it_there() -> None:
    found = contact_of(stroke(0.0475), SHEET)
    assert found is not None
    assert found.delay_s == pytest.approx(0.0475, abs=2e-4)
    assert contact_of(stroke(0.0475, held_s=0.012), SHEET) is None


def test_strokes_of_a_gear_have_a_mean_and_a_spread() -> None:
    delays = [0.046, 0.047, 0.045, 0.048, 0.0465]
    found = sleeve_fit([stroke(delay) for delay in delays], SHEET)
    assert found is not None
    assert found.delays_s[MainGear.SECOND].mean() == pytest.approx(np.mean(delays), abs=2e-4)
    plain = float(np.std(delays, ddof=1))
    assert plain < found.spread_s < 1.5 * plain
    assert sleeve_fit([], SHEET) is None


@pytest.mark.parametrize("kiss", [0.31, 0.38])
def test_the_kiss_point_is_the_kink_in_the_engine_s_speed(kiss: float) -> None:
    at = np.arange(0.0, 0.21, 0.01)
    engine = np.arange(-0.1, 0.21, 0.01) + 0.0037
    touch = kiss * 0.2
    speed = 140.0 - 70.0 * engine - 3000.0 * np.maximum(engine - touch, 0.0) ** 2
    closing = Closing(at * 1e6, at / 0.2, engine * 1e6, speed)
    assert touch_of(closing, SHEET) == pytest.approx(kiss, abs=0.006)
    flat = Closing(at * 1e6, at / 0.2, engine * 1e6, 140.0 - 70.0 * engine)
    assert touch_of(flat, SHEET) is None


def test_valves_are_followed_as_their_drivers_have_it() -> None:
    valves = ValveSwitches()
    valves.take(ValveCommand(brake_action=ValveAction.ON_AT, brake_time_us=20_000), 10_000)
    valves.take(ValveCommand(brake_action=ValveAction.ON_AT, brake_time_us=30_000), 15_000)
    valves.take(ValveCommand(brake_action=ValveAction.OFF_AT, brake_time_us=90_000), 40_000)
    valves.take(ValveCommand(brake_action=ValveAction.OFF_NOW), 50_000)
    valves.take(ValveCommand(brake_action=ValveAction.ON_AT, brake_time_us=40_000), 60_000)
    valves.take(ValveCommand(brake_action=ValveAction.ON_AT, brake_time_us=900_000), 70_000)
    switches = valves.of(BRAKE, 2_000_000)
    assert switches == [Switch(30_000, True, True), Switch(50_000, False, False)]


def test_a_long_list_is_thinned_evenly() -> None:
    kept: Thinned[int] = Thinned(8)
    for k in range(100):
        kept.add(k)
    assert kept.seen == 100
    assert list(kept) == [0, 16, 32, 48, 64, 80, 96]


def test_a_jackknife_of_means_is_their_standard_error() -> None:
    values = np.array([1.0, 3.0, 2.0, 6.0])
    without = np.array([np.delete(values, k).mean() for k in range(4)])
    assert float(jackknife_sd(without)) == pytest.approx(values.std(ddof=1) / 2.0)
    low, high = scatter_interval(1.0, 10.0)
    assert (low, high) == (pytest.approx(0.699, abs=1e-3), pytest.approx(1.755, abs=1e-3))


def test_what_an_empty_log_does_not_tell_is_said_with_the_reason() -> None:
    found = identify(LogContent(), SHEET)
    assert all(figure.value is None and figure.why for figure in found.figures)
    assert found.figure("brake torque").why == "no valve commands in the log"
    assert found.figure("clutch kiss point").why == "no engine speed (EEC1) in the log"


def test_an_overlay_is_a_data_sheet_that_changes_what_was_told(tmp_path: Path) -> None:
    told = Identified(omega_ref_rad_s=100.0)
    told.figures.append(Figure("brake torque", "Nm", 91.5, 90.0, 93.0, 100.0, 20))
    told.figures.append(Figure("drag", "Nm", 6.0, 5.0, 7.0, None, 20))
    told.figures.append(Figure("inertia ratio", "", None, None, None, 0.4, 20, "one split"))
    path = tmp_path / "own.toml"
    path.write_text(overlay(told, SHEET, "truck12", "a.log"), encoding="utf-8")
    sheet = load_sheet(path)
    assert sheet.name == "truck12, identified"
    assert sheet.brake.max_torque_nm == 91.5
    assert sheet.shafts.friction_nms == pytest.approx(0.06)
    assert sheet.shafts.input_inertia_kgm2 == SHEET.shafts.input_inertia_kgm2
    assert sheet.brake.valve_delay_s == SHEET.brake.valve_delay_s
    again = tmp_path / "again.toml"
    again.write_text('based_on = "own.toml"\n[brake]\nvalve_delay_ms = 10.0\n', encoding="utf-8")
    twice = load_sheet(again)
    assert (twice.brake.max_torque_nm, twice.brake.valve_delay_s) == (91.5, 0.01)
    for text in ('based_on = "own.toml"\n', "based_on = 3\n", 'based_on = "none.toml"\n'):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(SheetError, match=r"own\.toml|none\.toml"):
            load_sheet(path)
