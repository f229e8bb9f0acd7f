"""Time and impact after a change against those before it: how often the verdict is wrong."""

from __future__ import annotations

import math

import numpy as np
import pytest

from meshpoint.campaigns.paired_ratio import paired_ratio
from meshpoint.campaigns.verdict import Verdict, looks

RUNS = 500
CHANGES = 200


def verdicts(rise: float, scatter: float, margin: float) -> list[Verdict]:
    """Of simulated changes, looked at as campaigns are: runs of about the same time before, and
    after it by a share longer, but for a scatter."""
    rng = np.random.Generator(np.random.PCG64(7))
    found = []
    for _ in range(CHANGES):
        before = 1.0 + 0.16 * rng.standard_normal(RUNS)
        after = (before + scatter * rng.standard_normal(RUNS)) * (1.0 + rise)
        sums = list(zip(before.tolist(), after.tolist(), strict=True))
        verdict = Verdict.OPEN
        for runs in looks(RUNS):
            verdict = paired_ratio(sums[:runs], margin).verdict
            if verdict is not Verdict.OPEN:
                break
        found.append(verdict)
    return found


@pytest.mark.parametrize("scatter", [0.05, 0.16])
def test_no_change_is_called_worse_in_few_of_a_hundred_and_a_rise_by_the_margin_is_found(
    scatter: float,
) -> None:
    alike, slower = verdicts(0.0, scatter, 0.05), verdicts(0.05, scatter, 0.05)
    assert alike.count(Verdict.WORSE) <= 0.03 * CHANGES
    assert slower.count(Verdict.WORSE) >= 0.95 * CHANGES


def test_the_interval_is_that_of_a_ratio_of_means() -> None:
    """Three runs by hand: 33 over 30; residuals -0.4, 0.3, 0.1 of 11 / 10."""
    found = paired_ratio([(10.0, 10.6), (10.0, 11.3), (10.0, 11.1)], 0.05)
    assert found.value == pytest.approx(1.1)
    error = math.sqrt(3 / 2 * (0.16 + 0.09 + 0.01)) / 30
    assert found.high - found.value == pytest.approx(14.0890 * error, rel=1e-4)
    assert found.verdict is Verdict.OPEN, "of three runs nothing is said"


def test_pairs_that_did_not_change_are_not_worse() -> None:
    assert paired_ratio([(3.0, 3.0)] * 16, 0.05).verdict is Verdict.NOT_WORSE
    assert paired_ratio([(0.0, 0.0)] * 16, 0.05).verdict is Verdict.NOT_WORSE
    assert paired_ratio([(0.0, 0.1)] * 16, 0.05).verdict is Verdict.WORSE
