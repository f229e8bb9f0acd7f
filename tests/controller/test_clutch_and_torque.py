"""What is known of the clutch and the engine's torque ahead: course, kiss point, torque left."""

from __future__ import annotations

import math

import pytest

from meshpoint.controller.sensing.clutch_track import ClutchTrack
from meshpoint.controller.shift.kiss_point import KissPoint
from meshpoint.controller.shift.torque_fall import TorqueFall
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


def close_with(kiss: KissPoint, touch: float, own_rad_s2: float, slope: float) -> None:
    """A closing in 200 ms: from `touch` on the plates brake the engine by `slope` a travel."""
    track, dt = ClutchTrack(), 1e-4
    speed, position = 140.0, 0.0
    for k in range(2001):
        if k % 100 == 0:
            track.take(k * 100, position)
            kiss.look(track, speed)
        grip = slope * max(0.0, position - touch)
        speed += (own_rad_s2 - grip) * dt
        position = min(1.0, position + dt / 0.2)


@pytest.mark.parametrize("touch", [0.31, 0.35, 0.388])
@pytest.mark.parametrize("own_rad_s2", [-78.0, 0.0, 120.0])
def test_the_kiss_point_is_learned_from_the_engine(touch: float, own_rad_s2: float) -> None:
    kiss = KissPoint(TRUCK12)
    assert kiss.share == pytest.approx(0.35)
    for _ in range(8):
        close_with(kiss, touch, own_rad_s2, slope=1600.0)
    assert kiss.share == pytest.approx(touch, abs=0.012)
    assert kiss.sd < 0.01
    assert TRUCK12.clutch.surely_open_share <= kiss.parted_share <= kiss.share


@pytest.mark.parametrize(
    ("touch", "slope"), [(0.35, 0.0), (0.2, 1600.0), (0.6, 1600.0)], ids=["none", "low", "high"]
)
def test_what_cannot_be_the_kiss_point_is_not_learned(touch: float, slope: float) -> None:
    """An engine that nothing brakes, and points outside the sheet's tolerance."""
    kiss = KissPoint(TRUCK12)
    for _ in range(3):
        close_with(kiss, touch, -78.0, slope)
    assert (kiss.share, kiss.sd) == pytest.approx((0.35, 0.025))


def test_an_engine_that_says_nothing_teaches_nothing() -> None:
    kiss, track = KissPoint(TRUCK12), ClutchTrack()
    for k in range(20):
        track.take(k * TICK_US, k / 20)
        kiss.look(track, None)
    assert kiss.share == pytest.approx(0.35)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_the_torque_left_follows_the_engines_lag(sign: float) -> None:
    fall, lag_s = TorqueFall(), 0.06
    for k in range(2):
        fall.take(k * TICK_US, sign * 0.4 * math.exp(-k * 0.01 / lag_s))
    left = fall.left_in(0.065)
    assert left == pytest.approx(sign * 0.4 * math.exp(-0.075 / lag_s))


def test_a_torque_that_does_not_fall_stays() -> None:
    for before, now in ((0.3, 0.3), (0.3, 0.31), (-0.1, 0.2), (0.0, 0.0), (0.0, 0.1)):
        fall = TorqueFall()
        fall.take(0, before)
        fall.take(TICK_US, now)
        assert fall.left_in(0.1) == now


def test_a_torque_that_nobody_says_is_none() -> None:
    fall = TorqueFall()
    fall.take(0, None)
    assert fall.left_in(0.1) is None
    fall.take(TICK_US, 0.3)
    fall.take(2 * TICK_US, None)
    assert fall.left_in(0.1) == 0.3
