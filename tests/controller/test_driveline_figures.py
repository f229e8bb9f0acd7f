"""The figures of a driveline in its backlash: the sheet's as felt at the main shaft, how
measurements and windows correct them; each against the formula of the textbook."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from meshpoint.controller.estimate.lash import (
    LEAST_DRAG,
    LEAST_SHARE_SD,
    SEEN_SDS,
    Lash,
    LashStart,
)
from meshpoint.controller.estimate.lash_cloud import MOST_OFF, correct
from meshpoint.controller.models.backlash import (
    ANGLE,
    DRAG,
    HALF,
    HILL,
    LOSS,
    ROWS,
    SPEED,
    STIFF,
    TYRE_STIFF,
    VEHICLE,
    WAY,
)
from meshpoint.gearbox.driveline import Axle

AXLE, RATIO, BACKLASH_RAD, FACTOR = Axle(), 0.27, math.radians(2.0), 2.0
TURNED_KGM2 = AXLE.main_kgm2 + AXLE.propeller_kgm2 * RATIO**2
VEHICLE_SDS = (0.3, 8.0)


def a_lash() -> Lash:
    return Lash(AXLE, BACKLASH_RAD, FACTOR, RATIO)


def test_a_driveline_s_figures_are_the_sheet_s_as_felt_at_the_main_shaft() -> None:
    """A torque at the propeller shaft is i times that at the main shaft, an angle 1 / i of it; an
    even law between two limits has their half distance over the root of 3."""
    lash = a_lash()
    assert [figure.value for figure in lash.known] == pytest.approx([
        AXLE.shaft_nm_rad * RATIO**2 / TURNED_KGM2, AXLE.flank_loss_s_rad * RATIO,
        BACKLASH_RAD / 2.0 / RATIO, (AXLE.pinion_nm * RATIO + AXLE.loose_nm) / TURNED_KGM2,
    ])  # fmt: skip
    assert [figure.sd for figure in lash.known] == pytest.approx(
        (AXLE.shaft_tolerance, math.log(AXLE.flank_loss_factor),
         math.log(FACTOR) / 3**0.5, AXLE.pinion_tolerance / 3**0.5)
    )  # fmt: skip
    assert lash.shafts == pytest.approx((AXLE.shaft_nm_rad, BACKLASH_RAD / 2.0))
    assert lash.model(-60.0) == pytest.approx(
        (TURNED_KGM2 / (AXLE.wheels_kgm2 * RATIO**2), AXLE.tyre_nms / AXLE.wheels_kgm2,
         60.0 * RATIO / AXLE.relaxation_rad)
    )  # fmt: skip
    chance_rad_s2 = math.hypot(AXLE.main_chance_nm, RATIO * AXLE.propeller_chance_nm) / TURNED_KGM2
    assert lash.chance == pytest.approx((2.0 * chance_rad_s2**2 * AXLE.chance_s, AXLE.chance_s))


def test_a_first_cloud_scatters_as_what_is_not_known_each_figure_by_itself() -> None:
    """Logarithms of what has no sign; vehicle and hill by their covariance where one was
    reported."""
    lash, root = a_lash(), np.array(((0.2, 0.0), (1.0, 3.0)))
    start = LashStart(0.0, 3.0, 61.0, 60.0, -2.0)
    plain, reported = lash.cloud(start), lash.cloud(start._replace(vehicle_root=root))
    logs = [np.log(plain[row]) for row in (STIFF, LOSS, HALF)]
    tyre = math.log(AXLE.tyre_nm_rad / AXLE.wheels_kgm2)
    rows = [*logs, np.log(plain[TYRE_STIFF]), plain[VEHICLE], plain[HILL]]
    means = [*(figure.log for figure in lash.known[:3]), tyre, 60.0, -2.0]
    sds = [*(figure.sd for figure in lash.known[:3]), AXLE.tyre_tolerance, *lash.vehicle_sds]
    for row, mean, sd in zip(rows, means, sds, strict=True):
        assert row.mean() == pytest.approx(mean, abs=0.02 * sd)
        assert row.std() == pytest.approx(sd, rel=0.01)
    assert np.corrcoef(rows) == pytest.approx(np.eye(6), abs=0.03)
    assert np.cov(reported[VEHICLE], reported[HILL]) == pytest.approx(root @ root.T, rel=0.03)
    assert (set(plain[ANGLE]), set(plain[SPEED])) == ({3.0}, {61.0})


def test_a_driveline_is_corrected_as_by_kalman_and_weighed_by_huber_s_law() -> None:
    """Beyond four deviations the logarithm goes on in a straight line, and the correction stays."""
    off = np.array((-0.09, -0.041, -0.01, 0.0, 0.02, 0.039, 0.041, 0.2))
    variance, gain = 1e-4, np.array((0.6, 3.0, 20.0))
    x = np.arange(1.0, ROWS * off.size + 1.0).reshape(ROWS, off.size)
    x[DRAG] = 1.0
    expected, sds = x.copy(), off / math.sqrt(variance)
    near = np.clip(sds, -MOST_OFF, MOST_OFF)
    for row, share in ((ANGLE, gain[0]), (WAY, gain[0]), (SPEED, gain[1])):
        expected[row] += share * near * math.sqrt(variance)
    drag = 1.0 - gain[2] * near * math.sqrt(variance)
    expected[DRAG] = np.maximum(drag, LEAST_DRAG)
    logs = np.full(off.size, -0.5)
    correct(x, logs, off, gain, variance)
    assert x == pytest.approx(expected)
    assert MOST_OFF == 4.0
    assert logs == pytest.approx(-0.5 - near**2 / 2.0 - MOST_OFF * np.abs(sds - near))


FIGURES = (STIFF, LOSS, HALF, DRAG)


@settings(deadline=None, max_examples=20)
@given(st.floats(-9.0, 9.0), st.floats(0.01, 1.0), st.integers(0, 3))
def test_what_windows_tell_of_a_figure_is_learned_as_by_bayes_within_the_sheet(
    by: float, sd: float, k: int
) -> None:
    """Two normal laws' product; no surer than a window can be, within two deviations of the
    sheet's."""
    lash = a_lash()
    reported = {row: (lash.known[j].log, sd) for j, row in enumerate(FIGURES)}
    middle, most = lash.known[k].log, lash.known[k].sd
    reported[FIGURES[k]] = (middle + by, sd)
    lash.learn(reported.__getitem__)
    weights = most**-2, max(sd, SEEN_SDS[k]) ** -2
    mean = middle + by * weights[1] / sum(weights)
    assert lash.known[k].log == pytest.approx(
        min(max(mean, middle - 2.0 * most), middle + 2.0 * most)
    )
    assert lash.known[k].sd == pytest.approx(max(sum(weights) ** -0.5, LEAST_SHARE_SD * most))


@pytest.mark.parametrize("figure", [(math.nan, 0.1), (1.0, math.nan), (math.inf, 0.1)])
def test_a_figure_that_is_no_number_teaches_nothing(figure: tuple[float, float]) -> None:
    lash = a_lash()
    lash.learn(lambda row: figure)
    assert lash.known == a_lash().known
