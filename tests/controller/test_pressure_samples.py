"""What a sensor's lag did to a pressure is withdrawn."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from meshpoint.controller.measure.gearbox_view import PressureSampler, together

TICK_US = 10_000


@given(
    level=st.floats(0.0, 9e5),
    slope=st.floats(-1e7, 1e7),
    bend=st.floats(-1e9, 1e9),
    lag_s=st.floats(0.0, 9e-3),
    ticks=st.lists(st.integers(5_000, 15_000), min_size=5, max_size=9),
)
def test_a_pressure_that_is_a_parabola_in_time_is_found_again_exactly(
    level: float, slope: float, bend: float, lag_s: float, ticks: list[int]
) -> None:
    """A first-order lag shows of p its value less tau p' plus tau^2 p'', long after its start; at
    samples however far apart."""
    times = np.cumsum(ticks)
    t = times * 1e-6
    shown = level + slope * t + bend * t**2 - lag_s * (slope + 2 * bend * t) + lag_s**2 * 2 * bend
    samples = PressureSampler().take(list(zip(times.tolist(), shown.tolist(), strict=True)))
    then_us, pressure = samples.before_the_lag(lag_s)
    then = then_us * 1e-6
    assert pressure[2:] == pytest.approx(
        (level + slope * then + bend * then**2)[2:], rel=1e-6, abs=1.0
    )


@pytest.mark.parametrize("lag_s", [2e-3, 5e-3, 8e-3])
def test_of_a_chamber_that_empties_half_the_error_of_a_mere_shift_is_left(lag_s: float) -> None:
    """Its pressure falls as exp(-t / 25 ms); the sensor shows the first-order lag of that."""
    empty_s, start_pa = 25e-3, 6e5
    sampler, parts = PressureSampler(), []
    for k in range(12):
        t = k * TICK_US * 1e-6
        lagged = (empty_s * math.exp(-t / empty_s) - lag_s * math.exp(-t / lag_s)) / (
            empty_s - lag_s
        )
        parts.append(sampler.take([(k * TICK_US, start_pa * lagged)]))
    then_us, pressure = together(parts).before_the_lag(lag_s)
    true = start_pa * np.exp(-then_us * 1e-6 / empty_s)
    shifted = together(parts).pressure_pa
    later = slice(4, None)
    assert np.abs(pressure - true)[later].max() < 0.5 * np.abs(shifted - true)[later].max()


def test_behind_a_hole_in_the_samples_no_curvature_is_said() -> None:
    sampler = PressureSampler()
    taken = sampler.take([(0, 1e5), (10_000, 2e5), (20_000, 2.5e5), (80_000, 0.0), (90_000, 1e5)])
    assert taken.curvature_pa_s2.tolist() == pytest.approx([0.0, 0.0, -5e8, 0.0, 0.0])
    assert sampler.take([(90_000, 3e5)]).curvature_pa_s2.tolist() == [0.0]


def test_without_a_lag_samples_are_taken_as_they_are() -> None:
    taken = PressureSampler().take([(0, 1e5), (10_000, 2e5), (20_000, 2.5e5)])
    then_us, pressure = taken.before_the_lag(0.0)
    assert (then_us.tolist(), pressure.tolist()) == ([0, 10_000, 20_000], [1e5, 2e5, 2.5e5])
