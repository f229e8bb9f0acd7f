"""The offset between two wheels as a seventh state, against a Kalman filter of whole matrices."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from meshpoint.controller.estimation.fusion_kernels import (
    MOST_IN_A_ROW,
    carry_offset,
    follow_offset,
    take_geared,
)
from meshpoint.controller.motion.kernels import DISTURBANCE, PRESSURE, STATES
from meshpoint.controller.records import Vector

OFFSET = STATES
TOOTH_RAD, EDGE_S, OMEGA_RAD_S = 4e-3, 2e-5, 150.0
R = TOOTH_RAD**2 + (OMEGA_RAD_S * EDGE_S) ** 2
SEEN: Vector = np.eye(STATES + 1)[0] + np.eye(STATES + 1)[OFFSET]
"""An edge of the geared wheel is the shaft's angle and the offset."""


def plain(kernel: Any) -> Any:
    """The piece as it is written, whether or not it is compiled elsewhere."""
    return getattr(kernel, "py_func", kernel)


def a_filter(seed: int = 1) -> tuple[Any, Vector, Vector]:
    """A filter's record; and the same as one state and one covariance."""
    rng = np.random.default_rng(seed)
    root = 0.01 * rng.standard_normal((STATES + 1, STATES + 1))
    whole = root @ root.T + 1e-5 * np.eye(STATES + 1)
    z = np.array([3.0, OMEGA_RAD_S, 2.0, -1.0, 1.0, -3.0, 0.4])
    x = z[:STATES].copy()
    f = SimpleNamespace(
        x=x, p=np.triu(whole[:STATES, :STATES]), offset_rad=z[OFFSET],
        offset_rad2=whole[OFFSET, OFFSET], offset_by=whole[OFFSET, :STATES].copy(),
        gain=np.zeros(STATES), squares=5.0, count=2.0, astray_in_a_row=0, gate_sd=4.0,
        edge_time_s=EDGE_S, geared_tooth_rad=TOOTH_RAD, loose_rad2_s=0.3, at_flank_rad2_s=0.02,
        state=SimpleNamespace(theta_rad=x[0], omega_rad_s=x[1]),
    )  # fmt: skip
    return f, z, whole


def assert_is(f: Any, z: Vector, whole: Vector) -> None:
    """The record holds this state and this covariance."""
    assert np.append(f.x, f.offset_rad) == pytest.approx(z)
    assert f.offset_rad2 == pytest.approx(whole[OFFSET, OFFSET])
    assert f.offset_by == pytest.approx(whole[OFFSET, :STATES])
    assert np.triu(f.p) == pytest.approx(np.triu(whole[:STATES, :STATES]))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_an_edge_of_the_geared_wheel_measures_angle_and_offset_together(seed: int) -> None:
    f, z, whole = a_filter(seed)
    f.astray_in_a_row = 3
    angle_rad = z[0] + z[OFFSET] + 0.01
    s = SEEN @ whole @ SEEN + R
    gain = whole @ SEEN / s
    plain(take_geared)(f, angle_rad, STATES)
    assert_is(f, z + gain * 0.01, whole - np.outer(gain, gain) * s)
    assert f.squares == pytest.approx(5.0 + 0.01**2 / s)
    assert (f.count, f.astray_in_a_row) == (3.0, 0)


@pytest.mark.parametrize("i", [0, PRESSURE])
def test_what_is_measured_of_the_shaft_tells_the_offset_by_what_they_share(i: int) -> None:
    f, z, whole = a_filter()
    s, innovation = whole[i, i] + 1e-4, 0.02
    gain = whole[:, i] / s
    f.gain[:] = gain[:STATES]
    plain(follow_offset)(f, i, innovation, s, STATES)
    after = whole - np.outer(gain, gain) * s
    assert f.offset_rad == pytest.approx(z[OFFSET] + gain[OFFSET] * innovation)
    assert f.offset_rad2 == pytest.approx(after[OFFSET, OFFSET])
    assert f.offset_by == pytest.approx(after[OFFSET, :STATES])


@pytest.mark.parametrize("loose", [False, True])
def test_the_offset_walks_and_goes_with_the_shaft_as_that_moves(loose: bool) -> None:
    """Faster while the mesh may change its flank. F has the step's derivatives of angle and speed;
    pressure and disturbance fade, gain and drag stay."""
    f, _, whole = a_filter()
    theta_by, omega_by = np.linspace(0.3, 0.8, STATES), np.linspace(-0.4, 0.9, STATES)
    theta_by[0] = omega_by[0] = 7.0
    f.step = SimpleNamespace(
        theta_by=theta_by, omega_by=omega_by, pressure_left=0.7, disturbance_left=0.9
    )
    transition = np.eye(STATES)
    transition[0, 1:], transition[1, 1:] = theta_by[1:], omega_by[1:]
    transition[PRESSURE, PRESSURE], transition[DISTURBANCE, DISTURBANCE] = 0.7, 0.9
    plain(carry_offset)(f, 0.004, loose)
    assert f.offset_by == pytest.approx(transition @ whole[OFFSET, :STATES])
    grown = 0.004 * (0.3 if loose else 0.02)
    assert f.offset_rad2 == pytest.approx(whole[OFFSET, OFFSET] + grown)


def test_the_first_edge_gives_an_offset_that_is_not_known() -> None:
    """It is the limit of a filter that knew nothing of it: the sum is as sure as the edge, and the
    offset is off where the shaft's angle is, the other way."""
    f, z, whole = a_filter()
    f.offset_rad2 = 0.0
    x, p = f.x.copy(), f.p.copy()
    plain(take_geared)(f, z[0] + 0.7, STATES)
    assert f.offset_rad == pytest.approx(0.7)
    assert f.offset_rad2 == pytest.approx(whole[0, 0] + R)
    assert f.offset_by == pytest.approx(-whole[0, :STATES])
    assert f.x.tolist() == x.tolist()
    assert f.p.tolist() == p.tolist()
    assert (f.count, f.squares) == (2.0, 5.0)


@pytest.mark.parametrize(("share", "taken"), [(0.999, True), (1.001, False)])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_an_edge_beyond_the_gate_is_refused(share: float, taken: bool, side: float) -> None:
    f, z, whole = a_filter()
    s = SEEN @ whole @ SEEN + R
    before = f.x.copy()
    off = side * share * f.gate_sd * math.sqrt(s)
    plain(take_geared)(f, z[0] + z[OFFSET] + off, STATES)
    assert (f.x.tolist() != before.tolist()) is taken
    assert f.count == (3.0 if taken else 2.0)
    assert f.astray_in_a_row == (0 if taken else 1)


def test_an_offset_that_eight_edges_in_a_row_deny_is_not_known_any_more() -> None:
    f, z, _ = a_filter()
    for k in range(1, MOST_IN_A_ROW):
        plain(take_geared)(f, z[0] + z[OFFSET] + 1.0, STATES)
        assert f.astray_in_a_row == k
        assert f.offset_rad2 > 0.0
    plain(take_geared)(f, z[0] + z[OFFSET] + 1.0, STATES)
    assert (f.offset_rad2, f.astray_in_a_row, MOST_IN_A_ROW) == (0.0, 0, 8)
