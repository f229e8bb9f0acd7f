"""The crossing-time filter step by step, against a Kalman filter of whole matrices.

That one takes the motion from the matrix exponential of the equations at the head of
`controller/motion/kernels.py`, and what a tooth's error does to an innovation from a run in which
that tooth's edges are moved."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pytest
from free_layshaft import law_array
from late_batches import EVERYTHING, after, refuses_what_was_before_its_state
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from meshpoint.controller.estimation.crossing_kernels import (
    cholesky,
    crossing_filter,
    inverse_by_root,
    inverse_of_positive,
)
from meshpoint.controller.estimation.crossing_layout import (
    DONE,
    LATE,
    FilterMemory,
    TeethArrays,
)
from meshpoint.controller.motion.models import MotionModel, first_order_law
from meshpoint.controller.records import Vector
from meshpoint.units import US

A, G, FADING, LAW_PER_S, SUPPLY_PA = 0.8, 4e-4, 30.0, 12.0, 6e5
EDGE_S, TOOTH_RAD, PRESSURE_PA, GATE = 4e-6, 3e-3, 4e3, 5.0
START = np.array([0.2, 120.0, 2e4, 6.0, 1.1, -4.0])
SCALES = np.array([5e-3, 1.5, 1e4, 5.0, 0.06, 3.0])
NO_TEETH = TeethArrays(0).flat
NONE = np.empty(0)
OFF = np.empty((2, 0))


class Shaft(NamedTuple):
    """What a filter is set to."""

    brake: float = G
    edge_s: float = EDGE_S
    noise: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)


def spread_at_first() -> Vector:
    """A covariance of all six states in which each goes with each."""
    rng = np.random.default_rng(5)
    root = np.eye(6) + 0.25 * rng.standard_normal((6, 6))
    whole = root @ root.T
    sd = np.sqrt(np.diag(whole))
    found: Vector = whole / np.outer(sd, sd) * np.outer(SCALES, SCALES)
    return found


def a_memory(shaft: Shaft | None = None, law: Vector | None = None) -> FilterMemory:
    """A filter at 1 ms in its first state."""
    shaft, memory = shaft or Shaft(), FilterMemory()
    memory.set_sensor(shaft.edge_s, TOOTH_RAD, PRESSURE_PA, GATE)
    rates = np.array([A, shaft.brake, FADING])
    law = first_order_law(LAW_PER_S, SUPPLY_PA) if law is None else law
    memory.model[:] = MotionModel(rates, law, np.array(shaft.noise)).flat
    memory.time_us[0], memory.x[:], memory.p[:] = 1000.0, START, spread_at_first()
    return memory


def run(
    memory: FilterMemory,
    edges: Vector,
    pressures: tuple[Vector, Vector] = (NONE, NONE),
    switches: Vector = OFF,
    teeth: Vector = NO_TEETH,
) -> int:
    """The kernel over a batch."""
    return int(crossing_filter(memory.flat, edges, *pressures, switches, teeth))


class Whole:
    """A Kalman filter of six states, by whole matrices."""

    def __init__(self, shaft: Shaft) -> None:
        self.shaft, self.time_us, self.z = shaft, 1000.0, START.copy()
        self.p = spread_at_first()
        self.squares = self.logs = 0.0
        self.innovations: list[tuple[float, float]] = []
        """Of the edges, with their variances."""

    def move(self, to_us: float, on: bool) -> None:
        """The equations, linear about the motion itself: F is integrated along it."""
        seconds, brake = (to_us - self.time_us) * US, self.shaft.brake
        flow = LAW_PER_S * SUPPLY_PA if on else 0.0

        def rate(_: float, flat: Vector) -> Vector:
            z, f = flat[:6], flat[6:].reshape(6, 6)
            a = np.zeros((6, 6))
            a[0, 1], a[1, 1] = 1.0, -A
            a[1, 2], a[1, 3], a[1, 4], a[1, 5] = -brake * z[4], 1.0, -brake * z[2], 1.0
            a[2, 2], a[3, 3] = -LAW_PER_S, -FADING
            moved = np.array([z[1], -A * z[1] - brake * z[4] * z[2] + z[3] + z[5],
                              flow - LAW_PER_S * z[2], -FADING * z[3], 0.0, 0.0])  # fmt: skip
            return np.concatenate((moved, (a @ f).ravel()))

        begin = np.concatenate((self.z, np.eye(6).ravel()))
        end = solve_ivp(rate, (0.0, seconds), begin, method="DOP853", rtol=1e-11, atol=1e-12)
        self.z, f = end.y[:6, -1], end.y[6:, -1].reshape(6, 6)
        self.p = f @ self.p @ f.T
        self.time_us = to_us

    def measure(self, seen: Vector, off: float, r: float) -> float:
        s = float(seen @ self.p @ seen) + r
        gain = self.p @ seen / s
        self.z = self.z + gain * off
        self.p = self.p - np.outer(gain, gain) * s
        return s

    def edge(self, angle: float) -> None:
        off = angle - self.z[0]
        r = (self.z[1] * self.shaft.edge_s) ** 2 + TOOTH_RAD**2
        s = self.measure(np.eye(6)[0], off, r)
        self.squares, self.logs = self.squares + off**2 / s, self.logs + math.log(s)
        self.innovations.append((float(off), s))

    def pressure(self, seen_pa: float) -> None:
        self.measure(np.eye(6)[2], seen_pa - self.z[2], PRESSURE_PA**2)


def assert_is(memory: FilterMemory, whole: Whole) -> None:
    """The record holds this state and this covariance."""
    assert memory.time_us[0] == whole.time_us
    sd = np.sqrt(np.diag(whole.p))
    assert memory.x / sd == pytest.approx(whole.z / sd, rel=1e-7, abs=1e-6)
    both = np.outer(sd, sd)
    assert memory.p / both == pytest.approx(whole.p / both, abs=1e-7)
    assert memory.nis[0] == pytest.approx(whole.squares, rel=1e-6)


SWITCHES = np.array([[3000.0, 8500.0], [1.0, 0.0]])
OWN_US = np.array([2000.0, 2900.0, 4000.0, 5000.0, 6000.0, 7100.0, 8000.0, 9000.0, 9900.0])
PRESSURE_US = np.array([1200.0, 4000.0, 5500.0, 9000.0, 10_500.0])


def angles_at(times_us: Vector, off_rad: float) -> Vector:
    """About where the shaft is then, off by a pattern."""
    wave = np.where(np.arange(times_us.size) % 2 == 0, 1.0, -0.6)
    found: Vector = START[0] + 120.0 * (times_us - 1000.0) * US + off_rad * wave
    return found


def test_edges_and_pressures_are_taken_in_order_of_time_as_kalman_has_it() -> None:
    """Through both switches of the brake; where two things are of one time, pressure comes behind
    the edge that is there already and finds nothing to move."""
    memory, whole = a_memory(), Whole(Shaft())
    own, pressures = angles_at(OWN_US, 4e-3), 2e4 + 3e3 * np.cos(PRESSURE_US)
    assert run(memory, np.array((OWN_US, own)), (PRESSURE_US, pressures), SWITCHES) == DONE
    seen = [(t, 0, y) for t, y in zip(OWN_US, own, strict=True)]
    seen += [(t, 1, y) for t, y in zip(PRESSURE_US, pressures, strict=True) if t not in OWN_US]
    seen += [(t, 2, 0.0) for t in SWITCHES[0]]
    on = False
    for time_us, kind, value in sorted(seen):
        whole.move(time_us, on)
        if kind == 2:
            on = not on
        else:
            (whole.edge, whole.pressure)[kind](value)
    assert_is(memory, whole)
    assert memory.nis[1] == OWN_US.size
    assert memory.log_variance[0] == pytest.approx(whole.logs, rel=1e-7)
    assert np.array_equal(memory.p, memory.p.T)


def test_teeth_s_equations_hold_how_each_tooth_s_error_moves_each_innovation() -> None:
    """The sums of m m' / s and of -m times innovation / s, m being what an error adds to each
    innovation: here the difference of two runs, one with that tooth's edges moved. Nothing bends
    where the brake does not act and edges are as sure at any speed."""
    shaft, place = Shaft(brake=0.0, edge_s=0.0), np.array([0, 1, 2, 0, 1, 2, 0, 1, 2])
    pressure_us = np.array([1200.0, 2500.0, 4000.0, 4500.0, 5500.0, 7500.0, 8200.0, 9500.0])
    own, pressures = angles_at(OWN_US, 4e-3), 2e4 + 3e3 * np.cos(pressure_us)
    memory, teeth = a_memory(shaft), TeethArrays(3)
    edges = np.array((OWN_US, own, place))
    assert run(memory, edges, (pressure_us, pressures), SWITCHES, teeth.flat) == DONE

    def innovations(moved: Vector) -> Vector:
        whole = Whole(shaft)
        seen = [(t, 0, y) for t, y in zip(OWN_US, moved, strict=True)]
        seen += [(t, 1, y) for t, y in zip(pressure_us, pressures, strict=True) if t not in OWN_US]
        seen += [(t, 2, 0.0) for t in SWITCHES[0]]
        on = False
        for time_us, kind, value in sorted(seen):
            whole.move(time_us, on)
            if kind == 2:
                on = not on
            else:
                (whole.edge, whole.pressure)[kind](value)
        return np.array(whole.innovations).T

    (off, variance), by = innovations(own), np.empty((3, OWN_US.size))
    for tooth in range(3):
        moved = own + np.where(place == tooth, 1e-3, 0.0)
        by[tooth] = (innovations(moved)[0] - off) / 1e-3
    upper = np.triu((by / variance) @ by.T)
    assert np.triu(teeth.normal) / upper.max() == pytest.approx(upper / upper.max(), abs=1e-7)
    assert not np.tril(teeth.normal, -1).any()
    right = -(by / variance) @ off
    assert teeth.right == pytest.approx(right, rel=1e-5, abs=1e-5 * np.abs(right).max())


def test_a_tooth_that_the_gate_refuses_teaches_nothing() -> None:
    memory, teeth = a_memory(), TeethArrays(2)
    run(memory, np.array([[2000.0], [9.0], [1.0]]), teeth=teeth.flat)
    assert memory.part("gated_in_a_row")[0] == 1
    assert not teeth.normal.any()
    assert not teeth.right.any()


def test_a_batch_of_before_the_state_is_refused_while_there_is_a_snapshot() -> None:
    """Nothing is taken then; without one its late edges are left out. At the state's own time an
    edge is not late, and has been seen."""
    refuses_what_was_before_its_state(a_memory, run, 0.68)
    assert (DONE, LATE) == (0, 1)


def test_a_batch_without_edges_is_never_late() -> None:
    for edges in (OFF, np.array([[2000.0], [0.32]])):
        memory = a_memory()
        memory.held[0] = 1
        assert run(memory, edges) == DONE
        assert memory.time_us[0] == (2000.0 if edges.size else 1000.0)


def test_late_pressures_are_left_out() -> None:
    memory, other = a_memory(), a_memory()
    run(memory, OFF, (np.array([900.0, 1000.0, 2000.0]), np.array([9e5, 9e5, 2.1e4])))
    run(other, OFF, (np.array([2000.0]), np.array([2.1e4])))
    assert after(memory, *EVERYTHING) == after(other, *EVERYTHING)


def test_the_states_before_the_newest_four_batches_can_be_gone_back_to() -> None:
    memory, kept = a_memory(), []
    fields = EVERYTHING[:4]
    for k in range(6):
        memory.part("restless")[0] = 1.0 + k
        kept.append(after(memory, *fields))
        run(memory, np.array([[2000.0 + 1000.0 * k], [0.32 + 0.12 * k]]))
        assert memory.held[0] == min(k + 1, 4)
    for k in (5, 4, 3, 2):
        memory.go_back()
        assert after(memory, *fields) == kept[k]
    assert memory.held[0] == 0


def test_a_brake_is_taken_to_have_a_fifth_of_its_torque_at_least() -> None:
    for gain, kept in ((0.1, 0.2), (0.21, 0.21)):
        memory = a_memory()
        memory.p[:] = np.diag(np.diag(memory.p))
        memory.p[4, 4] = 0.0
        memory.x[4], memory.x[2] = gain, 0.0
        run(memory, np.array([[1001.0], [0.2]]))
        assert memory.x[4] == pytest.approx(kept)


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize(("share", "taken"), [(0.999, True), (1.001, False)])
def test_an_edge_beyond_the_gate_is_refused_and_the_eighth_in_a_row_widens_what_is_not_known(
    share: float, taken: bool, side: float
) -> None:
    """By the innovation's square, a fifth of the speed and 100 rad/s2 of steady acceleration: then
    it is taken as any other; but it tells nothing of how well the filter fits."""
    for refused in (0, 6, 7):
        memory, whole = a_memory(), Whole(Shaft())
        memory.part("gated_in_a_row")[0] = refused
        whole.move(2000.0, False)
        r = (whole.z[1] * EDGE_S) ** 2 + TOOTH_RAD**2
        off = side * share * GATE * math.sqrt(whole.p[0, 0] + r)
        run(memory, np.array([[2000.0], [whole.z[0] + off]]))
        if not taken and refused == 7:
            whole.p += np.diag((off**2, (0.2 * whole.z[1]) ** 2, 0.0, 0.0, 0.0, 100.0**2))
        if taken or refused == 7:
            whole.edge(whole.z[0] + off)
        if not taken:
            whole.squares = whole.logs = 0.0
        assert_is(memory, whole)
        assert memory.part("gated_in_a_row")[0] == (0 if taken or refused == 7 else refused + 1)
        assert memory.nis[1] == (1.0 if taken else 0.0)
        assert memory.log_variance[0] == pytest.approx(whole.logs, rel=1e-7)


@pytest.mark.parametrize(
    ("sds", "before", "heed", "restless"),
    [(3.0, 2.0, 0.1, 2.0 * (1.0 + 0.1 * 8.0)), (0.5, 2.0, 0.1, 2.0 * (1.0 - 0.1 * 0.75)),
     (9.0, 2.0, 0.1, 2.0 * (1.0 + 0.1 * 24.0)), (0.0, 1.05, 0.1, 1.0), (3.0, 9e3, 0.1, 1e4),
     (3.0, 0.5, 0.0, 0.5)],
)  # fmt: skip
def test_noise_grows_and_fades_with_how_far_off_edges_are(
    sds: float, before: float, heed: float, restless: float
) -> None:
    """By the square's distance from the 1 that is expected, counted no further than to the gate;
    never below the model's, nor above ten thousand times it."""
    memory, whole = a_memory(), Whole(Shaft())
    memory.part("restless")[0], memory.part("heed")[0] = before, heed
    whole.move(2000.0, False)
    sd = math.sqrt(whole.p[0, 0] + (whole.z[1] * EDGE_S) ** 2 + TOOTH_RAD**2)
    run(memory, np.array([[2000.0], [whole.z[0] + sds * sd]]))
    assert memory.part("restless")[0] == pytest.approx(restless, rel=1e-5)


@pytest.mark.parametrize("restless", [1.0, 7.0])
def test_what_is_not_known_grows_by_each_white_noise_and_faster_while_noise_is_restless(
    restless: float,
) -> None:
    """Van Loan's integral, over 40 ms within 2 % of a deviation: no step of the filter is so long
    that it would not hold. Noises of pressure and gain are not accelerations."""
    noise, seconds = (4e4, 4e10, 2.0, 900.0), 0.04
    memory = a_memory(Shaft(noise=noise, brake=G))
    memory.p[:], memory.x[2] = 0.0, 0.0
    memory.part("restless")[0], gain = restless, memory.x[4]
    run(memory, OFF, (np.array([41_000.0]), np.array([0.0])))
    a = np.zeros((6, 6))
    a[0, 1], a[1, 1], a[1, 2], a[1, 3], a[1, 5] = 1.0, -A, -G * gain, 1.0, 1.0
    a[2, 2], a[3, 3] = -LAW_PER_S, -FADING
    q = np.diag((0.0, 0.0, noise[1], restless * noise[0], noise[2], restless * noise[3]))
    block = expm(np.block([[-a, q], [np.zeros((6, 6)), a.T]]) * seconds)
    p = block[6:, 6:].T @ block[:6, 6:]
    left = p - np.outer(p[2], p[2]) / (p[2, 2] + PRESSURE_PA**2)
    for i in (0, 1, 2, 3, 4, 5):
        assert memory.p[i, i] == pytest.approx(left[i, i], rel=0.02)


KNEE_PA = 1e5


def bent_law() -> Vector:
    """Emptying that is three times as fast above 1 bar."""
    law = (((10.0, 0.0), (30.0, -2e6)), ((10.0, 6e6), (30.0, 4e6)))
    found: Vector = law_array(law, (0.0, KNEE_PA))
    return found


def emptied(seconds: float, from_pa: float) -> float:
    """Pressure by the law above the knee: p' = -2e6 - 30 p; and by the one below it, p' = -10 p."""
    rest = 2e6 / 30.0
    until = math.log((from_pa + rest) / (KNEE_PA + rest)) / 30.0
    if seconds <= until:
        return (from_pa + rest) * math.exp(-30.0 * seconds) - rest
    return KNEE_PA * math.exp(-10.0 * (seconds - until))


@pytest.mark.parametrize(("wait_us", "follows"), [(1900.0, False), (2000.0, False),
                                                  (2300.0, True), (9000.0, True)])  # fmt: skip
def test_a_pressure_changes_its_law_on_the_way_in_a_step_of_more_than_two_milliseconds(
    wait_us: float, follows: bool
) -> None:
    memory = a_memory(law=bent_law())
    memory.x[2] = 1.04e5
    memory.p[:] = 0.0
    run(memory, np.array([[1000.0 + wait_us], [0.0]]))
    seconds, rest = wait_us * US, 2e6 / 30.0
    straight = (1.04e5 + rest) * math.exp(-30.0 * seconds) - rest
    expected = emptied(seconds, 1.04e5) if follows else straight
    assert memory.x[2] == pytest.approx(expected, rel=1e-5)
    other = straight if follows else emptied(seconds, 1.04e5)
    assert abs(memory.x[2] - other) > 20.0


def test_a_switch_at_a_batch_s_very_end_has_not_been_passed() -> None:
    """One at the state's time has."""
    switches = np.array([[1000.0, 3000.0], [1.0, 0.0]])
    memory = a_memory()
    memory.p[:] = 0.0
    run(memory, np.array([[3000.0], [0.0]]), switches=switches)
    run(memory, np.array([[4000.0], [0.0]]), switches=switches)
    braked = SUPPLY_PA + (START[2] - SUPPLY_PA) * math.exp(-LAW_PER_S * 2e-3)
    assert memory.x[2] == pytest.approx(braked * math.exp(-LAW_PER_S * 1e-3))


@pytest.mark.parametrize("n", [1, 2, 7])
def test_a_matrix_s_root_and_its_inverse_are_those_of_linear_algebra(n: int) -> None:
    rng = np.random.default_rng(n)
    root = rng.standard_normal((n, n))
    matrix = root @ root.T + 0.1 * np.eye(n)
    lower = cholesky(np.triu(matrix) + np.tril(matrix, -1))
    assert lower == pytest.approx(np.linalg.cholesky(matrix), rel=1e-9, abs=1e-12)
    assert inverse_by_root(lower) == pytest.approx(np.linalg.inv(matrix), rel=1e-7)
    assert inverse_of_positive(matrix) == pytest.approx(np.linalg.inv(matrix), rel=1e-7)
    assert np.array_equal(inverse_of_positive(matrix), inverse_of_positive(matrix).T)


@pytest.mark.parametrize("bad", [np.diag((1.0, 0.0, 2.0)), np.diag((1.0, 2.0, -1.0)),
                                 np.diag((math.nan, 1.0, 1.0)), np.diag((-1.0, 1.0, 1.0)),
                                 np.ones((2, 2)), np.diag((0.0, 1.0))])  # fmt: skip
def test_a_matrix_that_is_not_positive_has_no_root_and_no_inverse(bad: Vector) -> None:
    assert np.isnan(cholesky(bad)).all()
    assert cholesky(bad).shape == bad.shape
    assert np.isnan(inverse_of_positive(bad)).all()
