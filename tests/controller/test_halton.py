"""Numbers that stand for chance: even ones for a first cloud, scattered ones for what is added."""

from __future__ import annotations

import numpy as np
import pytest

from meshpoint.controller.estimate.lash import PRIMES, normal, scattered_twice

COUNT = 2500


@pytest.mark.parametrize("row", range(len(PRIMES)))
def test_numbers_of_both_kinds_are_of_the_normal_law(row: int) -> None:
    """Even ones lie closer to it than drawn ones, of which a half lie within 0.83 / sqrt(n)."""
    from scipy.stats import kstest  # a second: not where tests are collected

    assert kstest(normal(COUNT)[row], "norm").statistic < 0.3 / np.sqrt(COUNT)
    assert kstest(scattered_twice(COUNT)[row, :COUNT], "norm").statistic < 1.36 / np.sqrt(COUNT)


def test_scattered_numbers_go_with_no_others() -> None:
    """Neither with a first cloud nor with those of another row or draw: of this many pairs, drawn
    ones would be 0.075 alike at most."""
    twice = scattered_twice(COUNT)
    draws = [twice[:, begin : begin + COUNT] for begin in range(0, COUNT, 311)]
    alike = np.corrcoef(np.concatenate((normal(COUNT), *draws)))
    np.fill_diagonal(alike, 0.0)
    alike[: len(PRIMES), : len(PRIMES)] = 0.0
    assert np.abs(alike).max() < 0.09
