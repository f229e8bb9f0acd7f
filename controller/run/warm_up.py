"""Compiles the numeric kernels before the first frame, so that no step waits for the compiler."""

from __future__ import annotations

import numpy as np

from meshpoint.controller.estimate.brake_model import pressure_trajectory
from meshpoint.controller.estimate.crossing_filter import MAIN_FILTER, CrossingFilter, Pressures
from meshpoint.controller.estimate.crossing_kernels import inverse_of_positive
from meshpoint.controller.estimate.lash_cloud import correct
from meshpoint.controller.estimate.loaded_kernels import (
    LOADED_MODEL,
    LOADED_STATES,
    follow_loaded,
    loaded_ahead,
)
from meshpoint.controller.measure import gate_kernels, inputs
from meshpoint.controller.models.backlash import ROWS, Chance, LashModel, LashTrajectory, move
from meshpoint.controller.models.layshaft import (
    Ticks,
    first_order_law,
    following_motion,
    outlook,
    predict,
)
from meshpoint.controller.models.layshaft_kernels import STATES
from meshpoint.controller.models.swing import SWING_STATES, Swing, SwingMotion, SwingRates
from meshpoint.controller.models.thesis import (
    CRUISE_FILTER,
    LINEAR,
    THESIS_FILTER,
    cruise_filter,
    propagate,
    thesis_filter,
)
from meshpoint.controller.plan import gear_predictor, target_phase
from meshpoint.controller.settings.filters import CrossingFilterTuning
from meshpoint.controller.shift.engine import least_within
from meshpoint.controller.sleeve import cylinder
from meshpoint.kernels.records import WORD_BYTES, RecordMemory, filled
from meshpoint.kernels.watch import uncollected


def warm_up(baselines: bool = False) -> None:
    """Calls each kernel that a controller uses, once, on a standing shaft: half a minute with a
    cold cache, else milliseconds. baselines: those of the estimators `thesis` and `window` too."""
    warm_up_sensing()
    warm_up_estimation(baselines)


def warm_up_sensing() -> None:
    """Those of sensing, sleeves and planning: some third of the work."""
    with uncollected():
        inputs.warm_up()
        gate_kernels.warm_up()
        gear_predictor.warm_up()
        target_phase.warm_up()
        cylinder.warm_up()


def warm_up_estimation(baselines: bool = False) -> None:
    """The others."""
    with uncollected():
        _warm_up_crossing()
        _warm_up_swing()
        if baselines:
            _warm_up_baselines()
        inverse_of_positive(np.eye(2))
        least_within(np.eye(1), np.ones(1), 0.0, 1.0, np.ones(1))


def _warm_up_baselines() -> None:
    model = filled(LINEAR, friction_per_s=0.1, brake_per_s=10.0, brake_rad_s2_pa=0.0, supply_pa=1.0)
    edges, switches = np.array([1.0]), np.array([[0.5], [0.5]])
    propagate(np.zeros(3), 0.0, 1.0, switches, model)
    thesis = RecordMemory(THESIS_FILTER)
    thesis.part("model")[:], thesis.part("r_rad2")[0] = model, 1.0
    thesis_filter(thesis.flat, edges, edges, switches)
    cruise = RecordMemory(CRUISE_FILTER)
    cruise.part("edge_time_s")[0] = 1e-6
    cruise_filter(cruise.flat, edges, edges)


def _warm_up_crossing() -> None:
    tuning, none = CrossingFilterTuning(), np.empty(0)
    switches = np.empty((2, 0))
    model = following_motion(1.0, 1.0, 1.0).changed(segments=first_order_law(1.0, 1.0))
    shaft = CrossingFilter(tuning)
    shaft.begin(0.0, np.ones(STATES), np.eye(STATES))
    shaft.take(np.array([[1e3], [0.1]]), 0.1, Pressures(none, none), switches, model)
    state = shaft.at(2e3, switches, model)
    predict(state, 3e3, switches, model)
    outlook(state, Ticks(1.0, 1.0, 1), switches, model)
    pressure_trajectory(np.ones(STATES), np.array([1e3]), switches, model.flat, np.empty(1))


def _warm_up_swing() -> None:
    none, switches = np.empty(0), np.empty((2, 0))
    model = SwingMotion(1.0, 1.0, SwingRates(10.0, 1.0, 1.0))
    shaft = CrossingFilter(CrossingFilterTuning(), MAIN_FILTER)
    shaft.begin(0.0, np.ones(SWING_STATES), np.eye(SWING_STATES))
    shaft.take(np.array([[1e3], [0.1]]), 0.1, Pressures(none, none), switches, model)
    swing = Swing(shaft.x, shaft.p, model)
    swing.theta_sd_ahead(0.1)
    swing.outlook(0.1, 0.01, 1)
    swing.trajectories(np.ones(1), 0.1, np.empty((1, 2, 1)))
    model_of_lash, spread = LashModel(1.0, 1.0, 1.0), (np.eye(3), Chance(1.0, 1.0))
    move(np.ones((ROWS, 1)), 1e-3, model_of_lash)
    correct(np.ones((ROWS, 1)), np.ones(1), np.ones(1), np.ones(3), 1.0)
    lash = LashTrajectory(np.ones((ROWS, 1)), model_of_lash, spread, 0.1)
    lash.ahead(0.0)
    lash.outlook(0.1, 0.01, 1)
    loaded = np.ones((LOADED_STATES, LOADED_STATES))
    model_of_load = np.ones(LOADED_MODEL.itemsize // WORD_BYTES)
    loaded_ahead(loaded[0].copy(), loaded, 1e-3, model_of_load)
    follow_loaded(
        loaded[0].copy(), loaded, np.zeros(2), np.ones((2, 1)), 1.0, np.ones(2), model_of_load
    )
