"""The brake's model term by term, each where its motion can be written down; and what a run becomes
before it is fitted."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp

from meshpoint.controller.records import Vector
from meshpoint.gearbox import Range, Split, load_sheet
from meshpoint.testbench.identify.brake_course import (
    COUNT,
    BrakeCourses,
    Course,
    P,
    angles_at,
    flow_share,
    make_course,
    prior_of,
    time_constant_s,
)
from meshpoint.testbench.identify.log_reader import FreeRun, Wheel
from meshpoint.testbench.identify.valve_switches import Switch

SHEET = load_sheet("truck12")
AIR_PA = SHEET.air.atmosphere_pa
TEETH = SHEET.wheels.layshaft.teeth
STEP_S, LEAD, NODES = 1e-3, 30, 90
TAU_S = SHEET.brake.time_constant_s
SHAFTS = SHEET.shafts
I_SPLIT = 1.25
RPM = 2.0 * math.pi / 60.0
NM_PER_PA = SHEET.brake_nm_per_pa
QUICK, QUICK_S = -9.0, 3e-3 * math.exp(-5.0)
"""A sensor as quick as one can be, and by how much it is late all the same."""


def course_of(**changed: Any) -> Course:
    """A run of 60 ms behind 30 ms of lead, whose valve is switched on at the very beginning."""
    nothing = np.zeros(0)
    values: dict[str, Any] = {
        "angle": nothing, "weights": nothing, "edges": nothing, "nodes_of_edges": nothing,
        "theta_rad": nothing, "place": nothing, "first_node": LEAD, "nodes": NODES,
        "start_us": 0.0, "switches": ((0.0, True),), "pressure_s": nothing, "pressure_pa": nothing,
        "supply_pa": 8e5, "i_split": I_SPLIT, "omega_rad_s": 100.0,
        "engine_rad_s": np.full(NODES, np.nan), "share_of_log": 0.25,
    }  # fmt: skip
    return Course(**(values | changed))


def parameters(**values: float) -> Vector:
    """None but these; the sensor's lag is that of the law."""
    found = np.zeros((1, COUNT))
    for name, value in values.items():
        found[0, P[name]] = value
    return found


def gone(
    course: Course, values: Vector, omega: float = 100.0, choked: bool = False
) -> tuple[Vector, Vector, Vector]:
    model = BrakeCourses([course], SHEET, choked)
    angles, speeds, felts = model.run(values, np.array([omega]))
    return angles[:, 0, 0], speeds[:, 0, 0], felts[:, 0, 0]


AT_S = STEP_S * np.arange(NODES)
SINCE_S = STEP_S * (np.arange(NODES) - LEAD)
INERTIA = SHAFTS.layshaft_inertia_kgm2 + SHAFTS.input_inertia_kgm2 / I_SPLIT**2
PLAIN = {"DRAG": 0.0, "TOUCH": 50.0}
"""The brake never touches: what moves the shaft is drag alone."""


def test_what_is_known_before_a_log_is_read() -> None:
    """A mean and a standard deviation each; delays are known to a half of the sheet's."""
    delay = SHEET.brake.valve_delay_s
    expected = {
        P.GAIN: (0.0, 0.7), P.BY_SPEED: (0.0, 0.15), P.BY_TIME: (0.0, 0.1),
        P.INERTIA: (0.0, 0.4), P.DRAG: (0.0, 10.0), P.VISCOUS: (SHAFTS.friction_nms, 0.15),
        P.ON_DELAY: (delay, delay / 2), P.OFF_DELAY: (delay, delay / 2),
        P.FILLING: (0.0, 0.7), P.EMPTYING: (0.0, 0.7), P.TOUCH: (0.2, 0.3),
        P.SUPPLY: (0.0, 0.2), P.SENSOR_LAG: (0.0, 1.0), P.CRITICAL: (0.3, 0.08),
        P.INPUT_VISCOUS: (0.0, 0.01), P.PLATES: (0.0, 2.0),
    }  # fmt: skip
    prior = prior_of(SHEET)
    assert len(expected) == COUNT == prior.mean.size == prior.sd.size
    for name, (mean, sd) in expected.items():
        assert (prior.mean[name], prior.sd[name]) == (pytest.approx(mean), pytest.approx(sd))
    quick = prior_of(replace(SHEET, brake=replace(SHEET.brake, valve_delay_s=0.001)))
    assert quick.sd[P.ON_DELAY] == quick.sd[P.OFF_DELAY] == pytest.approx(0.002)
    assert quick.mean[P.OFF_DELAY] == pytest.approx(0.001)


def test_a_first_order_brake_fills_and_empties_exponentially_and_its_sensor_follows() -> None:
    """Felt: two lags in a row, of the sheet's 45 ms less 20 % and of 3 ms times e."""
    values = parameters(FILLING=math.log(1.25), SUPPLY=0.5, SENSOR_LAG=1.0, **PLAIN)
    _, _, felt = gone(course_of(), values)
    a, b = 1.0 / (0.003 * math.e), 1.25 / TAU_S
    both = (a * np.exp(-b * AT_S) - b * np.exp(-a * AT_S)) / (a - b)
    assert felt == pytest.approx(8.5e5 * (1.0 - both), abs=8.5e5 * 2e-4)
    assert felt[0] == 0.0
    off = course_of(switches=((0.0, True), (0.04, False)))
    _, _, felt = gone(off, parameters(EMPTYING=math.log(0.8), SENSOR_LAG=QUICK, **PLAIN))
    full = 8e5 * (1.0 - math.exp(-0.04 / TAU_S))
    emptying = full * np.exp(-0.8 * (AT_S - 0.04 - QUICK_S) / TAU_S)
    assert felt[41:] == pytest.approx(emptying[41:], abs=40.0)


@pytest.mark.parametrize(("log_lag", "lag_s"), [(9.0, 3e-3 * math.exp(4.0)), (-9.0, 2.02e-5)])
def test_a_sensor_lags_by_no_more_than_54_and_no_less_than_a_hundredth_of_what_is_usual(
    log_lag: float, lag_s: float
) -> None:
    """Behind a pressure that rises steadily, it is behind by its lag."""
    course = course_of(supply_pa=1e7, nodes=400, engine_rad_s=np.full(400, np.nan))
    values = parameters(SENSOR_LAG=log_lag, FILLING=-4.0, **PLAIN)
    _, _, felt = gone(course, values)
    rate = 1e7 * math.exp(-4.0) / TAU_S
    slow = math.exp(-4.0) / TAU_S
    at = STEP_S * np.arange(400)
    a = 1.0 / lag_s
    both = (a * np.exp(-slow * at) - slow * np.exp(-a * at)) / (a - slow)
    assert felt == pytest.approx(1e7 * (1.0 - both), abs=rate * 1e-6)


def test_a_valve_acts_its_delay_after_its_switch_and_in_part_of_a_step() -> None:
    """On at 4.3 ms with 2.5 ms of delay: from 6.8 ms on. Off at 12 ms with 1.6: in six tenths of
    step 13. On again at 20 ms; that is over with the next off."""
    switches = ((4.3e-3, True), (12e-3, False), (20e-3, True), (24e-3, False))
    model = BrakeCourses([course_of(switches=switches)], SHEET, False)
    values = np.repeat(parameters(ON_DELAY=2.5e-3, OFF_DELAY=1.6e-3), 2, axis=0)
    values[1, P.ON_DELAY] = 1.7e-3
    acting = model._switched(values)
    assert acting.shape == (NODES, 2, 1)
    expected = np.zeros(NODES)
    expected[6], expected[7:13], expected[13] = 0.2, 1.0, 0.6
    expected[22], expected[23:25], expected[25] = 0.5, 1.0, 0.6
    assert acting[:, 0, 0] == pytest.approx(expected, abs=1e-9)
    assert acting[6, 1, 0] == pytest.approx(1.0)
    assert acting[5, 1, 0] == pytest.approx(0.0, abs=1e-9)


def test_air_that_is_less_than_a_tenth_of_a_bar_counts_as_that() -> None:
    _, _, felt = gone(course_of(supply_pa=-5e4), parameters(SENSOR_LAG=QUICK, **PLAIN))
    late = np.maximum(AT_S - QUICK_S, 0.0)
    assert felt == pytest.approx(1e4 * (1.0 - np.exp(-late / TAU_S)), abs=0.5)


def test_a_choked_brake_fills_at_a_constant_rate_and_empties_exponentially() -> None:
    """By the absolute pressures: nine bar before the valve, to six tenths of them."""
    quick = parameters(FILLING=math.log(0.5), CRITICAL=0.9, SENSOR_LAG=QUICK, **PLAIN)
    _, _, felt = gone(course_of(), quick, choked=True)
    before = 8e5 + AIR_PA
    filling = 0.5 * before * np.maximum(AT_S - QUICK_S, 0.0) / TAU_S
    choked = filling + AIR_PA < 0.6 * before
    assert 30 < choked.sum() < 60
    assert felt[choked] == pytest.approx(filling[choked], abs=20.0)
    assert felt[~choked][-1] < filling[-1] * 0.99
    off = course_of(switches=((0.0, True), (0.03, False)))
    values = parameters(EMPTYING=math.log(0.6), FILLING=math.log(0.5), CRITICAL=0.9,
                        SENSOR_LAG=QUICK, **PLAIN)  # fmt: skip
    _, _, felt = gone(off, values, choked=True)
    since = AT_S - 0.03 - QUICK_S
    leaving = (0.5 * before * 0.03 / TAU_S + AIR_PA) * np.exp(-0.6 * since / TAU_S)
    choked = (leaving > AIR_PA / 0.6) & (AT_S > 0.031)
    assert choked.sum() > 20
    assert felt[choked] == pytest.approx(leaving[choked] - AIR_PA, abs=40.0)


def test_air_flows_no_less_freely_than_a_critical_ratio_of_none_lets_it() -> None:
    """A ratio below none counts as none: then the flow is a quarter of an ellipse all the way."""
    values = parameters(CRITICAL=-0.3, SENSOR_LAG=QUICK, **PLAIN)
    _, _, felt = gone(course_of(), values, choked=True)
    before = 8e5 + AIR_PA
    angle = np.maximum(AT_S - QUICK_S, 0.0) / TAU_S + math.asin(AIR_PA / before)
    rising = angle < 1.3
    assert rising.sum() > 40
    assert felt[rising] == pytest.approx((before * np.sin(angle) - AIR_PA)[rising], abs=60.0)


def test_a_valve_that_is_open_in_half_of_a_step_fills_and_empties_by_halves() -> None:
    model = BrakeCourses([course_of()], SHEET, True)
    gauge, supply = np.array([[4e5]]), np.array([[8e5]])
    p = parameters(FILLING=math.log(1.5), EMPTYING=math.log(0.75), CRITICAL=0.5)[:, :, None]
    (rate,) = model._rates(gauge, np.array([[0.5]]), supply, p)[0]
    own, before = 4e5 + AIR_PA, 8e5 + AIR_PA
    filling = 1.5 * before * math.sqrt(1.0 - ((own / before - 0.5) / 0.5) ** 2)
    emptying = 0.75 * own
    assert rate == pytest.approx(0.5 * (filling - emptying) / TAU_S)
    closed = model._rates(gauge, np.array([[0.0]]), supply, p)[0, 0]
    assert closed == pytest.approx(-emptying / TAU_S)
    open_ = model._rates(gauge, np.array([[1.0]]), supply, p)[0, 0]
    assert open_ == pytest.approx(filling / TAU_S)


def test_drag_alone_slows_the_shaft_steadily_from_the_run_s_first_node_on() -> None:
    """The inertia is that of the layshaft and the input shaft's over the ratio's square."""
    for log_inertia in (0.0, 0.3):
        angles, speeds, _ = gone(
            course_of(), parameters(DRAG=5.0, INERTIA=log_inertia, TOUCH=50.0), omega=80.0
        )
        input_ = SHAFTS.input_inertia_kgm2 * math.exp(log_inertia) / I_SPLIT**2
        slowing = 5.0 / (SHAFTS.layshaft_inertia_kgm2 + input_)
        since = np.maximum(SINCE_S, 0.0)
        assert speeds == pytest.approx(80.0 - slowing * since, rel=1e-12)
        assert angles == pytest.approx(80.0 * since - slowing * since**2 / 2.0, abs=1e-12)


def test_viscous_drag_lets_the_speed_fall_exponentially() -> None:
    """That of the input shaft is seen by the ratio's square less."""
    values = parameters(VISCOUS=0.9, INPUT_VISCOUS=1.0, TOUCH=50.0)
    angles, speeds, _ = gone(course_of(), values)
    rate = (0.9 + 1.0 / I_SPLIT**2) / INERTIA
    since = np.maximum(SINCE_S, 0.0)
    assert speeds == pytest.approx(100.0 * np.exp(-rate * since), rel=3e-6)
    assert angles == pytest.approx(100.0 / rate * (1.0 - np.exp(-rate * since)), abs=2e-5)


def test_an_engine_pulls_by_its_plates_toward_its_own_speed() -> None:
    """As a tanh of how much faster it is than the input shaft over 2 rad/s; of an engine of which
    one speed is not known, nothing is."""
    engine = np.full(NODES, 81.0)
    values = parameters(PLATES=3.0, TOUCH=50.0)
    angles, speeds, _ = gone(course_of(engine_rad_s=engine), values)

    def motion(_: float, omega: Vector) -> Vector:
        ahead = 81.0 - omega / I_SPLIT
        return np.asarray(3.0 / I_SPLIT * np.tanh(ahead / 2.0) / INERTIA)

    solved = solve_ivp(motion, (0.0, SINCE_S[-1]), [100.0], t_eval=SINCE_S[LEAD:], rtol=1e-10)
    assert speeds[LEAD:] == pytest.approx(solved.y[0], rel=3e-6)
    assert speeds[-1] - 100.0 > 0.1
    assert angles[-1] == pytest.approx(np.trapezoid(solved.y[0], SINCE_S[LEAD:]), rel=3e-6)
    engine[5] = np.nan
    _, unknown, _ = gone(course_of(engine_rad_s=engine), values)
    assert unknown == pytest.approx(100.0, abs=1e-12)


FULL = {"FILLING": 3.0, "SENSOR_LAG": 0.0}
"""Filled by the run's first node: 30 ms are 13 time constants."""


def test_the_brake_s_torque_is_the_sheet_s_by_the_pressure_beyond_the_pads_touch() -> None:
    values = parameters(GAIN=math.log(0.8), BY_TIME=0.4, TOUCH=0.3, SUPPLY=0.5, **FULL)
    angles, speeds, felt = gone(course_of(), values)
    torque = 0.8 * NM_PER_PA * (1.0 + 0.4 * 0.25) * (8.5e5 - 0.3e5)
    since = np.maximum(SINCE_S, 0.0)
    assert felt[LEAD] == pytest.approx(8.5e5, rel=3e-4)
    assert speeds == pytest.approx(100.0 - torque / INERTIA * since, abs=1e-4)
    assert angles == pytest.approx(100.0 * since - torque / INERTIA * since**2 / 2.0, abs=1e-5)


def test_friction_that_goes_with_speed_is_told_at_the_reference_speed() -> None:
    """By a tenth more each 1,000 rpm: the speed less the reference's goes as an exponential."""
    model = BrakeCourses([course_of()], SHEET, False)
    assert model.omega_ref == pytest.approx(1000.0 * RPM)
    model.omega_ref = 70.0
    values = parameters(BY_SPEED=0.5, **FULL)
    _, speeds, _ = model.run(values, np.array([100.0]))
    k, slowing = 0.5 / (1000.0 * RPM), NM_PER_PA * 8e5 / INERTIA
    since = np.maximum(SINCE_S, 0.0)
    expected = 70.0 + ((1.0 + k * 30.0) * np.exp(-k * slowing * since) - 1.0) / k
    assert speeds[:, 0, 0] == pytest.approx(expected, abs=1e-4)


def test_the_torque_of_a_step_is_that_of_its_mean_pressure() -> None:
    """While the brake fills: the speed lost is the integral of the pressure, by trapezoids."""
    course = course_of(first_node=0)
    _, speeds, _ = gone(course, parameters())
    lost = NM_PER_PA * 8e5 / INERTIA * (AT_S - TAU_S * (1.0 - np.exp(-AT_S / TAU_S)))
    assert speeds == pytest.approx(100.0 - lost, abs=2e-4 * float(lost[-1]))


def test_a_pressure_that_would_swing_over_its_ends_stays_between_them() -> None:
    """A valve that is far too quick for the grid: by a step of three time constants the pressure
    would go below none; and from the supply's up, beyond it."""
    empty = course_of(switches=((0.0, True),))
    three = math.log(3.0 * TAU_S / STEP_S)
    _, _, felt = gone(empty, parameters(FILLING=three, SENSOR_LAG=QUICK, **PLAIN))
    assert felt == pytest.approx(0.0, abs=1e-6)
    later = course_of(switches=((0.0, True), (0.05, False)))
    values = parameters(FILLING=3.0, EMPTYING=three, SENSOR_LAG=QUICK, **PLAIN)
    _, _, felt = gone(later, values)
    assert felt[60:] == pytest.approx(8e5, rel=1e-3)


def test_runs_of_unlike_length_share_a_grid_and_each_has_its_own_engine() -> None:
    """A shorter run's engine is known for its own nodes alone."""
    short = course_of(nodes=60, engine_rad_s=np.full(60, 200.0), i_split=1.5)
    long = course_of(share_of_log=-0.5, supply_pa=7e5)
    model = BrakeCourses([short, long], SHEET, False)
    values = np.repeat(parameters(PLATES=2.0, TOUCH=50.0), 2, axis=0)
    angles, speeds, felts = model.run(values, np.array([90.0, 100.0]))
    assert angles.shape == speeds.shape == felts.shape == (NODES, 2, 2)
    inertia = SHAFTS.layshaft_inertia_kgm2 + SHAFTS.input_inertia_kgm2 / 1.5**2
    gained = 2.0 / 1.5 / inertia * (59 - LEAD) * STEP_S
    assert speeds[59, :, 0] == pytest.approx(90.0 + gained, rel=1e-9)
    assert speeds[:, :, 1] == pytest.approx(100.0)


def test_air_that_is_nearly_as_dense_on_both_sides_flows_laminar() -> None:
    """From 99 % on, in proportion to what is left."""
    part = math.sqrt(1.0 - ((0.99 - 0.4) / 0.6) ** 2)
    found = flow_share(np.array([0.99, 0.995, 0.9999, 1.0, 1.2]), np.array([0.4]))
    assert found == pytest.approx([part, 0.5 * part, 0.01 * part, 0.0, 0.0], abs=1e-9)
    assert flow_share(np.array([0.3, 0.7]), np.array([0.4])) == pytest.approx([1, 0.75**0.5])


def test_a_brake_s_time_constant_is_that_to_63_percent_of_its_way_by_iso_6358() -> None:
    """Filling: choked up to three tenths of nine bar, then by an arc's sine. Emptying: by a
    quadrature of what is left over its flow."""
    way = 1.0 - math.exp(-1.0)
    end = (1e5 + way * 8e5) / 9e5
    for critical in (0.3, 0.2):
        filling = (
            critical - 1.0 / 9.0 + (1.0 - critical) * math.asin((end - critical) / (1.0 - critical))
        )
        found = time_constant_s(np.array([20.0, 40.0]), 8e5, 1e5, np.array([critical]), True)
        assert found == pytest.approx([filling / 20.0, filling / 40.0], rel=1e-5)

    def slowness(pressure: float) -> float:
        part = max(1e5 / pressure - 0.15, 0.0) / 0.85
        return 1.0 / (pressure * math.sqrt(1.0 - part**2))

    emptying = quad(slowness, 1e5 + (1.0 - way) * 8e5, 9e5)[0]
    found = time_constant_s(np.array([20.0]), 8e5, 1e5, np.array([0.15]), False)
    assert found == pytest.approx([emptying / 20.0], rel=1e-5)


CUBIC = np.polynomial.Polynomial((3.0, 120.0, -150.0, 400.0))
"""An angle by time (s): what is bent no more than this, the grid's nodes give exactly."""
RUN_US = 2_000_000


def free_run(
    seconds: Vector,
    length_s: float = 0.1004,
    angle: np.polynomial.Polynomial = CUBIC,
    **changed: Any,
) -> FreeRun:
    """Edges at these times of a run of such a length, 85,000 us of it brake on at once."""
    wheel = Wheel(RUN_US + 1e6 * seconds, np.asarray(angle(seconds)),
                  np.arange(seconds.size, dtype=np.float64) % (2 * TEETH))  # fmt: skip
    values: dict[str, Any] = {
        "start_us": RUN_US, "end_us": RUN_US + round(1e6 * length_s), "split": Split.LOW,
        "range_": Range.HIGH, "layshaft": wheel, "main": wheel,
        "brake": (Switch(RUN_US - 400_000, False, True), Switch(RUN_US - 160_000, False, True),
                  Switch(RUN_US + 5_000, True, True), Switch(RUN_US + 90_000, False, True)),
        "pressure": np.array([[RUN_US - 20_000.0, RUN_US + 40_000.0], [1.5e5, 6e5]]),
        "supply_pa": 9.2e5, "engine": np.empty((2, 0)),
    }  # fmt: skip
    return FreeRun(**(values | changed))


NO_ERROR = np.zeros(2 * TEETH)
EDGES_S = np.arange(0.00073, 0.1, 0.0011)


def made(run: FreeRun, errors: Vector = NO_ERROR) -> Course:
    found = make_course(run, SHEET, errors, 1.1e5, 0.4)
    assert found is not None
    return found


def test_a_bin_s_angle_is_the_mean_of_its_edges_and_so_are_its_weights() -> None:
    """Bins of 5 ms from the run's beginning on; the last one goes to the run's end, and one without
    an edge is left out."""
    seen = EDGES_S[(EDGES_S < 0.030) | (EDGES_S > 0.035)]
    errors = 1e-3 * np.random.default_rng(1).standard_normal(2 * TEETH)
    course = made(free_run(seen), errors)
    number = np.minimum((seen / 0.005).astype(int), 19)
    theta = CUBIC(seen) + errors[np.arange(seen.size) % (2 * TEETH)]
    numbers = [k for k in range(20) if k != 6]
    assert course.edges.tolist() == [(number == k).sum() for k in numbers]
    assert course.angle == pytest.approx([theta[number == k].mean() - theta[0] for k in numbers])
    assert (course.first_node, course.nodes) == (150, 150 + 101 + 2)
    assert course.weights.shape == (19, 253, 2)
    at = 1e-3 * (np.arange(course.nodes) - 150)
    by_nodes = course.weights[:, :, 0] @ CUBIC(at) + course.weights[:, :, 1] @ CUBIC.deriv()(at)
    assert by_nodes == pytest.approx([CUBIC(seen[number == k]).mean() for k in numbers], abs=1e-10)


def test_a_cubic_s_angles_between_the_nodes_are_those_of_its_angles_and_speeds_at_them() -> None:
    course = made(free_run(EDGES_S))
    at = 1e-3 * (np.arange(course.nodes) - 150)
    assert course.nodes_of_edges == pytest.approx(150.0 + 1e3 * EDGES_S)
    between = angles_at(course.nodes_of_edges, np.asarray(CUBIC(at)), np.asarray(CUBIC.deriv()(at)))
    assert between == pytest.approx(CUBIC(EDGES_S), abs=1e-10)
    assert course.theta_rad == pytest.approx(CUBIC(EDGES_S) - CUBIC(EDGES_S[0]))
    assert course.place.tolist() == [k % (2 * TEETH) for k in range(EDGES_S.size)]


def test_a_run_s_times_are_told_from_150_ms_before_it_and_its_pressures_without_zeros() -> None:
    """A valve that is switched off first was on for nobody knows how long."""
    course = made(free_run(EDGES_S))
    assert course.start_us == RUN_US - 150_000
    assert [on for _, on in course.switches] == [True, False]
    assert [at for at, _ in course.switches] == pytest.approx([0.155, 0.240])
    assert course.pressure_s == pytest.approx([0.130, 0.190])
    assert course.pressure_pa == pytest.approx([0.4e5, 4.9e5])
    assert course.supply_pa == pytest.approx(9.2e5 - AIR_PA)
    assert course.i_split == pytest.approx(SHEET.split_mesh(Split.LOW).ratio)
    assert course.share_of_log == 0.4
    assert made(free_run(EDGES_S, brake=())).switches == ()


def test_the_engine_s_speed_at_the_nodes_lies_between_its_samples() -> None:
    engine = np.array([[RUN_US - 150_000.0, RUN_US - 50_000.0, RUN_US + 50_000.0],
                       [100.0, 110.0, 70.0]])  # fmt: skip
    found = made(free_run(EDGES_S, engine=engine)).engine_rad_s
    assert found[[0, 50, 100, 150, 200, 252]] == pytest.approx([100, 105, 110, 90, 70, 70])
    two = made(free_run(EDGES_S, engine=engine[:, :2])).engine_rad_s
    assert two[[0, 100, 150]] == pytest.approx([100, 110, 110])
    one = made(free_run(EDGES_S, engine=engine[:, :1])).engine_rad_s
    assert one.shape == (253,)
    assert np.isnan(one).all()


def test_a_run_s_first_speed_is_that_of_its_first_20_ms() -> None:
    """By the line of least squares through their edges; of three edges none is made."""
    early = EDGES_S[EDGES_S < 0.02]
    centred = early - early.mean()
    slope = float(centred @ CUBIC(early) / (centred @ centred))
    assert made(free_run(EDGES_S)).omega_rad_s == pytest.approx(slope)
    late = EDGES_S[EDGES_S > 0.02]
    for few, speed in (((0.003, 0.008, 0.013), 100.0), ((0.003, 0.008, 0.013, 0.018), None)):
        own = np.array(few)
        omega = made(free_run(np.concatenate((own, late)))).omega_rad_s
        line = float((own - own.mean()) @ CUBIC(own) / np.sum((own - own.mean()) ** 2))
        assert omega == pytest.approx(line if speed is None else speed)


@pytest.mark.parametrize(
    ("length_s", "edges", "is_made"),
    [(0.0599, 200, False), (0.0600, 200, True), (0.1004, 60, True), (0.1004, 59, False)],
)
def test_twelve_bins_and_three_edges_a_bin_make_a_course(
    length_s: float, edges: int, is_made: bool
) -> None:
    run = free_run(np.linspace(0.0005, length_s - 0.0005, edges), length_s)
    assert (make_course(run, SHEET, NO_ERROR, 1e5, 0.0) is not None) is is_made
