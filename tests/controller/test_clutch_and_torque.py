"""What is known of the clutch and the engine's torque ahead: trajectory, torque left."""

from __future__ import annotations

import math

import pytest

from meshpoint.controller.measure.gearbox_view import ClutchTrack
from meshpoint.controller.shift.step_snapshot import TorqueDecay
from meshpoint.gearbox import load_sheet

TRUCK12 = load_sheet("truck12")
TICK_US = 10_000


def opened(*closed: float, every_us: int = TICK_US) -> ClutchTrack:
    track = ClutchTrack()
    for k, position in enumerate(closed):
        track.take(k * every_us, position)
    return track


def test_an_opening_clutch_passes_a_level_at_its_rate() -> None:
    track = opened(1.0, 0.9, 0.8)
    assert track.rate_per_s == pytest.approx(-10.0)
    assert track.falls_to_us(0.35) == pytest.approx(20_000 + 45_000)
    assert track.falls_to_us(0.8) == 20_000  # passed already


@pytest.mark.parametrize(
    "track",
    [
        ClutchTrack(),
        opened(1.0),
        opened(1.0, 1.0),
        opened(0.5, 0.6),
        opened(1.0, 0.999),  # noise of a clutch that stands
        opened(1.0, 0.8, every_us=30_000),  # a lost sample
        opened(1.0, 0.99),  # further ahead than anything is said of
    ],
    ids=["unseen", "one sample", "still", "closing", "noise", "gap", "far"],
)
def test_of_a_clutch_that_does_not_open_nothing_is_said(track: ClutchTrack) -> None:
    assert track.falls_to_us(0.3) is None


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_the_torque_left_follows_the_engines_lag(sign: float) -> None:
    fall, lag_s = TorqueDecay(), 0.06
    for k in range(2):
        fall.take(k * TICK_US, sign * 0.4 * math.exp(-k * 0.01 / lag_s))
    left = fall.left_in(0.065)
    assert left == pytest.approx(sign * 0.4 * math.exp(-0.075 / lag_s))


def test_a_torque_that_does_not_fall_stays() -> None:
    for before, now in ((0.3, 0.3), (0.3, 0.31), (-0.1, 0.2), (0.0, 0.0), (0.0, 0.1)):
        fall = TorqueDecay()
        fall.take(0, before)
        fall.take(TICK_US, now)
        assert fall.left_in(0.1) == now


def test_a_torque_that_nobody_says_is_none() -> None:
    fall = TorqueDecay()
    fall.take(0, None)
    assert fall.left_in(0.1) is None
    fall.take(TICK_US, 0.3)
    fall.take(2 * TICK_US, None)
    assert fall.left_in(0.1) == 0.3


def test_the_engines_acceleration_is_not_taken_over_a_pause() -> None:
    """After a pause in what the engine says nobody knows what it did meanwhile: the guard, which
    takes the speeds anew as well, would forbid what was asked for by it."""
    fall = TorqueDecay()
    for k in range(6):
        fall.take(k * TICK_US, 0.3, speed_rad_s=100.0 + k)
    assert fall.engine_rad_s2 == pytest.approx(100.0)
    for k in range(6):
        fall.take(20 * TICK_US + k * TICK_US, 0.3, speed_rad_s=150.0 + 2.0 * k)
        if k < 5:
            assert fall.engine_rad_s2 == 0.0
    assert fall.engine_rad_s2 == pytest.approx(200.0)


@pytest.mark.parametrize("tick_us", [5_000, 10_000, 20_000])
def test_the_engines_acceleration_is_known_at_any_tick(tick_us: int) -> None:
    """The engine says its speed each 10 ms, and every other step comes half a millisecond late. Red
    before: at 20 ms that was a pause."""
    fall, heard_us = TorqueDecay(), -1
    for step in range(40):
        now_us, said_us = step * tick_us + 500 * (step % 2), step * tick_us // 10_000 * 10_000
        speed = 100.0 + 100e-6 * said_us if said_us > heard_us else None
        heard_us = said_us
        fall.take(now_us, None, speed_rad_s=speed)
    assert fall.engine_rad_s2 == pytest.approx(100.0, rel=0.02)
