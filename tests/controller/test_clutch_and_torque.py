"""What is known of the clutch and the engine's torque ahead: trajectory, kiss point, torque
left."""

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
            kiss.measure(track, speed)
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
        kiss.measure(track, None)
    assert kiss.share == pytest.approx(0.35)


def touched(
    touch: float, rise_rad_s3: float = -6_000.0, unsaid: int | None = None, again: int = 0
) -> KissPoint:
    """Five samples of a clutch that closes by 0.05 in each 10 ms, its plates touching 0.075 after
    the first: from there the engine's acceleration changes evenly. Without its speed at the
    sample `unsaid`; the middle one is looked at `again` as often."""
    kiss, track, first = KissPoint(TRUCK12), ClutchTrack(), touch - 0.075
    track.take(990_000, first - 0.05)
    for k in range(5):
        track.take(1_000_000 + k * TICK_US, first + 0.05 * k)
        since_s = max(0.0, k * 0.01 - 0.015)
        speed = 140.0 + 20.0 * k * 0.01 + rise_rad_s3 * since_s**2 / 2.0
        kiss.measure(track, None if k == unsaid else speed)
        for _ in range(again if k == 2 else 0):
            kiss.measure(track, speed + 50.0)
    return kiss


SEEN_SD = 4.0 / 200.0
"""Of one touch: 4 ms of a clutch that closes in 200 ms."""


def touch_taken(kiss: KissPoint) -> float | None:
    """By how much of the way to it the share went: what was known and what was seen are weighed by
    their variances."""
    known, sd = TRUCK12.clutch.kiss_share, TRUCK12.clutch.kiss_tolerance / 2.0
    if (kiss.share, kiss.sd) == (known, sd):
        return None
    weight = sd**2 / (sd**2 + SEEN_SD**2)
    assert kiss.sd == pytest.approx(math.sqrt(1.0 - weight) * sd)
    return known + (kiss.share - known) / weight


@pytest.mark.parametrize("rise_rad_s3", [-6_000.0, 6_000.0])
@pytest.mark.parametrize("again", [0, 3])
def test_a_touch_is_where_the_growing_acceleration_leaves_its_own(
    rise_rad_s3: float, again: int
) -> None:
    """Whether the plates brake or pull; a sample that is looked at twice counts once."""
    found = touch_taken(touched(0.35, rise_rad_s3, again=again))
    assert found == pytest.approx(0.35, abs=1e-6)


@pytest.mark.parametrize("unsaid", [0, 2, 4])
def test_without_the_engines_speed_in_each_sample_no_touch_is_seen(unsaid: int) -> None:
    assert touch_taken(touched(0.35, unsaid=unsaid)) is None


@pytest.mark.parametrize(("off", "is_taken"), [(0.005, True), (-0.005, False)])
def test_no_touch_is_taken_that_the_sheet_does_not_allow(off: float, is_taken: bool) -> None:
    clutch = TRUCK12.clutch
    highest = clutch.kiss_share + clutch.kiss_tolerance
    for touch in (clutch.surely_open_share + off, highest - off):
        assert (touch_taken(touched(touch)) is not None) is is_taken


def test_past_touches_weigh_as_ten() -> None:
    """Linings wear: the sheet's share and the first touches are forgotten."""
    kiss = KissPoint(TRUCK12)
    for _ in range(60):
        close_with(kiss, 0.33, 0.0, slope=1600.0)
    assert kiss.sd == pytest.approx(SEEN_SD / math.sqrt(10.0))
    assert kiss.share == pytest.approx(0.33, abs=0.012)


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


def test_the_engines_acceleration_is_not_taken_over_a_pause() -> None:
    """After a pause in what the engine says nobody knows what it did meanwhile: the guard, which
    takes the speeds anew as well, would forbid what was asked for by it."""
    fall = TorqueFall()
    for k in range(6):
        fall.take(k * TICK_US, 0.3, speed_rad_s=100.0 + k)
    assert fall.engine_rad_s2 == pytest.approx(100.0)
    for k in range(6):
        fall.take(20 * TICK_US + k * TICK_US, 0.3, speed_rad_s=150.0 + 2.0 * k)
        if k < 5:
            assert fall.engine_rad_s2 == 0.0
    assert fall.engine_rad_s2 == pytest.approx(200.0)
