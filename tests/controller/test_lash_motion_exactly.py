"""The driveline's step in its parts: linear on a flank, a polynomial between them, by the law of
Hunt and Crossley where it is met."""

from __future__ import annotations

import numpy as np
import pytest

from meshpoint.controller.motion.lash_motion import (
    ANGLE,
    DRAG,
    HALF,
    HILL,
    LONGEST_S,
    LOSS,
    MOST_LOSS,
    ROWS,
    SPEED,
    STIFF,
    TYRE,
    TYRE_STIFF,
    VEHICLE,
    WAY,
    WHEELS,
    LashModel,
    move,
    move_often,
)
from meshpoint.controller.records import Vector

MODEL = LashModel(wheels_share=0.25, tyre_per_s=4.0, fading_per_s=17.0)
MOVING = (ANGLE, SPEED, WAY, WHEELS, TYRE, VEHICLE)


def a_driveline(way: float, loss: float = 0.0) -> Vector:
    """One driveline, (ROWS, 1), this far from the flank to which drag takes it; the gap is 0.1."""
    x = np.zeros((ROWS, 1))
    x[ANGLE], x[SPEED], x[WHEELS], x[VEHICLE], x[TYRE] = 0.7, 63.0, 60.0, 58.0, 0.003
    x[WAY], x[HALF], x[STIFF], x[LOSS] = way, 0.05, 4800.0, loss
    x[DRAG], x[HILL], x[TYRE_STIFF] = 6.0, -1.5, 5500.0
    return x


def linear(x: Vector, model: LashModel) -> tuple[Vector, Vector]:
    """x' = A x + c of what moves, as the module's head has it, where a flank's push is linear."""
    (m, d_t, r), k, c_t = model, x[STIFF, 0], x[TYRE_STIFF, 0]
    way, gap = x[WAY, 0], 2.0 * x[HALF, 0]
    touched = 1.0 if way < 0.0 or way > gap else 0.0
    from_ = gap if way > gap else 0.0
    a, c = np.zeros((6, 6)), np.zeros(6)
    theta, w, z, w_a, y, w_v = range(6)
    a[theta, w] = a[z, w] = 1.0
    a[z, w_a] = -1.0
    a[w, z], c[w] = -k * touched, k * touched * from_ - x[DRAG, 0]
    # The tyre's carcass pushes by d_t y', and by that takes up some of the slip.
    slack = 1.0 + r * d_t / c_t
    a[y, [w_a, w_v, y]] = 1.0 / slack, -1.0 / slack, -r / slack
    a[w_a] = -d_t * a[y]
    a[w_a, y] -= c_t
    a[w_a, z] += m * k * touched
    c[w_a] = -m * k * touched * from_
    c[w_v] = x[HILL, 0]
    return a, c


@pytest.mark.parametrize("way", [-0.004, 0.05, 0.106])
@pytest.mark.parametrize("seconds", [2e-5, 8e-4, 1.3e-3])
def test_a_step_without_loss_is_the_exponential_to_its_second_order(
    way: float, seconds: float
) -> None:
    """The midpoint rule of a linear system: 1 + A t + (A t)^2 / 2, and t + A t^2 / 2 of what is
    steady. On either flank and between; what does not move stays."""
    x = a_driveline(way)
    a, c = linear(x, MODEL)
    start = x[list(MOVING), 0]
    at = a * seconds
    series = np.eye(6) + at + at @ at / 2.0
    expected = series @ start + seconds * (np.eye(6) + at / 2.0) @ c
    before = x.copy()
    move(x, seconds, MODEL)
    assert x[list(MOVING), 0] == pytest.approx(expected, rel=1e-11)
    still = [row for row in range(ROWS) if row not in MOVING]
    assert np.array_equal(x[still], before[still])


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize("slip", [-30.0, -3.0, 0.0, 3.0, 30.0])
@pytest.mark.parametrize("loss", [0.2, 0.4])
def test_a_flank_pushes_harder_the_faster_it_is_met_and_never_pulls(
    side: float, slip: float, loss: float
) -> None:
    """k b (1 + c b'), the factor from 0 to 10: Hunt and Crossley's law, over a microsecond."""
    beyond = 0.004
    x = a_driveline(-beyond if side < 0.0 else 0.1 + beyond, loss)
    x[SPEED] = x[WHEELS] + slip
    before = x.copy()
    move(x, 1e-7, MODEL)
    factor = min(max(1.0 + loss * side * slip, 0.0), 10.0)
    push = side * 4800.0 * beyond * factor
    assert (x[SPEED, 0] - before[SPEED, 0]) / 1e-7 == pytest.approx(-6.0 - push, rel=2e-3)
    assert MOST_LOSS == 10.0


def test_a_long_time_is_cut_into_equal_steps_of_1_3_ms_at_most() -> None:
    """To the bit as if the parts were asked for; no time at all moves nothing."""
    assert (LONGEST_S, ROWS) == (1.3e-3, 12)
    for seconds, parts in ((1.3e-3, 1), (1.4e-3, 2), (2.6e-3, 2), (2.7e-3, 3), (1e-4, 1)):
        whole, cut = a_driveline(0.106, 0.1), a_driveline(0.106, 0.1)
        move(whole, seconds, MODEL)
        for _ in range(parts):
            move(cut, seconds / parts, MODEL)
        assert np.array_equal(whole, cut), seconds
    x = a_driveline(0.106, 0.1)
    move(x, 0.0, MODEL)
    assert np.array_equal(x, a_driveline(0.106, 0.1))


def test_angles_and_speeds_are_noted_before_each_time() -> None:
    """Of each driveline by itself, on flanks or between them."""
    ways = (-0.004, 0.05, 0.106)
    x = np.concatenate([a_driveline(way, 0.1) for way in ways], axis=1)
    x[TYRE_STIFF] = 5000.0, 5500.0, 6000.0
    found, alone = np.empty((2, 3, 3)), x.copy()
    move_often(x, 2.5e-3, MODEL, found)
    for k in range(3):
        assert np.array_equal(found[0, k], alone[ANGLE])
        assert np.array_equal(found[1, k], alone[SPEED])
        for i in range(3):
            one = alone[:, i : i + 1].copy()
            move(one, 2.5e-3, MODEL)
            alone[:, i] = one[:, 0]
    assert np.array_equal(x, alone)
