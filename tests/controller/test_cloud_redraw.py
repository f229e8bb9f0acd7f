"""A cloud of particles resampled: as often as they weigh, spread without being widened, and what
goes together stays together. Each against sums over the cloud before."""

from __future__ import annotations

import numpy as np
import pytest

from meshpoint.controller.estimate.lash import normal
from meshpoint.controller.estimate.lash_cloud import drawn, resampled
from meshpoint.controller.models.backlash import (
    ANGLE,
    DRAG,
    HALF,
    HILL,
    LOSS,
    ROWS,
    SPEED,
    STIFF,
    TYRE,
    TYRE_STIFF,
    VEHICLE,
    WAY,
    WHEELS,
)
from meshpoint.kernels.records import Vector

COUNT = 4000
NUMBERS = normal(COUNT)[:9, ::-1]
SPREAD = [WAY, WHEELS, TYRE, VEHICLE, HILL]
SHARES = [STIFF, LOSS, HALF, TYRE_STIFF]
EVEN = np.full(COUNT, 1.0 / COUNT)
COAST, BETWEEN, DRIVE = -0.01, 0.03, 0.11
"""Ways at the flank of coast, between the flanks and at the flank of drive of a backlash of 0.1."""


def quantities(x: Vector) -> Vector:
    return np.concatenate((x[SPREAD], np.log(x[SHARES])))


def a_cloud(*ways: float, seed: int = 1) -> Vector:
    """Drivelines around each of the ways, as many at each; wheels go with the vehicle, and wide
    backlashes with soft shafts."""
    chance = np.random.default_rng(seed)
    x = np.empty((ROWS, COUNT))
    x[ANGLE], x[SPEED], x[DRAG] = chance.normal((0.1, 60.0, 9.0), 0.1, (COUNT, 3)).T
    x[WAY] = np.resize(ways, COUNT) + 1e-3 * chance.normal(size=COUNT)
    x[VEHICLE] = 60.0 + 0.3 * chance.normal(size=COUNT)
    x[WHEELS] = x[VEHICLE] + 0.02 * chance.normal(size=COUNT)
    x[TYRE], x[HILL] = chance.normal((0.0, -0.5), (1e-3, 0.4), (COUNT, 2)).T
    wide = 0.02 * chance.normal(size=COUNT)
    x[HALF], x[STIFF] = 0.05 * np.exp(wide), 4000.0 * np.exp(-3.0 * wide)
    x[LOSS], x[TYRE_STIFF] = np.exp(chance.normal((-2.5, 8.6), 0.1, (COUNT, 2))).T
    return x


def covariance(rows: Vector, weights: Vector = EVEN) -> Vector:
    return np.cov(rows, aweights=weights, ddof=0)


@pytest.mark.parametrize("way", [COAST, BETWEEN, DRIVE])
def test_mean_and_covariance_are_as_they_were(way: float) -> None:
    """However unevenly the drivelines weigh."""
    x = a_cloud(way)
    weights = np.exp(2.0 * (x[VEHICLE] - 60.0) / 0.3)
    weights /= weights.sum()
    before, after = quantities(x), quantities(resampled(x, weights, NUMBERS))
    expected = covariance(before, weights)
    sds = np.sqrt(np.diag(expected))
    assert (after.mean(axis=1) - before @ weights) / sds == pytest.approx(0.0, abs=0.05)
    scale = np.outer(sds, sds)
    assert covariance(after) / scale == pytest.approx(expected / scale, abs=0.12)


def test_what_goes_together_stays_together_draw_after_draw() -> None:
    """Wheels with their vehicle, wide backlashes with soft shafts: ten draws by even weights."""
    x = a_cloud(BETWEEN)
    chance = np.random.default_rng(2)
    for _ in range(10):
        x = resampled(x, EVEN, chance.normal(size=(9, COUNT)))
    assert np.std(x[WHEELS] - x[VEHICLE]) == pytest.approx(0.02, rel=0.2)
    assert np.std(x[VEHICLE]) == pytest.approx(0.3, rel=0.2)
    assert np.corrcoef(np.log(x[HALF]), np.log(x[STIFF]))[0, 1] == pytest.approx(-1.0, abs=0.02)


@pytest.mark.parametrize("ways", [(COAST, BETWEEN), (BETWEEN, DRIVE), (COAST, DRIVE)])
def test_drivelines_in_one_contact_are_not_spread_by_how_far_others_lie(
    ways: tuple[float, float],
) -> None:
    """Two kinds at once, 0.04 rad apart or more and 0.001 wide each: both stay as narrow."""
    x = resampled(a_cloud(*ways), EVEN, NUMBERS)
    for way in ways:
        near = x[WAY][np.abs(x[WAY] - way) < 0.015]
        assert near.size == COUNT / 2
        assert near.std() == pytest.approx(1e-3, rel=0.1)


def test_copies_of_a_driveline_part_and_its_angle_speed_and_drag_stay() -> None:
    x, weights = a_cloud(BETWEEN), np.zeros(COUNT)
    weights[[5, 9]] = 0.7, 0.3
    found = resampled(x, weights, NUMBERS)
    chosen = drawn(weights, COUNT)
    for row in (ANGLE, SPEED, DRAG):
        assert found[row].tolist() == x[row, chosen].tolist()
    assert np.unique(found[WAY]).size > 0.9 * COUNT
    # Two of them leave a line to be on, and next to nothing beside it.
    before = quantities(x)
    line = (before[:, 9] - before[:, 5])[:, np.newaxis]
    off = quantities(found) - before[:, [5]]
    along = (line.T @ off) / float((line.T @ line).item())
    apart = np.abs(off - line * along) / np.abs(line)
    assert apart.max() < 0.02
    assert np.std(along) > 0.1


@pytest.mark.parametrize("weight", [1.0, 1e-3, 0.0])
def test_one_driveline_with_all_the_weight_is_all_of_the_cloud(weight: float) -> None:
    """The last one is, too, where rounding has left it none."""
    x, weights = a_cloud(BETWEEN), np.zeros(COUNT)
    x[WAY, -1], weights[-1] = DRIVE, weight
    found = resampled(x, weights, NUMBERS)
    assert found == pytest.approx(np.repeat(x[:, -1:], COUNT, axis=1))


@pytest.mark.parametrize(("weight", "times"), [(0.24, 2), (0.26, 3), (0.34, 3), (0.36, 4)])
def test_a_point_is_drawn_as_often_as_its_weight_rounded(weight: float, times: int) -> None:
    chosen = drawn(np.array([weight, 1.0 - weight]), 10)
    assert np.count_nonzero(chosen == 0) == times


def test_points_are_drawn_even_where_rounding_leaves_weights_that_are_less_than_one() -> None:
    assert drawn(np.array([0.5, 0.4]), 10).tolist() == [0] * 5 + [1] * 5


@pytest.mark.parametrize("weight", [4.6e-319, 1e-300, 1e-160])
def test_a_driveline_that_weighs_next_to_nothing_does_not_matter(weight: float) -> None:
    """A step raised: of so small a weight no correlation can be worked out."""
    weights = np.zeros(COUNT)
    weights[[7, 9]] = 1.0, weight
    for seed in range(10):
        x = a_cloud(COAST, seed=seed)
        found = resampled(x, weights, NUMBERS)
        wanted = np.repeat(quantities(x[:, [7]]), COUNT, axis=1)
        np.testing.assert_allclose(quantities(found), wanted, rtol=1e-6, atol=1e-12)
