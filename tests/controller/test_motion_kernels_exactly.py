"""The layshaft's motion in its parts: each branch by a closed form or the matrix exponential."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.linalg import expm

from meshpoint.controller.jit import DISABLED, record_on
from meshpoint.controller.motion.kernels import (
    COVARIANCE,
    LONGEST_S,
    MODEL,
    SEGMENTS,
    STATE,
    STATES,
    STEP,
    forecast,
    longest_in_segment,
    measure,
    settling,
    travel,
)
from meshpoint.controller.motion.models import MotionModel, first_order_law
from meshpoint.controller.records import Vector

THETA, OMEGA, PRESSURE, TORQUE, GAIN, DRAG = range(6)
NEVER = np.empty((2, 0))
QUIET = np.zeros(4)
UNUSED = (math.inf, 1.0, 0.0)


def law_of(off: list[tuple[float, float, float]], on: list[tuple[float, float, float]]) -> Vector:
    """Segments (from which pressure, b, r) of each direction."""
    law = np.empty((2, SEGMENTS, 3))
    law[:] = UNUSED
    for u, parts in enumerate((off, on)):
        law[u, : len(parts)] = np.reshape(parts, (-1, 3))
    return law


def one_segment(b: float, r: float) -> Vector:
    """Whatever the valve does, p' = r - b p."""
    return law_of([(-math.inf, b, r)], [(-math.inf, b, r)])


def model_of(
    rates: tuple[float, float, float], law: Vector, noise: Vector | None = None
) -> MotionModel:
    return MotionModel(np.array(rates), law, QUIET if noise is None else noise)


def moved(
    x: list[float], seconds: float, model: MotionModel, switches: Vector = NEVER, at_us: float = 0.0
) -> Vector:
    """The state after a time."""
    found = np.array(x)
    travel(found, at_us, at_us + 1e6 * seconds, switches, model.flat)
    return found


def spread_after(p: Vector, x: list[float], seconds: float, model: MotionModel) -> Vector:
    """The covariance after a time, its lower half at first none at all."""
    found = np.where(np.tri(STATES, k=-1) > 0.0, np.nan, p)
    forecast(np.array(x), found, 0.0, 1e6 * seconds, NEVER, model.flat)
    return found


def test_records_are_as_long_as_what_they_hold() -> None:
    """Six states; three rates, six segments a direction, four noises; a step's derivatives."""
    assert SEGMENTS == 6
    assert STATE.itemsize == 8 * 6
    assert COVARIANCE.itemsize == 8 * 36
    assert MODEL.itemsize == 8 * (3 + 2 * 6 * 3 + 4)
    assert STEP.itemsize == 8 * (6 + 6 + 2)


@pytest.mark.parametrize("slowed", [0.0, 1e-5, 4e-4, 9.9e-4, 1.3e-3, 0.02, 0.4])
def test_a_shaft_that_is_only_slowed_by_oil_turns_on_by_the_exponential_series(
    slowed: float,
) -> None:
    """Speed fades as e^-at; angle by speed and by a steady drag as its integrals, to the last
    digits on both sides of where the series is taken in place of the closed form."""
    seconds = 2e-3
    a = slowed / seconds
    model = model_of((a, 0.0, 3.0), one_segment(5.0, 0.0))
    series = [(-slowed) ** k for k in range(30)]
    once = seconds * math.fsum(s / math.factorial(k + 1) for k, s in enumerate(series))
    twice = seconds**2 * math.fsum(s / math.factorial(k + 2) for k, s in enumerate(series))
    by_speed = moved([0.0, 1.0, 0.0, 0.0, 0.0, 0.0], seconds, model)
    assert by_speed[:2] == pytest.approx([once, math.exp(-slowed)], rel=2e-14, abs=0.0)
    by_drag = moved([0.0, 0.0, 0.0, 0.0, 0.0, 1.0], seconds, model)
    assert by_drag[OMEGA] == pytest.approx(once, rel=2e-14, abs=0.0)
    assert by_drag[THETA] == pytest.approx(twice, rel=3e-14 if slowed < 1e-3 else 2e-12, abs=0.0)


RATES = [(0.0, 2e-4, 60.0), (0.3, 2e-4, 60.0), (12.0, 3e-4, 60.0), (20.0, 3e-4, 60.0),
         (60.0, 3e-4, 20.0), (60.0, 3e-4, 60.0)]  # fmt: skip
"""Friction, brake and fading; two of them, or one and the brake's 20 a second, are equal."""


@pytest.mark.parametrize("rates", RATES)
@pytest.mark.parametrize("seconds", [4e-4, 4.5e-3])
def test_a_step_is_the_matrix_exponential(
    rates: tuple[float, float, float], seconds: float
) -> None:
    """State and 1, in which the brake's supply enters; pressure in hundreds of kPa."""
    (a, g, b_d), (b, r) = rates, (20.0, 1.6e7)
    x = [0.3, 140.0, 3.1e5, 8.0, 1.3, -5.0]
    flow = np.zeros((7, 7))
    flow[THETA, OMEGA] = 1.0
    flow[OMEGA, [OMEGA, PRESSURE, TORQUE, DRAG]] = -a, -g * x[GAIN] * 1e5, 1.0, 1.0
    flow[PRESSURE, [PRESSURE, 6]] = -b, r / 1e5
    flow[TORQUE, TORQUE] = -b_d
    order = np.ix_([1, 0, 2, 3, 4, 5, 6], [1, 0, 2, 3, 4, 5, 6])
    whole = np.zeros((7, 7))
    whole[order] = expm(flow[order] * seconds)
    start = np.array([*x, 1.0])
    start[PRESSURE] /= 1e5
    expected = (whole @ start)[:6]
    expected[PRESSURE] *= 1e5
    model = model_of(rates, one_segment(b, r))
    assert moved(x, seconds, model) == pytest.approx(expected, rel=1e-12)

    # The covariance: one state after the other unknown, then all together.
    f = whole[:6, :6].copy()
    f[:2, PRESSURE] /= 1e5

    def slowed(t: float, row: int) -> float:
        """What the brake's pressure at a time has made of speed or angle by the end."""
        left = seconds - t
        pressure = r / b + (x[PRESSURE] - r / b) * math.exp(-b * t)
        turned = -math.expm1(-a * left) / a if a else left
        return pressure * (turned if row == THETA else math.exp(-a * left))

    for row in (THETA, OMEGA):
        f[row, GAIN] = -g * quad(slowed, 0.0, seconds, (row,), epsrel=1e-12)[0]
    for k in range(STATES):
        unit = np.zeros((6, 6))
        unit[k, k] = 1.0
        found = spread_after(unit, x, seconds, model)
        assert found == pytest.approx(f @ unit @ f.T, rel=1e-9, abs=1e-14)
    root = np.random.default_rng(4).normal(size=(6, 6)) * [[1e-3], [0.5], [2e4], [3.0], [0.2], [2]]
    p = root @ root.T
    sds = np.sqrt(np.diag(f @ p @ f.T))
    found = spread_after(p, x, seconds, model) / np.outer(sds, sds)
    assert found == pytest.approx(f @ p @ f.T / np.outer(sds, sds), abs=1e-10)


@pytest.mark.parametrize(("driven", "density"), [(TORQUE, 7.0), (PRESSURE, 3e9), (DRAG, 5.0)])
@pytest.mark.parametrize(("seconds", "near"), [(1e-4, 4e-3), (4e-3, 0.08)])
def test_each_noise_spreads_the_state_as_van_loan_s_integral_has_it(
    driven: int, density: float, seconds: float, near: float
) -> None:
    """Over a short step to half a percent, over a long one to 8 % of each variance."""
    a, g, b_d, b, gain = 0.4, 3e-4, 30.0, 20.0, 1.4
    noise = np.zeros(4)
    noise[{TORQUE: 0, PRESSURE: 1, DRAG: 3}[driven]] = density
    model = model_of((a, g, b_d), one_segment(b, b * 4e5), noise)
    flow, drive = np.zeros((6, 6)), np.zeros((6, 6))
    flow[THETA, OMEGA] = 1.0
    flow[OMEGA, [OMEGA, PRESSURE, TORQUE, DRAG]] = -a, -g * gain, 1.0, 1.0
    flow[PRESSURE, PRESSURE], flow[TORQUE, TORQUE] = -b, -b_d
    drive[driven, driven] = density
    whole = expm(np.block([[-flow, drive], [np.zeros((6, 6)), flow.T]]) * seconds)
    exact = whole[6:, 6:].T @ whole[:6, 6:]
    found = spread_after(np.zeros((6, 6)), [0.0, 150.0, 4e5, 0.0, gain, 0.0], seconds, model)
    assert np.array_equal(found, found.T)
    moves = np.ix_([THETA, OMEGA, driven], [THETA, OMEGA, driven])
    assert found[moves] / exact[moves] == pytest.approx(np.ones((3, 3)), abs=near)
    rest = found.copy()
    rest[moves] = 0.0
    assert not rest.any()


def test_the_brake_s_gain_wanders_alone() -> None:
    model = model_of((0.4, 3e-4, 30.0), one_segment(20.0, 8e6), np.array([0.0, 0.0, 0.06, 0.0]))
    found = spread_after(np.zeros((6, 6)), [0.0, 150.0, 0.0, 0.0, 1.0, 0.0], 1e-3, model)
    assert found[GAIN, GAIN] == pytest.approx(0.06 * 1e-3)
    found[GAIN, GAIN] = 0.0
    assert not found.any()


def test_a_covariance_is_moved_on_by_5_ms_at_most() -> None:
    """12 ms are 5, 5 and 2, to the bit; the state in between is the right one."""
    model = model_of((0.4, 3e-4, 30.0), one_segment(20.0, 8e6), np.array([7.0, 3e9, 0.1, 5.0]))
    start = [0.0, 150.0, 1e5, 2.0, 1.2, -3.0]
    whole, parts = np.eye(6), np.eye(6)
    x, y = np.array(start), np.array(start)
    forecast(x, whole, 0.0, 12e3, NEVER, model.flat)
    for begin_us, end_us in ((0.0, 5e3), (5e3, 10e3), (10e3, 12e3)):
        forecast(y, parts, begin_us, end_us, NEVER, model.flat)
    assert LONGEST_S == 5e-3
    assert whole == pytest.approx(parts, rel=1e-13)
    assert x == pytest.approx(y, rel=1e-13)
    finer = np.eye(6)
    y = np.array(start)
    forecast(y, finer, 0.0, 6e3, NEVER, model.flat)
    forecast(y, finer, 6e3, 12e3, NEVER, model.flat)
    assert not np.allclose(whole, finer, rtol=1e-13, atol=0.0)


FULL = 8e5


def test_the_brake_fills_from_when_the_valve_opens_and_empties_from_when_it_closes() -> None:
    """Also where a switch lies just at the begin or the end of the time, before, or behind it."""
    b = 20.0
    model = model_of((0.0, 2e-4, 30.0), first_order_law(b, FULL))
    switches = np.array([[10e3, 30e3, 45e3], [1.0, 0.0, 1.0]])

    def pressure(t: float, since: float = 10e-3) -> float:
        if t <= since:
            return 0.0
        filled = FULL * -math.expm1(-b * (min(t, 30e-3) - since))
        emptied = filled * math.exp(-b * max(0.0, min(t, 45e-3) - 30e-3))
        return FULL + (emptied - FULL) * math.exp(-b * max(0.0, t - 45e-3))

    times_s = [5e-3, 10e-3, 17e-3, 30e-3, 38e-3, 45e-3, 60e-3]
    x, at = np.array([0.0, 150.0, 0.0, 0.0, 1.0, 0.0]), 0.0
    for to in times_s:
        whole = moved([0.0, 150.0, 0.0, 0.0, 1.0, 0.0], to, model, switches)
        slowed = 2e-4 * quad(pressure, 0.0, to, points=[10e-3, 30e-3, 45e-3], epsrel=1e-11)[0]
        turned = quad(lambda t, to=to: 2e-4 * pressure(t) * (to - t), 0.0, to,
                      points=[10e-3, 30e-3, 45e-3], epsrel=1e-11)[0]  # fmt: skip
        expected = [150.0 * to - turned, 150.0 - slowed, pressure(to)]
        assert whole[:3] == pytest.approx(expected, rel=1e-8, abs=1e-6)
        travel(x, 1e6 * at, 1e6 * to, switches, model.flat)
        assert x == pytest.approx(whole, rel=1e-9, abs=1e-6), "in parts as at once"
        y, p = np.array([0.0, 150.0, 0.0, 0.0, 1.0, 0.0]), np.zeros((6, 6))
        forecast(y, p, 0.0, 1e6 * to, switches, model.flat)
        assert y == pytest.approx(whole, rel=1e-9, abs=1e-6), "with the covariance as without"
        at = to
    same = np.array([1.0, 150.0, 3e5, 2.0, 1.0, 3.0])
    for at_us in (10e3, 12e3):
        kept, p = same.copy(), np.eye(6)
        travel(kept, at_us, at_us, switches, model.flat)
        forecast(kept, p, at_us, at_us, switches, model.flat)
        assert kept.tolist() == same.tolist()
        assert p.tolist() == np.eye(6).tolist()


@pytest.mark.parametrize(("at_us", "u"), [(9e3, 0), (10e3, 1), (20e3, 1), (30e3, 0), (40e3, 0)])
def test_a_moment_ago_the_valve_was_as_it_is_now(at_us: float, u: int) -> None:
    """Backwards the pressure goes by the law of the valve at the time from which it goes."""
    b, switches = 20.0, np.array([[10e3, 30e3, 90e3], [1.0, 0.0, 1.0]])
    model = model_of((0.0, 0.0, 30.0), first_order_law(b, FULL))
    back = moved([0.0, 150.0, 2e5, 3.0, 1.0, 0.0], -1e-3, model, switches, at_us)
    target = FULL * u
    assert back[PRESSURE] == pytest.approx(target + (2e5 - target) * math.exp(b * 1e-3))
    assert back[TORQUE] == pytest.approx(3.0 * math.exp(0.03))
    assert back[OMEGA] == pytest.approx(150.0 - 3.0 * math.expm1(0.03) / 30.0)


KNOTS = (0.0, 1e5, 2e5, 3e5, 4e5, 5e5)
RISING = [(18.0, 1.5e7), (14.0, 1.3e7), (9.0, 1.1e7), (6.0, 1.0e7), (4.0, 0.9e7), (2.0, 0.8e7)]
FALLING = [(3.0, -1e6), (5.0, -9e5), (7.0, -8e5), (11.0, -6e5), (13.0, -4e5), (17.0, -2e5)]


def six_segments(parts: list[tuple[float, float]]) -> list[tuple[float, float, float]]:
    below = (-math.inf, *KNOTS[1:])
    return [(knot, *part) for knot, part in zip(below, parts, strict=True)]


LAW = law_of(six_segments(FALLING), six_segments(RISING))


def time_through(segment: tuple[float, float], begin: float, end: float) -> float:
    """p' = r - b p, solved for the time from one pressure to another."""
    b, r = segment
    return math.log((r - b * begin) / (r - b * end)) / b


def test_a_filling_brake_passes_all_six_segments_of_its_law() -> None:
    """Each knot is reached when the times through the segments before say so."""
    model, on = model_of((0.0, 0.0, 30.0), LAW), np.array([[0.0], [1.0]])
    at = 0.0
    for k, part in enumerate(RISING):
        end = 5.8e5 if k == SEGMENTS - 1 else KNOTS[k + 1]
        middle = 0.5 * (KNOTS[k] + end)
        for pressure in (middle, end):
            seconds = at + time_through(part, KNOTS[k], pressure)
            found = moved([0.0, 0.0, 0.0, 0.0, 1.0, 0.0], seconds, model, on)
            assert found[PRESSURE] == pytest.approx(pressure, abs=1.5)
        at += time_through(part, KNOTS[k], end)


def test_an_emptying_brake_passes_them_the_other_way() -> None:
    model = model_of((0.0, 0.0, 30.0), LAW)
    at = 0.0
    for k in reversed(range(SEGMENTS)):
        begin = 5.8e5 if k == SEGMENTS - 1 else KNOTS[k + 1]
        for pressure in (0.5 * (begin + KNOTS[k]), KNOTS[k]):
            seconds = at + time_through(FALLING[k], begin, pressure)
            found = moved([0.0, 0.0, 5.8e5, 0.0, 1.0, 0.0], seconds, model)
            assert found[PRESSURE] == pytest.approx(pressure, abs=2.0)
        at += time_through(FALLING[k], begin, KNOTS[k])


def _longest(model: Vector, u: int, pressure: float, dt: float) -> float:
    return longest_in_segment(record_on(model, MODEL), u, pressure, dt)


longest: Any = _longest
if not DISABLED:
    from numba import njit

    longest = njit(_longest)


def whole_in_segment(law: Vector, u: int, pressure: float, dt: float) -> float:
    """How much of `dt` passes before the pressure leaves its segment."""
    return float(longest(model_of((0.0, 0.0, 1.0), law).flat, u, pressure, dt))


def test_a_step_ends_where_the_pressure_leaves_its_segment() -> None:
    """Rising just at the knot, which is the upper segment's; falling a hair below it."""
    up = whole_in_segment(LAW, 1, 1.5e5, 1.0)
    assert up == pytest.approx(time_through(RISING[1], 1.5e5, 2e5), rel=1e-12)
    down = whole_in_segment(LAW, 0, 1.5e5, 1.0)
    assert down == pytest.approx(time_through(FALLING[1], 1.5e5, 1e5 - 1e-3), rel=1e-12)
    assert down - time_through(FALLING[1], 1.5e5, 1e5) > 3e-10
    for u, pressure, whole in ((1, 1.5e5, up), (0, 1.5e5, down)):
        assert whole_in_segment(LAW, u, pressure, 0.999 * whole) == 0.999 * whole
        assert whole_in_segment(LAW, u, pressure, 1.001 * whole) == whole
    leak = law_of([(-math.inf, 5.0, 0.0), (1e5, 5.0, 2e5)], [])
    down = whole_in_segment(leak, 0, 1.5e5, 1.0)
    assert down == pytest.approx(math.log(1.1e5 / 6e4) / 5.0, rel=1e-6), "from 1.5 towards 0.4e5"
    assert whole_in_segment(leak, 0, 1.5e5, 1.05 * down) == down
    on_knot = whole_in_segment(LAW, 1, 2e5, 1.0)
    assert on_knot == pytest.approx(time_through(RISING[2], 2e5, 3e5), rel=1e-12)
    for u, pressure in ((0, 1.5e5), (1, 1.5e5), (0, 0.5e5), (1, 5.5e5)):
        assert whole_in_segment(LAW, u, pressure, 1e-4) == 1e-4, "it does not leave it so soon"
    assert whole_in_segment(LAW, 0, 0.5e5, 10.0) == 10.0, "there is none below the lowest"
    assert whole_in_segment(LAW, 1, 5.5e5, 10.0) == 10.0, "and none above the highest"


def test_a_step_is_never_so_short_that_time_stands_still() -> None:
    """From the knot down it would last some nanoseconds; but no longer than is left."""
    fast = law_of([(-math.inf, 10.0, -1e6), (1e5, 10.0, -1e6)], [])
    assert whole_in_segment(fast, 0, 1e5, 1e-3) == 1e-7
    assert whole_in_segment(fast, 0, 1e5, 5e-8) == 5e-8


@pytest.mark.parametrize("short", [1e-3, 0.5e-3])
def test_a_pressure_that_comes_to_rest_a_hair_below_a_knot_stays_in_its_segment(
    short: float,
) -> None:
    """It never gets as far as to the lower segment: nothing ends the step."""
    rest = 1024.0 - short
    law = law_of([(-math.inf, 5.0, 0.0), (1024.0, 1.0, rest)], [])
    assert whole_in_segment(law, 0, 2000.0, 60.0) == 60.0


@pytest.mark.parametrize("i", [0, 1, 2])
def test_a_measured_state_corrects_all_as_kalman_has_it(i: int) -> None:
    """Of the covariance the upper half alone is read and written."""
    root = np.random.default_rng(8).normal(size=(3, 3))
    p, x = root @ root.T, np.array([1.0, -2.0, 3.0])
    upper, found, gain = np.where(np.tri(3, k=-1) > 0.0, np.nan, p), x.copy(), np.empty(3)
    s = measure(found, upper, i, 0.7, 0.3, gain)
    assert s == pytest.approx(p[i, i] + 0.3)
    expected = p[:, i] / (p[i, i] + 0.3)
    assert gain == pytest.approx(expected)
    assert found == pytest.approx(x + 0.7 * expected)
    row = np.eye(3)[i]
    left = (np.eye(3) - np.outer(expected, row)) @ p
    kept = np.triu_indices(3)
    assert upper[kept] == pytest.approx(left[kept])


def test_what_will_be_known_is_told_for_each_tick_and_no_further() -> None:
    """An angle of variance V and nothing else unknown: edges of variance r make it Vr/(V + r)."""
    model = model_of((0.4, 3e-4, 30.0), one_segment(20.0, 0.0))
    x, p, found = np.array([0.0, 150.0, 0.0, 0.0, 1.0, 0.0]), np.zeros((6, 6)), np.empty(4)
    p[0, 0] = 4e-6
    settling(x, p, np.array([1e6, 45e3, 8e3, 1e-6]), NEVER, model.flat, found)
    assert found == pytest.approx([1.0 / (1.0 / 4e-6 + k / 1e-6) for k in range(4)])
    assert x[OMEGA] == pytest.approx(150.0 * math.exp(-0.4 * 24e-3)), "moved by three ticks"


def test_what_will_be_known_counts_the_valve_s_switches_by_the_time_of_each_tick() -> None:
    """An unknown gain of the brake shows in the angle as the brake is on: for the last 5 ms of the
    first horizon, 15 ms of the second, 25 ms of the third."""
    g, b = 3e-4, 4000.0
    model = model_of((0.0, g, 30.0), first_order_law(b, FULL))
    x, p, found = np.array([0.0, 150.0, 0.0, 0.0, 1.0, 0.0]), np.zeros((6, 6)), np.empty(3)
    p[GAIN, GAIN] = 0.01
    switches = np.array([[1e6 + 40e3], [1.0]])
    settling(x, p, np.array([1e6, 45e3, 10e3, 1.0]), switches, model.flat, found)
    on = np.array([5e-3, 15e-3, 25e-3]) - 1.0 / b  # filling, it lags behind by its time constant
    assert found == pytest.approx(0.01 * (g * FULL * 0.5 * on**2) ** 2, rel=0.02)
