"""Three ways to predict the layshaft over the actuator's delay (thesis 5.4), as functions of one
state: linear (5.12), Euler (5.15) and zero-order hold (5.17). The controller's own is `predict` of
`controller/models/layshaft.py`.
"""

from __future__ import annotations

import numpy as np

from meshpoint.controller.models.layshaft import LayshaftState
from meshpoint.controller.models.thesis import propagate
from meshpoint.kernels.records import Vector
from meshpoint.units import US


def predict_hold(
    state: LayshaftState, to_us: float, switches: Vector, model: Vector
) -> LayshaftState:
    """Zero-order hold through every brake switch (5.16-5.18)."""
    x = np.array([state.theta_rad, state.omega_rad_s, state.pressure_pa])
    propagate(x, float(state.time_us), float(to_us), switches, model)
    theta, omega, pressure = x.tolist()
    return LayshaftState(to_us, theta, omega, pressure, *state[4:7])


def predict_linear(state: LayshaftState, to_us: float) -> LayshaftState:
    """Constant speed over the horizon (5.12)."""
    theta = state.theta_rad + state.omega_rad_s * (to_us - state.time_us) * US
    return state._replace(time_us=to_us, theta_rad=theta)


def predict_euler(
    state: LayshaftState, to_us: float, u: float, model: Vector, step_s: float
) -> LayshaftState:
    """Euler steps of `step_s` with the input held at `u` (5.13-5.15)."""
    a, b, g, k = model
    theta, omega, pressure = state.theta_rad, state.omega_rad_s, state.pressure_pa
    left_s = (to_us - state.time_us) * US
    while left_s > 1e-12:
        h = min(step_s, left_s)
        theta, omega, pressure = (
            theta + h * omega,
            omega + h * (-a * omega - g * pressure),
            pressure + h * b * (k * u - pressure),
        )
        left_s -= h
    return state._replace(
        time_us=to_us, theta_rad=theta, omega_rad_s=float(omega), pressure_pa=float(pressure)
    )
