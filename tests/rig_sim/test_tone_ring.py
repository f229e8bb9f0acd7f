"""A toothed ring and its sensor, held against closed forms."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from meshpoint.rig_sim.truck_nodes.tone_ring import KEPT, ToneRing

TEETH = 100
TRUE = [0.0] * TEETH
LEAST_HZ = 16.0
WINDOW_US = 20_000
STEP_US = 10_000


def turned(ring: ToneRing, turns_s: Callable[[float], float], until_us: int) -> ToneRing:
    """The ring, turned until then at a speed that is a function of the time in s."""
    for time_us in range(0, until_us + 1, STEP_US):
        ring.turn(time_us, turns_s(time_us * 1e-6))
    return ring


@pytest.mark.parametrize("turns_s", [0.2, 1.0, 7.03, 22.0, -7.03])
def test_an_even_speed_is_read_to_the_microsecond_either_way_round(turns_s: float) -> None:
    ring = turned(ToneRing(TRUE, LEAST_HZ), lambda _: turns_s, 1_000_000)
    for at_us in range(500_000, 1_000_001, 3_777):
        read = ring.turns_s(at_us, WINDOW_US)
        assert read == pytest.approx(abs(turns_s), rel=2.0 / WINDOW_US)


def test_a_ring_off_its_axis_reads_too_fast_and_too_slow_once_a_turn() -> None:
    """(error_first - error_last) / m with m teeth in the window: at most 2 E sin(pi m / n) / m."""
    off, speed = 0.02, 7.0
    errors = [off * math.sin(math.tau * k / TEETH) for k in range(TEETH)]
    ring = turned(ToneRing(errors, LEAST_HZ), lambda _: speed, 1_000_000)
    read = [ring.turns_s(at_us, WINDOW_US) for at_us in range(700_000, 1_000_000, 500)]
    wrong = [each / speed - 1.0 for each in read if each is not None]
    teeth = math.ceil(speed * TEETH * WINDOW_US * 1e-6)
    expected = 2.0 * off * math.sin(math.pi * teeth / TEETH) / teeth
    assert max(wrong) == pytest.approx(expected, rel=0.1)
    assert min(wrong) == pytest.approx(-expected, rel=0.1)


def test_a_falling_speed_is_read_as_that_of_half_the_window_ago() -> None:
    start, rate = 7.0, -2.0

    def speed(time_s: float) -> float:
        return start + rate * time_s

    ring = turned(ToneRing(TRUE, LEAST_HZ), speed, 1_000_000)
    for at_us in range(500_000, 1_000_001, 3_777):
        read = ring.turns_s(at_us, WINDOW_US)
        now = speed(at_us * 1e-6)
        assert read is not None
        tooth_s, window_s = 1.0 / TEETH / now, WINDOW_US * 1e-6
        old_s = (now - read) / rate
        assert window_s / 2.0 - 1e-3 < old_s < window_s / 2.0 + 1.5 * tooth_s + 1e-3


@pytest.mark.parametrize(("teeth_s", "reads"), [(15.0, False), (17.0, True)])
def test_below_the_least_speed_it_reads_as_standing(teeth_s: float, reads: bool) -> None:
    ring = turned(ToneRing(TRUE, LEAST_HZ), lambda _: teeth_s / TEETH, 2_000_000)
    for at_us in range(1_000_000, 2_000_000, 3_777):
        expected = pytest.approx(teeth_s / TEETH, rel=1e-3) if reads else 0.0
        assert ring.turns_s(at_us, WINDOW_US) == expected


def test_it_knows_nothing_before_two_teeth_or_a_standstill_have_shown() -> None:
    ring = ToneRing(TRUE, LEAST_HZ)
    assert ring.turns_s(0, WINDOW_US) is None
    turned(ring, lambda _: 0.0, 100_000)
    patience_us = round(1e6 / LEAST_HZ)
    assert ring.turns_s(patience_us - 1, WINDOW_US) is None
    assert ring.turns_s(patience_us + 1, WINDOW_US) == 0.0


def test_a_shaft_that_stops_reads_its_last_speed_and_then_zero() -> None:
    ring = turned(ToneRing(TRUE, LEAST_HZ), lambda s: 7.0 if s < 0.5 else 0.0, 1_000_000)
    assert ring.turns_s(490_000, WINDOW_US) == pytest.approx(7.0, rel=1e-3)
    assert 3.5 < (ring.turns_s(520_000, WINDOW_US) or 0.0) < 7.0
    assert ring.turns_s(700_000, WINDOW_US) == 0.0


@settings(max_examples=30, deadline=None)
@given(
    speeds=st.lists(st.floats(0.2, 22.0), min_size=30, max_size=60),
    place=st.floats(0.0, TEETH),
)
def test_a_true_ring_reads_no_speed_that_was_not_in_its_window(
    speeds: list[float], place: float
) -> None:
    ring = ToneRing(TRUE, LEAST_HZ, place)
    for step, speed in enumerate(speeds):
        ring.turn(step * STEP_US, speed)
    end_us = (len(speeds) - 1) * STEP_US
    read = ring.turns_s(end_us, WINDOW_US)
    assert read is not None
    reach = 1 + math.ceil((WINDOW_US + 3e6 / TEETH / 0.2) / STEP_US)
    assert min(speeds[-reach:]) * 0.999 < read < max(speeds[-reach:]) * 1.001


def test_a_long_drive_keeps_what_it_looks_back_on() -> None:
    ring = turned(ToneRing(TRUE, LEAST_HZ), lambda _: 20.0, 5 * KEPT * 1_000)
    assert ring.turns_s(5 * KEPT * 1_000 - 300_000, WINDOW_US) == pytest.approx(20.0, rel=1e-3)
