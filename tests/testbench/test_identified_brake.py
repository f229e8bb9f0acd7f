"""Brake, drag and inertia from runs in neutral: the model against its equations solved in small
steps, and the fit against gearboxes whose parameters are known."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from logged_gearbox import DELAY_S, EDGES, GAIN, SHEET, TAU_S, braked, runs
from scipy.integrate import quad

from meshpoint.gearbox import Split
from meshpoint.identify.brake_fit import CHANCE_RAD2_S3, fit, whitening
from meshpoint.identify.brake_trajectory import (
    COUNT,
    GRID_S,
    LAMINAR_FROM,
    SOFT_RAD_S,
    TYPICAL_LAG_S,
    BrakeTrajectories,
    P,
    Trajectory,
    angles_at,
    flow_share,
    make_trajectory,
    prior_of,
    time_constant_s,
)
from meshpoint.identify.identify import identify
from meshpoint.identify.log_reader import LogContent
from meshpoint.kernels.records import Vector
from meshpoint.units import BAR, RPM

ATMOSPHERE_PA = SHEET.air.atmosphere_pa
FINE = 20
"""Small steps in one of the grid's."""


def trajectory_of(split: Split = Split.HIGH, engine_rpm: float | None = 900.0) -> Trajectory:
    run = braked(1_000_000, 1_400.0, 0.09, split)
    if engine_rpm is not None:
        engine = np.array([[0.0, 5e6], [engine_rpm * RPM, engine_rpm * RPM]])
        run = replace(run, engine=engine)
    made = make_trajectory(run, SHEET, np.zeros(EDGES), ATMOSPHERE_PA, 0.3)
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
    trajectory: Trajectory, parameters: Vector, omega: float, choked: bool, omega_ref: float
) -> tuple[Vector, Vector, Vector]:
    """Angle, speed and felt pressure at the grid's nodes."""
    p = {name: float(parameters[name]) for name in P}
    supply = trajectory.supply_pa + p[P.SUPPLY] * BAR
    gain = (
        SHEET.brake_nm_per_pa * math.exp(p[P.GAIN]) * (1.0 + p[P.BY_TIME] * trajectory.share_of_log)
    )
    shafts, i = SHEET.shafts, trajectory.i_split
    inertia = shafts.layshaft_inertia_kgm2
    inertia += shafts.input_inertia_kgm2 * math.exp(p[P.INERTIA]) / i**2
    lag_s = TYPICAL_LAG_S * math.exp(p[P.SENSOR_LAG])
    rate = 1.0 / SHEET.brake.time_constant_s
    pressure = felt = theta = 0.0
    found, step = [], GRID_S / FINE
    engine = trajectory.engine_rad_s
    for k in range(trajectory.nodes * FINE):
        if k % FINE == 0:
            found.append((theta, omega, felt))
        now_s, on = k * step, False
        for at_s, is_on in trajectory.switches:
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
        if k >= trajectory.first_node * FINE:
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


def drawn(seed: int, trajectory: Trajectory) -> Vector:
    """A gearbox from the tolerances; its valve switches at whole small steps."""
    prior, rng = prior_of(SHEET), np.random.default_rng(seed)
    parameters = prior.mean + 0.5 * prior.sd * rng.uniform(-1.0, 1.0, COUNT)
    parameters[P.CRITICAL] = rng.uniform(0.2, 0.5)
    parameters[P.TOUCH] = rng.uniform(0.0, 0.4)
    step = GRID_S / FINE
    for number, name in enumerate((P.ON_DELAY, P.OFF_DELAY)):
        at_s = trajectory.switches[number][0]
        parameters[name] = step * round((at_s + parameters[name]) / step) - at_s
    return parameters


@pytest.mark.parametrize("choked", [True, False])
@pytest.mark.parametrize("split", list(Split))
@pytest.mark.parametrize("engine_rpm", [None, 700.0, 1_900.0])
def test_a_run_goes_as_its_equations_say_whatever_the_gearbox(
    choked: bool, split: Split, engine_rpm: float | None
) -> None:
    trajectory = trajectory_of(split, engine_rpm)
    model = BrakeTrajectories([trajectory], SHEET, choked)
    model.omega_ref = 120.0
    for seed in range(3):
        parameters, omega = drawn(seed, trajectory), 140.0 + 5.0 * seed
        angles, speeds, felts = model.run(parameters[None], np.array([omega]))
        theta, speed, felt = solved(trajectory, parameters, omega, choked, 120.0)
        lost = omega - speed[-1]
        assert lost > 5.0
        assert speeds[:, 0, 0] == pytest.approx(speed, abs=0.004 * lost + 0.01)
        assert angles[:, 0, 0] == pytest.approx(theta, abs=0.002 * lost * 0.25 + 1e-3)
        assert felts[:, 0, 0] == pytest.approx(felt, abs=0.01 * float(felt.max()) + 200.0)


def test_a_trajectory_is_the_run_s_angles_in_bins_and_its_first_speed() -> None:
    """Angles and speeds at the grid's nodes give the bins' means back, by what weighs them."""
    trajectory = trajectory_of()
    run = braked(1_000_000, 1_400.0, 0.09, Split.HIGH)
    seconds = (run.layshaft.time_us - run.start_us) * 1e-6
    at = np.arange(trajectory.nodes) * GRID_S - trajectory.first_node * GRID_S
    smooth = np.polynomial.Polynomial.fit(seconds, run.layshaft.theta_rad, 9)
    angles = smooth(np.clip(at, 0.0, seconds[-1])) - run.layshaft.theta_rad[0]
    speeds = smooth.deriv()(np.clip(at, 0.0, seconds[-1]))
    reported = trajectory.weights[:, :, 0] @ angles + trajectory.weights[:, :, 1] @ speeds
    inside = slice(1, -1)
    assert trajectory.angle[inside] == pytest.approx(reported[inside], abs=2e-2)
    assert trajectory.weights[:, :, 0].sum(axis=1) == pytest.approx(1.0)
    assert trajectory.omega_rad_s == pytest.approx(1_400.0 * RPM, rel=0.02)
    assert trajectory.edges.sum() <= run.layshaft.time_us.size
    edges = angles_at(trajectory.nodes_of_edges, angles, speeds)
    assert edges[20:-20] == pytest.approx(trajectory.theta_rad[20:-20], abs=2e-2)
    assert trajectory.pressure_s.size == trajectory.pressure_pa.size == run.pressure.shape[1]
    assert trajectory.pressure_pa == pytest.approx(run.pressure[1] - ATMOSPHERE_PA)
    assert trajectory.supply_pa == pytest.approx(run.supply_pa - ATMOSPHERE_PA)
    assert [on for _, on in trajectory.switches] == [True, False]
    assert trajectory.switches[1][0] - trajectory.switches[0][0] == pytest.approx(0.09)
    assert trajectory.switches[0][0] == pytest.approx(trajectory.first_node * GRID_S, abs=GRID_S)
    assert trajectory.share_of_log == 0.3


def test_air_flows_as_iso_6358_has_it() -> None:
    for critical in (0.2, 0.4):
        for ratio in (0.1, critical, 0.6, 0.9, 0.98, 0.9999, 1.0):
            found = float(flow_share(np.array([ratio]), np.array([critical]))[0])
            assert found == pytest.approx(flow(ratio, 1.0, critical), abs=1e-9)


@pytest.mark.parametrize("critical", [0.2, 0.3])
def test_a_brake_s_time_constant_is_that_to_63_percent_of_its_way_by_iso_6358(
    critical: float,
) -> None:
    """The time to fill or empty at 20 a second: a quadrature of one over the flow."""
    gauge_pa, air_pa, way = 8e5, 1e5, 1.0 - math.exp(-1.0)
    full_pa = air_pa + gauge_pa
    for filling, ends, rate in (
        (True, (air_pa, air_pa + way * gauge_pa), lambda p: full_pa * flow(p, full_pa, critical)),
        (False, (full_pa - way * gauge_pa, full_pa), lambda p: p * flow(air_pa, p, critical)),
    ):
        expected_s = quad(lambda p, rate=rate: 1.0 / rate(p), *ends)[0] / 20.0
        found = time_constant_s(np.array([20.0]), gauge_pa, air_pa, np.array([critical]), filling)
        assert found == pytest.approx([expected_s], rel=1e-4)


def test_whitened_angles_of_a_shaft_that_chance_drives_are_independent() -> None:
    """A torque of white noise from the run's beginning on moves the angle by the integral of its
    age times the noise, and every edge has an error of its own."""
    seconds = np.array((0.02, 0.05, 0.09, 0.2))
    variances = np.array((1e-7, 4e-7, 1e-7, 9e-7))
    grid = (np.arange(20_000) + 0.5) * 1e-5
    ages = np.maximum(seconds[:, None] - grid, 0.0)
    covariance = CHANCE_RAD2_S3 * (ages @ ages.T) * 1e-5 + np.diag(variances)
    white = whitening(seconds, variances)
    assert white @ covariance @ white.T == pytest.approx(np.eye(4), abs=1e-4)


@pytest.fixture(scope="module")
def trajectories() -> list[Trajectory]:
    made = [
        make_trajectory(run, SHEET, np.zeros(EDGES), ATMOSPHERE_PA, k / 5 - 0.5)
        for k, run in enumerate(runs())
    ]
    found = [trajectory for trajectory in made if trajectory is not None]
    assert len(found) == 6
    return found


def test_the_brake_is_found_by_its_effect_on_the_layshaft(trajectories: list[Trajectory]) -> None:
    found = fit(trajectories, SHEET, False, 900.0 * RPM)
    assert found.used.all()
    value = found.parameters
    assert math.exp(value[P.GAIN]) == pytest.approx(GAIN, rel=0.02)
    assert value[P.ON_DELAY] == pytest.approx(DELAY_S, abs=4e-4)
    assert value[P.OFF_DELAY] == pytest.approx(DELAY_S, abs=4e-4)
    filling = SHEET.brake.time_constant_s * math.exp(-value[P.FILLING])
    assert filling == pytest.approx(TAU_S, rel=0.03)
    assert abs(value[P.INERTIA]) < 0.15


def test_a_run_in_which_something_else_moved_the_shaft_is_as_if_it_were_not_there(
    trajectories: list[Trajectory],
) -> None:
    """In the middle of the run a sleeve gives the shaft a push."""
    push = 0.3 * np.maximum(np.linspace(-1.0, 1.0, trajectories[2].angle.size), 0.0)
    pushed = replace(trajectories[2], angle=trajectories[2].angle + push)
    among = [*trajectories[:3], pushed, *trajectories[3:]]
    found, alone = (fit(each, SHEET, False, 900.0 * RPM) for each in (among, trajectories))
    assert found.used.tolist() == [True] * 3 + [False] + [True] * 3
    assert np.abs((found.parameters - alone.parameters) / alone.prior.sd).max() < 2e-3
    assert found.reduced_chi2 == pytest.approx(alone.reduced_chi2, rel=0.01)
    assert found.covariance == pytest.approx(alone.covariance, rel=0.05, abs=1e-12)


@pytest.mark.parametrize("pulled", [(0, 1), (0, 2), (2, 4)])
def test_two_of_six_runs_in_which_a_torque_pulled_do_not_hide_each_other(
    trajectories: list[Trajectory], pulled: tuple[int, int]
) -> None:
    """A steady torque on the shaft, of 1 rad by the run's end. Before anything is left out, runs
    that do not fit weigh less: else the two draw the fit to them, and all six seem to fit."""
    among = []
    for k, each in enumerate(trajectories):
        share = np.linspace(0.0, 1.0, each.angle.size)
        among.append(replace(each, angle=each.angle + (k in pulled) * share**2))
    found, whole = (fit(each, SHEET, False, 900.0 * RPM) for each in (among, trajectories))
    assert found.used.tolist() == [k not in pulled for k in range(6)]
    assert np.abs((found.parameters - whole.parameters) / whole.prior.sd).max() < 0.1


def test_what_is_found_without_a_run_is_what_the_others_alone_tell(
    trajectories: list[Trajectory],
) -> None:
    whole = fit(trajectories, SHEET, False, 900.0 * RPM)
    for k in (0, 5):
        others = fit([*trajectories[:k], *trajectories[k + 1 :]], SHEET, False, 900.0 * RPM)
        assert np.abs((whole.without[k] - others.parameters) / whole.prior.sd).max() < 0.1


def content_of(count: int, split: Split | None = None) -> LogContent:
    content = LogContent()
    names = ("ValveCommand", "EdgesLayshaftRise", "SleevesMain", "SleevesAux", "GearboxSensors")
    content.messages.update(names)
    for run in runs(count):
        content.runs.add(run if split is None else replace(run, split=split))
    return content


def test_figures_of_a_log_have_the_true_ones_in_their_intervals_and_predict_better() -> None:
    """100 Nm by the sheet; the runs know it better than the sheet does."""
    found = identify(content_of(8), SHEET)
    for name, true in (
        ("brake torque", 100.0 * GAIN),
        ("brake valve on delay", 1e3 * DELAY_S),
        ("brake valve off delay", 1e3 * DELAY_S),
    ):
        figure = found.figure(name)
        assert figure.value == pytest.approx(true, rel=0.05), name
        assert figure.low is not None and figure.high is not None
        assert figure.low < true < figure.high, name
        assert figure.samples == 8
    check = next(each for each in found.held_out if each.name.startswith("layshaft speed"))
    assert (check.unit, check.samples) == ("rpm", 8)
    assert check.identified < 0.3 * check.by_sheet


def test_too_few_runs_or_one_step_of_the_splitter_alone_tell_less() -> None:
    few = identify(content_of(4), SHEET).figure("drag")
    assert (few.value, few.why) == (
        None, "4 runs in neutral with an open clutch, 5 are needed",
    )  # fmt: skip
    one = identify(content_of(6, Split.HIGH), SHEET).figure("inertia ratio")
    assert one.value is None
    assert one.why == "all runs in one step of the splitter: inertias are seen as one"
