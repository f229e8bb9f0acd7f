"""A wheel with missing teeth: which tooth is which, from its gaps, and when that is in doubt.

Ten teeth of which the eighth, number 7, is missing; a tooth takes a millisecond."""

from __future__ import annotations

import pytest
from gate_bench import NOW, Fed, cruising, feed, health, mode, sought, value

from meshpoint.controller.records import Integers
from meshpoint.controller.sensing.gate_layout import (
    COUNTING,
    SEARCHING,
    SEEKING,
    UNKNOWN,
    GateMemory,
    teeth_of,
)

SIZE = 10
MISSING = (7,)
PRESENT = [k for k in range(SIZE) if k not in MISSING]


def wheel() -> Integers:
    return teeth_of(SIZE, MISSING)


def at(tooth: int, **fields: float) -> GateMemory:
    """Counting; the rising edge of this tooth has just come."""
    gate = cruising(tooth=tooth, widest=2, **fields)
    gate.last[:] = tooth, tooth - 1
    return gate


def searching(
    candidates: list[int], searched: int, gaps: int = 0, guess: int = UNKNOWN, **fields: float
) -> tuple[GateMemory, Integers]:
    """The first edge of the search may have been of these teeth; it is so many pitches ago. The
    newest rising edge was given the number 500."""
    gate = at(500, mode=SEARCHING, searched=searched, gaps=gaps, **fields)
    gate.part("guess")[0] = guess
    teeth = wheel()
    teeth[1, candidates] = 1
    return gate, teeth


def possible(teeth: Integers) -> list[int]:
    return [k for k in range(teeth.shape[1]) if teeth[1, k] == 1]


def turned(first: int, last: int) -> tuple[list[int], list[int]]:
    """Rising and falling edges of the teeth from the first to the last one."""
    rises = [1000 * k for k in range(first, last + 1) if k % SIZE in PRESENT]
    return rises, [each + 500 for each in rises]


@pytest.mark.parametrize("first", [1, 3, 8])
def test_teeth_are_numbered_by_the_drawing_after_a_turn_that_fits(first: int) -> None:
    """Eleven pitches or more behind the first edge: then a whole turn was seen."""
    gate, teeth = sought(widest=2), wheel()
    begin = first if first != 3 else 8
    rises, falls = turned(begin, begin + 25)
    fed = feed(gate, rises, falls, teeth)
    numbered = next(k for k in range(begin + 11, begin + 14) if k % SIZE in PRESENT)
    assert fed.times[0] == 1000 * numbered
    assert [tooth % SIZE for tooth in fed.teeth] == [time // 1000 % SIZE for time in fed.times]
    assert fed.falling[:3] == [0, 1, 0]
    assert health(gate) == (0, 0, 0, 0, 0)
    assert mode(gate) == COUNTING
    assert value(gate, "guess") == UNKNOWN
    assert value(gate, "found_us") == NOW + fed.times[0]


def test_a_gap_is_gone_through_by_the_drawing() -> None:
    """From tooth 6 the next one is 8."""
    gate = at(106)
    fed = feed(gate, [2000, 3000], [500, 2500], wheel())
    assert fed.teeth == [106, 108, 108, 109]
    assert health(gate) == (0, 0, 0, 0, 0)
    assert gate.part("interval_us")[0] == 1000.0


def test_steps_that_do_not_fit_strike_teeth_off() -> None:
    """After four pitches and one more, it was no tooth that has a gap there."""
    gate, teeth = searching(PRESENT, 4)
    feed(gate, [1000], teeth=teeth)
    assert possible(teeth) == [k for k in PRESENT if (k + 4) % SIZE not in (6, 7)]
    assert (value(gate, "searched"), value(gate, "gaps")) == (5, 0)
    assert mode(gate) == SEARCHING


def test_a_gap_leaves_the_tooth_that_has_one_there() -> None:
    gate, teeth = searching(PRESENT, 4)
    fed = feed(gate, [2000], teeth=teeth)
    assert possible(teeth) == [2]
    assert (value(gate, "searched"), value(gate, "gaps")) == (6, 1)
    assert mode(gate) == SEARCHING
    assert fed.times == []
    assert gate.last[0] == 502
    assert value(gate, "missed") == 0


def test_an_edge_that_the_sensor_missed_is_no_gap() -> None:
    """The falling edge of its tooth came. Any tooth may be there that exists."""
    gate, teeth = searching(PRESENT, 4)
    feed(gate, [2000], [500, 1500], teeth)
    assert possible(teeth) == [k for k in PRESENT if (k + 6) % SIZE != 7]
    assert (value(gate, "searched"), value(gate, "gaps")) == (6, 0)
    assert health(gate)[1] == 0


@pytest.mark.parametrize(("searched", "is_counting"), [(9, False), (10, True)])
def test_one_tooth_that_fits_is_believed_after_more_than_a_turn(
    searched: int, is_counting: bool
) -> None:
    """The first edge was of tooth 2, so with the next one it is tooth 2 + 9 or 10 + 1. What was
    numbered 501 is the next number from there that is so on the drawing."""
    gate, teeth = searching([2], searched, gaps=1)
    gate.part("gap_hits")[0] = 2
    fed = feed(gate, [1000], teeth=teeth)
    assert mode(gate) == (COUNTING if is_counting else SEARCHING)
    assert fed.teeth == ([503] if is_counting else [])
    assert gate.last.tolist() == ([503, 501] if is_counting else [501, 499])
    assert value(gate, "tooth") == (503 if is_counting else 501)
    assert value(gate, "gap_hits") == 0
    assert health(gate)[3] == 0


def test_two_teeth_that_fit_are_not_told_apart_however_long() -> None:
    gate, teeth = searching([2, 3], 20, gaps=2)
    assert feed(gate, [1000], teeth=teeth).times == []
    assert possible(teeth) == [2, 3]


@pytest.mark.parametrize(
    ("guess", "lost", "tooth"), [(692, 0, 693), (693, 1, 503), (UNKNOWN, 0, 503)]
)
def test_a_count_that_was_in_doubt_goes_on_where_the_gaps_agree_with_it(
    guess: int, lost: int, tooth: int
) -> None:
    """The search says tooth 3. A guess of 692 was at 2 and is at 3 now, so no number is lost."""
    gate, teeth = searching([2], 10, gaps=1, guess=guess)
    fed = feed(gate, [1000], teeth=teeth)
    assert fed.teeth == [tooth]
    assert health(gate) == (0, 0, 0, lost, 0)
    assert value(gate, "guess") == UNKNOWN


@pytest.mark.parametrize(("gaps", "lost"), [(0, 0), (1, 1)])
def test_without_a_gap_a_doubtful_count_is_not_given_up(gaps: int, lost: int) -> None:
    """One tooth is left, and the count says another."""
    gate, teeth = searching([2], 2, gaps=gaps, guess=605)
    feed(gate, [1000], teeth=teeth)
    assert health(gate)[3] == lost
    assert value(gate, "guess") == (UNKNOWN if lost else 606)


def test_a_doubtful_count_goes_through_the_gap_by_the_drawing_and_by_steps_elsewhere() -> None:
    gate, teeth = searching([2], 4, guess=606)
    feed(gate, [2000], teeth=teeth)
    assert value(gate, "guess") == 608
    missed, teeth = searching(PRESENT, 4, guess=603)
    feed(missed, [2000], [500, 1500], teeth)
    assert value(missed, "guess") == 605
    early, teeth = searching(PRESENT, 4, guess=606)
    feed(early, [1000], teeth=teeth)
    assert value(early, "guess") == 608


@pytest.mark.parametrize("guess", [UNKNOWN, 601])
def test_steps_that_fit_no_tooth_begin_the_search_anew(guess: int) -> None:
    """A count that was in doubt is lost with it."""
    gate, teeth = searching([2], 4, gaps=1, guess=guess)
    feed(gate, [1000], teeth=teeth)
    assert possible(teeth) == PRESENT
    assert (value(gate, "searched"), value(gate, "gaps")) == (0, 0)
    assert health(gate)[3] == int(guess != UNKNOWN)
    assert mode(gate) == SEARCHING


def test_a_gap_that_fits_no_tooth_is_the_first_of_the_new_search() -> None:
    """Behind it is tooth 8."""
    gate, teeth = searching([3], 4)
    feed(gate, [2000], teeth=teeth)
    assert possible(teeth) == [8]
    assert value(gate, "searched") == 0


@pytest.mark.parametrize(
    ("seen_us", "is_gap"), [(1760, True), (1740, False), (2890, True), (2910, False)]
)
def test_a_gap_looks_longer_or_shorter_by_less_than_a_factor_of_1_45(
    seen_us: int, is_gap: bool
) -> None:
    """And it is a hole: three quarters of a pitch beyond the next one. A hole that is no gap ends
    the search."""
    gate, teeth = searching(PRESENT, 4)
    feed(gate, [seen_us], teeth=teeth)
    assert (value(gate, "gaps") == 1) is is_gap
    if seen_us == 2910:
        assert mode(gate) == SEEKING
        assert health(gate) == (0, 0, 1, 0, 0)


@pytest.mark.parametrize(("seen_us", "wide"), [(2430, 2), (2470, 3)])
def test_of_two_gaps_the_one_counts_that_is_nearer_by_its_ratio(seen_us: int, wide: int) -> None:
    """Of two and of three pitches: between them at the root of six, 2.449."""
    gate, _ = searching([], 4)
    gate.part("widest")[0] = 3
    teeth = teeth_of(SIZE, (3, 4, 7))
    teeth[1] = teeth[0] > 0
    feed(gate, [seen_us], teeth=teeth)
    assert value(gate, "searched") == 4 + wide
    assert gate.last[0] == 500 + wide
    assert value(gate, "lag") == pytest.approx(0.4 * (seen_us / 1000.0 - wide))


def test_a_gap_behind_an_extra_edge_ends_the_search() -> None:
    gate, teeth = searching(PRESENT, 4, rejected=1)
    feed(gate, [2000], teeth=teeth)
    assert (mode(gate), health(gate)) == (SEEKING, (0, 0, 1, 0, 0))


def test_a_gap_that_ends_with_a_falling_edge_is_counted_for_a_change_of_places() -> None:
    gate, teeth = searching(PRESENT, 4, other_gaps=1)
    feed(gate, [], [1500], teeth)
    assert value(gate, "other_gaps") == 2
    assert (mode(gate), health(gate)) == (SEEKING, (0, 0, 1, 0, 0))
    own, teeth = searching(PRESENT, 4, other_gaps=1)
    feed(own, [2000], teeth=teeth)
    assert value(own, "other_gaps") == 0


def test_a_search_ends_where_the_wheel_was_silent_for_its_widest_gap_at_its_least_speed() -> None:
    """8.8 ms a pitch, twice: it may have stopped then, for nothing was counted it is no loss."""
    for silent_us, gone in ((17_500, 0), (17_700, 1)):
        gate, teeth = searching(PRESENT, 4, guess=601)
        feed(gate, [silent_us], teeth=teeth)
        assert mode(gate) == SEEKING
        assert health(gate) == (0, 0, 1 - gone, 1, gone)


def hit(extra_us: int, before_us: float = 1000.0) -> tuple[GateMemory, Fed]:
    """Before the gap's end an edge comes where the wheel has no tooth."""
    gate = at(106)
    gate.part("interval_us")[0] = before_us
    return gate, feed(gate, [extra_us, 2000, 3000, 4000], teeth=wheel())


@pytest.mark.parametrize(
    ("extra_us", "is_doubt"), [(1000, True), (1240, True), (1260, False), (760, True), (740, False)]
)
def test_an_edge_in_the_gap_where_a_tooth_would_be_speaks_against_the_count(
    extra_us: int, is_doubt: bool
) -> None:
    """Within a quarter of a pitch of its place. The edge is extra all the same, and the count goes
    on as a guess till the next gap."""
    gate, fed = hit(extra_us)
    assert fed.extra == [extra_us]
    assert health(gate) == (1, 0, int(is_doubt), 0, 0)
    assert mode(gate) == (SEARCHING if is_doubt else COUNTING)
    assert fed.times == ([] if is_doubt else [2000, 3000, 4000])
    if is_doubt:
        assert value(gate, "guess") == 110
        assert value(gate, "searched") == 2


def test_an_edge_in_its_turn_but_for_an_extra_one_says_nothing_of_the_gap() -> None:
    """Half a pitch before a tooth that has another before it."""
    gate = at(104)
    fed = feed(gate, [10, 1000, 2000, 4000, 5000], teeth=wheel())
    assert fed.extra == [10]
    assert fed.teeth == [105, 106, 108, 109]
    assert health(gate)[2] == 0


def test_falling_edges_in_the_gap_do_not_speak_against_the_count() -> None:
    gate = at(106, falling=0)
    fed = feed(gate, [2000], [500, 1500, 2500, 3500], wheel())
    assert fed.extra == [1500]
    assert fed.teeth[:2] == [106, 108]
    assert health(gate)[2] == 0


@pytest.mark.parametrize(("before_us", "is_extra"), [(920.0, True), (905.0, False)])
def test_an_edge_in_the_gap_is_extra_where_intervals_are_calm_without_it(
    before_us: float, is_extra: bool
) -> None:
    """Within a tenth of each other: 1,000 us a pitch through the gap and after it, beside those
    before. With the edge at 1,250 us they differ by less than a half, too."""
    gate, fed = hit(1250, before_us)
    assert (fed.extra == [1250]) is is_extra
    assert health(gate)[2] == int(not is_extra)
    if not is_extra:
        assert mode(gate) == SEARCHING


def test_in_doubt_the_count_goes_on_as_if_the_edge_were_true_and_nothing_else_is_learned() -> None:
    """The guess has the edge's tooth, 108; the speed is that of its next interval, 750 us."""
    gate = at(106)
    gate.part("interval_us")[0] = 905.0
    teeth = wheel()
    fed = feed(gate, [1250, 2000, 3000], teeth=teeth)
    assert fed.times == []
    assert gate.last[0] == 109
    assert value(gate, "guess") == 109
    assert health(gate) == (0, 0, 1, 0, 0)
    assert value(gate, "searched") == 1
    assert possible(teeth) == [k for k in PRESENT if k != 6]
    assert value(gate, "rate_per_us") == pytest.approx(1.0 / 750.0)


def test_an_edge_behind_a_hole_puts_the_count_in_doubt_with_a_guess() -> None:
    """Of tooth 103 and 104 nothing came. Their edges are taken to be missing, for the guess."""
    gate, teeth = at(102), wheel()
    fed = feed(gate, [3000], teeth=teeth)
    assert (mode(gate), fed.times) == (SEARCHING, [])
    assert value(gate, "guess") == 105
    assert possible(teeth) == PRESENT
    assert health(gate) == (0, 0, 1, 0, 0)
    assert value(gate, "rate_per_us") == 1e-3
    assert value(gate, "lag") == 0.0
    assert (value(gate, "time_us"), value(gate, "rejected")) == (NOW + 3000, 0)


def test_a_falling_edge_behind_a_hole_leaves_the_guess_of_the_rising_one_before() -> None:
    gate = at(102)
    feed(gate, [], [3500], wheel())
    assert mode(gate) == SEARCHING
    assert value(gate, "guess") == 102


def test_a_long_silence_of_a_wheel_with_gaps_is_a_doubt_and_no_loss() -> None:
    """The gaps will show whether the count was right; the guess is the tooth that was due."""
    gate = at(102)
    feed(gate, [9_000], teeth=wheel())
    assert mode(gate) == SEARCHING
    assert value(gate, "guess") == 103
    assert health(gate) == (0, 0, 1, 0, 0)


@pytest.mark.parametrize(
    ("late_us", "is_taken"), [(1510, True), (1530, False), (470, False), (490, True)]
)
def test_on_a_wheel_with_gaps_that_scatters_edges_may_be_further_off(
    late_us: int, is_taken: bool
) -> None:
    """Six times what it scatters beyond four hundredths: 0.4 and 0.12 of a pitch."""
    gate = at(102, scatter=0.06)
    fed = feed(gate, [late_us, late_us + 1000], teeth=wheel())
    assert (fed.teeth[:1] == [103]) is is_taken
    quiet = at(102, scatter=0.04)
    assert feed(quiet, [late_us, late_us + 1000], teeth=wheel()).teeth == []
    whole = cruising(scatter=0.06)
    assert feed(whole, [late_us, late_us + 1000]).teeth == []


def test_through_a_gap_edges_may_be_off_by_as_much_a_pitch() -> None:
    gate = at(106, scatter=0.06)
    assert feed(gate, [2630, 3630], teeth=wheel()).teeth[:1] == [108]
    gate = at(106, scatter=0.06)
    assert feed(gate, [2650, 3650], teeth=wheel()).teeth == []


def test_a_tooth_is_no_skipped_one_where_the_wheel_has_none() -> None:
    """Rising edge 106 was missed, and an edge comes at 107, of which there is no tooth."""
    gate = at(105)
    fed = feed(gate, [2000], [500, 1500], wheel())
    assert fed.teeth == [105, 106]
    assert fed.used[0] == 0
    there = at(104)
    fed = feed(there, [2000], [500, 1500], wheel())
    assert fed.teeth == [104, 105, 106]
    assert health(there)[1] == 1


@pytest.mark.parametrize(("third_us", "is_true"), [(450, True), (250, False)])
def test_an_edge_out_of_its_place_in_a_search_has_a_tooth_where_the_intervals_are_even(
    third_us: int, is_true: bool
) -> None:
    gate, teeth = searching(PRESENT, 4)
    gate.part("interval_us")[0] = 700.0
    fed = feed(gate, [590, 1040, 1040 + third_us], teeth=teeth)
    assert (fed.extra[:1] == [590]) is not is_true
    assert value(gate, "doubts") == 0
    if is_true:
        assert value(gate, "searched") >= 5


def test_a_wheel_with_gaps_that_scatters_much_is_counted_on() -> None:
    gate = at(102, scatter=0.15)
    assert feed(gate, [1000], teeth=wheel()).teeth == [103]
    assert mode(gate) == COUNTING
