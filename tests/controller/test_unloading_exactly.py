"""How many steps a torque is taken away in, by frequencies that are known to a share."""

from __future__ import annotations

import math

import pytest

from meshpoint.controller.shift.swing_fit import Known
from meshpoint.controller.shift.unloading import GearedBodies, Loaded, Unloading, unloading
from meshpoint.gearbox import load_sheet

SHEET = load_sheet("truck12")
HARMLESS_NM, RATIO, ENGINE = 100.0, 2.0, 400.0


def bodies(tolerance: float) -> GearedBodies:
    """Whose frequency is known within a share, by the shafts alone."""
    stiffness_sd = 2.0 * tolerance / math.sqrt(3.0)
    return GearedBodies(RATIO, ENGINE, Known(16e3, stiffness_sd, 1.0 / 900.0, 0.0), HARMLESS_NM)


def ramps(pulled_nm: float, tolerance: float = 1.0 / 3.0, error_nm: float = 0.0) -> list[Unloading]:
    return unloading(SHEET, bodies(tolerance), Loaded(70.0, pulled_nm, -0.5, error_nm), 900)


@pytest.mark.parametrize(("stiffness_sd", "vehicle_sd"), [(0.3, 0.0), (0.0, 4e-4), (0.3, 4e-4)])
def test_a_frequency_is_known_by_half_the_share_of_what_it_goes_with(
    stiffness_sd: float, vehicle_sd: float
) -> None:
    """w^2 = k (1/J1 + 1/J2); an even law's ends are sqrt 3 deviations away."""
    known = Known(16e3, stiffness_sd, 1.0 / 900.0, vehicle_sd)
    made, inverse = GearedBodies(RATIO, ENGINE, known, HARMLESS_NM), 1.0 / ENGINE + 1.0 / 900.0
    expected = math.sqrt(0.75) * math.hypot(stiffness_sd, vehicle_sd / inverse)
    assert made.tolerance == pytest.approx(expected)
    assert made.drag_nm == 0.0
    assert made.coasting_nm(0.0) == 0.0


@pytest.mark.parametrize(
    ("pulled", "count"), [(100.0, 1), (101.0, 2), (-199.0, 2), (201.0, 3), (4_000.0, 3)]
)
def test_each_step_more_leaves_half_of_the_swing_where_a_third_of_a_frequency_is_not_known(
    pulled: float, count: int
) -> None:
    """sin(pi / 6): until as little is left as is harmless, in three steps at most."""
    found = ramps(pulled)
    assert [len(each.shares) for each in found] == [1, 2, 3][:count]
    for each in found:
        assert (each.taken, each.began_us, each.step_us) == (1, 900, 900)
        assert each.left_nm == pytest.approx(ENGINE * -0.5 / RATIO)
        last_nm = max(HARMLESS_NM, each.shares[-1] * abs(pulled))
        settles = SHEET.engine.lag_s * math.log(last_nm / HARMLESS_NM)
        assert each.settle_us == pytest.approx(1e6 * settles)


@pytest.mark.parametrize("tolerance", [1.0, 1.2, 1.5, 3.0])
def test_a_frequency_that_is_not_known_at_all_leaves_the_whole_swing(tolerance: float) -> None:
    """However little there is to take away."""
    assert len(ramps(101.0, tolerance)) == 3


@pytest.mark.parametrize(
    ("pulled", "error", "is_told"),
    [(210.0, 50.0, True), (-210.0, 50.0, True), (200.0, 50.0, True), (199.0, 50.0, False),
     (99.0, 0.0, False), (100.0, 0.0, True), (-99.0, 0.0, False)],
)  # fmt: skip
def test_a_torque_that_could_be_none_or_is_harmless_is_left_as_it_is(
    pulled: float, error: float, is_told: bool
) -> None:
    """Told from none by twice its error at the propeller shaft."""
    found = ramps(pulled, error_nm=error)
    if is_told:
        assert found[0].left_nm == pytest.approx(-100.0)
    else:
        (only,) = found
        assert (only.torque_nm, only.left_nm, only.settle_us) == (70.0, 70.0, 0.0)
        assert (only.shares, only.taken, only.next_us) == ((1.0,), 1, math.inf)
        assert only.over_us == 900.0
