"""The crossing-time filters of both shafts against a Kalman filter of whole matrices.

That one integrates the equations of motion with SciPy: the layshaft's, along the motion itself, by
a Runge-Kutta solver; the main shaft's, on a driveline that swings, by the matrix exponential."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from meshpoint.controller.estimate.crossing_filter import (
    LAYSHAFT_FILTER,
    MAIN_FILTER,
    NO_PRESSURES,
    CrossingFilter,
    FilterKind,
    Pressures,
)
from meshpoint.controller.estimate.teeth import TeethLearner
from meshpoint.controller.measure.wheel_edges import EdgeBatch
from meshpoint.controller.models.layshaft import MotionModel, first_order_law
from meshpoint.controller.models.swing import SwingMotion, SwingRates
from meshpoint.controller.settings.filters import CrossingFilterTuning
from meshpoint.kernels.records import RecordMemory, Vector

TUNING = replace(
    CrossingFilterTuning(),
    edge_time_s=4e-6, tooth_error_rad=3e-3, pressure_sd_pa=4e3, gate_sd=5.0,
)  # fmt: skip
TOOTH_RAD = TUNING.tooth_error_rad
A, G, FADING, LAW_PER_S, SUPPLY_PA = 0.8, 4e-4, 30.0, 12.0, 6e5
WHITE, WALK, RATES = 40.0, 300.0, SwingRates(110.0, 9.0, 500.0)
OFF = np.empty((2, 0))
SWITCHES = np.array([[3000.0, 8500.0], [1.0, 0.0]])
Moved = tuple[Vector, Vector]


def layshaft(z: Vector, p: Vector, seconds: float, on: bool) -> Moved:
    """Angle, speed, pressure, torque, brake gain, drag: linear about the motion itself."""

    def rate(_: float, flat: Vector) -> Vector:
        x, f = flat[:6], flat[6:].reshape(6, 6)
        a = np.zeros((6, 6))
        a[0, 1], a[2, 2], a[3, 3] = 1.0, -LAW_PER_S, -FADING
        a[1, 1:] = -A, -G * x[4], 1.0, -G * x[2], 1.0
        filled = LAW_PER_S * (SUPPLY_PA * on - x[2])
        moved = x[1], -A * x[1] - G * x[4] * x[2] + x[3] + x[5], filled, -FADING * x[3], 0.0, 0.0
        return np.concatenate((moved, (a @ f).ravel()))

    begin = np.concatenate((z, np.eye(6).ravel()))
    end = solve_ivp(rate, (0.0, seconds), begin, method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
    f = end[6:].reshape(6, 6)
    return end[:6], f @ p @ f.T


def swinging(z: Vector, p: Vector, seconds: float, on: bool) -> Moved:
    """Angle, speed, steady acceleration, angle and speed of the swing; noise by Van Loan."""
    a, q = np.zeros((5, 5)), np.zeros((5, 5))
    a[0, 1] = a[1, 2] = a[3, 4] = 1.0
    a[4, 3:] = -(RATES.natural_rad_s**2), -2.0 * RATES.decay_per_s
    a[1] += a[4]
    q[1, 1], q[2, 2] = WHITE, WALK
    kick = np.eye(5)[1] + np.eye(5)[4]  # what drives the swing drives the shaft
    q += RATES.noise_rad2_s3 * np.outer(kick, kick)
    parts = expm(np.block([[-a, q], [np.zeros((5, 5)), a.T]]) * seconds)
    f = parts[5:, 5:].T
    return f @ z, f @ p @ f.T + f @ parts[:5, 5:]


class Shaft(NamedTuple):
    kind: FilterKind
    model: RecordMemory
    start: Vector
    sds: Vector
    move: Callable[[Vector, Vector, float, bool], Moved]

    def spread(self) -> Vector:
        """A covariance in which each state goes with each."""
        n = self.start.size
        root = np.eye(n) + 0.25 * np.random.default_rng(5).standard_normal((n, n))
        whole = root @ root.T
        sd = np.sqrt(np.diag(whole))
        return np.asarray(whole / np.outer(sd, sd) * np.outer(self.sds, self.sds))

    def filter(self) -> CrossingFilter:
        """In its first state at 1 ms."""
        found = CrossingFilter(TUNING, self.kind)
        found.begin(1000.0, self.start, self.spread())
        return found


def a_law(brake: float) -> MotionModel:
    rates = np.array([A, brake, FADING])
    return MotionModel(rates, first_order_law(LAW_PER_S, SUPPLY_PA), np.zeros(4))


LAYSHAFT = Shaft(
    LAYSHAFT_FILTER, a_law(G), np.array([0.2, 120.0, 2e4, 6.0, 1.1, -4.0]),
    np.array([5e-3, 1.5, 1e4, 5.0, 0.06, 3.0]), layshaft,
)  # fmt: skip
MAIN = Shaft(
    MAIN_FILTER, SwingMotion(WHITE, WALK, RATES), np.array([0.2, 60.0, -4.0, 4e-3, 0.7]),
    np.array([5e-3, 1.5, 4.0, 3e-3, 0.8]), swinging,
)  # fmt: skip
both_shafts = pytest.mark.parametrize("shaft", [LAYSHAFT, MAIN], ids=["layshaft", "main"])


class Kalman:
    """The same, in whole matrices."""

    def __init__(self, shaft: Shaft) -> None:
        self.shaft, self.time_us, self.on = shaft, 1000.0, False
        self.z, self.p = shaft.start.copy(), shaft.spread()
        self.squares = self.logs = 0.0

    def move(self, to_us: float) -> None:
        self.z, self.p = self.shaft.move(self.z, self.p, (to_us - self.time_us) * 1e-6, self.on)
        self.time_us = to_us

    def measure(self, row: int, seen: float, variance: float) -> tuple[float, float]:
        off, s = seen - self.z[row], self.p[row, row] + variance
        gain = self.p[:, row] / s
        self.z, self.p = self.z + gain * off, self.p - np.outer(gain, gain) * s
        return float(off), float(s)

    def edge(self, angle: float) -> None:
        r = (self.z[1] * TUNING.edge_time_s) ** 2 + TOOTH_RAD**2
        off, s = self.measure(0, angle, r)
        self.squares, self.logs = self.squares + off**2 / s, self.logs + math.log(s)


def assert_same(found: CrossingFilter, expected: Kalman) -> None:
    sd = np.sqrt(np.diag(expected.p))
    both = np.outer(sd, sd)
    assert found.time_us == expected.time_us
    assert found.x / sd == pytest.approx(expected.z / sd, rel=1e-7, abs=1e-6)
    assert found.p / both == pytest.approx(expected.p / both, abs=1e-7)
    assert np.array_equal(found.p, found.p.T)


EDGES_US = np.array([2000.0, 2900.0, 4000.0, 5000.0, 6000.0, 7100.0, 8000.0, 9000.0, 9900.0])
PRESSURES_US = np.array([1200.0, 4000.0, 5500.0, 9000.0, 10_500.0])


def edges_of(shaft: Shaft) -> Vector:
    """About where the shaft is then, off by a pattern."""
    wave = np.where(np.arange(EDGES_US.size) % 2 == 0, 4e-3, -2.4e-3)
    return np.array((EDGES_US, shaft.start[0] + shaft.start[1] * 1e-6 * (EDGES_US - 1e3) + wave))


@both_shafts
def test_edges_pressures_and_switches_are_taken_in_order_of_time_as_kalman_has_it(
    shaft: Shaft,
) -> None:
    """A pressure at an edge's time finds nothing to move. The deviance is twice the negative
    logarithm of the likelihood."""
    found, kalman, edges = shaft.filter(), Kalman(shaft), edges_of(shaft)
    pascal, braked = 2e4 + 3e3 * np.cos(PRESSURES_US), shaft is LAYSHAFT
    pressures = Pressures(PRESSURES_US, pascal) if braked else NO_PRESSURES
    found.take(edges, TOOTH_RAD, pressures, SWITCHES if braked else OFF, shaft.model)
    events = [(t, 0, y) for t, y in edges.T.tolist()]
    if braked:
        seen = zip(PRESSURES_US, pascal, strict=True)
        events += [(t, 1, y) for t, y in seen if t not in EDGES_US]
        events += [(t, 2, u) for t, u in SWITCHES.T]
    for time_us, kind, value in sorted(events):
        kalman.move(time_us)
        if kind == 0:
            kalman.edge(value)
        elif kind == 1:
            kalman.measure(2, value, TUNING.pressure_sd_pa**2)
        else:
            kalman.on = bool(value)
    assert_same(found, kalman)
    assert found.nis.tolist() == pytest.approx([kalman.squares, EDGES_US.size], rel=1e-6)
    assert found.deviance(EDGES_US.size) == pytest.approx(kalman.squares + kalman.logs, rel=1e-6)


@both_shafts
@pytest.mark.parametrize(("share", "taken"), [(0.999, True), (-0.999, True), (1.001, False)])
def test_an_edge_within_the_gate_is_taken_and_one_beyond_it_changes_nothing(
    shaft: Shaft, share: float, taken: bool
) -> None:
    """Where more than a tenth of the edges are such, the model does not fit."""
    found, kalman = shaft.filter(), Kalman(shaft)
    kalman.move(2000.0)
    r = (kalman.z[1] * TUNING.edge_time_s) ** 2 + TOOTH_RAD**2
    angle = kalman.z[0] + share * TUNING.gate_sd * math.sqrt(kalman.p[0, 0] + r)
    found.take(np.array([[2000.0], [angle]]), TOOTH_RAD, NO_PRESSURES, OFF, shaft.model)
    if taken:
        kalman.edge(angle)
    assert_same(found, kalman)
    assert found.nis[1] == taken
    assert math.isinf(found.deviance(1)) is not taken


@both_shafts
@pytest.mark.parametrize("fewer", [0, 1])
def test_a_shaft_that_edges_deny_again_and_again_is_taken_to_be_where_they_say(
    shaft: Shaft, fewer: int
) -> None:
    """The layshaft at the eighth in a row, the main shaft, which the driveline throws, at the
    third."""
    found, in_a_row = shaft.filter(), 8 if shaft is LAYSHAFT else 3
    times = 2000.0 + 100.0 * np.arange(in_a_row - fewer)
    angles = shaft.start[0] + 0.5 + shaft.start[1] * 1e-6 * (times - 1000.0)
    found.take(np.array((times, angles)), TOOTH_RAD, NO_PRESSURES, OFF, shaft.model)
    off = abs(found.x[0] - angles[-1])
    assert (off < 0.02) is not fewer
    assert found.nis.tolist() == [0.0, 0.0], "it says nothing of how well the filter fits"


@both_shafts
def test_an_edge_that_comes_a_batch_late_ends_in_the_state_of_one_that_does_not(
    shaft: Shaft,
) -> None:
    edges, found = edges_of(shaft), []
    for batches in (
        ([0, 1, 2, 3], [4, 5, 6]),
        ([0, 1, 3], [2, 4, 5, 6]),
        ([0, 1, 2, 3, 4, 5, 6],),
        ([0], [2, 3], [4], [1, 5, 6]),
    ):
        each = shaft.filter()
        for numbers in batches:
            each.take(edges[:, numbers].copy(), TOOTH_RAD, NO_PRESSURES, OFF, shaft.model)
        found.append(np.concatenate((each.x, each.p.ravel())))
    assert found[1] == pytest.approx(found[0], rel=1e-9)
    assert found[2] == pytest.approx(found[0], rel=1e-9)
    assert found[3] == pytest.approx(found[0], rel=1e-9), "or three late"


def test_noise_that_heeds_the_innovations_grows_with_them() -> None:
    """Edges off by four deviations each."""
    plain, heeding = MAIN.filter(), MAIN.filter()
    heeding.noise_adaptation(0.1)
    edges = edges_of(MAIN) + np.array([[0.0], [0.012]]) * (-1.0) ** np.arange(EDGES_US.size)
    for each in (plain, heeding):
        each.take(edges, TOOTH_RAD, NO_PRESSURES, OFF, MAIN.model)
    assert heeding.p[1, 1] > 2.0 * plain.p[1, 1]


FREE = {
    "layshaft": a_law(0.0),
    "main": SwingMotion(0.0, 0.0, RATES._replace(noise_rad2_s3=0.0)),
}


@both_shafts
def test_a_window_s_equations_for_its_teeth_are_those_of_the_normal_law_of_its_edges(
    shaft: Shaft,
) -> None:
    """Normal matrix S' C^-1 S and right side -S' C^-1 y, S telling whose tooth's error is in which
    edge; squares y' C^-1 y; and the logarithm of C's determinant. C says how edges go together by
    what is not known of the shaft; nothing drives it, and no brake bends its motion."""
    model = FREE["layshaft" if shaft is LAYSHAFT else "main"]
    n, p0 = shaft.start.size, 1e-2 * shaft.spread()
    learner, place = TeethLearner(TUNING, 3, shaft.kind), np.array([0, 1, 2, 0, 1, 2, 0, 1, 2])
    waits = 1e-6 * (EDGES_US - 1000.0)

    def by(wait: float) -> Vector:
        a = np.zeros((n, n))
        a[0, 1] = 1.0
        if shaft is LAYSHAFT:
            a[1, [1, 3, 5]], a[2, 2], a[3, 3] = (-A, 1.0, 1.0), -LAW_PER_S, -FADING
        else:
            a[1, 2] = a[3, 4] = 1.0
            a[4, 3:] = -(RATES.natural_rad_s**2), -2.0 * RATES.decay_per_s
            a[1] += a[4]
        return np.asarray(expm(a * wait)[:2])

    rows, speeds = np.array([by(wait) for wait in waits]).transpose(1, 0, 2)
    y = 1e-7 * np.cos(np.arange(9.0))
    seen = np.array((EDGES_US, rows @ shaft.start + y))
    learner.begin(1000.0, shaft.start, p0)
    for part in (slice(0, 4), slice(4, 9)):  # in parts as at once
        batch = EdgeBatch(seen[0, part], seen[1, part], place[part], 0 * place[part])
        learner.take(batch, place[part], NO_PRESSURES, OFF, model)
    c = rows @ p0 @ rows.T + np.diag(speeds @ shaft.start * TUNING.edge_time_s) ** 2
    inverse, whose = np.linalg.inv(c), np.eye(3)[place]
    found, normal = learner.so_far(), whose.T @ inverse @ whose
    assert found.normal / normal.max() == pytest.approx(normal / normal.max(), abs=1e-5)
    right = -whose.T @ inverse @ y
    assert found.right / np.abs(right).max() == pytest.approx(right / np.abs(right).max(), abs=1e-4)
    assert found.squares == pytest.approx(y @ inverse @ y, rel=1e-3)
    assert found.edges == learner.edges == 9.0
    assert learner.log_variance == pytest.approx(np.linalg.slogdet(c)[1], abs=0.01)
