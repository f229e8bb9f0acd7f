"""A main shaft that swings, in its parts: against the matrix exponential, and by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.linalg import expm

from meshpoint.controller.motion.lash_course import LashCourse
from meshpoint.controller.motion.swing import (
    OUTLOOK_US,
    ModeRates,
    ShaftState,
    Swing,
    SwingMotion,
    between_ticks,
    ticks_over,
)
from meshpoint.controller.motion.swing_kernels import (
    SWING_MODEL,
    SWING_MODEL_WORDS,
    SWING_STATE,
    SWING_STATES,
    SWING_STEP,
    swing_ahead,
    swing_course,
    swing_outlook,
)
from meshpoint.controller.records import Vector

NEAR, FAR = (110.0, 9.0), (26.0, 3.5)
"""Natural frequency and decay of the two modes."""
X = np.array([0.3, 52.0, -4.0, 0.008, 2.5, -0.01, 1.2])
STEPS_S = [1e-3, 0.013, 0.08]


def motion(
    white: float = 0.0, walk: float = 0.0, near: float = 0.0, far: float = 0.0
) -> SwingMotion:
    """A model with these densities of its noises."""
    return SwingMotion(white, walk, [ModeRates(*NEAR, near), ModeRates(*FAR, far)])


def flow() -> Vector:
    """x' = A x of the seven states, as the module's head has it."""
    a = np.zeros((7, 7))
    a[0, 1] = a[1, 2] = 1.0
    for i, (natural, decay) in ((3, NEAR), (5, FAR)):
        a[i, i + 1] = 1.0
        for row in (i + 1, 1):
            a[row, i : i + 2] = -(natural**2), -2.0 * decay
    return a


def noise_after(drive: Vector, seconds: float) -> Vector:
    """Van Loan's integral."""
    a = flow()
    whole = expm(np.block([[-a, drive], [np.zeros((7, 7)), a.T]]) * seconds)
    return np.asarray(whole[7:, 7:].T @ whole[:7, 7:])


def test_records_are_as_long_as_what_they_hold() -> None:
    """Seven states; two noises and three numbers a mode; two rows, blocks, noises and the work."""
    assert SWING_STATES == 7
    assert SWING_STATE.itemsize == 8 * 7
    assert SWING_MODEL.itemsize == 8 * (2 + 2 * 3)
    assert SWING_MODEL_WORDS == 8
    assert SWING_STEP.itemsize == 8 * (7 + 7 + 2 * 4 + 2 * 3 + 49)


@pytest.mark.parametrize("seconds", [-5e-3, 0.0, *STEPS_S])
def test_state_goes_on_and_back_by_the_matrix_exponential(seconds: float) -> None:
    f = expm(flow() * seconds)
    for k in range(7):
        unit = np.eye(7)[k]
        x, _ = Swing(unit, np.zeros((7, 7)), motion()).spread_ahead(seconds)
        assert x == pytest.approx(f[:, k], rel=1e-10, abs=1e-10)
    swing = Swing(X, np.zeros((7, 7)), motion())
    expected = f @ X
    assert swing.spread_ahead(seconds)[0] == pytest.approx(expected, rel=1e-10)
    assert swing.ahead(seconds) == pytest.approx(tuple(expected[:2]), rel=1e-12)


@pytest.mark.parametrize("seconds", [0.0, *STEPS_S])
def test_what_is_not_known_goes_on_with_the_shaft(seconds: float) -> None:
    """One state after the other unknown, then all; the lower half of the covariance is made of the
    upper one."""
    f = expm(flow() * seconds)
    root = np.random.default_rng(2).normal(size=(7, 7))
    for root_ in (*(np.diag(row) for row in np.eye(7)), root):
        p = root_ @ root_.T
        expected = f @ p @ f.T
        upper = np.where(np.tri(7, k=-1) > 0.0, np.nan, p)
        swing_ahead(X.copy(), upper, seconds, motion().flat)
        assert upper == pytest.approx(expected, rel=1e-8, abs=1e-9 * np.abs(expected).max())
        assert np.array_equal(upper, upper.T)


@pytest.mark.parametrize("seconds", STEPS_S)
@pytest.mark.parametrize("which", ["white", "walk", "near", "far"])
def test_each_noise_alone_spreads_it_by_van_loan_s_integral(which: str, seconds: float) -> None:
    """A mode's noise drives its own speed, and by it the shaft's."""
    drive = np.zeros((7, 7))
    driven = {"white": [1], "walk": [2], "near": [1, 4], "far": [1, 6]}[which]
    drive[np.ix_(driven, driven)] = 3.0
    expected = noise_after(drive, seconds)
    model = SwingMotion(
        3.0 * (which == "white"),
        3.0 * (which == "walk"),
        [ModeRates(*NEAR, 3.0 * (which == "near")), ModeRates(*FAR, 3.0 * (which == "far"))],
    )
    x, found = Swing(X, np.zeros((7, 7)), model).spread_ahead(seconds)
    sds = np.sqrt(np.maximum(np.diag(expected), 1e-14))
    scale = np.outer(sds, sds)
    assert found / scale == pytest.approx(expected / scale, abs=2e-6)
    assert x == pytest.approx(expm(flow() * seconds) @ X, rel=1e-10)


def test_a_step_back_is_no_surer_and_no_less_sure() -> None:
    root = np.random.default_rng(2).normal(size=(7, 7))
    p = root @ root.T
    assert np.array_equal(Swing(X, p, motion(1.0, 1.0, 1.0)).spread_ahead(-1e-3)[1], p)


def test_a_course_has_its_first_time_after_the_wait_and_the_others_at_equal_steps() -> None:
    found = np.empty((2, 5))
    Swing(X, np.zeros((7, 7)), motion()).course(0.011, 0.004, found)
    for k in range(5):
        expected = expm(flow() * (0.011 + 0.004 * k)) @ X
        assert found[:, k] == pytest.approx(expected[:2], rel=1e-10)
    alone = np.empty((2, 1))
    swing_course(X, motion().flat, 0.02, 0.5, alone)
    assert alone[:, 0] == pytest.approx((expm(flow() * 0.02) @ X)[:2], rel=1e-10)


def test_what_will_be_known_is_what_edges_have_told_tick_by_tick() -> None:
    """Each tick's edges have the variance of one edge's over how many come in it. By hand where
    the angle alone is unknown; else P - P h h' P / (h P h + r), a horizon ahead."""
    found, p = np.empty(4), np.zeros((7, 7))
    p[0, 0] = 4e-6
    swing_outlook(X, p, motion().flat, np.array([0.05, 0.01, 1e-8]), found)
    assert found == pytest.approx([1.0 / (1.0 / 4e-6 + k / 1e-6) for k in range(4)])
    root = np.random.default_rng(3).normal(size=(7, 7)) * 1e-3
    whole = root @ root.T
    drive = np.zeros((7, 7))
    drive[1, 1], drive[2, 2] = 0.2, 0.7
    q = [noise_after(drive, seconds) for seconds in (0.05, 0.01)]
    f = [expm(flow() * seconds) for seconds in (0.05, 0.01)]
    expected, now = [], whole
    for _ in range(4):
        expected.append((f[0] @ now @ f[0].T + q[0])[0, 0])
        now = f[1] @ now @ f[1].T + q[1]
        now = now - np.outer(now[:, 0], now[0]) / (now[0, 0] + 1e-6)
    before = whole.copy()
    outlook = Swing(X, whole, motion(0.2, 0.7), 1e-8).outlook(0.05, 0.01, 4)
    assert outlook == pytest.approx(expected, rel=1e-6)
    assert np.array_equal(whole, before), "the swing itself stays where it is"


def test_a_swing_s_own_speed_is_that_of_both_modes_and_its_edges_are_sure_to_a_milliradian() -> (
    None
):
    swing = Swing(X, np.zeros((7, 7)), motion())
    assert swing.speed_rad_s == pytest.approx(2.5 + 1.2)
    assert swing.edge_rad2_s == 1e-6


def test_an_angle_s_deviation_ahead_is_the_root_of_its_variance_or_none() -> None:
    p = np.zeros((7, 7))
    p[0, 0], p[1, 1] = 9e-6, 4e-4
    swing = Swing(X, p, motion())
    assert swing.theta_sd_ahead(0.1) == pytest.approx(math.sqrt(9e-6 + 0.01 * 4e-4))
    x_before, p_before = X.copy(), p.copy()
    swing.spread_ahead(0.1)
    assert np.array_equal(swing.x, x_before)
    assert np.array_equal(swing.p, p_before)
    assert Swing(X, np.zeros((7, 7)), motion()).theta_sd_ahead(0.0) == 0.0
    p[0, 0] = -1e-20
    assert Swing(X, p, motion()).theta_sd_ahead(0.0) == 0.0


def test_a_model_of_a_swing_is_written_down_in_the_order_of_its_record() -> None:
    model = motion(0.1, 0.2, 0.3, 0.4)
    assert model.flat.tolist() == [0.1, 0.2, *NEAR, 0.3, *FAR, 0.4]


@pytest.mark.parametrize(
    ("step_us", "count", "ticks"),
    [(2500.0, 4, 2), (2500.0, 5, 3), (2500.0, 8, 3), (2500.0, 9, 4), (2500.0, 1, 2),
     (2500.0, 0, 2), (12_000.0, 1, 3), (12_000.0, 2, 3), (12_000.0, 3, 4)],
)  # fmt: skip
def test_ticks_reach_beyond_the_last_step_of_time(step_us: float, count: int, ticks: int) -> None:
    """Of 10 ms each, the first one now; one step at least."""
    assert OUTLOOK_US == 10_000.0
    assert ticks_over(step_us, count) == ticks


def test_between_ticks_what_will_be_known_goes_straight_and_behind_the_last_it_stays() -> None:
    found = between_ticks(np.array([5.0, 3.0, 2.0]), 4_000.0, 8)
    assert found == pytest.approx([5.0, 4.2, 3.4, 2.8, 2.4, 2.0, 2.0, 2.0])


BARE = ShaftState(2e6, 1.0, 60.0, 3e-3, 0.04, -5.0)
P = np.diag([9e-6, 1e-3, 0.01, 1e-6, 0.01, 1e-6, 0.01])
SWINGING = BARE._replace(swing=Swing(X, P, motion(0.3, 2.0), 2e-8))


def test_a_shaft_that_does_not_swing_keeps_its_acceleration() -> None:
    """After 0.2 s: 60 - 1, and 1 + 12 - 0.1; what is not known of the speed adds to the angle."""
    at = 2.2e6
    assert BARE.theta_at(at) == pytest.approx(12.9)
    assert BARE.omega_at(at) == pytest.approx(59.0)
    assert BARE.steady_omega_at(at) == pytest.approx(59.0)
    assert BARE.theta_sd_at(at) == pytest.approx(math.hypot(3e-3, 8e-3))
    assert BARE.theta_at(1.8e6) == pytest.approx(1.0 - 12.0 - 0.1)
    assert not BARE.is_by_cloud
    assert ShaftState(0.0, 1.0, 60.0, 0.1, 0.2)[5:] == (0.0, None)
    course = BARE.course(2.1e6, 50e3, 3)
    assert course[0] == pytest.approx([1.0 + 60.0 * t - 2.5 * t * t for t in (0.1, 0.15, 0.2)])
    assert course[1] == pytest.approx([59.5, 59.25, 59.0])
    assert BARE.variances(2.1e6, 2e3, 3) == pytest.approx([9e-6 + 0.01 * 0.0016] * 3)


def test_a_shaft_that_swings_goes_on_as_its_swing_does() -> None:
    """Counted from the state's own time; the vehicle's speed is that without the swing."""
    seconds = 0.03
    at = 2e6 + 1e6 * seconds
    f = expm(flow() * seconds)
    expected = f @ X
    assert SWINGING.theta_at(at) == pytest.approx(expected[0])
    assert SWINGING.omega_at(at) == pytest.approx(expected[1])
    assert SWINGING.steady_omega_at(at) == pytest.approx(60.0 - 5.0 * seconds - 3.7)
    drive = np.diag([0.0, 0.3, 2.0, 0.0, 0.0, 0.0, 0.0])
    variance = (f @ P @ f.T + noise_after(drive, seconds))[0, 0]
    assert SWINGING.theta_sd_at(at) == pytest.approx(math.sqrt(variance))
    course = SWINGING.course(at, 7e3, 4)
    for k in range(4):
        assert course[:, k] == pytest.approx((expm(flow() * (seconds + 7e-3 * k)) @ X)[:2])
    assert not SWINGING.is_by_cloud


def test_variances_of_a_shaft_that_swings_are_predicted_over_the_wait_at_ticks_of_10_ms() -> None:
    swing = SWINGING.swing
    assert isinstance(swing, Swing)
    for first_us, horizon_s in ((2.03e6, 0.03), (2e6, 0.0), (1.9e6, 0.0)):
        at_ticks = swing.outlook(horizon_s, 0.01, 4)
        found = SWINGING.variances(first_us, 5e3, 6)
        middles = [0.5 * (at_ticks[k] + at_ticks[k + 1]) for k in range(3)]
        expected = [at_ticks[0], middles[0], at_ticks[1], middles[1], at_ticks[2], middles[2]]
        assert found == pytest.approx(expected)


def test_a_shaft_is_told_by_a_cloud_where_a_course_of_one_is_its_swing() -> None:
    assert BARE._replace(swing=LashCourse.__new__(LashCourse)).is_by_cloud
