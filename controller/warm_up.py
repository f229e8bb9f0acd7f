"""Compiles the numeric kernels before the first frame, so that no step waits for the compiler."""

from __future__ import annotations

import numpy as np

from meshpoint.controller.estimation.brake_kernels import pressure_course
from meshpoint.controller.estimation.crossing_filter import CrossingFilter, Pressures
from meshpoint.controller.estimation.crossing_kernels import inverse_of_positive
from meshpoint.controller.motion.kernels import STATES
from meshpoint.controller.motion.linear_kernels import cruise_filter, propagate, thesis_filter
from meshpoint.controller.motion.models import first_order_law, following_motion, predict
from meshpoint.controller.planning import plan_kernels
from meshpoint.controller.sensing import chain_kernels as edge_kernels
from meshpoint.controller.sensing import gate_kernels as edge_gate
from meshpoint.controller.settings import CrossingFilterTuning


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
    inverse_of_positive(np.eye(2))
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
