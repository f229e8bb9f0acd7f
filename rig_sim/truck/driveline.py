"""Propeller and axle shafts that twist, and the vehicle behind them.

    T = k (theta_P - theta_V) + d (w_P - w_V)      J_V dw_V/dt = T - F r / i_axle

on the propeller shaft's side of the axle, J_V = m (r / i_axle)^2. With k = 0 the shafts are rigid
and the vehicle is part of the propeller shaft's inertia. While the bench drives the propeller shaft
it drives the wheels along with it, so that its script twists nothing.
"""

from __future__ import annotations

from meshpoint.rig_sim.jit import inlined
from meshpoint.rig_sim.parts.vehicle import resistance_n
from meshpoint.rig_sim.shared.angle_kernels import Floats
from meshpoint.rig_sim.truck.layout import (
    ACCEL,
    AIR_NS2_M2,
    FORCED,
    GRADE_J,
    GRADE_N,
    LEAD,
    LOAD,
    PROPELLER,
    RATE,
    ROAD_J,
    ROLLING_N,
    SPEED,
    STIFF_NM_RAD,
    TWIST_J,
    TWIST_NMS,
    TWIST_RAD,
    VEHICLE_KGM2,
    WHEEL_M,
    WHEELS_RAD_S,
    WORK_J,
)


@inlined
def load_propeller(y: Floats, p: Floats, g: Floats, rate: Floats, aux: Floats) -> None:
    """Torque of the vehicle on the propeller shaft, its motion, and what road and slope take.

    Adds to WORK_J what the bench spends on wheels that it drives; so the rate must be there."""
    stiff = p[STIFF_NM_RAD]
    omega = y[SPEED + PROPELLER] if stiff == 0.0 else y[WHEELS_RAD_S]
    speed = omega * p[WHEEL_M]
    road = resistance_n(speed, p[ROLLING_N], p[AIR_NS2_M2])
    resisting = (road + p[GRADE_N]) * p[WHEEL_M]
    rate[ROAD_J] = road * speed
    rate[GRADE_J] = p[GRADE_N] * speed
    rate[WHEELS_RAD_S] = rate[TWIST_RAD] = rate[TWIST_J] = 0.0
    if stiff == 0.0:
        aux[LOAD + PROPELLER] = -resisting
        return
    slip = y[SPEED + PROPELLER] - omega
    damping = p[TWIST_NMS] * slip
    torque = stiff * y[TWIST_RAD] + damping
    aux[LOAD + PROPELLER] = -torque
    lead = int(g[LEAD + PROPELLER])
    if g[FORCED + lead] != 0.0:
        rate[WHEELS_RAD_S] = g[RATE + PROPELLER] * g[ACCEL + lead]
        given = p[VEHICLE_KGM2] * rate[WHEELS_RAD_S] + resisting - torque
        rate[WORK_J] += given * omega
        return
    rate[WHEELS_RAD_S] = (torque - resisting) / p[VEHICLE_KGM2]
    rate[TWIST_RAD] = slip
    rate[TWIST_J] = damping * slip
