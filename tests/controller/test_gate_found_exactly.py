"""The edge gate that looks for its wheel: what is one, how fast, when it stands (`gate_bench`)."""

from __future__ import annotations

import pytest
from gate_bench import LEAST, NOW, PITCH_RAD, cruising, feed, health, mode, sought, value

from meshpoint.controller.sensing.gate_kernels import stand, turn
from meshpoint.controller.sensing.gate_layout import (
    COUNTING,
    SEARCHING,
    SEEKING,
    UNKNOWN,
    teeth_of,
)


def test_four_even_intervals_are_a_wheel() -> None:
    """Its speed is that of the first two, its duty that of the falling edges between, its first
    tooth the sensor's number."""
    gate = sought()
    falls = [400 + 1000 * k for k in range(4)]
    fed = feed(gate, [1000 * k for k in range(5)], falls)
    assert fed.times == [0, 400, 1000, 1400, 2000, 2400, 3000, 3400, 4000]
    assert fed.teeth == [500, 500, 501, 501, 502, 502, 503, 503, 504]
    assert fed.angles[1] == pytest.approx(500.5)
    assert value(gate, "found_us") == NOW
    assert value(gate, "duty") == pytest.approx(0.4)
    assert value(gate, "rate_per_us") == pytest.approx(1e-3)
    assert fed.used == (5, 4)
    assert health(gate) == (0, 0, 0, 0, 0)
    assert gate.last.tolist() == [504, 503]
    assert gate.part("interval_us").tolist() == [1000.0, 1000.0]
    assert value(gate, "scatter") == pytest.approx(0.05 * 0.9375**8)


def test_three_even_intervals_are_none_yet() -> None:
    gate = sought()
    fed = feed(gate, [0, 1000, 2000, 3000], [400, 1400])
    assert (fed.times, fed.used) == ([], (0, 0))
    assert mode(gate) == SEEKING


def test_the_state_behind_a_found_speed_is_that_of_its_first_rising_edge() -> None:
    """Then nothing is expected yet but the falling edge that belongs to it: the falling one before
    it is a pitch less the duty ago. Here the first two intervals are a hundredth apart."""
    gate = sought()
    feed(gate, [0, 990, 2000, 3000, 4000], [])
    assert value(gate, "duty") == 0.5
    first_rate = 1e-3
    error = 0.99 * 1e0 - 1.0
    assert error == pytest.approx(-0.01)
    assert value(gate, "rate_per_us") == pytest.approx(first_rate, rel=0.01)
    assert gate.last.tolist() == [504, 499]
    assert gate.part("last_us").tolist() == [NOW + 4000, NOW - 500]
    assert gate.part("interval_us").tolist() == [1000.0, 1000.0]


@pytest.mark.parametrize(("odd_us", "used"), [(1240, 0), (1260, 2), (810, 0), (790, 2)])
def test_neighbouring_intervals_of_a_speed_differ_by_a_quarter_at_most(
    odd_us: int, used: int
) -> None:
    """The second one is odd: with it there is no speed, and the edges before it are dropped."""
    gate = sought()
    rises = [0, 1000, 1000 + odd_us]
    rises += [rises[-1] + 1000 * k for k in range(1, 3)]
    fed = feed(gate, rises)
    assert (len(fed.times) > 0) is (used == 0)
    late = sought()
    rises += [rises[-1] + 1000 * k for k in range(1, 3)]
    fed = feed(late, rises)
    assert fed.teeth[:1] == [500 + used]


@pytest.mark.parametrize(("odd_us", "is_found"), [(1480, True), (1520, False)])
def test_on_a_wheel_with_missing_teeth_they_differ_by_a_half_at_most(
    odd_us: int, is_found: bool
) -> None:
    gate = sought(widest=2)
    feed(gate, [0, 1000, 1000 + odd_us, 2000 + odd_us, 3000 + odd_us], teeth=teeth_of(10, (7,)))
    assert (mode(gate) == SEARCHING) is is_found


@pytest.mark.parametrize(
    ("interval_us", "is_found"), [(8_780, True), (8_830, False), (222, True), (221, False)]
)
def test_a_speed_is_no_less_than_the_least_and_no_more_than_6000_rpm(
    interval_us: int, is_found: bool
) -> None:
    """45 teeth at 630 rad/s: 221.6 us a pitch. At 300 rad/s2 to a stop in three: 8,807 us."""
    assert abs(1.0 / LEAST - 8_807) < 1
    assert abs(PITCH_RAD / 630.0 * 1e6 - 221.6) < 0.1
    gate = sought()
    feed(gate, [interval_us * k for k in range(5)])
    assert (mode(gate) == COUNTING) is is_found


@pytest.mark.parametrize(("turned", "duty"), [(0, 0.4), (1, 0.6)])
def test_the_duty_is_the_sheet_s_where_not_every_tooth_has_its_falling_edge(
    turned: int, duty: float
) -> None:
    """On a wheel whose edges have changed places it is what the sheet's leaves."""
    gate = sought(duty=0.4)
    gate.part("turned")[0] = turned
    feed(gate, [1000 * k for k in range(5)], [300, 1300, 2300])
    assert value(gate, "duty") == pytest.approx(duty, abs=0.02)
    four = sought(duty=0.4)
    feed(four, [1000 * k for k in range(5)], [-700, 250, 1350, 2250, 3350])
    assert value(four, "duty") == pytest.approx(0.3, abs=0.03)


def test_falling_edges_before_a_wheel_s_first_rising_one_are_dropped() -> None:
    gate = sought()
    fed = feed(gate, [1000 * k for k in range(5)], [-1500, -500, 500, 1500, 2500, 3500])
    assert fed.times[:3] == [0, 500, 1000]
    assert fed.used == (5, 6)


def test_without_a_speed_edges_are_kept_that_may_yet_belong_to_one() -> None:
    """Four rising edges; the falling ones before the first of these are of no use."""
    gate = sought()
    rises = [0, 3000, 3500, 9000, 9100, 15_000, 15_010]
    fed = feed(gate, rises, [1000, 3200, 9050])
    assert (fed.times, fed.used[0]) == ([], 3)
    assert fed.used[1] == 2


def test_a_wheel_that_stands_still_has_no_count() -> None:
    gate = cruising(rejected=4)
    stand(gate.flat)
    assert health(gate) == (0, 0, 0, 1, 1)
    assert (mode(gate), gate.part("guess")[0], gate.part("rejected")[0]) == (SEEKING, UNKNOWN, 0)
    stand(gate.flat)
    assert health(gate) == (0, 0, 0, 1, 1)
    guessing = cruising(mode=SEARCHING, guess=3)
    stand(guessing.flat)
    assert health(guessing) == (0, 0, 0, 1, 1)


def test_polarities_change_places_after_two_gaps_of_the_other_one_or_where_it_is_alone() -> None:
    gate = cruising(other_gaps=1)
    gate.given[:] = 3, 4
    assert not turn(gate.flat, 0)
    assert mode(gate) == COUNTING
    gate.part("other_gaps")[0] = 2
    assert turn(gate.flat, 0)
    assert (gate.part("turned")[0], gate.part("other_gaps")[0]) == (1, 0)
    assert gate.given.tolist() == [0, 0]
    assert mode(gate) == SEEKING
    assert health(gate) == (0, 0, 0, 1, 0)
    assert turn(gate.flat, 1)
    assert gate.part("turned")[0] == 0
    assert health(gate) == (0, 0, 0, 1, 0)
