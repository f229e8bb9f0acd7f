"""The main shaft's crossing-time filter, against a Kalman filter of whole matrices.

That one takes the motion of a driveline that swings from the matrix exponential of its equations
(`controller/motion/swing_kernels`), its noise from Van Loan's, and what a tooth's error does to an
innovation from a run in which that tooth's edges are moved."""

from __future__ import annotations

import math

import numpy as np
import pytest
from late_batches import after, refuses_what_was_before_its_state
from scipy.linalg import expm

from meshpoint.controller.estimation.crossing_layout import (
    DONE,
    FilterMemory,
    TeethArrays,
)
from meshpoint.controller.estimation.swing_filter import MAIN_FILTER
from meshpoint.controller.motion.swing import ModeRates, SwingMotion
from meshpoint.controller.records import Vector
from meshpoint.units import US

EDGE_S, TOOTH_RAD, GATE = 4e-6, 3e-3, 5.0
WHITE, WALK = 40.0, 300.0
MODES = (ModeRates(110.0, 9.0, 500.0), ModeRates(25.0, 3.0, 20.0))
START = np.array([0.2, 60.0, -4.0, 4e-3, 0.7, -9e-3, 0.3])
SCALES = np.array([5e-3, 1.5, 4.0, 3e-3, 0.8, 8e-3, 0.4])
NONE = np.empty(0)
NO_TEETH = TeethArrays(0).flat


def spread_at_first() -> Vector:
    """A covariance of all seven states in which each goes with each."""
    root = np.eye(7) + 0.25 * np.random.default_rng(5).standard_normal((7, 7))
    whole = root @ root.T
    sd = np.sqrt(np.diag(whole))
    found: Vector = whole / np.outer(sd, sd) * np.outer(SCALES, SCALES)
    return found


def a_memory(edge_s: float = EDGE_S) -> FilterMemory:
    """A filter at 1 ms in its first state; its noise restless by 3."""
    memory = MAIN_FILTER.memory()
    memory.set_sensor(edge_s, TOOTH_RAD, 1.0, GATE)
    memory.model[:] = SwingMotion(WHITE, WALK, MODES).flat
    memory.part("restless")[0] = 3.0
    memory.time_us[0], memory.x[:], memory.p[:] = 1000.0, START, spread_at_first()
    return memory


def run(memory: FilterMemory, edges: Vector, teeth: Vector = NO_TEETH) -> int:
    """The kernel over a batch."""
    return MAIN_FILTER.run(memory.flat, edges, NONE, NONE, np.empty((2, 0)), teeth)


class Whole:
    """A Kalman filter of seven states, by whole matrices."""

    def __init__(self, edge_s: float = EDGE_S) -> None:
        self.time_us, self.z, self.edge_s = 1000.0, START.copy(), edge_s
        self.p = spread_at_first()
        self.squares = self.logs = 0.0
        self.innovations: list[tuple[float, float]] = []
        a, q = np.zeros((7, 7)), np.zeros((7, 7))
        a[0, 1] = a[1, 2] = 1.0
        q[1, 1], q[2, 2] = 3.0 * WHITE, WALK
        for i, mode in ((3, MODES[0]), (5, MODES[1])):
            a[i, i + 1], a[i + 1, i] = 1.0, -(mode.natural_rad_s**2)
            a[i + 1, i + 1] = -2.0 * mode.decay_per_s
            a[1] += a[i + 1]
            # What drives a mode drives the shaft that it is part of.
            kick = np.eye(7)[1] + np.eye(7)[i + 1]
            q += mode.noise_rad2_s3 * np.outer(kick, kick)
        self.a, self.q = a, q

    def move(self, to_us: float) -> None:
        seconds = (to_us - self.time_us) * US
        block = np.block([[-self.a, self.q], [np.zeros((7, 7)), self.a.T]]) * seconds
        parts = expm(block)
        f = parts[7:, 7:].T
        self.z = f @ self.z
        self.p = f @ self.p @ f.T + f @ parts[:7, 7:]
        self.time_us = to_us

    def measure(self, seen: Vector, off: float) -> float:
        s = float(seen @ self.p @ seen) + (self.z[1] * self.edge_s) ** 2 + TOOTH_RAD**2
        gain = self.p @ seen / s
        self.z, self.p = self.z + gain * off, self.p - np.outer(gain, gain) * s
        self.squares += off**2 / s
        return float(s)

    def edge(self, angle: float) -> None:
        off = float(angle - self.z[0])
        s = self.measure(np.eye(7)[0], off)
        self.logs += math.log(s)
        self.innovations.append((off, s))


def assert_is(memory: FilterMemory, whole: Whole) -> None:
    """The record holds this state and this covariance."""
    assert memory.time_us[0] == whole.time_us
    sd = np.sqrt(np.diag(whole.p))
    both = np.outer(sd, sd)
    assert memory.x / sd == pytest.approx(whole.z / sd, rel=1e-8, abs=1e-8)
    assert memory.p / both == pytest.approx(whole.p / both, abs=1e-9)
    assert np.array_equal(memory.p, memory.p.T)


OWN_US = np.array([2000.0, 2900.0, 4000.0, 5000.0, 6000.0, 7100.0, 8000.0, 19_000.0, 20_000.0])


def angles_at(times_us: Vector) -> Vector:
    """About where the shaft is then, off by a pattern."""
    wave = np.where(np.arange(times_us.size) % 2 == 0, 4e-3, -2e-3)
    found: Vector = START[0] + 60.0 * (times_us - 1000.0) * US + wave
    return found


def test_edges_are_taken_in_order_of_time_as_kalman_has_it() -> None:
    memory, whole, edges = a_memory(), Whole(), np.array((OWN_US, angles_at(OWN_US)))
    assert run(memory, edges) == DONE
    for time_us, angle in edges.T:
        whole.move(time_us)
        whole.edge(angle)
    assert_is(memory, whole)
    assert memory.nis.tolist() == pytest.approx([whole.squares, OWN_US.size], rel=1e-8)
    assert memory.log_variance[0] == pytest.approx(whole.logs)


def test_teeth_s_equations_hold_how_each_tooth_s_error_moves_each_innovation() -> None:
    """The sums of m m' / s and of -m times innovation / s, m being what an error adds to each
    innovation: the difference of two runs, one with that tooth's edges moved."""
    place = np.array([0, 1, 2, 0, 1, 2, 0, 1, 2])
    memory, teeth = a_memory(edge_s=0.0), TeethArrays(3)
    own = angles_at(OWN_US)
    assert run(memory, np.array((OWN_US, own, place)), teeth.flat) == DONE

    def innovations(moved: Vector) -> Vector:
        whole = Whole(edge_s=0.0)
        for time_us, angle in zip(OWN_US, moved, strict=True):
            whole.move(time_us)
            whole.edge(angle)
        return np.array(whole.innovations).T

    (off, variance), by = innovations(own), np.empty((3, OWN_US.size))
    for tooth in range(3):
        moved = own + np.where(place == tooth, 1e-3, 0.0)
        by[tooth] = (innovations(moved)[0] - off) / 1e-3
    upper = np.triu((by / variance) @ by.T)
    assert np.triu(teeth.normal) / upper.max() == pytest.approx(upper / upper.max(), abs=1e-8)
    right = -(by / variance) @ off
    assert teeth.right == pytest.approx(right, rel=1e-7, abs=1e-7 * np.abs(right).max())


def test_a_wheel_of_one_edge_has_its_equation_too() -> None:
    memory, teeth = a_memory(edge_s=0.0), TeethArrays(1)
    run(memory, np.array([[2000.0, 3000.0], [0.26, 0.32], [0.0, 0.0]]), teeth.flat)
    whole = Whole(edge_s=0.0)
    whole.move(2000.0)
    whole.edge(0.26)
    lever = whole.p[0, 0] / TOOTH_RAD**2
    f = expm(whole.a * 1e-3)
    gain = whole.p[:, 0] / TOOTH_RAD**2
    whole.move(3000.0)
    whole.edge(0.32)
    (first, second), by = whole.innovations, 1.0 - float(f[0] @ gain)
    assert lever < 1.0
    assert teeth.normal.item() == pytest.approx(1.0 / first[1] + by**2 / second[1])
    assert teeth.right.item() == pytest.approx(-first[0] / first[1] - by * second[0] / second[1])


def test_a_tooth_that_the_gate_refuses_teaches_nothing() -> None:
    memory, teeth = a_memory(), TeethArrays(2)
    run(memory, np.array([[2000.0], [9.0], [1.0]]), teeth.flat)
    assert memory.part("gated_in_a_row")[0] == 1
    assert not teeth.normal.any()


def test_the_third_edge_in_a_row_that_is_refused_makes_all_ten_times_as_uncertain() -> None:
    """And the angle by the innovation's square before that: then it is taken as any other."""
    for refused in (0, 1, 2):
        memory, whole = a_memory(), Whole()
        memory.part("gated_in_a_row")[0] = refused
        whole.move(2000.0)
        run(memory, np.array([[2000.0], [whole.z[0] + 0.5]]))
        if refused == 2:
            whole.p[0, 0] += 0.5**2
            whole.p *= 10.0
            whole.edge(float(whole.z[0]) + 0.5)
        assert_is(memory, whole)
        assert memory.part("gated_in_a_row")[0] == (0 if refused == 2 else refused + 1)
        assert memory.nis.tolist() == [0.0, 0.0]


def test_a_batch_of_before_the_state_is_refused_while_there_is_a_snapshot() -> None:
    """Nothing is taken then; without one its late edges are left out. At the state's own time an
    edge is not late, and has been seen."""
    refuses_what_was_before_its_state(a_memory, run, 0.44)


def test_the_states_before_the_newest_four_batches_can_be_gone_back_to() -> None:
    memory, kept = a_memory(), []
    for k in range(6):
        memory.part("restless")[0] = 1.0 + k
        kept.append(after(memory)[:4])
        run(memory, np.array([[2000.0 + 1000.0 * k], [0.26 + 0.06 * k]]))
        assert memory.held[0] == min(k + 1, 4)
    for k in (5, 4, 3, 2):
        memory.go_back()
        assert after(memory)[:4] == kept[k]
