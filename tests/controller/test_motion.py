"""The closed forms of the six states' motion against SciPy, which knows the equations alone."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from free_layshaft import flow_pa_s, law_array
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from meshpoint.controller.models.layshaft import (
    LayshaftState,
    MotionModel,
    Ticks,
    first_order_law,
    outlook,
    predict,
    predict_spread,
    state_of,
)
from meshpoint.units import US

RATES = st.tuples(
    st.one_of(st.just(0.0), st.floats(1e-6, 20.0)), st.floats(1e-5, 1e-3), st.floats(1.0, 500.0)
)
"""a (1/s), g (rad/s2 per Pa), b_d (1/s)."""
STATE = st.tuples(
    st.floats(-10.0, 10.0),
    st.floats(50.0, 300.0),
    st.floats(0.0, 8e5),
    st.floats(-50.0, 50.0),
    st.floats(0.5, 1.5),
    st.floats(-20.0, 20.0),
)
QUIET = np.zeros(4)
SUPPLY_PA = 8e5


def scale(g: float, seconds: float) -> np.ndarray:
    """What 1 means in each state: angle, speed and pressure by what they move in the time."""
    omega = 300.0 + g * SUPPLY_PA * seconds
    return np.array([omega * seconds, omega, SUPPLY_PA, 50.0, 1.0, 20.0])


@settings(deadline=None, max_examples=60, derandomize=True)
@given(
    rates=RATES,
    start=STATE,
    switches=st.lists(st.integers(-20_000, 200_000), max_size=5, unique=True),
    first=st.booleans(),
    horizon_us=st.integers(100, 200_000),
)
def test_a_prediction_solves_the_equations_through_switches_and_segments(
    rates: tuple[float, float, float],
    start: tuple[float, ...],
    switches: list[int],
    first: bool,
    horizon_us: int,
) -> None:
    """Against Dormand and Prince's method of order 8, stopped at each switch: to a millionth. With
    the covariance or without, the state is the same."""
    (a, g, b_d), x = rates, np.array(start)
    switch_us = np.array(sorted(switches), dtype=float)
    switch_u = np.array([float((i % 2 == 0) == first) for i in range(len(switches))])
    model = MotionModel(np.array(rates), law_array(), QUIET)
    state = state_of(x, np.eye(6), 0.0)
    ours = predict(state, float(horizon_us), np.array((switch_us, switch_u)), model)
    spread = predict_spread(state, float(horizon_us), np.array((switch_us, switch_u)), model)

    stops = [0.0, *[t for t in switch_us if 0.0 < t < horizon_us], float(horizon_us)]
    for begin, end in itertools.pairwise(stops):
        past = [u for t, u in zip(switch_us, switch_u, strict=True) if t <= begin]
        u = int(past[-1]) if past else 0

        def slope(_t: float, y: np.ndarray, u: int = u) -> list[float]:
            _theta, omega, p, d, gain, drag = y
            turning = -a * omega - g * gain * p + d + drag
            return [omega, turning, float(flow_pa_s(u, p)), -b_d * d, 0.0, 0.0]

        span = (begin * US, end * US)
        x = solve_ivp(slope, span, x, "DOP853", rtol=1e-10, atol=1e-9).y[:, -1]
    unit = scale(g, horizon_us * US)
    assert np.all(np.abs(ours.vector - x) <= 1e-6 * unit)
    assert np.all(np.abs(spread.vector - x) <= 1e-6 * unit)


@settings(deadline=None, max_examples=60, derandomize=True)
@example(rates=(2.0, 1e-3, 2.0), b=2.0, start=(0.0, 50.0, 3e5, 9.0, 1.0, 5.0), span_us=5_000)
@given(rates=RATES, b=st.floats(2.0, 300.0), start=STATE, span_us=st.integers(1, 50_000))
def test_within_a_segment_the_transition_is_the_matrix_exponential(
    rates: tuple[float, float, float], b: float, start: tuple[float, ...], span_us: int
) -> None:
    """State, and without noise the covariance F P F': six states and 1, the gain's column being
    what the brake does in the time. Rates may be equal."""
    (a, g, b_d), seconds = rates, span_us * US
    law = law_array(law=(((b, b * SUPPLY_PA),),) * 2)
    model = MotionModel(np.array(rates), law, QUIET)
    x, unit = np.array(start), scale(g, seconds)
    gain = x[4]
    # omega, theta and pressure in their units, so that no element of expm drowns another.
    flow = np.zeros((7, 7))
    flow[0, 1] = 1.0
    flow[1, [1, 2, 3, 5]] = -a, -g * gain, 1.0, 1.0
    flow[2, [2, 6]] = -b, b * SUPPLY_PA
    flow[3, 3] = -b_d
    units = np.array([*unit, 1.0])
    # With omega before theta SciPy does not take its shorter way for triangular matrices.
    order = np.ix_([1, 0, 2, 3, 4, 5, 6], [1, 0, 2, 3, 4, 5, 6])
    whole = np.zeros((7, 7))
    whole[order] = expm((flow * units / units[:, None])[order] * seconds)
    f = whole[:6, :6]
    braked = whole[:2, 2] * x[2] / unit[2] + whole[:2, 6]
    f[:2, 4] = braked / gain  # of a unit gain
    mixed = np.random.default_rng(span_us).standard_normal((6, 6))
    p = (mixed @ mixed.T) * np.outer(unit, unit)
    state = LayshaftState(0.0, *x[:3], 0.0, 0.0, 0.0, *x[3:], covariance=p)
    ours = predict_spread(state, float(span_us), np.empty((2, 0)), model)
    moved = whole[:6, :6].copy()
    moved[:2, 4] = 0.0
    expected = moved @ (x / unit) + whole[:6, 6]
    assert np.all(np.abs(ours.vector / unit - expected) <= 1e-10)
    grown = f @ mixed @ mixed.T @ f.T
    assert ours.covariance is not None
    assert np.all(np.abs(ours.covariance / np.outer(unit, unit) - grown) <= 1e-9 * np.trace(grown))


@settings(deadline=None, max_examples=40, derandomize=True)
@example(rates=(2.0, 1e-3, 2.0), b=2.0, span_us=20_000, share=0)  # equal rates
@given(
    rates=st.tuples(st.floats(0.0, 2.0), st.floats(1e-5, 1e-3), st.floats(2.0, 100.0)),
    b=st.floats(2.0, 40.0),
    span_us=st.integers(100, 60_000),
    share=st.integers(0, 2),
)
def test_noise_grows_the_covariance_as_van_loans_integral_does(
    rates: tuple[float, float, float], b: float, span_us: int, share: int
) -> None:
    """One noise at a time, from a state that is known: within 2 % of each standard deviation, and
    of the correlations."""
    a, g, b_d = rates
    driven = (3, 2, 5)[share]
    noise = QUIET.copy()
    noise[(0, 1, 3)[share]] = 7.0
    model = MotionModel(np.array(rates), law_array(law=(((b, b * SUPPLY_PA),),) * 2), noise)
    known = LayshaftState(0.0, 0.0, 150.0, SUPPLY_PA, covariance=np.zeros((6, 6)))
    grown = predict_spread(known, float(span_us), np.empty((2, 0)), model).covariance
    flow, drive = np.zeros((6, 6)), np.zeros((6, 6))
    flow[0, 1] = 1.0
    flow[1, [1, 2, 3, 5]] = -a, -g, 1.0, 1.0
    flow[2, 2], flow[3, 3] = -b, -b_d
    drive[driven, driven] = 7.0
    whole = expm(np.block([[-flow, drive], [np.zeros((6, 6)), flow.T]]) * span_us * US)
    exact = whole[6:, 6:].T @ whole[:6, 6:]
    moved = [0, 1, driven]
    assert grown is not None
    sd, ours_sd = np.sqrt(np.diag(exact)[moved]), np.sqrt(np.diag(grown)[moved])
    assert np.allclose(ours_sd, sd, rtol=0.02)
    ours, theirs = grown[np.ix_(moved, moved)], exact[np.ix_(moved, moved)]
    assert np.allclose(ours / np.outer(sd, sd), theirs / np.outer(sd, sd), atol=0.04)


@settings(deadline=None, max_examples=30, derandomize=True)
@given(rates=RATES, start=STATE, moment_us=st.floats(10.0, 5_000.0), at_us=st.floats(0.0, 1e7))
def test_a_moment_back_undoes_a_moment_ahead(
    rates: tuple[float, float, float],
    start: tuple[float, ...],
    moment_us: float,
    at_us: float,
) -> None:
    """With an empty brake, whose valve is off: nothing but the shaft's own motion is undone."""
    x = np.array((*start[:2], 0.0, *start[3:]))
    model, none = MotionModel(np.array(rates), law_array(), QUIET), np.empty((2, 0))
    state = state_of(x, np.eye(6), at_us)
    ahead = predict(state, at_us + moment_us, none, model)
    back = predict(ahead, at_us, none, model)
    assert ahead.theta_rad > state.theta_rad
    off = np.abs(back.vector - state.vector) / scale(rates[1], moment_us * US)
    assert off.max() < 1e-6


KNOTS_PA = (0.0, 1e5, 2e5, 3e5, 4e5, 5e5, 5.8e5)
RISING = ((18.0, 1.5e7), (14.0, 1.3e7), (9.0, 1.1e7), (6.0, 1.0e7), (4.0, 0.9e7), (2.0, 0.8e7))
FALLING = ((3.0, -1e6), (5.0, -9e5), (7.0, -8e5), (11.0, -6e5), (13.0, -4e5), (17.0, -2e5))


@pytest.mark.parametrize("on", [True, False])
def test_a_brake_that_fills_or_empties_passes_all_six_segments_of_its_law(on: bool) -> None:
    """p' = r - b p in each, solved for the time to its end and to half-way there."""
    law = np.empty((2, 6, 3))
    law[:, :, 0] = -math.inf, *KNOTS_PA[1:6]
    law[0, :, 1:], law[1, :, 1:] = FALLING, RISING
    model, at_s = MotionModel(np.array([0.0, 0.0, 30.0]), law, QUIET), 0.0
    start = LayshaftState(0.0, 0.0, 0.0, KNOTS_PA[0 if on else -1])
    switches = np.array([[0.0], [1.0]]) if on else np.empty((2, 0))
    for k in range(6) if on else reversed(range(6)):
        begin, end = KNOTS_PA[k : k + 2] if on else (KNOTS_PA[k + 1], KNOTS_PA[k])
        b, r = (RISING if on else FALLING)[k]
        for pressure in (0.5 * (begin + end), end):
            seconds = at_s + math.log((r - b * begin) / (r - b * pressure)) / b
            found = predict(start, 1e6 * seconds, switches, model)
            assert found.pressure_pa == pytest.approx(pressure, abs=2.0)
        at_s = seconds


def test_a_pressure_that_comes_to_rest_just_below_a_knot_stays_there() -> None:
    law = first_order_law(1.0, 0.0)
    law[0, 0], law[0, 1] = (-math.inf, 5.0, 0.0), (1024.0, 1.0, 1023.9995)
    model = MotionModel(np.array([0.0, 0.0, 1.0]), law, QUIET)
    found = predict(LayshaftState(0.0, 0.0, 0.0, 2000.0), 60e6, np.empty((2, 0)), model)
    assert found.pressure_pa == pytest.approx(1024.0, abs=1.0)


def test_what_will_be_known_counts_the_valve_s_switches_by_the_time_of_each_tick() -> None:
    """An unknown gain of the brake shows in the angle as the brake is on: for the last 5 ms of the
    first horizon, 15 ms of the second, 25 ms of the third."""
    g, b = 3e-4, 4000.0
    model = MotionModel(np.array([0.0, g, 30.0]), first_order_law(b, SUPPLY_PA), QUIET)
    p = np.zeros((6, 6))
    p[4, 4] = 0.01
    known = LayshaftState(0.0, 0.0, 150.0, 0.0, covariance=p, edge_rad2_s=1.0)
    found = outlook(known, Ticks(45e3, 10e3, 3), np.array([[40e3], [1.0]]), model)
    on = np.array([5e-3, 15e-3, 25e-3]) - 1.0 / b  # filling, it lags behind by its time constant
    assert found == pytest.approx(0.01 * (g * SUPPLY_PA * 0.5 * on**2) ** 2, rel=0.02)
