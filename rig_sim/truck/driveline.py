"""Shafts and tyres that twist, and the vehicle behind them.

    P --k, d, backlash--> A --k_t, d_t--contact--> V

P is the propeller shaft with what is linked to it, A the driven wheels, V the vehicle, all felt at
the propeller shaft; P to A the propeller and half-shafts with the final drive's backlash b, A to V
the tyres, carcass and contact patch in series:

    u = theta_P - theta_A beyond +-b/2       T = k u + d (w_P - w_A) min(1, k |u| / T_c)
    T_t = k_t u_t + d_t du_t/dt              du_t/dt = w_A - w_V - (v / sigma) T_t / k_t
    J_A dw_A/dt = T - T_t                    J_V dw_V/dt = T_t - F r / i_axle

T is never of the other sign than u: flanks push. Without backlash T = k u + d (w_P - w_A). A tyre
that rolls at v slips by T_t v / (k_t sigma), with sigma = C_kappa / k_x its relaxation length: what
its contact patch lays down untwisted lets its twist go after some sigma of road (Pacejka, Tire and
Vehicle Dynamics, 7.2; Rill, Road Vehicle Dynamics, 3.5). At standstill it sticks. With
k_t = 0 the tyres are rigid and A is the vehicle, with k = 0 all of it is part of P. While the bench
drives the propeller shaft it drives wheels and vehicle along with it, so that its script twists
nothing.
"""

from __future__ import annotations

import math
from typing import Final

from meshpoint.kernels.jit import inlined
from meshpoint.rig_sim.parts.disturbance import WHEELS_SOURCE, chance_nm
from meshpoint.rig_sim.parts.vehicle import resistance_n
from meshpoint.rig_sim.truck.layout import PROPELLER, Rig, RigState, TwistingShafts

FILM_NM: Final = 50.0
"""T_c: torque at which the flanks of the final drive damp in full. Below it the oil between them
is not squeezed out yet; without such a span the torque would jump where they meet."""
LONGEST_SWING_RAD: Final = 0.4
"""A mode turns by no more than this in a step: Runge-Kutta's error of its frequency is then below
0.02 %."""


@inlined
def _shaft_nm(twist_rad: float, slip_rad_s: float, shafts: TwistingShafts) -> tuple[float, float]:
    """What the twisted shafts put on the wheels, and the part of it that is their spring."""
    if shafts.half_lash_rad == 0.0:
        spring = shafts.stiff_nm_rad * twist_rad
        return spring + shafts.damping_nms * slip_rad_s, spring
    beyond = abs(twist_rad) - shafts.half_lash_rad
    if beyond <= 0.0:
        return 0.0, 0.0
    side = 1.0 if twist_rad > 0.0 else -1.0
    spring = shafts.stiff_nm_rad * beyond
    torque = spring + side * shafts.damping_nms * slip_rad_s * min(spring / FILM_NM, 1.0)
    return side * max(torque, 0.0), side * spring


@inlined
def _tyre_nm(
    tyre_rad: float, creep_rad_s: float, rolling_m_s: float, shafts: TwistingShafts
) -> tuple[float, float]:
    """What the twisted tyres put on the vehicle, and the rate of their twist, rad/s."""
    released = rolling_m_s / shafts.relaxation_m
    rate = creep_rad_s - released * tyre_rad
    rate /= 1.0 + released * shafts.tyre_nms / shafts.tyre_nm_rad
    return shafts.tyre_nm_rad * tyre_rad + shafts.tyre_nms * rate, rate


@inlined
def load_propeller(y: RigState, rate: RigState, rig: Rig) -> None:
    """Torque of the vehicle on the propeller shaft, its motion, and what road and slope take.

    Adds to `work_j` what the bench spends on wheels that it drives; so the rate must be there."""
    vehicle, shafts = rig.p.road, rig.p.twisting
    stiff, tyre = shafts.stiff_nm_rad, shafts.tyre_nm_rad
    omega = y.speed_rad_s[PROPELLER]
    if stiff != 0.0:
        omega = y.wheels_rad_s if tyre == 0.0 else y.vehicle_rad_s
    speed = omega * vehicle.wheel_m
    road = resistance_n(speed, vehicle)
    resisting = (road + vehicle.grade_n) * vehicle.wheel_m
    rate.road_j = road * speed
    rate.grade_j = vehicle.grade_n * speed
    rate.wheels_rad_s = 0.0
    rate.twist_rad = 0.0
    rate.vehicle_rad_s = 0.0
    rate.tyre_rad = 0.0
    rate.twist_j = 0.0
    if stiff == 0.0:
        rig.torques.body_nm[PROPELLER] = -resisting
        return
    slip = y.speed_rad_s[PROPELLER] - y.wheels_rad_s
    torque, spring = _shaft_nm(y.twist_rad, slip, shafts)
    rig.torques.body_nm[PROPELLER] = -torque
    propeller = rig.g.bodies[PROPELLER]
    leader = rig.g.bodies[propeller.lead]
    if leader.forced != 0:
        rate.wheels_rad_s = propeller.rate * leader.accel_rad_s2
        driven_kgm2 = shafts.wheels_kgm2
        if tyre != 0.0:
            rate.vehicle_rad_s = rate.wheels_rad_s
            driven_kgm2 += shafts.vehicle_kgm2
        given = driven_kgm2 * rate.wheels_rad_s + resisting - torque
        rate.work_j += given * omega
        return
    rate.twist_rad = slip
    rate.twist_j = (torque - spring) * slip
    if tyre == 0.0:
        rate.wheels_rad_s = (torque - resisting) / shafts.wheels_kgm2
        return
    if rig.p.disturbance.is_on != 0:
        chance = chance_nm(rig.shaking, WHEELS_SOURCE)
        torque += chance
        rate.work_j += chance * y.wheels_rad_s
    creep = y.wheels_rad_s - omega
    traction, rate.tyre_rad = _tyre_nm(y.tyre_rad, creep, abs(speed), shafts)
    rate.twist_j += traction * creep - tyre * y.tyre_rad * rate.tyre_rad
    rate.wheels_rad_s = (torque - traction) / shafts.wheels_kgm2
    rate.vehicle_rad_s = (traction - resisting) / shafts.vehicle_kgm2


def modes_rad_s(shafts: TwistingShafts, gearbox_kgm2: float) -> tuple[float, ...]:
    """Natural frequencies without damping, slip and backlash, ascending, with this inertia (kg m2,
    at the propeller shaft) behind the shafts; one with rigid tyres, none with rigid shafts."""
    stiff, tyre = shafts.stiff_nm_rad, shafts.tyre_nm_rad
    if stiff == 0.0:
        return ()
    wheels = 1.0 / shafts.wheels_kgm2
    first = stiff * (1.0 / gearbox_kgm2 + wheels)
    if tyre == 0.0:
        return (math.sqrt(first),)
    second = tyre * (wheels + 1.0 / shafts.vehicle_kgm2)
    middle, apart = 0.5 * (first + second), 0.5 * (first - second)
    spread = math.sqrt(apart**2 + stiff * tyre * wheels**2)
    return (math.sqrt(middle - spread), math.sqrt(middle + spread))


def longest_step_us(step_us: float, shafts: TwistingShafts, gearbox_kgm2: float) -> float:
    """The grid for what swings: the given one, halved until no mode turns far within a step."""
    modes = modes_rad_s(shafts, gearbox_kgm2)
    while modes and modes[-1] * step_us * 1e-6 > LONGEST_SWING_RAD:
        step_us *= 0.5
    return step_us
