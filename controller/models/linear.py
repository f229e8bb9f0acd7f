"""Where layshaft and phase will be over the actuator delay (thesis 5.4).

Three ways of thesis 5.4 as functions of the same state: linear (5.12), Euler (5.15) and zero-order
hold (5.17). The node uses the hold over the known future brake commands; it is exact for the model,
not only at sampling points, because every switch of the input is a step of its own.
"""

from __future__ import annotations

import numpy as np

from meshpoint.controller.models.linear_kernels import LINEAR, propagate
from meshpoint.controller.models.models import LayshaftState
from meshpoint.gearbox import GearboxSheet, Split
from meshpoint.kernels.records import Vector, filled
from meshpoint.units import US


def layshaft_model(sheet: GearboxSheet, split: Split) -> Vector:
    """The `kernels.Linear` model [a, b, g, K] from the data sheet (4.4, 4.13, 4.15)."""
    inertia = sheet.inertia_kgm2(split)
    return filled(
        LINEAR,
        friction_per_s=sheet.shafts.friction_nms / inertia,
        brake_per_s=1.0 / sheet.brake.time_constant_s,
        brake_rad_s2_pa=sheet.brake_nm_per_pa / inertia,
        supply_pa=sheet.air.supply_gauge_pa,
    )


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
