"""Figures that are learned by their likelihood, on misfits whose minimum is known on paper."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import pytest

from meshpoint.controller.estimation.likelihood import Learned, learn, prior, restored

WIDE = Learned(0.0, 0.5, -5.0, 5.0, 0.5, 0.01)


def quadratic(*minima: tuple[float, float]) -> Callable[[Sequence[float]], float]:
    """Twice the negative logarithm of a normal law of independent figures: mean and sd each."""

    def misfit(logs: Sequence[float]) -> float:
        return sum(((log - at) / sd) ** 2 for log, (at, sd) in zip(logs, minima, strict=True))

    return misfit


@pytest.mark.parametrize("at", [-0.3, 0.0, 0.4])
@pytest.mark.parametrize("sd", [0.05, 0.2])
def test_figures_of_normal_likelihood_are_learned_as_by_bayes(at: float, sd: float) -> None:
    """The product of what was known, its variance a tenth larger from shift to shift but no larger
    than at first, and of what the window says."""
    known = [WIDE, Learned(0.2, 0.1, -5.0, 5.0, 0.5, 0.01)]
    found = learn(known, quadratic((at, sd), (0.1, 0.3))).figures
    before = 0.5**2, 1.1 * 0.1**2
    for one, (mean, variance), (log, spread) in zip(
        found, ((0.0, before[0]), (0.2, before[1])), ((at, sd), (0.1, 0.3)), strict=True
    ):
        weights = 1.0 / variance, spread**-2
        assert one.log == pytest.approx((mean * weights[0] + log * weights[1]) / sum(weights))
        assert one.sd == pytest.approx(sum(weights) ** -0.5)


def test_a_figure_of_which_a_shift_tells_nothing_is_known_less_well_behind_it() -> None:
    found = [Learned(0.3, 0.1, -5.0, 5.0, 0.5, 0.01)]
    for shifts in range(1, 60):
        found = learn(found, lambda _: 0.0).figures
        assert found[0].log == pytest.approx(0.3)
        assert found[0].sd == pytest.approx(min(0.1 * 1.1 ** (shifts / 2.0), 0.5))


def test_a_figure_is_never_known_better_than_it_may_be_nor_beyond_its_range() -> None:
    (sure,) = learn([WIDE], quadratic((0.0, 1e-4))).figures
    assert sure.sd == WIDE.least_sd
    for far, end in ((9.0, 0.4), (-9.0, -0.4)):
        figures = [Learned(0.0, 0.5, -0.4, 0.4, 0.5, 0.01)]
        for _ in range(60):
            figures = learn(figures, quadratic((far, 0.01))).figures
        assert figures[0].log == pytest.approx(end)


def test_of_several_minima_the_deepest_in_the_range_is_found_where_the_figure_is_scanned() -> None:
    """One at each half; the one at 2.0 is a little deeper."""

    def misfit(logs: Sequence[float]) -> float:
        return 40.0 * math.sin(math.pi * logs[0]) ** 2 - 50.0 * math.exp(-((logs[0] - 2.0) ** 2))

    one = Learned(0.0, 1.0, -3.0, 3.0, 1.0, 0.01)
    (plain,), (scanned,) = learn([one], misfit).figures, learn([one], misfit, (0,)).figures
    assert abs(plain.log) < 0.2
    assert scanned.log == pytest.approx(2.0, abs=0.05)


def test_what_is_known_at_first_and_what_an_earlier_run_learned() -> None:
    one = prior(0.3, 2.0, (0.01, 4.0), 0.02)
    assert one.value == pytest.approx(0.3)
    assert (one.sd, one.least_sd) == (pytest.approx(math.log(2.0)), 0.02)
    again = restored(one, 0.5, 0.1)
    assert (again.value, again.sd) == (pytest.approx(0.5), pytest.approx(0.1))
