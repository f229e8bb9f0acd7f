"""The brake pressure sensor's offset is learned while its chamber is empty."""

from __future__ import annotations

import math

import numpy as np
import pytest

from meshpoint.controller.sensing.pressure_zero import PressureZero

TAU_S, OFFSET_PA, TICK_US = 0.045, 0.3e5, 10_000


def course(seed: int) -> tuple[PressureZero, list[tuple[bool, float, float]]]:
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
    zero, seen = course(1)
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
