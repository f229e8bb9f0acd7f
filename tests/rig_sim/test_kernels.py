"""The solved instants: edges, flanks and stops, against a plain search of the same motion."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq

from meshpoint.kernels.structures import RecordArray
from meshpoint.rig_sim.shared.angle_kernels import geared, settled, wrapped
from meshpoint.rig_sim.thesis.closed_form import (
    ACCELERATED,
    FREE,
    Motion,
    motion_at,
    phase_at,
    time_of_exit,
    time_of_stop,
    time_to_turn,
)
from meshpoint.units import RPM

HORIZON_S = 0.010
BOTTOM, TOP = -0.02, 0.03


def braked(omega: float, drag: float, p_end: float, p_now: float) -> Motion:
    motion = Motion(FREE, omega, 0.0, drag, 1.0 / 0.06, 3.5e-4, p_end, p_now - p_end)
    return RecordArray(motion).array[0]


def steady(omega: float, accel: float = 0.0) -> Motion:
    return RecordArray(Motion(ACCELERATED, omega, accel)).array[0]


layshafts = st.builds(
    braked,
    st.floats(60.0, 160.0),
    st.sampled_from([0.0, 0.28, 16.0]),
    st.sampled_from([0.0, 8e5]),
    st.floats(0.0, 8e5),
)


@settings(deadline=None)
@given(layshafts, st.floats(-6.0, 6.0), st.floats(BOTTOM, TOP))
def test_the_tooth_leaves_where_a_plain_search_finds_it(
    layshaft: Motion, slip: float, phase: float
) -> None:
    main_rad_s = 0.775 * motion_at(layshaft, 0.0)[1] - slip
    main = steady(main_rad_s)

    def at(s: float) -> float:
        return phase_at(layshaft, main, 0.775, phase, s)

    s, side = time_of_exit(layshaft, main, 0.775, phase, (BOTTOM, TOP), HORIZON_S)
    grid = np.linspace(0.0, HORIZON_S, 501)
    outside = [t for t in grid if not BOTTOM <= at(t) <= TOP]
    if side == 0:
        # what only touches a limit between two points of the grid may go either way
        assert not outside or min(abs(at(outside[0]) - BOTTOM), abs(at(outside[0]) - TOP)) < 1e-9
        return
    assert 0.0 <= s <= HORIZON_S
    level = TOP if side > 0 else BOTTOM
    assert at(s) == pytest.approx(level, abs=1e-12)
    if outside and outside[0] > 0.0:
        before = outside[0] - HORIZON_S / 500
        if (at(before) - level) * (at(outside[0]) - level) < 0.0:
            exact = brentq(lambda t: at(t) - level, before, outside[0], xtol=1e-14)
            speed = abs(0.775 * motion_at(layshaft, exact)[1] - main_rad_s)
            assert s == pytest.approx(exact, abs=1e-9 + 1e-15 / max(speed, 1e-9))
        assert all(BOTTOM - 1e-12 <= at(t) <= TOP + 1e-12 for t in grid if t < s)


@settings(deadline=None)
@given(layshafts, st.floats(0.0, 0.5), st.floats(0.0, HORIZON_S))
def test_a_turned_angle_gives_back_its_time(layshaft: Motion, angle: float, guess: float) -> None:
    s = time_to_turn(layshaft, angle, 0.0, HORIZON_S, guess)
    assert motion_at(layshaft, s)[0] == pytest.approx(angle, abs=1e-12)


@settings(deadline=None)
@given(st.floats(0.1, 100.0), st.floats(-20.0, 2000.0), st.floats(0.0, 0.5))
def test_so_it_does_under_constant_acceleration(omega: float, accel: float, angle: float) -> None:
    motion = steady(omega, accel)
    if omega * omega + 2.0 * accel * angle <= 0.0:
        return  # it turns round before
    s = time_to_turn(motion, angle, 0.0, 1e3, 0.0)
    assert motion_at(motion, s)[0] == pytest.approx(angle, abs=1e-12)


@settings(deadline=None)
@given(st.floats(1e-3, 3.0), st.floats(0.0, 8e5))
def test_a_braked_shaft_stops_where_its_speed_is_zero(omega: float, p_now: float) -> None:
    motion = braked(omega, 0.28, 8e5, p_now)
    s = time_of_stop(motion, HORIZON_S)
    if s < 0.0:
        assert motion_at(motion, HORIZON_S)[1] > 0.0
    else:
        assert motion_at(motion, s)[1] == pytest.approx(0.0, abs=1e-9)


@settings(deadline=None)
@given(
    st.integers(-(10**9), 10**9),
    st.floats(0.0, 6.28),
    st.integers(8, 200),
    st.integers(8, 200),
)
def test_gearing_there_and_back_gives_the_same_angle_however_many_turns(
    turns: int, rest: float, teeth: int, other: int
) -> None:
    there = geared((turns, rest), teeth, other, (0, 0.0))
    assert 0.0 <= there[1] < 2.0 * math.pi
    back = geared(there, other, teeth, (0, 0.0))
    error = (back[0] - turns) * 2.0 * math.pi + back[1] - rest
    assert abs(error) < 1e-12 * max(1.0, other / teeth)


@settings(deadline=None)
@given(st.integers(-5, 5), st.floats(-100.0, 100.0))
def test_a_settled_angle_is_the_same_angle(turns: int, rest: float) -> None:
    whole, part = settled(turns, rest)
    assert 0.0 <= part < 2.0 * math.pi
    assert (whole - turns) * 2.0 * math.pi + part == pytest.approx(rest, abs=1e-12)


@settings(deadline=None)
@given(st.floats(-100.0, 100.0))
def test_a_wrapped_phase_lies_within_half_a_pitch(phase: float) -> None:
    pitch = 7.5 * math.pi / 180.0
    inside = wrapped(phase, pitch)
    assert -pitch / 2.0 <= inside < pitch / 2.0
    assert math.remainder(inside - phase, pitch) == pytest.approx(0.0, abs=1e-12)


def test_slip_is_counted_in_the_gears_direction() -> None:
    faster, slower = steady(1000.0 * RPM), steady(700.0 * RPM)
    assert phase_at(faster, slower, 0.775, 0.0, 1e-3) > 0.0
