"""Where a gear's gap is, each part of it: against the law of a look, written with SciPy's normal
law, and Bayes' rule over middles."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
import pytest
from scipy.stats import norm

from meshpoint.controller.phase.gap_posterior import CELLS, INDEPENDENT, LOOK_SHARES, GapPosterior
from meshpoint.controller.records import Vector

PITCH, BACKLASH = 3.0, 0.625
CELL = 0.01
"""A cell of 300; looks lie on cells, so that none is moved to the next one."""
MIDDLES: Vector = CELL * np.arange(300.0)
SHARES = (0.1, 0.12, 0.14, 0.17, 0.2, 0.24, 0.28)
"""Deviations, in backlashes, by which looks are counted."""


def wrapped(phase: Vector) -> Vector:
    """Within half a pitch of 0."""
    return np.asarray(phase - PITCH * np.round(phase / PITCH))


def density(phase: Vector, sd: float) -> Vector:
    """Of a look at a phase from the middle: 3 of 5 are at a flank, 1 of 50 is astray anywhere, the
    others are even over the gap and blurred by the look's own error."""
    half = BACKLASH / 2.0
    at_flank = 0.5 * (norm.pdf(phase, half, sd) + norm.pdf(phase, -half, sd))
    amid = (norm.cdf(phase + half, scale=sd) - norm.cdf(phase - half, scale=sd)) / BACKLASH
    return np.asarray(0.98 * (0.6 * at_flank + 0.4 * amid) + 0.02 / PITCH)


def posterior(looks: list[tuple[float, float]]) -> GapPosterior:
    """By looks: raw phase, and standard deviation in backlashes."""
    found = GapPosterior(PITCH, BACKLASH)
    for raw, share in looks:
        found.look(raw, share * BACKLASH)
    return found


def by_bayes(looks: list[tuple[float, float]]) -> tuple[float, float, float]:
    """Probability that the middle is within 0.3 backlashes of the likeliest, mean and deviation
    there; every look tells as much as a quarter of one by itself."""
    logs: Vector = np.zeros(300)
    for (raw, each), count in Counter(looks).items():
        logs += 0.25 * count * np.log(density(wrapped(raw - MIDDLES), each * BACKLASH))
    weight = np.exp(logs - np.max(logs))
    weight /= weight.sum()
    best = MIDDLES[np.argmax(weight)]
    away = wrapped(MIDDLES - best)
    near = np.abs(away) < 0.3 * BACKLASH
    share = weight[near].sum()
    mean = weight[near] @ away[near] / share
    sd = math.sqrt(weight[near] @ (away[near] - mean) ** 2 / share)
    return float(share), float(best + mean), sd


def both_flanks(at: float, count: int, share: float = 0.1) -> list[tuple[float, float]]:
    """So many looks at each flank of a gap, as near as there are cells."""
    return [(at - 0.31, share), (at + 0.31, share)] * count


@pytest.mark.parametrize("share", SHARES)
def test_one_look_makes_each_middle_as_likely_as_its_density_from_there(share: float) -> None:
    found = posterior([(0.42, share)])
    expected = density(wrapped(0.42 - MIDDLES), share * BACKLASH)
    assert np.exp(found._log / 0.25) == pytest.approx(expected, rel=1e-9)
    assert found._looks.sum() == 1.0
    assert found._looks[SHARES.index(share), 42] == 1.0
    assert (CELLS, INDEPENDENT, LOOK_SHARES) == (300, 0.25, SHARES)


@pytest.mark.parametrize("share", SHARES)
def test_the_density_of_a_look_is_one(share: float) -> None:
    whole = np.exp(posterior([(0.0, share)])._log / 0.25)
    assert whole.sum() * CELL == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("share", [0.0, 0.05, 0.11, 0.12, 0.15, 0.241])
def test_a_look_counts_with_the_next_larger_deviation(share: float) -> None:
    larger = min(each for each in SHARES if each >= share)
    assert np.array_equal(posterior([(1.0, share)])._log, posterior([(1.0, larger)])._log)


def test_a_look_that_is_too_vague_counts_for_nothing() -> None:
    found = posterior([(1.0, 0.2801), (1.1, 0.9)])
    assert not found._log.any()
    assert not found._looks.any()
    found.look(1.0, 0.28 * BACKLASH)
    assert found._looks.sum() == 1.0


@pytest.mark.parametrize(("raw", "cell"), [(1.234, 123), (1.236, 124), (-0.01, 299), (2.999, 0),
                                           (3.5, 50), (-7.0, 200)])  # fmt: skip
def test_a_look_lies_in_the_nearest_cell_of_a_pitch(raw: float, cell: int) -> None:
    assert posterior([(raw, 0.1)])._looks[0].argmax() == cell


@pytest.mark.parametrize("at", [1.0, 0.05, 2.9])
@pytest.mark.parametrize("share", [0.1, 0.17, 0.28])
def test_the_middle_is_what_bayes_rule_makes_of_the_looks(at: float, share: float) -> None:
    """Also near the end of a pitch; with more looks at one flank, and some amid the gap."""
    looks = [*both_flanks(at, 150, share), *[(at + 0.31, share)] * 9, *[(at + 0.1, share)] * 8]
    certain, raw, sd = by_bayes(looks)
    assert certain > 0.99
    middle = posterior(looks).middle()
    assert middle is not None
    assert middle.raw_rad == pytest.approx(raw, abs=1e-9)
    assert middle.sd_rad == pytest.approx(sd, rel=1e-6)
    assert abs(wrapped(np.array(middle.raw_rad - at))) < 0.02


def test_the_middle_is_known_where_97_of_100_lie_near_the_likeliest() -> None:
    """Looks at one flank, and ever more at the other one: from when on is told by Bayes' rule."""
    first = [(0.7, 0.2)] * 40
    told = as_told(first, [[(1.3, 0.2)]] * 40)
    assert any(0.9 < share < 0.97 for share in told)
    assert any(0.97 <= share < 0.99 for share in told)


def as_told(first: list[tuple[float, float]], more: list[list[tuple[float, float]]]) -> list[float]:
    """The probability near the likeliest middle after each of these; what is told of it then is
    what Bayes' rule says."""
    looks, found, shares = list(first), posterior(first), []
    for each in more:
        for look in each:
            found.look(look[0], look[1] * BACKLASH)
        looks += each
        share, raw, sd = by_bayes(looks)
        middle = found.middle()
        assert (middle is not None) is (share >= 0.97)
        if middle is not None:
            assert middle.raw_rad == pytest.approx(raw, abs=1e-9)
            assert middle.sd_rad == pytest.approx(sd, rel=1e-6)
        shares.append(share)
    return shares


@pytest.mark.parametrize("share", [0.14, 0.28])
@pytest.mark.parametrize("first", [1.0, 1.2])
def test_few_looks_tell_it_as_vaguely_as_they_do(first: float, share: float) -> None:
    """Of some the middle is known just so, with much of what is likely near the limit."""
    told = as_told([(first, share)], [both_flanks(1.0, 1, share)] * 40)
    assert any(each < 0.97 for each in told)
    assert any(0.97 <= each < 0.99 for each in told)


@pytest.mark.parametrize(("share", "inside", "outside"), [(0.1, 0.38, 0.39), (0.2, 0.46, 0.47),
                                                          (0.28, 0.52, 0.53)])  # fmt: skip
def test_where_more_than_a_tenth_of_the_looks_lie_outside_the_gap_is_elsewhere(
    share: float, inside: float, outside: float
) -> None:
    """Outside is beyond 1.2 deviations from a flank: with 0.1 backlashes, 0.3125 + 0.075."""
    most = both_flanks(1.0, 45, share)
    beyond, within = ([(1.0 - by, share), (1.0 + by, share)] for by in (outside, inside))
    assert posterior([*most, *beyond * 5]).middle() is not None, "10 of 100"
    assert posterior([*most, *beyond * 6]).middle() is None, "12 of 102"
    assert posterior([*most, *within * 6]).middle() is not None
    assert posterior([*most, *beyond * 5, *within * 20]).middle() is not None
