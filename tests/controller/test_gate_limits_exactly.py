"""The edge gate at its very limits, and what it does not touch. A tooth takes a millisecond."""

from __future__ import annotations

import pytest
from gate_bench import NOW, cruising, feed, health, mode, sought, value
from test_gate_search_exactly import at, wheel

from meshpoint.controller.sensing.gate_kernels import warm_up
from meshpoint.controller.sensing.gate_layout import COUNTING, SEEKING, UNKNOWN

EXACT = 2.0**-13
"""A least speed that is told exactly: a pitch in 8,192 us."""


@pytest.mark.parametrize(
    ("silent_us", "doubts", "stops"), [(8_192, 1, 0), (8_193, 0, 0), (16_384, 0, 0), (16_385, 0, 1)]
)
def test_a_wheel_is_gone_after_more_than_a_pitch_and_has_stopped_after_more_than_two(
    silent_us: int, doubts: int, stops: int
) -> None:
    gate = cruising(least_rate_per_us=EXACT)
    feed(gate, [silent_us])
    assert health(gate) == (0, 0, doubts, 1, stops)


@pytest.mark.parametrize(("silent_us", "lost"), [(16_384, 0), (16_385, 1)])
def test_extra_edges_are_no_wheel_after_more_than_two_pitches(silent_us: int, lost: int) -> None:
    gate = cruising(rate_per_us=2e-5, least_rate_per_us=EXACT)
    feed(gate, [silent_us, silent_us, silent_us + 1])
    assert health(gate)[3] == lost


def test_a_wheel_at_its_very_least_speed_is_counted() -> None:
    gate = cruising(rate_per_us=EXACT, least_rate_per_us=EXACT)
    assert feed(gate, [8_192]).teeth == [101]
    assert health(gate) == (0, 0, 0, 0, 0)


@pytest.mark.parametrize(("interval_us", "is_found"), [(8_192, True), (8_193, False)])
def test_a_speed_may_be_the_very_least_and_no_less(interval_us: int, is_found: bool) -> None:
    """What is slower has never been a wheel: nothing is lost with it."""
    gate = sought()
    gate.part("least_rate_per_us")[0] = EXACT
    feed(gate, [interval_us * k for k in range(5)])
    assert (mode(gate) == COUNTING) is is_found
    assert health(gate) == (0, 0, 0, 0, 0)


@pytest.mark.parametrize(("interval_us", "is_found"), [(256, True), (255, False)])
def test_a_speed_may_be_the_very_highest_and_no_higher(interval_us: int, is_found: bool) -> None:
    gate = sought()
    gate.part("most_rate_per_us")[0] = 2.0**-8
    feed(gate, [interval_us * k for k in range(5)])
    assert (mode(gate) == COUNTING) is is_found


def test_a_falling_edge_far_behind_its_place_is_out_of_its_place_and_no_hole() -> None:
    """Half a pitch late: a hole would be three quarters behind where it was due, at 1.25."""
    gate = cruising()
    assert feed(gate, [], [1000]).used == (0, 0)
    assert health(gate) == (0, 0, 0, 0, 0)
    behind = cruising(rejected=1)
    feed(behind, [], [1260])
    assert health(behind) == (0, 0, 1, 1, 0)


def test_behind_a_falling_edge_a_hole_begins_three_quarters_after_the_next_rising_one() -> None:
    """That is due half a pitch later; after an extra edge a hole is a doubt."""
    for late_us, is_hole in ((1240, False), (1260, True)):
        gate = cruising(falling=1, at=0.5, rejected=1, time_us=NOW)
        gate.last[:] = 100, 100
        feed(gate, [late_us])
        assert (health(gate)[2] == 1) is is_hole


@pytest.mark.parametrize(("late_us", "is_taken"), [(570, True), (590, False)])
def test_from_a_falling_edge_through_a_gap_it_is_a_pitch_and_a_half(
    late_us: int, is_taken: bool
) -> None:
    """By which six times the scatter beyond four hundredths is multiplied: 0.4 and 0.18."""
    gate = at(106, falling=1, at=0.5, scatter=0.06)
    gate.last[:] = 106, 106
    fed = feed(gate, [1500 + late_us, 2500 + late_us], teeth=wheel())
    assert (fed.teeth[:1] == [108]) is is_taken


def test_a_whole_wheel_s_count_has_no_guess() -> None:
    """Neither beside a missing edge nor behind a hole."""
    for rises, falls in (([2000], [500, 1500]), ([2000], []), ([3000], [])):
        gate = cruising()
        feed(gate, rises, falls)
        assert (mode(gate), value(gate, "guess")) == (COUNTING, UNKNOWN)


def test_a_guess_behind_a_hole_that_a_falling_edge_ends_is_the_last_rising_one() -> None:
    """Two of its teeth may be missing: that falling edge is of tooth 104."""
    gate = at(102)
    feed(gate, [], [2500], wheel())
    assert value(gate, "guess") == 102


def test_nothing_lags_in_a_dragged_shaft() -> None:
    gate = cruising(dragged=1, lag=0.1)
    feed(gate, [700])
    assert value(gate, "lag") == 0.0
    assert value(gate, "rate_per_us") == pytest.approx(1e-3 / 0.8)


@pytest.mark.parametrize(("second_us", "taken"), [(505, 505), (545, 440)])
def test_of_two_falling_edges_for_one_tooth_the_nearer_counts(second_us: int, taken: int) -> None:
    gate = cruising()
    fed = feed(gate, [], [440, second_us, 1500, 2500, 3500])
    assert fed.times[0] == taken
    assert fed.teeth[:2] == [100, 101]


def test_an_edge_and_one_of_the_other_polarity_at_one_time_are_one() -> None:
    """The rising one has its tooth, the falling one none."""
    gate = cruising()
    fed = feed(gate, [1000], [1000])
    assert (fed.times, fed.falling, fed.used) == ([1000], [0], (1, 1))


def test_a_gate_goes_on_from_batch_to_batch() -> None:
    gate = cruising()
    assert feed(gate, [1000, 2000], [500]).teeth == [100, 101, 102]
    assert feed(gate, [3000], [2500, 3500]).teeth == [102, 103, 103]
    assert health(gate)[0] == 0


def test_one_edge_of_the_other_polarity_is_enough_to_wait_for() -> None:
    gate = cruising()
    assert feed(gate, [1100], [2601]).used[0] == 1
    extra = cruising()
    assert feed(extra, [300, 1000], [2801]).extra == [300]


def test_a_found_wheel_s_first_edge_is_a_rising_one_at_its_tooth() -> None:
    gate = sought()
    fed = feed(gate, [1000 * k for k in range(5)], [400 + 1000 * k for k in range(4)])
    assert fed.falling[:3] == [0, 1, 0]
    assert fed.angles[:3] == pytest.approx([500.0, 500.5, 501.0])


def test_edges_that_are_no_wheel_leave_no_trace() -> None:
    gate = sought()
    feed(gate, [0, 3000, 3500, 9000, 9100, 15_000, 15_010])
    for name in ("rate_per_us", "duty", "time_us", "tooth"):
        assert value(gate, name) == 0.0


def test_a_wheel_whose_falling_edges_all_came_before_has_the_sheet_s_duty() -> None:
    gate = sought(duty=0.4)
    fed = feed(gate, [1000 * k for k in range(5)], [-700, -300])
    assert fed.times == [1000 * k for k in range(5)]
    assert value(gate, "duty") == pytest.approx(0.4)


@pytest.mark.parametrize(
    ("falls", "duty"),
    [([0, 300, 1300, 2300, 3300], 0.3), ([500, 1000, 2500, 3500], 0.375)],
)
def test_a_falling_edge_at_a_rising_one_s_time_belongs_to_the_tooth_that_begins(
    falls: list[int], duty: float
) -> None:
    """At the very first it is of the tooth before."""
    gate = sought(duty=0.4)
    feed(gate, [1000 * k for k in range(5)], falls)
    assert value(gate, "duty") == pytest.approx(duty, abs=0.012)


def test_an_extra_edge_near_the_tooth_behind_a_gap_says_nothing_of_the_gap() -> None:
    """Of two edges for tooth 108 the nearer counts, and the count is in no doubt."""
    gate = at(106)
    fed = feed(gate, [1800, 2010, 3000, 4000], teeth=wheel())
    assert fed.extra == [1800]
    assert fed.teeth == [108, 109, 110]
    assert health(gate)[2] == 0


@pytest.mark.parametrize(("tooth", "rises"), [(105, [590, 1490, 1940]), (104, [590, 1040, 1940])])
def test_a_gap_among_the_next_edges_is_taken_by_the_pitch(tooth: int, rises: list[int]) -> None:
    """A shaft that is quicker than it can be, before a gap or two teeth before it: all intervals
    are even, 450 us a pitch. Its count is in doubt, and goes on at that speed."""
    gate = at(tooth)
    gate.part("interval_us")[0] = 700.0
    feed(gate, rises, teeth=wheel())
    assert health(gate)[2] == 1
    assert value(gate, "rate_per_us") == pytest.approx(1.0 / 450.0)


def test_a_gate_that_is_warmed_up_has_nothing_to_judge() -> None:
    warm_up()
    gate = sought()
    assert feed(gate, []).times == []
    assert mode(gate) == SEEKING
