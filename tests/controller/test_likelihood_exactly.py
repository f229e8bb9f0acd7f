"""Figures that are learned by their likelihood, step by step and by hand."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pytest

from meshpoint.controller.estimation.likelihood import Learned, _grid, _scan, _step, learn

WIDE = Learned(0.0, 0.5, -5.0, 5.0, 0.5, 0.01)


def test_variances_grow_by_a_tenth_from_shift_to_shift() -> None:
    (found,), _ = learn([Learned(0.3, 0.1, -5.0, 5.0, 0.5, 0.01)], lambda _: 0.0)
    assert found.sd == pytest.approx(0.1 * math.sqrt(1.1))


@pytest.mark.parametrize(
    ("least", "most", "steps"), [(-1.0, 1.0, 17), (0.0, 0.6, 5), (0.0, 0.61, 6), (0.0, 9.0, 17)]
)
def test_a_range_is_looked_at_every_twelve_hundredths_or_at_eighteen_places(
    least: float, most: float, steps: int
) -> None:
    """Both ends are among them."""
    found = _grid(Learned(0.0, 0.5, least, most, 0.5, 0.01))
    assert found == pytest.approx([least + (most - least) * i / steps for i in range(steps + 1)])


def test_a_scan_looks_at_the_range_then_three_times_around_the_best_by_thirds() -> None:
    """Two steps to each side of it, in this order; what is as good as the best does not replace
    it."""
    one, seen = Learned(0.0, 0.5, 0.0, 0.6, 0.5, 0.01), []

    def misfit(logs: Sequence[float]) -> float:
        seen.append(logs[0])
        return abs(logs[0] - 0.25)

    at, least = _scan([0.5], 0.25, [0], [one], misfit)
    step, best, expected = 0.12, 0.24, [0.12 * i for i in range(6)]
    for _ in range(3):
        step /= 3.0
        tried = [best + i * step for i in (-2, -1, 0, 1, 2)]
        expected += tried
        best = min([best, *tried], key=lambda log: abs(log - 0.25))
    assert seen == pytest.approx(expected)
    assert at == pytest.approx([best])
    assert least == pytest.approx(abs(best - 0.25))
    at, _ = _scan([0.5], 0.25, [0], [one], lambda _: 0.25)
    assert at == [0.5]


@pytest.mark.parametrize(("sd", "scanned"), [(0.119, False), (0.121, True), (0.14, True)])
def test_a_figure_that_is_known_to_twelve_hundredths_is_not_scanned_for(
    sd: float, scanned: bool
) -> None:
    seen: list[float] = []
    one = Learned(0.0, sd, -1.0, 1.0, sd, 0.01)
    learn([one], lambda logs: seen.append(logs[0]) or 1.0, (0,))  # type: ignore[func-returns-value]
    assert (-1.0 in seen) is scanned


def test_a_figure_is_stepped_twice() -> None:
    """Three looks a step, once it is known where it begins."""
    seen: list[float] = []

    def misfit(logs: Sequence[float]) -> float:
        seen.append(logs[0])
        return 4.0 * (logs[0] - 0.3) ** 2

    learn([WIDE], misfit)
    assert sum(log != 0.0 for log in seen) == 2 * 3


@pytest.mark.parametrize(("sd", "reach"), [(0.5, 0.25), (0.1, 0.05), (0.018, 0.01), (2.0, 1.0)])
def test_probes_lie_half_a_deviation_to_either_side_or_a_hundredth(sd: float, reach: float) -> None:
    """A step to the minimum goes no further than twice as far."""
    for way in (-1.0, 1.0):
        seen: list[float] = []

        def misfit(logs: Sequence[float], way: float = way, seen: list[float] = seen) -> float:
            seen.append(logs[0])
            return (logs[0] - 9.0 * way) ** 2

        one = Learned(0.0, sd, -50.0, 50.0, 3.0, 0.001)
        at, _, _ = _step([0.0], 81.0, 0, one, misfit)
        assert seen[:2] == pytest.approx([-reach, reach])
        assert at == pytest.approx([2.0 * reach * way])


def test_where_the_misfit_is_no_parabola_the_best_probe_inside_the_range_is_taken() -> None:
    """And the figure is as unsure as before."""
    one = Learned(0.0, 0.5, -0.25, 0.2, 0.5, 0.01)
    for slope, taken in ((1.0, -0.25), (-1.0, 0.0)):
        found = _step([0.0], 1.0, 0, one, lambda logs, s=slope: 1.0 + s * logs[0])  # type: ignore[misc]
        assert found == ([taken], 1.0 + slope * taken, 0.5)
    found = _step([0.0], 1.0, 0, WIDE, lambda logs: 1.0 - logs[0] ** 2 + 0.1 * logs[0])
    assert (found[0], found[2]) == ([-0.25], 0.5)
    assert found[1] == pytest.approx(1.0 - 0.0625 - 0.025)
    found = _step([0.0], 1.0, 0, WIDE, lambda logs: math.inf if logs[0] > 0.0 else 0.5)
    assert found == ([0.0], 1.0, 0.5)


def test_a_flat_valley_is_a_parabola_too() -> None:
    """A curvature of 0.5: its deviation would be 2, and what was known is surer."""
    at, _, sd = _step([0.0], 0.01, 0, WIDE, lambda logs: 0.25 * (logs[0] - 0.2) ** 2)
    assert at == pytest.approx([0.2])
    assert sd == 0.5


def test_no_figure_is_ever_known_better_than_it_may_be() -> None:
    (found,), _ = learn([WIDE], lambda logs: 1e8 * logs[0] ** 2)
    assert found.sd == 0.01
