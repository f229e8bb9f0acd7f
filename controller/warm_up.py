"""Compiles the numeric kernels before the first frame, so that no step waits for the compiler."""

from __future__ import annotations

import numpy as np

from controller import edge_gate, edge_kernels, plan_kernels
from controller.brake_kernels import pressure_course
from controller.crossing import CrossingFilter, Pressures
from controller.kernels import cruise_filter, propagate, thesis_filter
from controller.motion import first_order_law, following_motion, predict
from controller.motion_kernels import STATES
from controller.settings import CrossingFilterTuning


def warm_up() -> None:
    """Calls each kernel once on a standing shaft; a second with a cold cache, else milliseconds."""
    edge_kernels.warm_up()
    edge_gate.warm_up()
    plan_kernels.warm_up()
    x, p, model = np.zeros(3), np.eye(3), np.array([0.1, 10.0, 0.0, 1.0])
    edges, switches = np.array([1.0]), np.array([0.5])
    propagate(x, 0.0, 1.0, switches, switches, model)
    thesis_filter(x, p, 0.0, edges, edges, switches, switches, model, np.zeros(3), 1.0)
    _warm_up_crossing()
    cruise_filter(np.zeros(2), np.eye(2), 0.0, edges, edges, 1.0, 1e-6)


def _warm_up_crossing() -> None:
    tuning, none = CrossingFilterTuning(), np.empty(0)
    model = following_motion(1.0, 1.0, 1.0)._replace(law=first_order_law(1.0, 1.0))
    shaft = CrossingFilter(tuning)
    shaft.begin(0.0, np.ones(STATES), np.eye(STATES))
    shaft.take(np.array([1e3]), np.array([0.1]), 0.1, Pressures(none, none), (none, none), model)
    state = shaft.at(2e3, (none, none), model)
    predict(state, 3e3, (none, none), model)
    pressure_course(
        np.ones(STATES), np.array([1e3]), none, none, model.motion, model.law, np.empty(1)
    )
