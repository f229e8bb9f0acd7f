"""What a cloud of particles is spread by when it is resampled: each time by numbers that no
driveline at that place was spread by before, or the same ones would be pushed the same way again
and again."""

from __future__ import annotations

import numpy as np
import pytest
from test_lash import Truth, a_lash

from meshpoint.controller.estimate import lash_cloud
from meshpoint.controller.estimate.lash import LashStart
from meshpoint.controller.estimate.lash_cloud import BacklashParticleFilter
from meshpoint.kernels.records import Vector

TOOTH_RAD = 5e-4
LEAST_DRAWS = 4


@pytest.fixture(scope="module")
def draws() -> list[Vector]:
    """The numbers of each time that a cloud was resampled, by the edges of one driveline."""
    spread_by: list[Vector] = []
    resampled = lash_cloud.resampled

    def noted(x: Vector, weights: Vector, numbers: Vector) -> Vector:
        spread_by.append(numbers.copy())
        return resampled(x, weights, numbers)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(lash_cloud, "resampled", noted)
        lash = a_lash()
        cloud = BacklashParticleFilter(lash, LashStart(0.0, 0.0, 60.0, 60.0), 1e-6)
        cloud.take(Truth(lash, 3, TOOTH_RAD).edges, TOOTH_RAD)
    assert len(spread_by) >= LEAST_DRAWS
    return spread_by


def test_no_place_in_the_cloud_gets_the_same_numbers_twice(draws: list[Vector]) -> None:
    for k, numbers in enumerate(draws):
        for before in draws[:k]:
            assert (numbers != before).any(axis=0).all()
            assert abs(np.corrcoef(numbers.ravel(), before.ravel())[0, 1]) < 0.05


def test_the_numbers_of_each_draw_are_those_of_a_normal_law_and_independent(
    draws: list[Vector],
) -> None:
    for numbers in draws:
        assert numbers.mean(axis=1) == pytest.approx(0.0, abs=0.05)
        assert np.cov(numbers) == pytest.approx(np.eye(len(numbers)), abs=0.08)
