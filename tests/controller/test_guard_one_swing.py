"""Row 3's bound of a main shaft that swings with one frequency: against the swing itself."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
from guard_cases import swing_within
from hypothesis import example, given, settings
from hypothesis import strategies as st

from meshpoint.controller.guard import one_swing
from meshpoint.controller.guard.own_speed import ShaftSpeed
from meshpoint.controller.guard.swing import SwingMemory
from meshpoint.units import RPM, TURN

START_US = (1 << 32) + 300_000
CYCLE_US = 10_000
MEASURED_S = 0.016
"""Some teeth take so long, over which a speed is the mean."""
MIDDLE = 520.0 * RPM
Speed = Callable[[float], float]


def swing(rpm: float, hertz: float = 11.0, decay: float = 2.5, phase: float = 0.0) -> Speed:
    """The speed (rad/s) at a time (s) of a shaft that swings by this much."""

    def at(time_s: float) -> float:
        turned = TURN * hertz * time_s + phase
        return MIDDLE + rpm * RPM * math.exp(-decay * time_s) * math.cos(turned)

    return at


def measured(shaft: Speed, count: int = 12) -> list[ShaftSpeed]:
    """As many means of it, one a cycle."""
    parts = [MEASURED_S * (k / 20.0 - 0.5) for k in range(21)]
    return [
        ShaftSpeed(
            START_US + k * CYCLE_US,
            sum(shaft(k * CYCLE_US * 1e-6 + part) for part in parts) / len(parts),
        )
        for k in range(count)
    ]


def bounds(
    shaft: Speed, ahead_ms: tuple[float, float] = (40.0, 50.0), count: int = 12
) -> tuple[float, float] | None:
    speeds = measured(shaft, count)
    newest_us = speeds[-1].time_us
    return one_swing.between(speeds, newest_us + 1e3 * ahead_ms[0], newest_us + 1e3 * ahead_ms[1])


def truth(shaft: Speed, ahead_ms: tuple[float, float], count: int = 12) -> tuple[float, float]:
    newest_s = (count - 1) * CYCLE_US * 1e-6
    first, last = ahead_ms
    met = [shaft(newest_s + 1e-3 * (first + (last - first) * k / 50.0)) for k in range(51)]
    return min(met), max(met)


@settings(deadline=None, max_examples=150)
@given(
    rpm=st.floats(12.0, 300.0),
    hertz=st.floats(6.0, 24.0),
    decay=st.floats(0.0, 12.0),
    phase=st.floats(0.0, TURN),
    first_ms=st.floats(20.0, 50.0),
)
def test_what_the_swing_does_lies_within_its_bound(
    rpm: float, hertz: float, decay: float, phase: float, first_ms: float
) -> None:
    """Whatever swing it is: the guard has seen 110 ms of it."""
    shaft, ahead_ms = swing(rpm, hertz, decay, phase), (first_ms, first_ms + 12.0)
    found = bounds(shaft, ahead_ms)
    if found is None:
        return
    least, most = truth(shaft, ahead_ms)
    assert found[0] <= least
    assert most <= found[1]


def test_it_is_narrower_than_how_far_the_shaft_has_been() -> None:
    """A swing of 150 rpm to either side, a quarter of a period past its end: in 40 to 50 ms it is
    on its way back. As fast and as far as it has been, it may be anywhere."""
    shaft = swing(150.0, phase=-TURN * 11.0 * 0.09)
    found = bounds(shaft)
    assert found is not None
    assert found[1] - found[0] < 175.0 * RPM
    memory, known = SwingMemory(), None
    for speed in measured(shaft):
        known = memory.take(speed)
    assert known is not None
    newest_us = known.newest.time_us
    assert known.between(newest_us + 40_000.0, newest_us + 50_000.0) == found
    omegas, rates = [speed.omega_rad_s for speed in known.speeds], known.rates_rad_s2
    as_far = swing_within(known.newest, 0.0, min(omegas), max(omegas), min(rates), max(rates))
    before = as_far.between(newest_us + 40_000.0, newest_us + 50_000.0)
    assert before[1] - before[0] > 220.0 * RPM


def test_a_swing_that_has_just_begun_is_bounded_wider_than_it_has_been() -> None:
    """It has not been at its lower end yet."""
    shaft = swing(150.0, hertz=6.0, decay=0.0)
    speeds = measured(shaft, 9)
    newest_us = speeds[-1].time_us
    found = one_swing.between(speeds, newest_us + 5_000.0, newest_us + 15_000.0)
    assert found is not None
    assert found[0] < min(speed.omega_rad_s for speed in speeds) - 0.3 * RPM


def test_a_shaft_that_hardly_swings_has_no_bound_of_its_own() -> None:
    for rpm, is_known in ((8.0, False), (13.0, True)):
        assert (bounds(swing(rpm, decay=0.0)) is not None) is is_known


@pytest.mark.parametrize(("count", "is_known"), [(7, False), (8, True), (9, True)])
def test_a_frequency_is_told_from_eight_speeds_on(count: int, is_known: bool) -> None:
    assert (bounds(swing(100.0), count=count) is not None) is is_known


def test_speeds_of_more_than_a_period_ago_say_nothing() -> None:
    """Before, a gear was in mesh."""
    shaft = swing(100.0)
    speeds = measured(shaft, 20)
    newest_us = speeds[-1].time_us
    late = (newest_us + 40_000.0, newest_us + 50_000.0)
    before = [speed._replace(omega_rad_s=30.0) for speed in speeds[:10]]
    assert one_swing.between([*before, *speeds[10:]], *late) is not None
    assert one_swing.between([*before, *speeds[10:]], *late) == one_swing.between(speeds, *late)


def test_a_shaft_that_rattles_in_its_backlash_meets_no_swing() -> None:
    """To and fro between two flanks at 60 rpm, which it leaves as fast as it came, 50 ms for each
    way."""

    def rattles(time_s: float) -> float:
        return MIDDLE + 60.0 * RPM * (1.0 if time_s % 0.1 < 0.05 else -1.0)

    assert bounds(rattles) is None


def test_a_swing_of_which_nothing_is_known_is_bounded_as_before() -> None:
    calm = swing_within(ShaftSpeed(START_US, 50.0), 0.0, 49.0, 51.0, -10.0, 20.0)
    assert calm.between(START_US + 10_000.0, START_US + 20_000.0) == (49.8, 50.4)


@given(
    st.lists(st.integers(0, 85_000), min_size=8, max_size=30, unique=True),
    st.lists(st.floats(0.0, 700.0), min_size=30, max_size=30),
)
@example([*range(8)], [float(k) for k in range(30)])
@example([*range(7), 85_000], [float(k) for k in range(30)])
@example([*range(8)], [1e9 * k for k in range(30)])
@settings(max_examples=60)
def test_speeds_at_any_times_are_answered(times_us: list[int], omegas: list[float]) -> None:
    """Edges that somebody forges may come at any time: those that show no swing bound none."""
    pairs = zip(sorted(times_us), omegas, strict=False)
    speeds = [ShaftSpeed(START_US + time_us, omega) for time_us, omega in pairs]
    newest_us = speeds[-1].time_us
    found = one_swing.between(speeds, newest_us + 40_000, newest_us + 50_000)
    assert found is None or (found[0] <= found[1] and all(map(math.isfinite, found)))
    if max(times_us) < 100:
        assert found is None


def speeds_over(span_us: int, count: int) -> list[ShaftSpeed]:
    """Of a swing of 11 Hz by 60 rpm, at equal steps of time, whole means left out."""
    shaft, steps = swing(60.0), [span_us * k // (count - 1) for k in range(count)]
    return [ShaftSpeed(START_US + at_us, shaft(at_us * 1e-6)) for at_us in steps]


def bound_of(speeds: list[ShaftSpeed]) -> tuple[float, float] | None:
    newest_us = speeds[-1].time_us
    return one_swing.between(speeds, newest_us + 40_000, newest_us + 50_000)


def test_a_swing_is_looked_for_in_eight_speeds_of_60_to_85_ms() -> None:
    assert bound_of(speeds_over(60_000, 8)) is not None
    assert bound_of(speeds_over(59_999, 8)) is None
    assert bound_of(speeds_over(60_000, 7)) is None
    assert bound_of(speeds_over(85_000, 8)) is not None
    assert bound_of(speeds_over(85_001, 8)) is None, "the first is too old, seven are left"
    assert one_swing.between([], 0.0, 1.0) is None


def test_what_is_tried_and_allowed_for_is_what_the_document_says() -> None:
    """docs/guard.md, row 3: numbers that a bounded swing alone does not show to a few per cent."""
    assert bound_of(speeds_over(85_000, 8)) is not None
    assert tuple(TURN * hertz / 2.0 for hertz in range(10, 51)) == one_swing.FREQUENCIES
    assert one_swing.DECAYS == (0.0, 4.0, 9.0, 14.0)
    assert (one_swing.SPAN_US, one_swing.LEAST_US, one_swing.LEAST_SPEEDS) == (85_000, 60_000, 8)
    assert (one_swing.SWINGS_RAD_S, one_swing.ERROR_RAD_S, one_swing.ERROR_SHARE) == (
        2.0,
        0.4,
        0.06,
    )
    assert (one_swing.MEASURED_OVER_S, one_swing.NEAR, one_swing.PARTS) == (0.02, 1.5, 5)
    assert one_swing.LEAST_SQUARE == 1e-6


def test_a_swing_is_as_much_wider_than_its_speeds_as_their_mean_takes_away() -> None:
    """A speed is the mean over 20 ms, and was 1 rad/s."""
    found = one_swing.OneSwing(frequency=TURN * 20.0, decay=0.0, middle=0.0, cosine=1.0, sine=0.0)
    parts = [found.at(0.02 * ((k + 0.5) / 1_000 - 0.5)) for k in range(1_000)]
    assert sum(parts) / len(parts) == pytest.approx(1.0, abs=1e-4)
