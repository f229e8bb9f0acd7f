"""The thesis's linear layshaft, its filter and its predictions, each part by hand or by SciPy."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.linalg import expm

from meshpoint.controller.motion.linear import (
    layshaft_model,
    predict_euler,
    predict_hold,
    predict_linear,
)
from meshpoint.controller.motion.linear_kernels import (
    CRUISE_FILTER,
    HOLD,
    LINEAR,
    THESIS_FILTER,
    correct,
    cruise_filter,
    propagate,
    thesis_filter,
)
from meshpoint.controller.motion.models import LayshaftState
from meshpoint.controller.records import RecordMemory, Vector
from meshpoint.gearbox import Split, load_sheet

NEVER = np.empty((2, 0))
FULL = 8e5


def on_from(*times_us: float) -> Vector:
    """Switches, the valve on and off in turn."""
    return np.array([times_us, [float(k % 2 == 0) for k in range(len(times_us))]])


def matrices(model: Vector, seconds: float) -> tuple[Vector, Vector]:
    """Phi and Gamma by the matrix exponential; pressure in units of the supply."""
    a, b, g, k = model
    flow = np.zeros((4, 4))
    flow[0, 1] = 1.0
    flow[1, 1:3] = -a, -g * k
    flow[2, 2:] = -b, b
    order = np.ix_([1, 0, 2, 3], [1, 0, 2, 3])
    whole = np.zeros((4, 4))
    whole[order] = expm(flow[order] * seconds)
    return whole[:3, :3], whole[:3, 3]


def held(x: Vector, seconds: float, u: float, model: Vector) -> Vector:
    """The state after a time with the valve as it is."""
    units = np.array([1.0, 1.0, model[3]])
    phi, gamma = matrices(model, seconds)
    return np.asarray((phi @ (x / units) + gamma * u) * units)


def covariance_after(p: Vector, seconds: float, w: Vector, model: Vector) -> Vector:
    """Phi P Phi' and the noise (w t)(w t)' of thesis 5.8."""
    units = np.array([1.0, 1.0, model[3]])
    phi = matrices(model, seconds)[0] * np.outer(units, 1.0 / units)
    return np.asarray(phi @ p @ phi.T + np.outer(w * seconds, w * seconds))


def test_records_are_as_long_as_what_they_hold() -> None:
    """Four parameters; eight elements; time, three states, nine variances, parameters, four noises;
    time, two states, four variances, two noises."""
    lengths = [each.itemsize // 8 for each in (LINEAR, HOLD, THESIS_FILTER, CRUISE_FILTER)]
    assert lengths == [4, 8, 1 + 3 + 9 + 4 + 4, 1 + 2 + 4 + 2]


MODELS = [(0.0, 20.0), (0.3, 16.7), (8.0, 50.0), (40.0, 9.0)]
"""Rates of friction and brake."""


@pytest.mark.parametrize(("a", "b"), MODELS)
@pytest.mark.parametrize("seconds", [3e-4, 0.02, 0.15])
@pytest.mark.parametrize("u", [0.0, 1.0])
def test_a_held_valve_moves_the_shaft_by_the_matrix_exponential(
    a: float, b: float, seconds: float, u: float
) -> None:
    model, x = np.array([a, b, 4e-4, FULL]), np.array([0.4, 140.0, 2.5e5])
    expected = held(x, seconds, u, model)
    switches = on_from(-1e4) if u else NEVER
    propagate(x, 0.0, 1e6 * seconds, switches, model)
    assert x == pytest.approx(expected, rel=1e-11)


@pytest.mark.parametrize("slowed", [0.0, 1e-5, 4e-4, 9.9e-4, 1.3e-3, 0.02, 0.4])
def test_friction_enters_by_the_exponential_series_to_the_last_digits(slowed: float) -> None:
    """A brake that fills at once and pulls with 1 rad/s2 turns the shaft back by the second
    integral of e^-at, slows it by the first."""
    seconds = 2e-3
    a = slowed / seconds
    series = [(-slowed) ** k for k in range(30)]
    once = seconds * math.fsum(s / math.factorial(k + 1) for k, s in enumerate(series))
    twice = seconds**2 * math.fsum(s / math.factorial(k + 2) for k, s in enumerate(series))
    braked, free = np.zeros(3), np.array([0.0, 1.0, 0.0])
    model = np.array([a, 1e16, 1.0, 1.0])
    propagate(braked, 0.0, 1e6 * seconds, on_from(-1.0), model)
    assert braked[2] == 1.0
    assert braked[1] == pytest.approx(-once, rel=2e-13, abs=0.0)
    assert braked[0] == pytest.approx(-twice, rel=5e-13 if slowed < 1e-3 else 3e-12, abs=0.0)
    propagate(free, 0.0, 1e6 * seconds, NEVER, model)
    assert free == pytest.approx([once, math.exp(-slowed), 0.0], rel=2e-14, abs=0.0)


@pytest.mark.parametrize("b", [2.0, 500.0])
@pytest.mark.parametrize("apart", [0.0, 1e-11, 3e-7, -3e-7, 1e-5, -1e-5])
def test_a_shaft_that_slows_as_fast_as_its_brake_empties_does_so_by_t_e_to_the_minus_bt(
    b: float, apart: float
) -> None:
    """The double root: omega = -g p t e^-bt, to what the rates are apart; and its integral."""
    seconds = 0.4 / b
    x = np.array([0.0, 0.0, 1.0])
    propagate(x, 0.0, 1e6 * seconds, NEVER, np.array([b * (1.0 + apart), b, 1.0, 1.0]))
    omega = -seconds * math.exp(-0.4)
    theta = -(1.0 - 1.4 * math.exp(-0.4)) / b**2
    assert x == pytest.approx(
        [theta, omega, math.exp(-0.4)], rel=2.0 * max(abs(apart), 1e-6), abs=0.0
    )


def test_a_valve_s_switches_count_from_their_time_on() -> None:
    """Before, at the begin of the time, within, and none behind its end."""
    model, start = np.array([0.3, 20.0, 4e-4, FULL]), np.array([0.0, 140.0, 1e5])
    switches = on_from(-5e3, 10e3, 25e3, 60e3)
    for begin, end in ((0.0, 8e3), (0.0, 10e3), (0.0, 40e3), (10e3, 20e3), (12e3, 60e3),
                       (25e3, 26e3), (25e3, 70e3), (60e3, 61e3), (-9e3, 1e3)):  # fmt: skip
        expected, at = start, begin
        for stop in (*[t for t in switches[0] if begin < t < end], end):
            past = switches[1][switches[0] <= at]
            expected = held(expected, 1e-6 * (stop - at), past[-1] if past.size else 0.0, model)
            at = stop
        found = start.copy()
        propagate(found, begin, end, switches, model)
        assert found == pytest.approx(expected, rel=1e-10), (begin, end)


@pytest.mark.parametrize("states", [2, 3])
def test_an_edge_corrects_as_kalman_has_it(states: int) -> None:
    """(I - K C) P with the whole row, also where the two halves of P are not the same."""
    rng = np.random.default_rng(5)
    p = rng.normal(size=(states, states))
    p[0, 0] = 2.0
    x = rng.normal(size=states)
    gain = p[:, 0] / (2.0 + 0.5)
    expected, left = x + gain * (1.7 - x[0]), p - np.outer(gain, p[0])
    correct(x, p, 1.7, 0.5)
    assert x == pytest.approx(expected)
    assert p == pytest.approx(left)


def thesis(
    model: Vector, x: Vector, p: Vector, w: Vector, r_rad2: float, at_us: float = 0.0
) -> RecordMemory:
    memory = RecordMemory(THESIS_FILTER)
    for name, value in (("x", x), ("p", p), ("model", model), ("w", w)):
        memory.part(name)[:] = value
    memory.part("r_rad2")[0], memory.part("time_us")[0] = r_rad2, at_us
    return memory


ROOT = np.random.default_rng(6).normal(size=(3, 3)) * [[1e-3], [0.5], [2e4]]
P = ROOT @ ROOT.T
W = np.array([0.02, 30.0, 2e5])


@pytest.mark.parametrize(("a", "b"), MODELS)
def test_what_is_not_known_goes_on_with_the_shaft_and_grows_by_the_noise(
    a: float, b: float
) -> None:
    """Seen after an edge that tells nothing."""
    model = np.array([a, b, 4e-4, FULL])
    memory = thesis(model, np.array([0.0, 140.0, 3e5]), P, W, 1e30)
    thesis_filter(memory.flat, np.array([7e3]), np.array([9.0]), NEVER)
    expected = covariance_after(P, 7e-3, W, model)
    sds = np.sqrt(np.diag(expected))
    found = memory.part("p")
    assert found / np.outer(sds, sds) == pytest.approx(expected / np.outer(sds, sds), abs=1e-11)
    assert np.array_equal(found, found.T)


@pytest.mark.parametrize("cut", [1, 2, 5])
@pytest.mark.parametrize("switched", [(-2e3, 1e3, 9e3, 14e3, 15e3), (7e3, 9e3, 14e3)])
def test_the_filter_takes_edges_and_switches_in_their_order(
    switched: tuple[float, ...], cut: int
) -> None:
    """A switch before the first edge, one at an edge, two between edges; edges of before the state
    and those that were taken already count no more. In one batch or in two."""
    model, r = np.array([0.4, 20.0, 4e-4, FULL]), 1e-6
    edges = np.array([[5e3, 6e3, 9e3, 13e3, 20e3], [0.05, 0.1, 0.9, 1.6, 2.1]])
    switches = on_from(*switched)
    x, p, at = np.array([0.0, 140.0, 3e5]), P.copy(), 5e3
    memory = thesis(model, x, p, W, r, at)
    for edge, angle in edges.T[1:]:
        for stop in (*[t for t in switches[0] if at < t < edge], edge):
            past = switches[1][switches[0] <= at]
            x = held(x, 1e-6 * (stop - at), past[-1] if past.size else 0.0, model)
            p = covariance_after(p, 1e-6 * (stop - at), W, model)
            at = stop
        gain = p[:, 0] / (p[0, 0] + r)
        x, p = x + gain * (angle - x[0]), p - np.outer(gain, p[0])
    for batch in (edges[:, :cut], edges[:, max(0, cut - 2) :]):
        thesis_filter(memory.flat, batch[0], batch[1], switches)
    assert memory.part("x") == pytest.approx(x, rel=1e-9)
    sds = np.sqrt(np.diag(p))
    assert memory.part("p") / np.outer(sds, sds) == pytest.approx(p / np.outer(sds, sds), abs=1e-8)
    assert memory.part("time_us")[0] == 20e3


def test_a_shaft_at_cruise_is_filtered_with_an_acceleration_held_from_edge_to_edge() -> None:
    """The angle of an edge is exact, its time is not: off by a speed's way in that time."""
    memory = RecordMemory(CRUISE_FILTER)
    p = np.array([[2e-6, 3e-4], [3e-4, 0.4]])
    memory.part("x")[:], memory.part("p")[:] = [0.1, 70.0], p
    memory.part("acceleration_rad_s2")[0], memory.part("edge_time_s")[0] = 600.0, 2e-6
    memory.part("time_us")[0] = 1e3
    x, at = np.array([0.1, 70.0]), 1e3
    edges = np.array([[1e3, 3e3, 8e3], [7.0, 0.24, 0.6]])
    for edge, angle in edges.T[1:]:
        dt = 1e-6 * (edge - at)
        move, push = np.array([[1.0, dt], [0.0, 1.0]]), np.array([0.5 * dt**2, dt]) * 600.0
        x, p = move @ x, move @ p @ move.T + np.outer(push, push)
        gain = p[:, 0] / (p[0, 0] + (x[1] * 2e-6) ** 2 + 1e-12)
        x, p, at = x + gain * (angle - x[0]), p - np.outer(gain, p[0]), edge
    cruise_filter(memory.flat, *edges[:, :2])
    cruise_filter(memory.flat, *edges)
    assert memory.part("x") == pytest.approx(x, rel=1e-11)
    assert memory.part("p") == pytest.approx(p, rel=1e-8)
    assert memory.part("time_us")[0] == 8e3


def test_a_shaft_at_cruise_that_stands_still_is_told_its_angle_to_a_millionth() -> None:
    """Without speed an edge's time tells nothing of its angle; what is left is 1e-6 rad."""
    memory = RecordMemory(CRUISE_FILTER)
    memory.part("p")[:] = np.diag([3e-12, 0.0])
    cruise_filter(memory.flat, np.array([1e3]), np.array([4e-6]))
    assert memory.part("x") == pytest.approx([3e-6, 0.0])
    assert memory.part("p")[0, 0] == pytest.approx(0.75e-12)


SHEET = load_sheet("truck12")
STATE = LayshaftState(2e6, 1.0, 8.0, 1.0, 0.1, 0.2, 0.3, covariance=np.eye(6))


@pytest.mark.parametrize("split", list(Split))
def test_the_model_is_that_of_the_data_sheet(split: Split) -> None:
    inertia = SHEET.inertia_kgm2(split)
    assert layshaft_model(SHEET, split).tolist() == [
        SHEET.shafts.friction_nms / inertia,
        1.0 / SHEET.brake.time_constant_s,
        SHEET.brake_nm_per_pa / inertia,
        SHEET.air.supply_gauge_pa,
    ]


def test_at_constant_speed_only_angle_and_time_go_on() -> None:
    later = predict_linear(STATE, 2.25e6)
    assert later.theta_rad == pytest.approx(1.0 + 0.25 * 8.0)
    assert later == STATE._replace(time_us=2.25e6, theta_rad=later.theta_rad)


def test_euler_s_steps_by_hand() -> None:
    """Two of half a second and what is left: each from angle, speed, pressure of the one before.

    8 - (4 + 2) / 2 = 5, 5 - (2.5 + 3) / 2 = 2.25, 2.25 - (1.125 + 3.75) / 4 = 1.03125."""
    model = np.array([0.5, 0.5, 2.0, 3.0])
    later = predict_euler(STATE._replace(theta_rad=0.0), 3.25e6, 1.0, model, 0.5)
    assert later[:4] == pytest.approx((3.25e6, 4.0 + 2.5 + 0.5625, 1.03125, 2.015625))
    assert later[4:] == STATE[4:]
    off = predict_euler(STATE._replace(theta_rad=0.0), 2.5e6, 0.0, model, 0.5)
    assert off[1:4] == pytest.approx((4.0, 5.0, 0.75))
    assert predict_euler(STATE, 2e6, 1.0, model, 0.5) == STATE, "no time, no step"


def test_the_hold_goes_through_every_switch_and_keeps_what_is_not_known() -> None:
    model = np.array([0.3, 20.0, 4e-4, FULL])
    state = LayshaftState(1e6, 0.5, 140.0, 1e5, 0.1, 0.2, 0.3, 7.0, 1.1, -2.0)
    later = predict_hold(state, 1.03e6, on_from(0.0, 1.01e6), model)
    half = held(np.array([0.5, 140.0, 1e5]), 0.01, 1.0, model)
    assert later[1:4] == pytest.approx(held(half, 0.02, 0.0, model))
    assert later[0] == 1.03e6
    assert later[4:] == (0.1, 0.2, 0.3, 0.0, 1.0, 0.0, None, 0.0), "three states alone"
