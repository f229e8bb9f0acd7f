"""The baselines of layshaft estimation on a wheel without errors: the thesis's filter knows where a
braked layshaft is, the production speed is that of the last 10 ms, held."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from meshpoint.controller.estimate.baselines import BaselineTracker, CruiseTracker
from meshpoint.controller.estimate.layshaft_tracker import LayshaftModels
from meshpoint.controller.estimate.wheel_tracker import (
    ESTIMATE_STALE_US,
    SPEED_WINDOW_US,
    WindowSpeed,
)
from meshpoint.controller.measure.gearbox_view import NO_SAMPLES
from meshpoint.controller.measure.wheel_edges import NO_EDGES, EdgeBatch
from meshpoint.controller.models.layshaft import BrakeInput, first_order_law, free_motion
from meshpoint.controller.models.thesis import layshaft_model
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.messages import Estimator
from meshpoint.gearbox import Split, load_sheet

SHEET = load_sheet("truck12")
SPLIT = Split.HIGH
TEETH = SHEET.wheels.layshaft.teeth
HALF_PITCH = math.pi / TEETH
DELAY_US, ON_US, OFF_US = 12_000, 150_000, 230_000
FREE_US, END_US = 100_000, 400_000
START_RAD_S = 140.0
BASELINES = (Estimator.THESIS, Estimator.WINDOW)


def truth() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Times (us), angle, speed and pressure of a layshaft that is braked for 80 ms, by SciPy."""
    inertia, brake = SHEET.inertia_kgm2(SPLIT), SHEET.brake

    def rate(u: float) -> object:
        def slope(_: float, y: np.ndarray) -> list[float]:
            torque = SHEET.shafts.friction_nms * y[1] + SHEET.brake_nm_per_pa * y[2]
            full = SHEET.air.supply_gauge_pa * u
            return [y[1], -torque / inertia, (full - y[2]) / brake.time_constant_s]

        return slope

    at, y = [np.arange(0.0, FREE_US, 50.0)], [START_RAD_S * 1e-6 * np.arange(0.0, FREE_US, 50.0)]
    angle = [y[0]]
    omega, pressure = [np.full(at[0].size, START_RAD_S)], [np.zeros(at[0].size)]
    state = np.array([START_RAD_S * FREE_US * 1e-6, START_RAD_S, 0.0])
    cuts = (FREE_US, ON_US + DELAY_US, OFF_US + DELAY_US, END_US)
    for (first, last), u in zip(itertools.pairwise(cuts), (0.0, 1.0, 0.0), strict=True):
        times = np.arange(first, last, 50.0)
        solved = solve_ivp(rate(u), (first * 1e-6, last * 1e-6), state, rtol=1e-10, atol=1e-9,
                           t_eval=np.append(times, last) * 1e-6)  # fmt: skip
        state = solved.y[:, -1]
        at.append(times)
        for found, values in zip((angle, omega, pressure), solved.y, strict=True):
            found.append(values[:-1])
    return tuple(np.concatenate(each) for each in (at, angle, omega, pressure))  # type: ignore[return-value]


AT_US, ANGLE, OMEGA, PRESSURE = truth()
EDGE_ANGLES = HALF_PITCH * np.arange(1, int(ANGLE[-1] / HALF_PITCH))
EDGES_US = np.interp(EDGE_ANGLES, ANGLE, AT_US)


def batch(first_us: float, last_us: float) -> EdgeBatch:
    inside = (first_us < EDGES_US) & (last_us >= EDGES_US)
    number = np.flatnonzero(inside) + 1
    return EdgeBatch(EDGES_US[inside], EDGE_ANGLES[inside], number // 2, number % 2)


def tracker_of(estimator: Estimator) -> BaselineTracker:
    settings, brake = ControllerSettings(), BrakeInput(DELAY_US)
    brake.schedule(ON_US, True, 0)
    brake.schedule(OFF_US, False, ON_US)
    found = BaselineTracker(estimator, settings, brake, 2.0 * HALF_PITCH)
    with pytest.raises(RuntimeError, match="model"):
        _ = found.model
    assert found.drag_nm(100.0) == 0.0
    law = first_order_law(1.0 / SHEET.brake.time_constant_s, SHEET.air.supply_gauge_pa)
    motion = free_motion(SHEET, SPLIT, law, settings.crossing_filter)
    thesis = layshaft_model(SHEET, SPLIT)
    found.set_models(LayshaftModels(motion, thesis, SHEET.inertia_kgm2(SPLIT)))
    return found


def followed(estimator: Estimator, until_us: int) -> BaselineTracker:
    """Has seen all edges to a time, 10 ms at a time; free from 100 ms on."""
    found = tracker_of(estimator)
    for now_us in range(10_000, until_us + 1, 10_000):
        found.set_free(now_us > FREE_US, float(now_us - 10_000), [])
        found.edges(batch(now_us - 10_000, now_us), NO_SAMPLES)
    return found


def true_at(time_us: float) -> tuple[float, float, float]:
    return tuple(float(np.interp(time_us, AT_US, one)) for one in (ANGLE, OMEGA, PRESSURE))  # type: ignore[return-value]


@pytest.mark.parametrize("until_us", [150_000, 200_000, 250_000, 350_000])
def test_the_thesis_s_filter_knows_angle_speed_and_pressure_and_what_they_will_be(
    until_us: int,
) -> None:
    """Through both switches of the brake that are known ahead."""
    found = followed(Estimator.THESIS, until_us)
    assert found.free
    for ahead_us in (0.0, 5_000.0, 30_000.0):
        state = found.at(until_us + ahead_us)
        assert state is not None
        theta, omega, pressure = true_at(until_us + ahead_us)
        assert state.time_us == until_us + ahead_us
        assert state.theta_rad == pytest.approx(theta, abs=0.02 * HALF_PITCH + 3e-8 * ahead_us)
        assert state.omega_rad_s == pytest.approx(omega, abs=0.6)
        assert state.pressure_pa == pytest.approx(pressure, abs=1.5e4)
    newest = found.latest()
    assert newest.time_us == pytest.approx(EDGES_US[until_us >= EDGES_US][-1])
    assert 0.0 < newest.theta_sd_rad < 0.02 * HALF_PITCH
    assert 0.0 < newest.omega_sd_rad_s < 2.0
    assert 0.0 < newest.pressure_sd_pa < 3e4


@pytest.mark.parametrize("until_us", [150_000, 220_000, 350_000])
def test_the_production_speed_is_that_of_the_last_10_ms_and_holds_between_edges(
    until_us: int,
) -> None:
    """The angle goes on from the last edge at that speed; the pressure is by the commands alone."""
    found = followed(Estimator.WINDOW, until_us)
    newest_us = EDGES_US[until_us >= EDGES_US][-1]
    before = EDGES_US[newest_us - SPEED_WINDOW_US >= EDGES_US][-1]
    turned = true_at(newest_us)[0] - true_at(before)[0]
    speed = turned / ((newest_us - before) * 1e-6)
    for ahead_us in (0.0, 4_000.0, 8_000.0):
        state = found.at(newest_us + ahead_us)
        assert state is not None
        assert state.omega_rad_s == pytest.approx(speed, rel=1e-4)
        expected = true_at(newest_us)[0] + speed * ahead_us * 1e-6
        assert state.theta_rad == pytest.approx(expected, abs=1e-4)
        assert state.pressure_pa == pytest.approx(true_at(newest_us + ahead_us)[2], abs=2e3)
    assert found.latest().omega_rad_s == pytest.approx(speed, rel=1e-4)


@pytest.mark.parametrize("estimator", BASELINES)
def test_with_a_gear_in_mesh_the_layshaft_turns_evenly_and_has_no_pressure(
    estimator: Estimator,
) -> None:
    found = followed(estimator, FREE_US)
    assert not found.free
    state = found.at(FREE_US + 2_000.0)
    assert state is not None
    assert state.omega_rad_s == pytest.approx(START_RAD_S, abs=0.05)
    assert state.theta_rad == pytest.approx(START_RAD_S * (FREE_US + 2_000.0) * 1e-6, abs=1e-3)
    assert state.pressure_pa == 0.0
    assert state.pressure_sd_pa > 0.0


@pytest.mark.parametrize("estimator", BASELINES)
def test_a_speed_that_was_lost_or_is_long_ago_is_none(estimator: Estimator) -> None:
    for lose in ("restart", "lose_speed"):
        found = followed(estimator, 200_000)
        getattr(found, lose)()
        assert not found.free
        assert found.at(200_000.0) is None
        found.set_free(True, 200_000.0, [])
        assert not found.free, "there is no speed to begin with"
        found.edges(batch(200_000, 210_000), NO_SAMPLES)
        found.set_free(True, 210_000.0, [])
        assert found.free
    for until_us in (FREE_US, 200_000):
        found = followed(estimator, until_us)
        found.edges(NO_EDGES, NO_SAMPLES)
        newest_us = EDGES_US[until_us >= EDGES_US][-1]
        assert found.at(newest_us + ESTIMATE_STALE_US - 1.0) is not None
        assert found.at(newest_us + ESTIMATE_STALE_US + 1.0) is None


@pytest.mark.parametrize("estimator", BASELINES)
def test_a_gear_that_comes_in_again_ends_what_the_free_layshaft_was_known_by(
    estimator: Estimator,
) -> None:
    found = followed(estimator, 200_000)
    found.set_free(False, 200_000.0, [])
    assert found.at(200_000.0) is None
    found.edges(batch(200_000, 210_000), NO_SAMPLES)
    found.edges(batch(210_000, 220_000), NO_SAMPLES)
    assert found.at(220_000.0) is not None
    assert not found.free


def test_the_sheet_s_friction_brakes_by_the_speed() -> None:
    found = tracker_of(Estimator.THESIS)
    for omega in (100.0, -100.0, 30.0):
        assert found.drag_nm(omega) == pytest.approx(SHEET.shafts.friction_nms * abs(omega))


def test_the_production_speed_needs_two_edges_and_forgets_with_them() -> None:
    speed = WindowSpeed()
    assert (speed.newest, speed.omega_rad_s) == (None, None)
    speed.edges(NO_EDGES)
    one = batch(0.0, EDGES_US[0] + 1.0)
    speed.edges(one)
    assert speed.newest == (EDGES_US[0], EDGE_ANGLES[0])
    assert speed.omega_rad_s is None
    speed.edges(batch(EDGES_US[0] + 1.0, EDGES_US[1] + 1.0))
    assert speed.omega_rad_s == pytest.approx(START_RAD_S, rel=1e-3)
    speed.restart()
    assert (speed.newest, speed.omega_rad_s) == (None, None)


def test_a_shaft_at_an_even_speed_is_known_better_and_better_and_less_well_ahead() -> None:
    tuning = ControllerSettings().cruise_filter
    cruise = CruiseTracker(tuning, 2.0 * HALF_PITCH)
    assert cruise.at(1_000.0) is None
    sds = []
    for now_us in range(10_000, FREE_US + 1, 10_000):
        cruise.edges(batch(now_us - 10_000, now_us))
        state = cruise.at(float(now_us))
        assert state is not None
        assert state.omega_rad_s == pytest.approx(START_RAD_S, abs=0.2)
        sds.append((state.theta_sd_rad, state.omega_sd_rad_s))
    assert sds[-1][0] < 0.2 * sds[0][0]
    assert sds[-1][1] < 0.5 * sds[0][1]
    newest_us = EDGES_US[EDGES_US <= FREE_US][-1]
    now, ahead = cruise.at(newest_us), cruise.at(newest_us + 40_000.0)
    assert now is not None and ahead is not None
    q, dt = tuning.acceleration_rad_s2, 0.04
    assert ahead.omega_sd_rad_s == pytest.approx(math.hypot(now.omega_sd_rad_s, q * dt))
    assert ahead.theta_rad == pytest.approx(now.theta_rad + now.omega_rad_s * dt)
    least = math.hypot(now.theta_sd_rad, 0.5 * q * dt * dt)
    most = least + now.omega_sd_rad_s * dt + now.theta_sd_rad
    assert least < ahead.theta_sd_rad < most
