"""Whether one strategy was better than another, beyond chance or not, in a sentence."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.stats import binomtest, ttest_rel

from meshpoint.results.better import Judged, Outcome, by_pairs, sentence


def pairs(mine: list[float], theirs: list[float]) -> list[tuple[Outcome, Outcome]]:
    """Shifts of which the impact alone is known."""
    return [
        (Outcome(None, None, a), Outcome(None, None, b)) for a, b in zip(mine, theirs, strict=True)
    ]


@given(st.lists(st.tuples(st.floats(0.01, 5.0), st.floats(0.01, 5.0)), min_size=3, max_size=30))
def test_a_mean_is_beyond_chance_where_the_paired_t_test_says_so(
    both: list[tuple[float, float]],
) -> None:
    mine, theirs = (np.array(side) for side in zip(*both, strict=True))
    assume(np.ptp(mine - theirs) > 1e-6 and abs(mine.mean() - theirs.mean()) > 0.01)
    (judged,) = by_pairs(pairs(mine.tolist(), theirs.tolist()))
    p = ttest_rel(mine, theirs).pvalue
    if abs(p - 0.05) > 1e-6:
        assert judged.is_beyond_chance is bool(p < 0.05)
    assert judged.is_better is bool(mine.mean() < theirs.mean())


@pytest.mark.parametrize(("better", "worse"), [(6, 0), (5, 0), (9, 1), (7, 1), (0, 6), (1, 9)])
def test_a_share_of_gaps_is_judged_by_the_shifts_in_which_the_two_differ(
    better: int, worse: int
) -> None:
    sides = [(True, False)] * better + [(False, True)] * worse + [(True, True)] * 20
    (judged,) = by_pairs([(Outcome(a, None, None), Outcome(b, None, None)) for a, b in sides])
    assert judged.is_beyond_chance is bool(binomtest(better, better + worse).pvalue < 0.05)
    assert judged.is_better is (better > worse)
    assert judged.values == f"{20 + better} instead of {20 + worse} of {len(sides)}"


def test_a_shift_that_was_not_engaged_has_no_duration_and_one_shift_tells_nothing() -> None:
    row = {"contact": "gap", "duration_ms": 400.0, "impact_j": 1.0, "result": "ended_in_neutral"}
    assert Outcome.of(row) == Outcome(True, None, 1.0)
    (judged,) = by_pairs(pairs([0.1], [9.0]))
    assert (judged.is_better, judged.is_beyond_chance) == (True, False)


def test_the_sentence_says_both_where_one_is_better_and_the_other_worse() -> None:
    gaps = [(Outcome(True, 500.0 + k, 1.0), Outcome(False, 400.0 + k, 1.0)) for k in range(8)]
    assert sentence("a", "b", 8, by_pairs(gaps)) == (
        "On the same 8 shifts a is better than b in first contact in a gap and worse in time: "
        "first contact in a gap 8 instead of 0 of 8 (better, beyond chance); time 504 instead of "
        "404 ms (worse, beyond chance); impact 1.00 instead of 1.00 J."
    )
    assert sentence("a", "b", 2, by_pairs(pairs([1.0, 2.0], [2.0, 1.5]))) == (
        "On the same 2 shifts a differs from b by no more than chance: impact 1.50 instead of "
        "1.75 J (better, within chance)."
    )
    assert sentence("a", "b", 0, []) == ""


def test_where_chance_is_not_known_none_is_said_to_explain_the_difference() -> None:
    unknown = [Judged("time", "421 instead of 484 ms", True, None)]
    assert sentence("a", "b", 2, unknown) == (
        "On the same 2 shifts a cannot be judged against b, as chance is not known: time 421 "
        "instead of 484 ms (better, chance not known)."
    )
