"""What the crossing-time filter claims of its own errors, against a layshaft written apart from it.

Bands are two-sided 95 % of the chi-square or binomial law that holds if the claim does (Bar-Shalom,
Li and Kirubarajan 2001, 5.4.2); the runs are seeded."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pytest
from free_layshaft import Runs, World, drive, law_array

from meshpoint.controller.estimate.crossing_filter import CrossingFilter, Pressures
from meshpoint.controller.estimate.teeth import WheelTeeth
from meshpoint.controller.measure.wheel_edges import EdgeBatch
from meshpoint.controller.models.layshaft import LayshaftState, MotionModel, diagonal, free_motion
from meshpoint.controller.settings.filters import CrossingFilterTuning
from meshpoint.gearbox import GearboxSheet, Split
from meshpoint.units import US

RUNS = 200
BATCH_US = 10_000
END_US = 250_000
AHEAD_US = 45_000
SWITCHES = np.array([[40e3, 140e3, 170e3, 190e3], [1.0, 0.0, 1.0, 0.0]])
"""Free, braked, free, a pulse, free."""
MOMENTS_US = (40_000, 90_000, 150_000, 200_000, 250_000)
PREDICTED_FROM_US = (90_000, 130_000, 160_000)
TUNING = CrossingFilterTuning()


class Bench(NamedTuple):
    """Runs whose starts are as scattered as the filter is given."""

    world: World
    model: MotionModel
    x: np.ndarray
    p: np.ndarray
    runs: Runs


@pytest.fixture(scope="module")
def bench(sheet: GearboxSheet) -> Bench:
    world = World.of(sheet, TUNING)
    inertia = sheet.inertia_kgm2(Split.HIGH)
    x = np.array([0.0, 150.0, 0.0, 0.0, 1.0, -3.0])
    p = diagonal(
        2.0 * TUNING.tooth_error_rad,
        2.0,
        TUNING.pressure_start_sd_pa,
        TUNING.torque_disturbance_nm / inertia,
        TUNING.gain_sd,
        TUNING.drag_sd_nm / inertia,
    )
    rng = np.random.default_rng(1)
    start = x + rng.standard_normal((RUNS, 6)) * np.sqrt(np.diag(p))
    runs = drive(world, start, SWITCHES, END_US * US, rng)
    return Bench(world, free_motion(sheet, Split.HIGH, law_array(), TUNING), x, p, runs)


def begun(bench: Bench) -> CrossingFilter:
    crossing = CrossingFilter(TUNING)
    crossing.begin(0.0, bench.x, bench.p)
    return crossing


def take(crossing: CrossingFilter, bench: Bench, edges: np.ndarray, pressures: Pressures) -> None:
    crossing.take(edges, TUNING.tooth_error_rad, pressures, SWITCHES, bench.model)


def within(arrays: tuple, from_us: float, to_us: float) -> np.ndarray:
    """What of a sensor's data lies in a time (2, n)."""
    inside = (arrays[0] > from_us) & (arrays[0] <= to_us)
    return np.array((arrays[0][inside], arrays[1][inside]))


def error_over_claim(truth: np.ndarray, state: LayshaftState) -> tuple[np.ndarray, np.ndarray]:
    """Errors over their standard deviations, and the claimed correlations."""
    assert state.covariance is not None
    sd = np.sqrt(np.diag(state.covariance))
    return (truth - state.vector) / sd, state.covariance / np.outer(sd, sd)


def band(freedom: float, of: float) -> np.ndarray:
    """Where a chi-square sum of this many degrees lies 95 times of 100, over `of`."""
    from scipy.stats import chi2  # a second: not where tests are collected

    return chi2.ppf([0.025, 0.975], freedom) / of


@pytest.fixture(scope="module")
def filtered(bench: Bench) -> dict[str, object]:
    """Every run through the filter: its squares at the moments, its predictions, innovations."""
    squares = {moment: [] for moment in MOMENTS_US}
    ahead_squares = {from_us: [] for from_us in PREDICTED_FROM_US}
    ahead_errors = {from_us: [] for from_us in PREDICTED_FROM_US}
    innovations, edge_count = np.zeros(2), 0
    definite = []
    for run in range(RUNS):
        crossing = begun(bench)
        edges, (pressure_us, pressure_pa) = bench.runs.edges[run], bench.runs.pressures[run]
        for end_us in range(BATCH_US, END_US + 1, BATCH_US):
            span = end_us - BATCH_US, end_us
            pressures = Pressures(*within((pressure_us, pressure_pa), *span))
            new = within(edges, *span)
            edge_count += new.shape[1]
            take(crossing, bench, new, pressures)
            if end_us in squares:
                state = crossing.at(end_us, SWITCHES, bench.model)
                error, correlation = error_over_claim(bench.runs.state[end_us // 100, run], state)
                squares[end_us].append(error @ np.linalg.solve(correlation, error))
                definite.append((crossing.p, np.linalg.eigvalsh(correlation).min()))
            if end_us in PREDICTED_FROM_US:
                to_us = end_us + AHEAD_US
                ahead = crossing.at(to_us, SWITCHES, bench.model)
                error, correlation = error_over_claim(bench.runs.state[to_us // 100, run], ahead)
                ahead_errors[end_us].append(error)
                ahead_squares[end_us].append(error @ np.linalg.solve(correlation, error))
        innovations += crossing.nis
    # An edge that the gate refuses is not counted.
    assert innovations[1] == edge_count
    return {
        "squares": squares,
        "ahead_errors": ahead_errors,
        "ahead_squares": ahead_squares,
        "innovations": innovations,
        "definite": definite,
    }


def test_innovations_are_as_large_as_the_filter_says(filtered: dict) -> None:
    """NIS over all edges of all runs."""
    total, count = filtered["innovations"]
    assert count > 300 * RUNS
    low, high = band(count, count)
    assert low < total / count < high


@pytest.mark.parametrize("moment_us", MOMENTS_US)
def test_errors_of_all_six_states_are_as_large_as_the_covariance_says(
    filtered: dict, moment_us: int
) -> None:
    """NEES, free, braked and after each release."""
    low, high = band(6 * RUNS, RUNS)
    assert low < np.mean(filtered["squares"][moment_us]) < high


def test_the_covariance_stays_symmetric_and_positive_definite(filtered: dict) -> None:
    for p, least in filtered["definite"]:
        assert np.array_equal(p, p.T)
        assert least > 1e-9


@pytest.mark.parametrize("from_us", PREDICTED_FROM_US)
def test_predictions_are_as_far_off_as_was_said(filtered: dict, from_us: int) -> None:
    """45 ms ahead of a delivered batch, through no switch, the release, a whole pulse: all six
    states together, and angle and speed by themselves."""
    low, high = band(6 * RUNS, RUNS)
    assert low < np.mean(filtered["ahead_squares"][from_us]) < high
    errors = np.array(filtered["ahead_errors"][from_us])[:, :2]
    squares = np.mean(errors**2, axis=0)
    low, high = band(RUNS, RUNS)
    assert np.all((low < squares) & (squares < high)), squares
    inside = np.sum(np.abs(errors) < 1.96, axis=0)
    from scipy.stats import binom

    least, most = binom.ppf([0.025, 0.975], RUNS, 0.95)
    assert np.all((least <= inside) & (inside <= most)), inside


def test_a_wheels_teeth_are_learned_as_well_as_is_said(sheet: GearboxSheet) -> None:
    """Braked windows, each too short to be certain of anything, of one wheel with pitch errors,
    eccentricity and duty bias; the filter believes the noises that are there."""
    rng = np.random.default_rng(2)
    world, teeth = World.of(sheet, TUNING), sheet.wheels.layshaft.teeth
    turn = np.pi / teeth * np.arange(2 * teeth)
    wheel = np.radians(0.1) * rng.standard_normal(2 * teeth) + np.radians(0.14) * np.sin(turn)
    wheel[1::2] += np.radians(0.3)
    wheel -= wheel.mean()
    model = free_motion(sheet, Split.HIGH, law_array(), TUNING)
    x = np.array([0.0, 150.0, 0.0, 0.0, 1.0, -3.0])
    p = diagonal(1e-3, 2.0, 2e4, 3.0, 0.05, 3.0)
    start = x + rng.standard_normal((12, 6)) * np.sqrt(np.diag(p))
    runs = drive(world, start, SWITCHES, END_US * US, rng, wheel)
    learned = WheelTeeth(teeth, TUNING)
    for (time_us, angle, number), pressures in zip(runs.edges, runs.pressures, strict=True):
        learned.learner.begin(0.0, x, p)
        batch = EdgeBatch(time_us, angle, number // 2, number % 2)
        place = learned.place(batch)
        learned.learner.take(batch, place, Pressures(*pressures), SWITCHES, model)
        learned.end_window()
    assert learned.learned
    error = learned.error_rad - wheel
    low, high = band(2 * teeth - 1, 2 * teeth)
    assert low < np.mean(error**2) / learned.sd_rad**2 < high
    assert math.sqrt(np.mean(error**2)) < 0.1 * math.sqrt(np.mean(wheel**2))
