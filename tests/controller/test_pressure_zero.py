"""The brake pressure sensor's offset is learned while its chamber is empty."""

from __future__ import annotations

import math

import numpy as np
import pytest

from meshpoint.controller.measure.gearbox_view import PressureZero

TAU_S, OFFSET_PA, TICK_US = 0.045, 0.3e5, 10_000


def trajectory(seed: int) -> tuple[PressureZero, list[tuple[bool, float, float]]]:
    """Rest, braking, the pressure's fall, rest: driven, true and corrected pressure."""
    rng, zero, pressure_pa = np.random.default_rng(seed), PressureZero(TAU_S), 0.0
    seen = []
    for k in range(400):
        driven = 200 <= k < 240
        goal = 8.5e5 if driven else 0.0
        pressure_pa += (goal - pressure_pa) * (1.0 - math.exp(-TICK_US * 1e-6 / TAU_S))
        shown = pressure_pa + OFFSET_PA + rng.normal(0.0, 5e3)
        seen.append((driven, pressure_pa, zero.take(k * TICK_US, shown, driven)))
    return zero, seen


def test_the_offset_is_taken_out_also_while_braking() -> None:
    zero, seen = trajectory(1)
    errors = [corrected - true for _, true, corrected in seen[200:]]
    assert abs(float(np.mean(errors))) < 1e3
    assert zero.offset_pa == pytest.approx(OFFSET_PA, abs=1e3)


def test_pressure_in_the_chamber_is_not_taken_for_an_offset() -> None:
    zero = PressureZero(TAU_S)
    for k in range(60):
        zero.take(k * TICK_US, 5e5, True)
    for k in range(60, 90):
        zero.take(k * TICK_US, 5e5 * math.exp(-(k - 60) * TICK_US * 1e-6 / TAU_S), False)
    assert zero.offset_pa == 0.0


def test_the_offset_is_the_mean_of_what_an_empty_chamber_showed_the_old_counting_less() -> None:
    """A sample weighs 0.998 of the next one. Nothing is reported before ten samples' weight."""
    zero, shown = PressureZero(TAU_S), []
    begun_us = 8e6 * TAU_S
    zero.take(0.0, 8e5, True)
    for k in range(1, 40):
        pressure_pa = OFFSET_PA + 1e3 * math.sin(2.0 * k)
        corrected = zero.take(begun_us + k * TICK_US, pressure_pa, False)
        shown.append(pressure_pa)
        weights = 0.998 ** np.arange(k - 1.0, -1.0, -1.0)
        reported = float(np.average(shown, weights=weights)) if weights.sum() >= 10.0 else 0.0
        assert zero.offset_pa == pytest.approx(reported)
        assert corrected == pytest.approx(pressure_pa - reported)


@pytest.mark.parametrize(("late_us", "is_empty"), [(0, False), (1, True)])
def test_a_chamber_is_empty_eight_time_constants_after_its_valve_went_off(
    late_us: int, is_empty: bool
) -> None:
    """An exponential has then fallen to 1 / 2981 of where it began."""
    zero = PressureZero(0.125)
    zero.take(5e6, 8e5, True)
    for _ in range(20):
        zero.take(5e6 + 1e6 + late_us, OFFSET_PA, False)
    assert (zero.offset_pa != 0.0) is is_empty


def test_the_pressure_of_a_stuck_valve_is_not_taken_for_an_offset() -> None:
    """Off for two seconds, and still 8 bar: it is reported as what it is, so that no gear is
    engaged against it."""
    zero = PressureZero(TAU_S)
    reported = [zero.take(k * TICK_US, 8e5, driven=k < 40) for k in range(240)]
    assert reported[-1] == 8e5
