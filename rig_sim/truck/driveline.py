"""Propeller and axle shafts that twist, and the vehicle behind them.

    T = k (theta_P - theta_V) + d (w_P - w_V)      J_V dw_V/dt = T - F r / i_axle

on the propeller shaft's side of the axle, J_V = m (r / i_axle)^2. With k = 0 the shafts are rigid
and the vehicle is part of the propeller shaft's inertia. While the bench drives the propeller shaft
it drives the wheels along with it, so that its script twists nothing.
"""

from __future__ import annotations

from meshpoint.rig_sim.jit import inlined
from meshpoint.rig_sim.parts.vehicle import resistance_n
from meshpoint.rig_sim.truck.layout import PROPELLER, Rig, RigState


@inlined
def load_propeller(y: RigState, rate: RigState, rig: Rig) -> None:
    """Torque of the vehicle on the propeller shaft, its motion, and what road and slope take.

    Adds to `work_j` what the bench spends on wheels that it drives; so the rate must be there."""
    vehicle, shafts = rig.p.road, rig.p.twisting
    stiff = shafts.stiff_nm_rad
    omega = y.speed_rad_s[PROPELLER] if stiff == 0.0 else y.wheels_rad_s
    speed = omega * vehicle.wheel_m
    road = resistance_n(speed, vehicle)
    resisting = (road + vehicle.grade_n) * vehicle.wheel_m
    rate.road_j = road * speed
    rate.grade_j = vehicle.grade_n * speed
    rate.wheels_rad_s = 0.0
    rate.twist_rad = 0.0
    rate.twist_j = 0.0
    if stiff == 0.0:
        rig.torques.body_nm[PROPELLER] = -resisting
        return
    slip = y.speed_rad_s[PROPELLER] - omega
    damping = shafts.damping_nms * slip
    torque = stiff * y.twist_rad + damping
    rig.torques.body_nm[PROPELLER] = -torque
    propeller = rig.g.bodies[PROPELLER]
    leader = rig.g.bodies[propeller.lead]
    if leader.forced != 0:
        rate.wheels_rad_s = propeller.rate * leader.accel_rad_s2
        given = shafts.vehicle_kgm2 * rate.wheels_rad_s + resisting - torque
        rate.work_j += given * omega
        return
    rate.wheels_rad_s = (torque - resisting) / shafts.vehicle_kgm2
    rate.twist_rad = slip
    rate.twist_j = damping * slip
