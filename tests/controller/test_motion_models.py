"""How a free layshaft is taken to move and to be known: by the data sheet, with variances that come
to what the settings say; and what will be known of it as edges come."""

from __future__ import annotations

import math

import numpy as np
import pytest

from meshpoint.controller.models.layshaft import (
    Disturbance,
    LayshaftState,
    MotionModel,
    Ticks,
    ahead,
    diagonal,
    first_order_law,
    following_motion,
    following_start,
    free_motion,
    outlook,
    predict,
    predict_spread,
    state_of,
)
from meshpoint.controller.settings.filters import CrossingFilterTuning
from meshpoint.gearbox import Split, load_sheet

SHEET = load_sheet("truck12")
TUNING = CrossingFilterTuning()
NONE = np.empty((2, 0))
LAW = first_order_law(1.0 / SHEET.brake.time_constant_s, SHEET.air.supply_gauge_pa)
ANGLE, SPEED, PRESSURE, TORQUE, GAIN, DRAG = range(6)


def free(split: Split = Split.HIGH, disturbance: Disturbance | None = None) -> MotionModel:
    return free_motion(SHEET, split, LAW, TUNING, disturbance)


def grown(model: MotionModel, p: np.ndarray, seconds: float, start: np.ndarray) -> np.ndarray:
    """The covariance after a time."""
    found = ahead(start, p, 0.0, 1e6 * seconds, NONE, model).covariance
    assert found is not None
    return found


START = np.array([0.0, 140.0, 0.0, 0.0, 1.0, 0.0])


@pytest.mark.parametrize("split", list(Split))
def test_a_free_layshaft_is_slowed_by_friction_brake_and_drag_over_its_inertia(
    split: Split,
) -> None:
    inertia, model = SHEET.inertia_kgm2(split), free(split)
    assert model.friction_per_s == pytest.approx(SHEET.shafts.friction_nms / inertia)
    assert model.brake_rad_s2_pa == pytest.approx(SHEET.brake_nm_per_pa / inertia)
    seconds = 1e-3
    for pressure, gain, drag in ((0.0, 1.0, 0.0), (4e5, 1.0, 0.0), (4e5, 1.2, -3.0)):
        state = LayshaftState(0.0, 0.0, 140.0, pressure, gain=gain, drag_rad_s2=drag)
        later = predict(state, 1e6 * seconds, NONE, model)
        mean_pa = 0.5 * (pressure + later.pressure_pa)
        slowing = SHEET.shafts.friction_nms * 140.0 + gain * SHEET.brake_nm_per_pa * mean_pa
        expected = 140.0 + seconds * (drag - slowing / inertia)
        assert later.omega_rad_s == pytest.approx(expected, abs=2e-3)
        assert later.theta_rad == pytest.approx(0.5 * seconds * (140.0 + expected), rel=1e-4)
        assert (later.gain, later.drag_rad_s2) == (gain, drag)


@pytest.mark.parametrize("split", list(Split))
def test_what_is_not_known_of_a_free_layshaft_grows_as_the_settings_say(split: Split) -> None:
    """Gain, drag and pressure wander by so much in a second; the torque left out comes to rest at
    its standard deviation, over the inertia."""
    inertia, model = SHEET.inertia_kgm2(split), free(split)
    p = grown(model, np.zeros((6, 6)), 1.0, START)
    assert math.sqrt(p[GAIN, GAIN]) == pytest.approx(TUNING.gain_walk)
    assert math.sqrt(p[DRAG, DRAG]) * inertia == pytest.approx(TUNING.drag_walk_nm)
    rest_nm = math.sqrt(p[TORQUE, TORQUE]) * inertia
    assert rest_nm == pytest.approx(TUNING.torque_disturbance_nm, rel=0.03)
    short = grown(model, np.zeros((6, 6)), 1e-3, START)
    assert math.sqrt(short[PRESSURE, PRESSURE]) == pytest.approx(
        TUNING.pressure_walk_pa * math.sqrt(1e-3), rel=0.05
    )
    known = diagonal(0.0, 0.0, 0.0, 3.0, 0.0, 0.0)
    after = grown(free(split, Disturbance(1e-9, TUNING.disturbance_s)), known, 0.03, START)
    faded = 3.0 * math.exp(-0.03 / TUNING.disturbance_s)
    assert math.sqrt(after[TORQUE, TORQUE]) == pytest.approx(faded, rel=1e-3)


def test_another_disturbance_or_law_changes_that_alone() -> None:
    model = free()
    other = model.changed(fading_per_s=77.0, disturbance_rad2_s5=5.0)
    law = first_order_law(30.0, 5e5)
    braked = model.changed(segments=law)
    assert other.part("fading_per_s")[0] == 77.0
    assert other.part("disturbance_rad2_s5")[0] == 5.0
    assert np.array_equal(braked.part("segments"), law.reshape(braked.part("segments").shape))
    for each in (other, braked):
        assert each.friction_per_s == model.friction_per_s
        assert each.brake_rad_s2_pa == model.brake_rad_s2_pa
    assert np.array_equal(other.part("segments"), model.part("segments"))
    assert braked.part("fading_per_s")[0] == model.part("fading_per_s")[0]
    assert model.part("fading_per_s")[0] == pytest.approx(1.0 / TUNING.disturbance_s)


def test_a_shaft_that_something_drives_may_accelerate_by_so_much_for_so_long() -> None:
    """No friction and no brake; accelerations of this size and memory, and a wandering one."""
    model = following_motion(60.0, 0.01, 50.0)
    still = LayshaftState(0.0, 1.0, 140.0, 0.0)
    later = predict(still, 1e5, NONE, model)
    assert (later.omega_rad_s, later.theta_rad) == (pytest.approx(140.0), pytest.approx(15.0))
    p = grown(model, np.zeros((6, 6)), 1.0, START)
    assert math.sqrt(p[TORQUE, TORQUE]) == pytest.approx(60.0, rel=0.02)
    assert math.sqrt(p[DRAG, DRAG]) == pytest.approx(50.0)
    assert p[GAIN, GAIN] == 0.0
    x, start = following_start(2e-3, 0.5, 60.0)
    assert x.tolist() == [0.0, 0.0, 0.0, 0.0, 1.0, 0.0]
    assert np.sqrt(np.diag(start)) == pytest.approx([2e-3, 0.5, 1.0, 60.0, 1e-9, 60.0])
    assert np.count_nonzero(start - np.diag(np.diag(start))) == 0


def test_a_state_is_reported_with_its_standard_deviations_and_none_of_a_negative_variance() -> None:
    p = diagonal(1e-3, 0.2, 3e3, 1.0, 0.1, 2.0)
    state = state_of(np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]), p, 77.0)
    assert state[:4] == (77.0, 1.0, 2.0, 3.0)
    assert state[4:7] == pytest.approx((1e-3, 0.2, 3e3))
    assert (state.disturbance_rad_s2, state.gain, state.drag_rad_s2) == (4.0, 5.0, 6.0)
    assert state.covariance is p
    assert state.vector.tolist() == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    p[0, 0] = -1e-20
    assert state_of(np.ones(6), p, 0.0).theta_sd_rad == 0.0
    assert state.is_finite
    for place in range(10):
        broken = LayshaftState(*[math.nan if k == place else v for k, v in enumerate(state)])
        assert not broken.is_finite


def test_a_prediction_without_a_covariance_keeps_what_is_not_known_and_says_no_spread() -> None:
    model = free()
    bare = LayshaftState(0.0, 1.0, 140.0, 0.0, 1e-3, 0.2, 3e3, edge_rad2_s=1e-9)
    assert bare[4:] == (1e-3, 0.2, 3e3, 0.0, 1.0, 0.0, None, 1e-9)
    later = predict(bare, 1e4, NONE, model)
    assert later[4:7] == bare[4:7]
    assert later.edge_rad2_s == 1e-9
    assert LayshaftState(0.0, 1.0, 140.0, 0.0)[4:] == (0.0, 0.0, 0.0, 0.0, 1.0, 0.0, None, 0.0)
    with pytest.raises(ValueError, match="covariance"):
        predict_spread(bare, 1e4, NONE, model)
    with pytest.raises(ValueError, match="covariance"):
        outlook(bare, Ticks(4e4, 1e4, 3), NONE, model)


def test_what_will_be_known_is_what_a_filter_will_have_made_of_the_edges_by_then() -> None:
    """An edge's angle of this variance each tick: P - P h (h P h + r)^-1 h P, tick by tick."""
    model = free()
    p = diagonal(2e-3, 0.5, 0.0, 2.0, 0.0, 2.0)
    edge, tick_us, horizon_us = 3e-9, 8_000.0, 45_000.0
    state = state_of(START.copy(), p, 1e6)._replace(edge_rad2_s=edge)
    found = outlook(state, Ticks(horizon_us, tick_us, 5), NONE, model)
    x, now, expected = START.copy(), p.copy(), []
    for _ in range(5):
        seen = ahead(x, now, 0.0, horizon_us, NONE, model)
        expected.append(seen.theta_sd_rad**2)
        later = ahead(x, now, 0.0, tick_us, NONE, model)
        x, now = later.vector, np.array(later.covariance)
        now = now - np.outer(now[:, 0], now[0]) / (now[0, 0] + edge / (tick_us * 1e-6))
    assert found == pytest.approx(expected, rel=1e-9)
    assert found[1] < 0.5 * found[0]
    assert found[0] == pytest.approx(predict_spread(state, 1e6 + horizon_us, NONE, model)[4] ** 2)
