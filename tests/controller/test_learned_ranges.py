"""Whatever the sensors say, what is learned of valves stays within what a calibration
file may hold: the controller can read what it has written."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from meshpoint.controller.estimate.brake_model import BrakeModel
from meshpoint.controller.measure.gearbox_view import PressureSamples
from meshpoint.gearbox import load_sheet

SHEET = load_sheet("truck12")
SUPPLY_PA = SHEET.air.supply_gauge_pa
MOST_S = 0.1
"""No brake valve takes longer to react; the rest of what is seen then is another fault."""


@settings(max_examples=60)
@given(
    on_us=st.floats(0.0, 300_000.0),
    off_us=st.floats(0.0, 300_000.0),
    level_pa=st.floats(0.0, 1.2 * SUPPLY_PA),
    noise_pa=st.floats(0.0, 2e5),
    seed=st.integers(0, 10_000),
    shifts=st.integers(1, 5),
)
def test_the_brake_valve_s_delays_are_never_negative_nor_over_a_tenth_of_a_second(
    on_us: float, off_us: float, level_pa: float, noise_pa: float, seed: int, shifts: int
) -> None:
    """Pressures that rise and fall at any time, before the command too."""
    model, rng = BrakeModel(SHEET, 0.1, 5.0), np.random.default_rng(seed)
    time_us = np.arange(0.0, 500_000.0, 5_000.0)
    seen_pa = np.where((time_us > on_us) & (time_us < on_us + off_us), level_pa, 0.0)
    for _ in range(shifts):
        noisy_pa = np.maximum(seen_pa + rng.normal(0.0, noise_pa, time_us.size), 0.0)
        still = np.zeros(time_us.size)
        samples = PressureSamples(time_us, noisy_pa, still)
        model.learn(samples, np.array([150_000.0, 250_000.0]), np.array([1.0, 0.0]))
    record = model.record()
    if record is not None:
        assert 0.0 <= record.off_delay_s <= MOST_S
        assert 0.0 <= record.on_delay_s <= MOST_S
