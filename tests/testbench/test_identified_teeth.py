"""A wheel's teeth from runs in neutral, against least squares that have the motion among the
unknowns."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from logged_gearbox import EDGES as LAYSHAFT_EDGES
from logged_gearbox import SHEET, STEP_S, TEETH, crossings, runs

from meshpoint.identify.identify import identify
from meshpoint.identify.log_reader import LogContent, Wheel
from meshpoint.identify.tooth_fit import ToothFit, tooth_fit, wheel_figures
from meshpoint.kernels.records import Vector
from meshpoint.units import TURN

JUDDER = 4
"""Amplitudes of the brake's torque: cosine and sine once a turn, and twice."""
TOOTH_COUNT = 20
EDGES = 2 * TOOTH_COUNT
PITCH = TURN / EDGES


def errors_of(seed: int) -> Vector:
    errors = 3e-3 * np.random.default_rng(seed).standard_normal(EDGES)
    return np.asarray(errors - errors.mean())


def turned(
    errors: Vector, rad_s: float, rad_s2: float = 0.0, turns: float = 5.2, first: int = 3,
    added: Vector | None = None,
) -> Wheel:  # fmt: skip
    """Edges of a wheel, seen as the reader has them: their nominal angles at their true times."""
    number = first + np.arange(int(turns * EDGES))
    place, nominal = number % EDGES, PITCH * number
    true = nominal + errors[place] + (0.0 if added is None else added[: number.size])
    way = true - true[0]
    seconds = way / rad_s if not rad_s2 else (
        (np.sqrt(rad_s**2 + 2.0 * rad_s2 * way) - rad_s) / rad_s2)  # fmt: skip
    return Wheel(1e6 * seconds, nominal, place)


def least_squares(wheels: list[Wheel], pressures: list[Vector] | None = None) -> Vector:
    """Errors and judder by one set of equations: each part of a run has a polynomial of the fifth
    degree of its own, and all errors a weak prior."""
    rows: list[Vector] = []
    rights: list[Vector] = []
    parts = []
    for number, wheel in enumerate(wheels):
        count = max(1, int((wheel.theta_rad[-1] - wheel.theta_rad[0]) / (2.0 * TURN)))
        cuts = [round(math.floor(k * wheel.theta_rad.size / count)) for k in range(count + 1)]
        parts += [(number, slice(a, b)) for a, b in itertools.pairwise(cuts)]
    size = EDGES + JUDDER
    for at, (number, part) in enumerate(parts):
        wheel = wheels[number]
        seconds, theta = wheel.time_us[part] * 1e-6, wheel.theta_rad[part]
        block = np.zeros((theta.size, size + 6 * len(parts)))
        block[np.arange(theta.size), wheel.place[part]] = -1.0
        if pressures is not None:
            since = seconds - seconds[0]
            speed = np.polyval(np.polyder(np.polyfit(since, theta, 3)), since)
            gauge = np.interp(wheel.time_us[part], *pressures[number])
            share = gauge / 8.5e5 * (100.0 / speed) ** 2
            angle = PITCH * wheel.place[part]
            block[:, EDGES] = share * np.cos(angle)
            block[:, EDGES + 1] = share * np.sin(angle)
            block[:, EDGES + 2] = share * np.cos(2.0 * angle) / 4.0
            block[:, EDGES + 3] = share * np.sin(2.0 * angle) / 4.0
        scaled = 2.0 * (seconds - seconds[0]) / (seconds[-1] - seconds[0]) - 1.0
        for k in range(6):
            block[:, size + 6 * at + k] = scaled**k
        rows.append(block)
        rights.append(theta - theta[0])
    prior = np.zeros((size, size + 6 * len(parts)))
    prior[:, :size] = 3e-4 / 0.02 * np.eye(size)
    found = np.linalg.lstsq(np.vstack([*rows, prior]),
                            np.concatenate([*rights, np.zeros(size)]), rcond=None)[0]  # fmt: skip
    found[:EDGES] -= found[:EDGES].mean()
    return np.asarray(found[:size])


RUNS = [(90.0, -30.0, 5.2), (120.0, 10.0, 6.9), (70.0, -12.0, 4.6), (100.0, 0.0, 5.5)]


@pytest.fixture(scope="module")
def wheels() -> list[Wheel]:
    rng = np.random.default_rng(4)
    return [
        turned(errors_of(1), rad_s, rad_s2, turns, first, 3e-4 * rng.standard_normal(400))
        for first, (rad_s, rad_s2, turns) in enumerate(RUNS)
    ]


@pytest.fixture(scope="module")
def found(wheels: list[Wheel]) -> ToothFit:
    fit = tooth_fit(wheels, TOOTH_COUNT)
    assert fit is not None
    return fit


def test_teeth_are_those_of_least_squares_with_the_motion_among_the_unknowns(
    wheels: list[Wheel], found: ToothFit
) -> None:
    """Of all runs, and without each in turn."""
    assert found.error_rad == pytest.approx(least_squares(wheels)[:EDGES], abs=1e-8)
    assert found.error_rad == pytest.approx(errors_of(1), abs=4e-4)
    for k in range(len(wheels)):
        others = wheels[:k] + wheels[k + 1 :]
        assert found.without[k] == pytest.approx(least_squares(others)[:EDGES], abs=1e-8)


def test_what_teeth_explain_is_told_of_runs_they_were_not_learned_from(found: ToothFit) -> None:
    """A perfect wheel leaves the teeth's own errors, less what a polynomial of two turns takes of
    them; the others' teeth leave little more than the edges' noise, which is 0.3 mrad."""
    assert 3e-4 * 0.7 < found.held_out_rad < 3e-4 * 1.5
    assert 1.5e-3 < found.nominal_rad < 4e-3
    assert found.spans == 2 + 3 + 2 + 2


def test_the_teeth_are_found_whatever_the_motion() -> None:
    rng = np.random.default_rng(1)
    errors = 2e-3 * rng.standard_normal(LAYSHAFT_EDGES)
    errors[1::2] += 3e-3
    errors -= errors.mean()
    wheels = []
    for _ in range(8):
        seconds = np.arange(int(0.3 / STEP_S)) * STEP_S
        theta = rng.uniform(100.0, 140.0) * seconds - rng.uniform(0.0, 60.0) * seconds**2
        wheels.append(crossings(theta, errors))
    found = tooth_fit(wheels, TEETH)
    assert found is not None
    assert np.std(found.error_rad - errors) < 2e-4
    assert found.held_out_rad < 0.2 * found.nominal_rad
    assert tooth_fit(wheels[:1], TEETH) is None


def test_a_part_in_which_a_sleeve_struck_is_left_out(wheels: list[Wheel]) -> None:
    """The whole of a run of its own: the others tell as much as without it."""
    struck = np.where(np.arange(400) < 70, 0.0, 0.03)
    odd = turned(errors_of(1), 100.0, turns=3.9, added=struck)
    among, alone = tooth_fit([*wheels, odd], TOOTH_COUNT), tooth_fit(wheels, TOOTH_COUNT)
    assert among is not None and alone is not None
    assert among.error_rad == pytest.approx(alone.error_rad, abs=1e-9)
    assert among.spans == alone.spans


def test_teeth_are_not_reported_where_an_edge_is_not_seen() -> None:
    one = turned(errors_of(1), 100.0)
    assert tooth_fit([one, one], TOOTH_COUNT) is not None
    gone = one.place != 5
    blind = Wheel(one.time_us[gone], one.theta_rad[gone], one.place[gone])
    assert tooth_fit([blind, blind], TOOTH_COUNT) is None


def test_a_brake_that_judders_is_reported_from_the_teeth() -> None:
    """Its torque goes with its pressure and moves the shaft by one over the speed's square; that
    of twice a turn by a quarter."""
    rng = np.random.default_rng(9)
    braked, pressures, true = [], [], np.array((1e-3, -2e-3, 3e-3, 1e-3))
    for k in range(4):
        wheel = turned(errors_of(3), 60.0 + 20.0 * k, -6.0, 6.2, k)
        gauge = 8.5e5 * np.clip(np.linspace(-0.4, 1.4, 30) if k % 2 else np.ones(30), 0.0, 1.0)
        samples = np.array((np.linspace(0.0, wheel.time_us[-1], 30), gauge))
        speed = 1e6 * np.gradient(wheel.theta_rad, wheel.time_us)
        share = np.interp(wheel.time_us, *samples) / 8.5e5 * (100.0 / speed) ** 2
        angle = PITCH * wheel.place
        parts = np.cos(angle), np.sin(angle), np.cos(2.0 * angle) / 4.0, np.sin(2.0 * angle) / 4.0
        added = share * (true @ np.stack(parts)) + 1e-4 * rng.standard_normal(angle.size)
        braked.append(Wheel(wheel.time_us, wheel.theta_rad + added, wheel.place))
        pressures.append(samples)
    found = tooth_fit(braked, TOOTH_COUNT, pressures)
    assert found is not None
    expected = least_squares(braked, pressures)
    assert found.error_rad == pytest.approx(expected[:EDGES], abs=1e-7)
    assert found.judder == pytest.approx(expected[EDGES:], abs=1e-7)
    assert found.judder == pytest.approx(true, abs=3e-4)


@pytest.mark.parametrize("once", [0.0, 4e-3])
def test_a_wheel_s_figures_are_duty_eccentricity_and_what_is_left_of_its_teeth(once: float) -> None:
    """An eccentric wheel's middles go as a sine once a turn; a tooth that is wider by an angle has
    its middle where it was."""
    angles = TURN * np.arange(30) / 30
    middle = once * np.cos(angles - 1.1) + 1e-3 * np.cos(5.0 * angles + 0.4) + 7.0
    error = np.stack((middle - 1e-3, middle + 1e-3), axis=1).ravel()
    figures = wheel_figures(error, 0.5)
    assert figures.eccentricity_rad == pytest.approx(once, abs=1e-12)
    assert figures.pitch_rms_rad == pytest.approx(1e-3 / math.sqrt(2.0))
    assert figures.duty_share == pytest.approx(0.5 + 2e-3 / (TURN / 30))


def test_the_layshaft_s_teeth_are_reported_once_more_with_its_motion_by_the_brake_s_model() -> None:
    """A polynomial of a short run takes an eccentricity of 2 mrad for motion, the model does not;
    a wheel with missing teeth is not reported."""
    place = np.arange(LAYSHAFT_EDGES)
    errors = 2e-3 * np.cos(TURN * place / LAYSHAFT_EDGES)
    content = LogContent()
    content.messages.update(["EdgesLayshaftRise", "ValveCommand"])
    for run in runs(6):
        theta = run.layshaft.theta_rad - errors[run.layshaft.place.astype(int)]
        content.runs.add(replace(run, layshaft=replace(run.layshaft, theta_rad=theta)))
    found = identify(content, SHEET)
    assert found.teeth["layshaft"].error_rad == pytest.approx(errors, abs=5e-4)
    wheel = found.figure("layshaft wheel eccentricity")
    assert wheel.value == pytest.approx(math.degrees(2e-3), rel=0.2)
    lacking = replace(SHEET.wheels.layshaft, missing=(3,))
    sheet = replace(SHEET, wheels=replace(SHEET.wheels, layshaft=lacking))
    why = identify(LogContent(), sheet).figure("layshaft wheel eccentricity").why
    assert why == "the wheel has missing teeth"
