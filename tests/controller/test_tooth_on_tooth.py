"""A sleeve on a tooth: it sticks if the gear turns so slowly that no gap will come in time."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from meshpoint.controller.shift.tooth_on_tooth import FaceWatch
from meshpoint.gearbox import load_sheet

SHEET = load_sheet("truck12")
HALF_FACE_RAD = math.radians(7.5 * 0.8 / 2.0)
"""48 teeth, a fifth of a pitch is gap."""
PATIENCE_S = 0.2
TICK_US = 10_000


def watched(slips_rad_s: list[float | None], tick_us: int = TICK_US) -> FaceWatch:
    """What has been seen after steps with these slips."""
    watch = FaceWatch(SHEET)
    watch.begin()
    for step, slip in enumerate(slips_rad_s):
        watch.take(5_000_000 + step * tick_us, slip)
    return watch


@given(st.floats(-6.0, 6.0), st.sampled_from((5_000, 10_000, 20_000)))
def test_a_gear_sticks_if_half_a_tooth_takes_longer_than_the_patience(
    slip_rad_s: float, tick_us: int
) -> None:
    crossing_s = math.inf if slip_rad_s == 0.0 else HALF_FACE_RAD / abs(slip_rad_s)
    if abs(crossing_s - PATIENCE_S) > 1e-9:
        seen = watched([slip_rad_s] * (1 + 60_000 // tick_us), tick_us)
        assert seen.sticks(PATIENCE_S) is (crossing_s > PATIENCE_S)


@given(st.floats(0.5, 10.0), st.integers(0, 20))
def test_speeds_that_the_teeth_falsify_to_and_fro_do_not_hide_it(
    error_rad_s: float, turned: int
) -> None:
    """Two waves of the error in the time watched."""
    errors: list[float | None] = [
        error_rad_s * math.sin(2.0 * math.pi * (step + turned) / 3.5) for step in range(7)
    ]
    assert watched(errors).sticks(PATIENCE_S)


def test_what_it_did_before_the_time_watched_does_not_count() -> None:
    assert watched([9.0] * 20 + [0.0] * 7).sticks(PATIENCE_S)
    assert not watched([0.0] * 20 + [9.0] * 7).sticks(PATIENCE_S)


@pytest.mark.parametrize(("steps", "told"), [(0, False), (1, False), (5, False), (6, True)])
def test_nothing_is_told_of_less_than_45_ms(steps: int, told: bool) -> None:
    assert watched([0.0] * steps).sticks(PATIENCE_S) is told


def test_a_missing_speed_begins_the_time_anew() -> None:
    assert not watched([0.0] * 20 + [None] + [0.0] * 5).sticks(PATIENCE_S)
    assert watched([0.0] * 20 + [None] + [0.0] * 6).sticks(PATIENCE_S)


def test_a_firing_begins_it_anew() -> None:
    watch = watched([0.0] * 20)
    watch.begin()
    assert not watch.sticks(PATIENCE_S)
    watch.take(6_000_000, 0.0)
    assert not watch.sticks(PATIENCE_S)
