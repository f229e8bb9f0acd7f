"""A run in neutral by the model that is fitted to it, against the same equations written once more
and solved in small steps: each parameter does what it is said to do."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from test_identification import SHEET, braked

from meshpoint.controller.records import Vector
from meshpoint.gearbox import Split
from meshpoint.testbench.identify.brake_course import (
    COUNT,
    GRID_S,
    LAMINAR_FROM,
    SOFT_RAD_S,
    TYPICAL_LAG_S,
    BrakeCourses,
    Course,
    P,
    angles_at,
    flow_share,
    make_course,
    prior_of,
)
from meshpoint.units import BAR, RPM

ATMOSPHERE_PA = SHEET.air.atmosphere_pa
FINE = 20
"""Small steps in one of the grid's."""


def course_of(split: Split = Split.HIGH, engine_rpm: float | None = 900.0) -> Course:
    run = braked(1_000_000, 1_400.0, 0.09, split)
    if engine_rpm is not None:
        engine = np.array([[0.0, 5e6], [engine_rpm * RPM, engine_rpm * RPM]])
        run = replace(run, engine=engine)
    made = make_course(run, SHEET, np.zeros(2 * SHEET.wheels.layshaft.teeth), ATMOSPHERE_PA, 0.3)
    assert made is not None
    return made


def flow(behind_pa: float, before_pa: float, critical: float) -> float:
    """ISO 6358, mass flow over that of the choked valve; laminar where the pressures are nearly
    alike."""
    ratio = behind_pa / before_pa
    if ratio <= critical:
        return 1.0
    part = (min(ratio, LAMINAR_FROM) - critical) / (1.0 - critical)
    return math.sqrt(1.0 - part**2) * min(1.0, max(0.0, (1.0 - ratio) / (1.0 - LAMINAR_FROM)))


def solved(
    course: Course, parameters: Vector, omega: float, choked: bool, omega_ref: float
) -> tuple[Vector, Vector, Vector]:
    """Angle, speed and felt pressure at the grid's nodes."""
    p = {name: float(parameters[name]) for name in P}
    supply = course.supply_pa + p[P.SUPPLY] * BAR
    gain = SHEET.brake_nm_per_pa * math.exp(p[P.GAIN]) * (1.0 + p[P.BY_TIME] * course.share_of_log)
    shafts, i = SHEET.shafts, course.i_split
    inertia = shafts.layshaft_inertia_kgm2
    inertia += shafts.input_inertia_kgm2 * math.exp(p[P.INERTIA]) / i**2
    lag_s = TYPICAL_LAG_S * math.exp(p[P.SENSOR_LAG])
    rate = 1.0 / SHEET.brake.time_constant_s
    pressure = felt = theta = 0.0
    found, step = [], GRID_S / FINE
    engine = course.engine_rad_s
    for k in range(course.nodes * FINE):
        if k % FINE == 0:
            found.append((theta, omega, felt))
        now_s, on = k * step, False
        for at_s, is_on in course.switches:
            if now_s >= at_s + p[P.ON_DELAY if is_on else P.OFF_DELAY] - 1e-9:
                on = is_on
        if choked:
            own, before = pressure + ATMOSPHERE_PA, supply + ATMOSPHERE_PA
            filling = before * flow(own, before, p[P.CRITICAL])
            emptying = own * flow(ATMOSPHERE_PA, own, p[P.CRITICAL])
        else:
            filling, emptying = supply - pressure, pressure
        by = math.exp(p[P.FILLING]) * filling if on else -math.exp(p[P.EMPTYING]) * emptying
        after = min(max(pressure + step * rate * by, 0.0), supply)
        felt += step / lag_s * (0.5 * (pressure + after) - felt)
        if k >= course.first_node * FINE:
            torque = gain * max(0.0, pressure - p[P.TOUCH] * BAR)
            torque *= 1.0 + p[P.BY_SPEED] * (omega - omega_ref) / (1000.0 * RPM)
            torque += p[P.DRAG] + (p[P.VISCOUS] + p[P.INPUT_VISCOUS] / i**2) * omega
            if np.isfinite(engine).all():
                ahead = float(engine[min(k // FINE, engine.size - 1)]) - omega / i
                torque -= p[P.PLATES] / i * math.tanh(ahead / SOFT_RAD_S)
            theta += step * (omega - 0.5 * step * torque / inertia)
            omega -= step * torque / inertia
        pressure = after
    return tuple(np.array(column) for column in zip(*found, strict=True))  # type: ignore[return-value]


def drawn(seed: int, course: Course) -> Vector:
    """A gearbox from the tolerances; its valve switches at whole small steps."""
    prior, rng = prior_of(SHEET), np.random.default_rng(seed)
    parameters = prior.mean + 0.5 * prior.sd * rng.uniform(-1.0, 1.0, COUNT)
    parameters[P.CRITICAL] = rng.uniform(0.2, 0.5)
    parameters[P.TOUCH] = rng.uniform(0.0, 0.4)
    step = GRID_S / FINE
    for number, name in enumerate((P.ON_DELAY, P.OFF_DELAY)):
        at_s = course.switches[number][0]
        parameters[name] = step * round((at_s + parameters[name]) / step) - at_s
    return parameters


@pytest.mark.parametrize("choked", [True, False])
@pytest.mark.parametrize("split", list(Split))
@pytest.mark.parametrize("engine_rpm", [None, 700.0, 1_900.0])
def test_a_run_goes_as_its_equations_say_whatever_the_gearbox(
    choked: bool, split: Split, engine_rpm: float | None
) -> None:
    course = course_of(split, engine_rpm)
    model = BrakeCourses([course], SHEET, choked)
    model.omega_ref = 120.0
    for seed in range(3):
        parameters, omega = drawn(seed, course), 140.0 + 5.0 * seed
        angles, speeds, felts = model.run(parameters[None], np.array([omega]))
        theta, speed, felt = solved(course, parameters, omega, choked, 120.0)
        lost = omega - speed[-1]
        assert lost > 5.0
        assert speeds[:, 0, 0] == pytest.approx(speed, abs=0.004 * lost + 0.01)
        assert angles[:, 0, 0] == pytest.approx(theta, abs=0.002 * lost * 0.25 + 1e-3)
        assert felts[:, 0, 0] == pytest.approx(felt, abs=0.01 * float(felt.max()) + 200.0)


def test_runs_and_gearboxes_that_are_gone_through_at_once_go_as_each_by_itself() -> None:
    courses = [course_of(Split.LOW, 800.0), course_of(Split.HIGH, None)]
    both = BrakeCourses(courses, SHEET, True)
    lanes = np.array([drawn(seed, courses[0]) for seed in range(2)])
    omega = np.array([150.0, 140.0])
    together = both.run(lanes, omega)
    for number, course in enumerate(courses):
        for lane in range(2):
            alone = BrakeCourses([course], SHEET, True).run(lanes[lane : lane + 1], omega[[number]])
            for all_, own in zip(together, alone, strict=True):
                assert all_[: course.nodes, lane, number] == pytest.approx(own[:, 0, 0], rel=1e-9)


def test_a_course_is_the_run_s_angles_in_bins_and_its_first_speed() -> None:
    """Angles and speeds at the grid's nodes give the bins' means back, by what weighs them."""
    course = course_of()
    run = braked(1_000_000, 1_400.0, 0.09, Split.HIGH)
    seconds = (run.layshaft.time_us - run.start_us) * 1e-6
    at = np.arange(course.nodes) * GRID_S - course.first_node * GRID_S
    smooth = np.polynomial.Polynomial.fit(seconds, run.layshaft.theta_rad, 9)
    angles = smooth(np.clip(at, 0.0, seconds[-1])) - run.layshaft.theta_rad[0]
    speeds = smooth.deriv()(np.clip(at, 0.0, seconds[-1]))
    told = course.weights[:, :, 0] @ angles + course.weights[:, :, 1] @ speeds
    inside = slice(1, -1)
    assert course.angle[inside] == pytest.approx(told[inside], abs=2e-2)
    assert course.weights[:, :, 0].sum(axis=1) == pytest.approx(1.0)
    assert course.omega_rad_s == pytest.approx(1_400.0 * RPM, rel=0.02)
    assert course.edges.sum() <= run.layshaft.time_us.size
    edges = angles_at(course.nodes_of_edges, angles, speeds)
    assert edges[20:-20] == pytest.approx(course.theta_rad[20:-20], abs=2e-2)
    assert course.pressure_s.size == course.pressure_pa.size == run.pressure.shape[1]
    assert course.pressure_pa == pytest.approx(run.pressure[1] - ATMOSPHERE_PA)
    assert course.supply_pa == pytest.approx(run.supply_pa - ATMOSPHERE_PA)
    assert [on for _, on in course.switches] == [True, False]
    assert course.switches[1][0] - course.switches[0][0] == pytest.approx(0.09)
    assert course.switches[0][0] == pytest.approx(course.first_node * GRID_S, abs=GRID_S)
    assert course.share_of_log == 0.3


def test_air_flows_as_iso_6358_has_it() -> None:
    for critical in (0.2, 0.4):
        for ratio in (0.1, critical, 0.6, 0.9, 0.98, 0.9999, 1.0):
            found = float(flow_share(np.array([ratio]), np.array([critical]))[0])
            assert found == pytest.approx(flow(ratio, 1.0, critical), abs=1e-9)
