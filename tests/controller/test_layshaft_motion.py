"""The layshaft's motion: a step by the matrix exponential, its noises by Van Loan's integral, and a
brake's pressure through all segments of its law by the times that these take."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.linalg import expm

from meshpoint.controller.motion.models import (
    LayshaftState,
    MotionModel,
    Ticks,
    ahead,
    first_order_law,
    outlook,
    predict,
)
from meshpoint.controller.records import Vector

THETA, OMEGA, PRESSURE, TORQUE, GAIN, DRAG = range(6)
NEVER, QUIET, FULL_PA = np.empty((2, 0)), np.zeros(4), 8e5


def state(*x: float) -> LayshaftState:
    """At time 0, of the six states."""
    return LayshaftState(0.0, *x[:3], disturbance_rad_s2=x[3], gain=x[4], drag_rad_s2=x[5])


def grown(x: Vector, p: Vector, seconds: float, model: MotionModel) -> Vector:
    found = ahead(x, p, 0.0, 1e6 * seconds, NEVER, model).covariance
    assert found is not None
    return found


@pytest.mark.parametrize(
    "rates",
    [(0.0, 2e-4, 60.0), (0.3, 2e-4, 60.0), (20.0, 3e-4, 60.0), (60.0, 3e-4, 20.0),
     (60.0, 3e-4, 60.0)],
)  # fmt: skip
@pytest.mark.parametrize("seconds", [4e-4, 4.5e-3])
def test_a_step_is_the_matrix_exponential(
    rates: tuple[float, float, float], seconds: float
) -> None:
    """Friction, brake and fading; where two rates, or one and the brake's 20 a second, are equal,
    too. State and 1, by which the brake's air enters; pressure in hundreds of kPa."""
    (a, g, fading), b = rates, 20.0
    x = np.array([0.3, 140.0, 3.1e5, 8.0, 1.3, -5.0])
    flow = np.zeros((7, 7))
    flow[THETA, OMEGA] = 1.0
    flow[OMEGA, [OMEGA, PRESSURE, TORQUE, DRAG]] = -a, -g * x[GAIN] * 1e5, 1.0, 1.0
    flow[PRESSURE, [PRESSURE, 6]] = -b, b * FULL_PA / 1e5
    flow[TORQUE, TORQUE] = -fading
    order = np.ix_([1, 0, 2, 3, 4, 5, 6], [1, 0, 2, 3, 4, 5, 6])
    whole = np.zeros((7, 7))
    whole[order] = expm(flow[order] * seconds)
    scale = np.array([1.0, 1.0, 1e5, 1.0, 1.0, 1.0])
    expected = scale * (whole @ np.array([*(x / scale), 1.0]))[:6]
    law = first_order_law(b, FULL_PA)
    law[0] = law[1]  # filled, whatever the valve does
    model = MotionModel(np.array(rates), law, QUIET)
    assert predict(state(*x), 1e6 * seconds, NEVER, model).vector == pytest.approx(
        expected, rel=1e-12
    )
    f = whole[:6, :6] * np.outer(scale, 1.0 / scale)

    def slowed(t: float, row: int) -> float:
        """What the brake's pressure at a time has made of speed or angle by the end."""
        left = seconds - t
        pressure = FULL_PA + (x[PRESSURE] - FULL_PA) * math.exp(-b * t)
        turned = -math.expm1(-a * left) / a if a else left
        return pressure * (turned if row == THETA else math.exp(-a * left))

    for row in (THETA, OMEGA):
        f[row, GAIN] = -g * quad(slowed, 0.0, seconds, (row,), epsrel=1e-12)[0]
    sds = np.array([1e-3, 0.5, 2e4, 3.0, 0.2, 2.0])
    root = np.random.default_rng(4).normal(size=(6, 6)) * sds[:, np.newaxis]
    p = f @ root @ root.T @ f.T
    both = np.sqrt(np.outer(np.diag(p), np.diag(p)))
    assert grown(x, root @ root.T, seconds, model) / both == pytest.approx(p / both, abs=1e-10)


@pytest.mark.parametrize(("driven", "density"), [(TORQUE, 7.0), (PRESSURE, 3e9), (DRAG, 5.0),
                                                 (GAIN, 0.06)])  # fmt: skip
@pytest.mark.parametrize(("seconds", "near"), [(1e-4, 4e-3), (4e-3, 0.08)])
def test_each_noise_spreads_the_state_as_van_loan_s_integral_has_it(
    driven: int, density: float, seconds: float, near: float
) -> None:
    """Over a short step to half a percent, over a long one to 8 % of each variance. The brake's
    gain wanders alone."""
    a, g, fading, b, gain = 0.4, 3e-4, 30.0, 20.0, 1.4
    noise = np.zeros(4)
    noise[{TORQUE: 0, PRESSURE: 1, GAIN: 2, DRAG: 3}[driven]] = density
    model = MotionModel(np.array([a, g, fading]), first_order_law(b, FULL_PA), noise)
    flow, drive = np.zeros((6, 6)), np.zeros((6, 6))
    flow[THETA, OMEGA] = 1.0
    flow[OMEGA, [OMEGA, PRESSURE, TORQUE, DRAG]] = -a, -g * gain, 1.0, 1.0
    flow[PRESSURE, PRESSURE], flow[TORQUE, TORQUE] = -b, -fading
    drive[driven, driven] = density
    whole = expm(np.block([[-flow, drive], [np.zeros((6, 6)), flow.T]]) * seconds)
    exact = whole[6:, 6:].T @ whole[:6, 6:]
    found = grown(np.array([0.0, 150.0, 0.0, 0.0, gain, 0.0]), np.zeros((6, 6)), seconds, model)
    assert np.array_equal(found, found.T)
    moved = exact != 0.0
    assert found[moved] == pytest.approx(exact[moved], rel=near)
    assert not found[~moved].any()


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
    start = state(0.0, 0.0, KNOTS_PA[0 if on else -1], 0.0, 1.0, 0.0)
    switches = np.array([[0.0], [1.0]]) if on else NEVER
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
    found = predict(state(0.0, 0.0, 2000.0, 0.0, 1.0, 0.0), 60e6, NEVER, model)
    assert found.pressure_pa == pytest.approx(1024.0, abs=1.0)


SWITCHES = np.array([[10e3, 30e3, 45e3], [1.0, 0.0, 1.0]])


@pytest.mark.parametrize("at_ms", [5, 10, 17, 30, 38, 45, 60])
def test_the_brake_fills_from_when_the_valve_opens_and_empties_from_when_it_closes(
    at_ms: int,
) -> None:
    """Also where a switch lies just at the end of the time; with the covariance as without."""
    b, g = 20.0, 2e-4
    model = MotionModel(np.array([0.0, g, 30.0]), first_order_law(b, FULL_PA), QUIET)

    def pressure(t: float) -> float:
        filled = FULL_PA * -math.expm1(-b * max(0.0, min(t, 30e-3) - 10e-3))
        emptied = filled * math.exp(-b * max(0.0, min(t, 45e-3) - 30e-3))
        return FULL_PA + (emptied - FULL_PA) * math.exp(-b * (t - 45e-3)) if t > 45e-3 else emptied

    end_s, kinks = 1e-3 * at_ms, (10e-3, 30e-3, 45e-3)
    slowed = g * quad(pressure, 0.0, end_s, points=kinks, epsrel=1e-11)[0]
    turned = g * quad(lambda t: pressure(t) * (end_s - t), 0.0, end_s, points=kinks,
                      epsrel=1e-11)[0]  # fmt: skip
    expected = [150.0 * end_s - turned, 150.0 - slowed, pressure(end_s)]
    start = state(0.0, 150.0, 0.0, 0.0, 1.0, 0.0)
    for found in (
        predict(start, 1e3 * at_ms, SWITCHES, model),
        ahead(start.vector, np.eye(6), 0.0, 1e3 * at_ms, SWITCHES, model),
    ):
        assert found.vector[:3] == pytest.approx(expected, rel=1e-8, abs=1e-6)


def test_what_will_be_known_counts_the_valve_s_switches_by_the_time_of_each_tick() -> None:
    """An unknown gain of the brake shows in the angle as the brake is on: for the last 5 ms of the
    first horizon, 15 ms of the second, 25 ms of the third."""
    g, b = 3e-4, 4000.0
    model = MotionModel(np.array([0.0, g, 30.0]), first_order_law(b, FULL_PA), QUIET)
    p = np.zeros((6, 6))
    p[GAIN, GAIN] = 0.01
    known = state(0.0, 150.0, 0.0, 0.0, 1.0, 0.0)._replace(covariance=p, edge_rad2_s=1.0)
    found = outlook(known, Ticks(45e3, 10e3, 3), np.array([[40e3], [1.0]]), model)
    on = np.array([5e-3, 15e-3, 25e-3]) - 1.0 / b  # filling, it lags behind by its time constant
    assert found == pytest.approx(0.01 * (g * FULL_PA * 0.5 * on**2) ** 2, rel=0.02)
