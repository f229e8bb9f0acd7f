"""The edge gate that counts a wheel, verdict by verdict, on edges set by hand (`gate_bench`)."""

from __future__ import annotations

import math

import pytest
from gate_bench import LEAST, NOW, cruising, feed, health, mode, value

from meshpoint.controller.sensing.gate_layout import (
    COUNTING,
    SEEKING,
    UNKNOWN,
    new_gate,
    teeth_of,
)


def test_a_new_gate_looks_for_a_wheel_between_its_least_speed_and_6000_rpm() -> None:
    gate = new_gate(0.2, 0.4, 300.0, 150.0, 3)
    assert value(gate, "least_rate_per_us") == pytest.approx(math.sqrt(6.0 * 150.0 / 0.2) * 1e-6)
    assert value(gate, "most_rate_per_us") == pytest.approx(630.0 / 0.2 * 1e-6)
    assert value(gate, "bend_per_us2") == pytest.approx(0.5 * 300.0 / 0.2 * 1e-12)
    assert value(gate, "duty_share") == 0.4
    assert value(gate, "pitch_rad") == 0.2
    assert (mode(gate), gate.part("guess")[0], gate.part("widest")[0]) == (SEEKING, UNKNOWN, 3)


def test_a_gate_that_forgets_looks_for_its_wheel_anew_and_counts_no_loss() -> None:
    gate = cruising(guess=7, rejected=3)
    gate.forget()
    assert (mode(gate), gate.part("guess")[0], gate.part("rejected")[0]) == (SEEKING, UNKNOWN, 0)
    assert health(gate) == (0, 0, 0, 0, 0)


def test_a_wheel_s_teeth_are_told_by_the_way_from_each_to_the_next() -> None:
    assert teeth_of(9, ()).tolist() == [[1], [0]]
    advance, room = teeth_of(9, (3, 4, 8))
    assert advance.tolist() == [1, 1, 3, 0, 0, 1, 1, 2, 0]
    assert not room.any()
    assert teeth_of(5, (0,))[0].tolist() == [0, 1, 1, 1, 2]


def test_edges_of_both_polarities_come_in_order_with_their_teeth_and_angles() -> None:
    """A falling edge has the tooth of the rising one before it, and a duty share more."""
    gate = cruising()
    fed = feed(gate, [1000, 2000], [500, 1500, 2500])
    assert fed.times == [500, 1000, 1500, 2000, 2500]
    assert fed.teeth == [100, 101, 101, 102, 102]
    assert fed.falling == [1, 0, 1, 0, 1]
    assert fed.angles == pytest.approx([100.5, 101.0, 101.5, 102.0, 102.5])
    assert (fed.extra, fed.used) == ([], (2, 3))
    assert health(gate) == (0, 0, 0, 0, 0)
    assert gate.last.tolist() == [102, 102]
    assert gate.part("last_us").tolist() == [NOW + 2000, NOW + 2500]
    assert gate.part("interval_us").tolist() == [1000.0, 1000.0]
    assert (value(gate, "at"), value(gate, "tooth"), value(gate, "falling")) == (0.5, 102, 1)
    assert value(gate, "found_us") == 1


def test_edges_of_a_turned_wheel_change_places_and_its_teeth_begin_with_the_falling_one() -> None:
    """So a rising edge is the second of its tooth, and begins the next one."""
    gate = cruising(turned=1)
    gate.part("duty_share")[0] = 0.4
    fed = feed(gate, [1000], [500])
    assert fed.teeth == [101, 101]
    assert fed.falling == [0, 1]
    assert fed.angles == pytest.approx([101.0, 101.4])


def test_an_edge_no_later_than_the_last_one_with_a_tooth_is_used_up_without_one() -> None:
    gate = cruising()
    fed = feed(gate, [-600, 0, 1000], [-10, 500])
    assert (fed.times, fed.extra, fed.used) == ([500, 1000], [], (3, 2))


@pytest.mark.parametrize("off_us", [5, -25])
def test_a_gate_follows_speed_place_duty_and_scatter_by_shares_of_what_an_edge_is_off(
    off_us: int,
) -> None:
    """It lagged by 0.01 already. Of the error: 0.3 over the way to the speed, 0.4 is left in place,
    a fiftieth goes to the duty, and a sixteenth to the scatter."""
    gate = cruising(lag=0.01)
    feed(gate, [], [500 + off_us])
    error = 0.01 + off_us * 1e-3
    assert value(gate, "rate_per_us") == pytest.approx(1e-3 * (1.0 - 0.3 * error / 0.5), rel=1e-12)
    assert value(gate, "lag") == pytest.approx(0.4 * error, rel=1e-9)
    assert value(gate, "duty") == pytest.approx(0.5 + 0.02 * error, rel=1e-12)
    scatter = 0.002 + 0.0625 * (abs(error) - 0.002)
    assert value(gate, "scatter") == pytest.approx(scatter, rel=1e-9)
    assert gate.part("interval_us")[1] == 1000 + off_us
    assert value(gate, "at") == 0.5


@pytest.mark.parametrize("way", [0.8, 0.3])
def test_the_way_to_a_rising_edge_is_what_the_duty_leaves_but_half_a_pitch_at_least(
    way: float,
) -> None:
    gate = cruising(falling=1, at=1.0 - way, duty=1.0 - way)
    gate.last[:] = 100, 100
    feed(gate, [round(1000 * way) + 10])
    assert value(gate, "rate_per_us") == pytest.approx(1e-3 * (1.0 - 0.3 * 0.01 / max(way, 0.5)))
    assert value(gate, "duty") == 1.0 - way
    assert value(gate, "lag") == pytest.approx(0.004)


@pytest.mark.parametrize("off", [0.2, -0.2])
def test_no_more_than_three_twentieths_of_a_pitch_move_speed_and_scatter(off: float) -> None:
    """The place follows all of it. The next edge, a pitch later, shows that this one is true."""
    gate = cruising()
    fed = feed(gate, [1000 + round(1000 * off), 2000 + round(1000 * off)])
    assert fed.times[0] == 1000 + round(1000 * off)
    gate = cruising()
    fed = feed(gate, [1000 + round(1000 * off)], [500, 1500, 3500])
    assert fed.teeth[:2] == [100, 101]
    only = cruising()
    only.part("scatter")[0] = 0.1
    feed(only, [1000 + round(1000 * off)])
    bounded = math.copysign(0.15, off)
    assert value(only, "rate_per_us") == pytest.approx(1e-3 * (1.0 - 0.3 * bounded))
    assert value(only, "lag") == pytest.approx(0.4 * off)
    assert value(only, "scatter") == pytest.approx(0.1 + 0.0625 * 0.05)


def test_scatter_is_no_less_than_a_five_hundredth_of_a_pitch() -> None:
    gate = cruising()
    feed(gate, [1000])
    assert value(gate, "scatter") == 0.002


@pytest.mark.parametrize(
    ("time_us", "way"), [(700, 0.7), (500, 0.6), (1250, 1.25), (1900, 1.4), (40, 0.6)]
)
def test_each_edge_of_a_dragged_shaft_is_the_next_one_and_its_speed_that_since_the_last(
    time_us: int, way: float
) -> None:
    """No more than four tenths of a pitch off; nothing lags."""
    gate = cruising(dragged=1, lag=0.0, scatter=0.01)
    fed = feed(gate, [time_us])
    assert (fed.times, fed.teeth) == ([time_us], [101])
    assert value(gate, "rate_per_us") == pytest.approx(1e-3 / way)
    assert value(gate, "lag") == 0.0
    scatter = 0.01 + 0.0625 * (abs(way - 1.0) - 0.01)
    assert value(gate, "scatter") == pytest.approx(scatter)


def test_scatter_is_no_more_than_a_fifth_of_a_pitch() -> None:
    gate = cruising(dragged=1, scatter=0.2)
    feed(gate, [1600], teeth=teeth_of(45, (44,)))
    assert value(gate, "scatter") == 0.2


@pytest.mark.parametrize(
    ("off_us", "is_sure"), [(49, True), (51, False), (-49, True), (-51, False)]
)
def test_an_edge_is_believed_at_once_within_a_fiftieth_and_three_scatters(
    off_us: int, is_sure: bool
) -> None:
    """Else it waits for the next edge of its polarity."""
    gate = cruising(scatter=0.01)
    fed = feed(gate, [1000 + off_us])
    assert fed.used == (int(is_sure), 0)
    assert fed.times == ([1000 + off_us] if is_sure else [])
    assert value(gate, "rejected") == 0


@pytest.mark.parametrize(("last_us", "waits"), [(2599, True), (2601, False)])
def test_an_edge_waits_for_the_next_one_till_the_other_polarity_is_a_pitch_and_a_half_on(
    last_us: int, waits: bool
) -> None:
    gate = cruising()
    fed = feed(gate, [1100], [500, 1500, last_us])
    assert (1100 in fed.times) is not waits
    assert fed.used[0] == int(not waits)


@pytest.mark.parametrize(
    ("second_us", "taken"), [(1039, 1039), (1041, 940), (961, 961), (959, 940)]
)
def test_of_two_edges_for_one_tooth_the_nearer_counts_if_it_is_nearer_by_a_fiftieth(
    second_us: int, taken: int
) -> None:
    """The first is 60 us early. The one that is left out is told as extra."""
    gate = cruising()
    fed = feed(gate, [940, second_us, 2000, 3000, 4000])
    assert fed.times[0] == taken
    assert fed.teeth[:3] == [101, 102, 103]
    assert fed.extra == [940 + second_us - taken]
    assert health(gate) == (1, 0, 0, 0, 0)


@pytest.mark.parametrize(
    ("scatter", "second_us", "taken"),
    [(0.041, 1240, 630), (0.039, 1240, 1240), (0.041, 1220, 1220)],
)
def test_on_an_erratic_wheel_edges_six_tenths_of_a_pitch_apart_may_be_of_two_teeth(
    scatter: float, second_us: int, taken: int
) -> None:
    """The first is 0.37 of a pitch early, the next one a bit less late."""
    gate = cruising(scatter=scatter)
    fed = feed(gate, [630, second_us, 2100])
    assert fed.times[0] == taken
    assert fed.teeth[0] == 101


@pytest.mark.parametrize(("first_us", "is_extra"), [(590, True), (610, False)])
def test_an_edge_more_than_four_tenths_of_a_pitch_early_is_out_of_its_turn(
    first_us: int, is_extra: bool
) -> None:
    """With the next one at the tooth's own place either is extra; with the next one of another
    tooth, the one that is in its turn has its tooth."""
    gate = cruising()
    fed = feed(gate, [first_us, 1000, 2000, 3000])
    assert (fed.times, fed.extra) == ([1000, 2000, 3000], [first_us])
    gate = cruising()
    fed = feed(gate, [first_us, 2000 - 400, 2600])
    assert (first_us in fed.times) is not is_extra


def test_behind_an_extra_edge_the_next_must_be_within_a_quarter_of_a_pitch() -> None:
    for late_us, taken in ((240, True), (260, False)):
        gate = cruising(rejected=1)
        fed = feed(gate, [1000 + late_us, 2000 + late_us, 3000 + late_us])
        assert (fed.teeth[:1] == [101]) is taken
    for early_us, taken in ((240, True), (260, False)):
        gate = cruising(rejected=1)
        fed = feed(gate, [1000 - early_us, 2000, 3000])
        assert (fed.times[:1] == [1000 - early_us]) is taken


@pytest.mark.parametrize(("last_us", "is_known"), [(2799, False), (2801, True)])
def test_an_edge_out_of_its_place_waits_for_the_two_after_it_no_longer_than_two_and_a_half_pitches(
    last_us: int, is_known: bool
) -> None:
    gate = cruising()
    fed = feed(gate, [300, 1000], [500, 1500, last_us])
    assert (fed.extra == [300]) is is_known
    assert fed.used[0] == (2 if is_known else 0)
    lone = cruising()
    assert feed(lone, [300, 1000]).used == (0, 0)


def test_an_extra_edge_is_left_out_and_the_count_goes_on() -> None:
    gate = cruising()
    fed = feed(gate, [300, 1000, 2000, 3000], [500, 1500, 2500])
    assert fed.extra == [300]
    assert fed.times == [500, 1000, 1500, 2000, 2500, 3000]
    assert fed.teeth == [100, 101, 101, 102, 102, 103]
    assert health(gate) == (1, 0, 0, 0, 0)
    assert value(gate, "rejected") == 0


def test_of_an_extra_falling_edge_the_same_is_true() -> None:
    gate = cruising()
    fed = feed(gate, [1000, 2000, 3000], [30, 500, 1500, 2500])
    assert fed.extra == [30]
    assert fed.teeth == [100, 101, 101, 102, 102, 103]


@pytest.mark.parametrize("rises", [[300, 300, 1000], [300, 1000, 1000]])
def test_edges_at_one_time_show_that_the_one_out_of_its_place_is_extra(rises: list[int]) -> None:
    gate = cruising()
    assert feed(gate, rises).extra[0] == 300


@pytest.mark.parametrize(
    ("interval_us", "step_us", "is_true"),
    [(700.0, 450, True), (900.0, 450, False), (850.0, 450, True), (700.0, 380, False),
     (700.0, 410, True)],
)  # fmt: skip
def test_an_edge_too_early_is_true_if_all_intervals_about_it_are_within_a_factor_of_1_5(
    interval_us: float, step_us: int, is_true: bool
) -> None:
    """590 us after the last, and the next two: the shaft has become quicker than any can. Then the
    whole wheel's count is given up, for nobody knows what was between."""
    gate = cruising()
    gate.part("interval_us")[0] = interval_us
    rises = [590, 590 + step_us, 590 + 2 * step_us]
    feed(gate, rises)
    assert (mode(gate) == SEEKING) is is_true
    assert health(gate)[2:4] == ((1, 1) if is_true else (0, 0))
    if is_true:
        assert value(gate, "rate_per_us") == pytest.approx(1.0 / step_us)
        assert value(gate, "rejected") == 0


@pytest.mark.parametrize("uneven_us", [280, 650])
def test_an_edge_whose_two_next_ones_are_uneven_is_extra(uneven_us: int) -> None:
    gate = cruising()
    gate.part("interval_us")[0] = 700.0
    feed(gate, [590, 590 + 430, 590 + 430 + uneven_us])
    assert health(gate)[2:4] == (0, 0)
    assert health(gate)[0] > 0


def test_a_missing_edge_of_one_polarity_is_seen_by_the_other() -> None:
    """Rising edge 101 did not come, falling edge 101 did."""
    gate = cruising()
    fed = feed(gate, [2000], [500, 1500])
    assert fed.teeth == [100, 101, 102]
    assert health(gate) == (0, 1, 0, 0, 0)
    assert gate.part("interval_us")[0] == 1000.0


def test_falling_edges_that_are_missing_are_counted() -> None:
    gate = cruising()
    fed = feed(gate, [1000, 2000, 3000], [3500])
    assert fed.teeth == [101, 102, 103, 103]
    assert health(gate) == (0, 3, 0, 0, 0)


@pytest.mark.parametrize(("skipped", "is_clear"), [(1, True), (2, True), (3, False)])
def test_behind_a_hole_two_teeth_may_be_missing(skipped: int, is_clear: bool) -> None:
    """Of both polarities. Else a whole wheel's count is given up, as of a doubt."""
    gate = cruising()
    late = 1000 * (skipped + 1)
    fed = feed(gate, [late])
    assert fed.teeth == ([101 + skipped] if is_clear else [])
    assert health(gate) == ((0, skipped, 0, 0, 0) if is_clear else (0, 0, 1, 1, 0))
    assert mode(gate) == (COUNTING if is_clear else SEEKING)


def test_behind_a_hole_nothing_is_believed_after_an_extra_edge() -> None:
    gate = cruising(rejected=1)
    feed(gate, [2000])
    assert health(gate) == (0, 0, 1, 1, 0)


@pytest.mark.parametrize(("off_us", "is_clear"), [(240, True), (260, False), (-240, True)])
def test_behind_a_hole_an_edge_is_within_a_quarter_of_a_pitch_of_its_tooth(
    off_us: int, is_clear: bool
) -> None:
    gate = cruising()
    feed(gate, [2000 + off_us, 3000 + off_us])
    assert (mode(gate) == COUNTING) is is_clear


@pytest.mark.parametrize(("off_us", "is_clear"), [(55, True), (60, False)])
def test_behind_a_hole_acceleration_and_an_error_of_speed_leave_less_than_half_a_pitch_open(
    off_us: int, is_clear: bool
) -> None:
    """At 55 us off: 0.055 and, of a shaft that may be 0.09 pitches/ms2 quicker, 0.09 times 2.055
    squared, and three hundredths of 2.055: 0.497. At 60: 0.504."""
    gate = cruising(bend_per_us2=9e-8)
    feed(gate, [2000 + off_us, 3000 + off_us])
    assert (mode(gate) == COUNTING) is is_clear
    early = cruising(bend_per_us2=9e-8)
    feed(early, [2000 - 79, 3000 - 79])
    assert mode(early) == COUNTING
    early = cruising(bend_per_us2=9.7e-8)
    feed(early, [2000 - 95, 3000 - 95])
    assert mode(early) == SEEKING


@pytest.mark.parametrize(("late_us", "is_hole"), [(1740, False), (1760, True)])
def test_a_hole_is_three_quarters_of_a_pitch_more_than_to_the_next_edge(
    late_us: int, is_hole: bool
) -> None:
    """Within it an edge between two teeth is extra, behind it a doubt."""
    odd = cruising()
    odd.part("rejected")[0] = 1
    feed(odd, [late_us])
    assert health(odd)[2:4] == ((1, 1) if is_hole else (0, 0))


@pytest.mark.parametrize(
    ("silent_us", "doubts", "stops"), [(8_700, 1, 0), (8_900, 0, 0), (17_500, 0, 0), (17_700, 0, 1)]
)
def test_a_wheel_that_was_silent_for_a_pitch_of_the_least_speed_is_gone(
    silent_us: int, doubts: int, stops: int
) -> None:
    """It may have stopped in twice that time."""
    assert silent_us * LEAST == pytest.approx(round(silent_us * LEAST), abs=0.03)
    gate = cruising()
    feed(gate, [silent_us])
    assert health(gate) == (0, 0, doubts, 1, stops)
    assert mode(gate) == SEEKING


def test_from_a_falling_edge_on_the_way_to_the_next_one_counts_as_a_pitch_all_the_same() -> None:
    gate = cruising(falling=1, at=0.5)
    gate.last[:] = 100, 100
    feed(gate, [8_700])
    assert health(gate) == (0, 0, 1, 1, 0)


@pytest.mark.parametrize(("before", "is_lost"), [(59, False), (60, True)])
def test_after_more_than_sixty_edges_without_a_tooth_the_count_is_given_up(
    before: int, is_lost: bool
) -> None:
    gate = cruising(rejected=before)
    fed = feed(gate, [300, 300, 350])
    assert fed.extra == [300]
    assert mode(gate) == (SEEKING if is_lost else COUNTING)


@pytest.mark.parametrize(("silent_us", "is_lost"), [(17_500, False), (17_700, True)])
def test_extra_edges_alone_for_two_pitches_of_the_least_speed_are_no_wheel(
    silent_us: int, is_lost: bool
) -> None:
    """It turned so slowly that none was due yet."""
    gate = cruising(rate_per_us=2e-5)
    feed(gate, [silent_us, silent_us, silent_us + 1])
    assert value(gate, "extra") >= 1
    assert (health(gate)[3] == 1) is is_lost


@pytest.mark.parametrize(("rate", "stops"), [(LEAST * 0.99, 1), (LEAST * 1.01, 0)])
def test_a_wheel_below_its_least_speed_has_stopped(rate: float, stops: int) -> None:
    gate = cruising(rate_per_us=rate)
    fed = feed(gate, [round(1.0 / rate)])
    assert health(gate) == (0, 0, 0, stops, stops)
    assert len(fed.times) == 1 - stops


@pytest.mark.parametrize(("scatter", "is_lost"), [(0.106, False), (0.108, True)])
def test_a_whole_wheel_that_scatters_by_more_than_a_tenth_of_a_pitch_has_no_count(
    scatter: float, is_lost: bool
) -> None:
    """This edge takes a sixteenth of it away."""
    gate = cruising(scatter=scatter)
    fed = feed(gate, [1000])
    assert mode(gate) == (SEEKING if is_lost else COUNTING)
    assert health(gate) == (0, 0, 0, int(is_lost), 0)
    assert fed.times == ([] if is_lost else [1000])


def test_where_teeth_are_lost_only_the_edges_after_it_are_told() -> None:
    """They are numbered by the sensor's own count from there on."""
    gate = cruising()
    gate.part("interval_us")[0] = 700.0
    rises = [590 + 450 * k for k in range(9)]
    fed = feed(gate, rises)
    assert health(gate)[3] == 1
    assert fed.times == rises[1:]
    assert fed.teeth == list(range(501, 509))
    assert mode(gate) == COUNTING
