"""The teeth's fit in its parts, against least squares that have the motion among the unknowns."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import t as student_t
from test_identification import SHEET, TEETH, braked

from meshpoint.controller.records import Vector
from meshpoint.gearbox import Split
from meshpoint.testbench.identify.brake_course import BrakeCourses, make_course
from meshpoint.testbench.identify.brake_fit import prior_of
from meshpoint.testbench.identify.log_reader import Wheel
from meshpoint.testbench.identify.tooth_fit import (
    EDGE_RAD,
    JUDDER,
    LEAST_EDGES,
    MOST_ODD,
    PRIOR_RAD,
    ToothFit,
    _judder_shape,
    _Span,
    _spans,
    teeth_by_model,
    tooth_fit,
    wheel_figures,
)
from meshpoint.units import TURN

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


def test_a_tooth_is_as_sure_as_the_runs_agree_on_it(found: ToothFit) -> None:
    """The jackknife's deviation; half of the 95 % interval is Student's with a run less."""
    mean = found.without.mean(axis=0)
    count = found.without.shape[0]
    sd = np.sqrt((count - 1) / count * ((found.without - mean) ** 2).sum(axis=0))
    assert found.sd_rad == pytest.approx(sd)
    assert found.half_rad == pytest.approx(sd * float(student_t.ppf(0.975, count - 1)))


def test_what_teeth_explain_is_told_of_runs_they_were_not_learned_from(
    wheels: list[Wheel], found: ToothFit
) -> None:
    """A perfect wheel leaves the teeth's own errors, less what a polynomial of two turns takes of
    them; the others' teeth leave little more than the edges' noise."""
    assert found.spans == sum(len(_spans(wheel, EDGES, None)) for wheel in wheels)
    squares: dict[str, list[float]] = {"known": [], "nominal": []}
    for number, wheel in enumerate(wheels):
        for a, b in parts_of(wheel):
            seconds, theta = wheel.time_us[a:b], wheel.theta_rad[a:b]
            for name, errors in (("known", found.without[number]), ("nominal", np.zeros(EDGES))):
                angles = theta - theta[0] + errors[wheel.place[a:b]]
                scaled = (seconds - seconds.mean()) / np.ptp(seconds)
                left = angles - np.polyval(np.polyfit(scaled, angles, 5), scaled)
                squares[name].append(float(np.mean(left**2)))
    assert found.held_out_rad == pytest.approx(math.sqrt(np.mean(squares["known"])), rel=1e-3)
    assert found.nominal_rad == pytest.approx(math.sqrt(np.mean(squares["nominal"])), rel=1e-3)
    assert 3e-4 * 0.7 < found.held_out_rad < 3e-4 * 1.5


def parts_of(wheel: Wheel) -> list[tuple[int, int]]:
    """From edge to edge: as many parts as there are pairs of whole turns."""
    turns = (wheel.theta_rad[-1] - wheel.theta_rad[0]) / TURN
    count = max(1, math.floor(turns / 2.0))
    size = wheel.theta_rad.size
    cuts = [size * k // count for k in range(count + 1)]
    return list(itertools.pairwise(cuts))


@pytest.mark.parametrize(("turns", "count"), [(3.9, 1), (4.1, 2), (6.1, 3)])
def test_a_run_is_looked_at_in_parts_of_two_turns_all_its_edges_in_them(
    turns: float, count: int
) -> None:
    wheel = turned(errors_of(1), 100.0, turns=turns)
    spans = _spans(wheel, EDGES, None)
    assert len(spans) == count
    assert sum(span.picked.shape[0] for span in spans) == wheel.theta_rad.size
    assert [span.picked.shape[0] for span in spans] == [b - a for a, b in parts_of(wheel)]


def test_a_run_of_few_edges_tells_nothing() -> None:
    """60 and more do."""
    for edges, told in ((LEAST_EDGES - 1, 0), (LEAST_EDGES, 1)):
        wheel = turned(errors_of(1), 100.0, turns=(edges + 0.5) / EDGES)
        assert wheel.theta_rad.size == edges
        assert len(_spans(wheel, EDGES, None)) == told
    assert LEAST_EDGES == 60


def test_a_part_in_which_a_sleeve_struck_is_left_out(wheels: list[Wheel]) -> None:
    """More than four times as much is left of it as usual. The others tell as much as without it:
    it is the whole of a run of its own."""
    struck = np.where(np.arange(400) < 70, 0.0, 0.03)
    odd = turned(errors_of(1), 100.0, turns=3.9, added=struck)
    among = tooth_fit([*wheels, odd], TOOTH_COUNT)
    alone = tooth_fit(wheels, TOOTH_COUNT)
    assert among is not None and alone is not None
    assert among.error_rad == pytest.approx(alone.error_rad, abs=1e-9)
    assert among.spans == alone.spans
    assert MOST_ODD == 4.0


def test_teeth_are_not_told_from_one_run_nor_where_an_edge_is_not_seen() -> None:
    one = turned(errors_of(1), 100.0)
    assert tooth_fit([one], TOOTH_COUNT) is None
    assert tooth_fit([one, one], TOOTH_COUNT) is not None
    gone = one.place != 5
    blind = Wheel(one.time_us[gone], one.theta_rad[gone], one.place[gone])
    assert tooth_fit([blind, blind], TOOTH_COUNT) is None


def test_a_weak_prior_draws_an_edge_that_was_hardly_seen_toward_none() -> None:
    assert (EDGE_RAD, PRIOR_RAD, JUDDER) == (3e-4, 0.02, 4)
    short = [turned(errors_of(2), 100.0, turns=1.6, first=k) for k in (0, 7)]
    found = tooth_fit(short, TOOTH_COUNT)
    assert found is not None
    assert found.error_rad == pytest.approx(least_squares(short)[:EDGES], abs=1e-8)


def test_a_brake_that_judders_is_told_from_the_teeth() -> None:
    """Its amplitudes go with its pressure, and with one over the speed's square; once and twice a
    turn, the second a quarter for the same torque."""
    rng = np.random.default_rng(9)
    runs, pressures = [], []
    for k in range(4):
        number = np.arange(int(6.2 * EDGES))
        wheel = turned(errors_of(3), 60.0 + 20.0 * k, -6.0, 6.2, k)
        gauge = 8.5e5 * np.clip(np.linspace(-0.4, 1.4, 30) if k % 2 else np.ones(30), 0.0, 1.0)
        samples = np.array((np.linspace(0.0, wheel.time_us[-1], 30), gauge))
        speed = 1e6 * np.gradient(wheel.theta_rad, wheel.time_us)
        share = np.interp(wheel.time_us, *samples) / 8.5e5 * (100.0 / speed) ** 2
        shape = _judder_shape(share, speed * 0.0 + 100.0, wheel.place, EDGES)
        added = shape @ np.array((1e-3, -2e-3, 3e-3, 1e-3))
        added = added + 1e-4 * rng.standard_normal(number.size)
        runs.append(Wheel(wheel.time_us, wheel.theta_rad + added, wheel.place))
        pressures.append(samples)
    found = tooth_fit(runs, TOOTH_COUNT, pressures)
    assert found is not None
    expected = least_squares(runs, pressures)
    assert found.error_rad == pytest.approx(expected[:EDGES], abs=1e-7)
    assert found.judder == pytest.approx(expected[EDGES:], abs=1e-7)
    assert found.judder == pytest.approx([1e-3, -2e-3, 3e-3, 1e-3], abs=3e-4)


def test_judder_moves_the_shaft_by_its_torque_over_the_square_of_its_frequency() -> None:
    """p / (k w)^2: a speed twice as high moves a quarter, pressure below none is none, and a shaft
    that hardly turns counts as turning at 10 rad/s."""
    place = np.arange(EDGES)
    at = PITCH * place
    for share, rad_s, size in ((1.0, 100.0, 1.0), (0.5, 200.0, 0.125), (-1.0, 100.0, 0.0),
                               (1.0, 5.0, 100.0), (1.0, 10.0, 100.0)):  # fmt: skip
        found = _judder_shape(np.full(EDGES, share), np.full(EDGES, rad_s), place, EDGES)
        parts = np.cos(at), np.sin(at), np.cos(2.0 * at) / 4.0, np.sin(2.0 * at) / 4.0
        assert found == pytest.approx(size * np.stack(parts, axis=1), abs=1e-12)


@pytest.mark.parametrize(("samples", "counts"), [(1, False), (2, True)])
def test_two_samples_of_the_pressure_are_enough(samples: int, counts: bool) -> None:
    wheel = turned(errors_of(1), 100.0, turns=3.0)
    pressure = np.array((np.linspace(0.0, wheel.time_us[-1], samples), np.full(samples, 8.5e5)))
    span = _Span(wheel.time_us, wheel.theta_rad, wheel.place, EDGES, pressure)
    assert bool(span.picked[:, EDGES:].any()) is counts


@pytest.mark.parametrize("once", [0.0, 4e-3])
def test_a_wheel_s_figures_are_duty_eccentricity_and_what_is_left_of_its_teeth(once: float) -> None:
    """An eccentric wheel's middles go as a sine once a turn; a tooth that is wider by an angle has
    its middle where it was."""
    teeth = 30
    angles = TURN * np.arange(teeth) / teeth
    wavy = once * np.cos(angles - 1.1)
    own = 1e-3 * np.cos(5.0 * angles + 0.4)
    middle, wide = wavy + own + 7.0, 2e-3
    error = np.empty(2 * teeth)
    error[::2], error[1::2] = middle - wide / 2.0, middle + wide / 2.0
    figures = wheel_figures(error, 0.5)
    assert figures.eccentricity_rad == pytest.approx(once, abs=1e-12)
    assert figures.pitch_rms_rad == pytest.approx(1e-3 / math.sqrt(2.0))
    assert figures.duty_share == pytest.approx(0.5 + wide / (TURN / teeth))


def test_teeth_are_told_once_more_from_runs_whose_motion_the_brake_s_model_has() -> None:
    """Whatever the model leaves of the angles, a wheel whose teeth are elsewhere by some errors is
    found to have these errors more, but for what a line through a run takes of them."""
    runs = [braked(1_000_000 * (k + 1), 1100.0 + 60.0 * k, 0.1, Split(k % 2)) for k in range(2)]
    none = np.zeros(2 * TEETH)
    made = [make_course(run, SHEET, none, SHEET.air.atmosphere_pa, 0.0) for run in runs]
    courses = [course for course in made if course is not None]
    assert len(courses) == 2
    best: Any = SimpleNamespace(
        parameters=prior_of(SHEET).mean,
        omega_rad_s=np.array([course.omega_rad_s for course in courses]),
    )
    model = BrakeCourses(courses, SHEET, False)
    errors = 1e-3 * np.random.default_rng(2).standard_normal(2 * TEETH)
    errors -= errors.mean()
    other = [
        replace(course, theta_rad=course.theta_rad - errors[course.place.astype(int)])
        for course in courses
    ]
    first = ToothFit(none, np.zeros((2, 2 * TEETH)), np.zeros(JUDDER), 0.1, 0.2, 7)
    before = teeth_by_model(first, courses, model, best)
    found = teeth_by_model(first, other, model, best)
    assert before is not None and found is not None
    off = found.error_rad - before.error_rad - errors
    assert float(np.sqrt(np.mean(off**2))) < 0.1e-3
    assert (found.held_out_rad, found.nominal_rad, found.spans) == (0.1, 0.2, 7)
    assert found.without.shape == (2, 2 * TEETH)
