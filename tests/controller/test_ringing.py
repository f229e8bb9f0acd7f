"""Whether a driveline twists: learned from how the main shaft turns in neutral."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from meshpoint.controller.shift.step_snapshot import RingingDetector
from meshpoint.dbc.messages import ControllerState as State
from meshpoint.gearbox import MainGear, load_sheet

STEP_US = 10_000


def measurement(
    rings: RingingDetector, state: State, now_us: int, main_rad_s: float | None
) -> None:
    gear = MainGear.NEUTRAL if state is State.SYNCHRONISING else MainGear.FIRST
    snapshot: Any = SimpleNamespace(
        now_us=now_us,
        speeds=SimpleNamespace(main=main_rad_s),
        view=SimpleNamespace(main_gear=gear),
    )
    rings.measure(state, snapshot)


def swing(amplitude_rad_s: float, step: int) -> float:
    """With 8 Hz."""
    return amplitude_rad_s * math.sin(2.0 * math.pi * 8.0 * step * STEP_US * 1e-6)


def looked_at(
    swing_rad_s: float, measurements: int = 20, noise_rad_s: float = 0.0, seed: int = 0
) -> RingingDetector:
    """A shift in which the shaft slows evenly, and swings about that."""
    rings = RingingDetector(load_sheet("truck12"))
    noise = np.random.default_rng(seed).normal(0.0, 1.0, measurements) * noise_rad_s
    for step in range(measurements):
        speed = 60.0 - 0.04 * step + swing(swing_rad_s, step) + noise[step]
        measurement(rings, State.SYNCHRONISING, step * STEP_US, speed)
    measurement(rings, State.ENGAGING, measurements * STEP_US, 59.0)
    return rings


def seen(swing_rad_s: float, measurements: int = 20) -> bool:
    return looked_at(swing_rad_s, measurements).twists


def is_beyond_noise(swing_rad_s: float, noise_rad_s: float, seed: int) -> bool:
    return looked_at(swing_rad_s, noise_rad_s=noise_rad_s, seed=seed).is_beyond_noise


@pytest.mark.parametrize(("swing_rad_s", "twists"), [(0.0, False), (0.2, False), (0.6, True)])
def test_a_swing_tells_shafts_that_twist(swing_rad_s: float, twists: bool) -> None:
    """A steady deceleration is none, and what a sensor wheel's teeth do is too little."""
    assert seen(swing_rad_s) is twists


def test_what_a_sensor_scatters_is_no_swing_to_wait_for() -> None:
    """Edges of 40 us scatter the speed by 0.4 rad/s. Red before: after each of these the clutch
    waited for what the shafts carry, and the torque was planned against noise."""
    assert sum(is_beyond_noise(0.0, 0.45, seed) for seed in range(100)) <= 10


def test_a_swing_is_seen_through_what_a_sensor_scatters() -> None:
    assert sum(is_beyond_noise(1.2, 0.25, seed) for seed in range(100)) >= 95


def test_too_few_measurements_tell_nothing() -> None:
    assert not seen(5.0, measurements=5)


def seen_at(tick_us: int, ends_us: int) -> bool:
    """A shaft that swings widely and is read each 10 ms, by steps of this tick, until then."""
    rings = RingingDetector(load_sheet("truck12"))
    for now_us in range(0, ends_us, tick_us):
        read_us = now_us - now_us % 10_000
        speed = 60.0 + 5.0 * math.sin(2.0 * math.pi * 8.0 * read_us * 1e-6)
        measurement(rings, State.SYNCHRONISING, now_us, speed)
    measurement(rings, State.ENGAGING, ends_us, 59.0)
    return rings.twists


@pytest.mark.parametrize("tick_us", [5_000, 10_000])
def test_what_tells_a_swing_is_reads_however_many_steps_look_at_each(tick_us: int) -> None:
    """Red before: six steps of 5 ms are three reads, and a line does not suit those."""
    assert not seen_at(tick_us, 50_000)
    assert seen_at(tick_us, 60_000)


def test_what_once_twisted_twists_for_good() -> None:
    rings = RingingDetector(load_sheet("truck12"))
    for shift, amplitude_rad_s in enumerate((2.0, 0.0)):
        for step in range(10):
            speed = 60.0 + swing(amplitude_rad_s, step)
            measurement(rings, State.SYNCHRONISING, (20 * shift + step) * STEP_US, speed)
        measurement(rings, State.ENGAGING, (20 * shift + 10) * STEP_US, 60.0)
    assert rings.twists
