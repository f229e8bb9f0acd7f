"""Engine torque and clutch capacity.

    dT/dt = clip((T_demand - T) / tau, +- rate)        first-order lag with a rate limit

T_demand: idle governor, k (w_idle - w); J1939 TSC1 speed control, k (w_asked - w), or torque
control; or in gear a driver who holds the main shaft's speed. Always within the engine's limits.
The clutch carries T_max (x - kiss) / (1 - kiss) at position x, and slips beyond it.
"""

from __future__ import annotations

from meshpoint.rig_sim.jit import part

IDLE, SPEED_CONTROL, TORQUE_CONTROL, DRIVE = range(4)
"""What the engine is asked for: idle, by TSC1 a speed or a torque, or in gear a speed held."""


@part
def demand_nm(
    mode: float,
    target: float,
    omega_rad_s: float,
    idle_rad_s: float,
    governor_nms: float,
    least_nm: float,
    most_nm: float,
) -> float:
    """What the engine is asked for; `target` is rad/s, or Nm in torque control."""
    if mode == TORQUE_CONTROL:
        demand = target
    else:
        wanted = idle_rad_s if mode == IDLE else target
        demand = governor_nms * (wanted - omega_rad_s)
    return min(max(demand, least_nm), most_nm)


@part
def torque_nm_s(demanded_nm: float, torque_nm: float, lag_rate: float, limit_nm_s: float) -> float:
    """How fast the torque follows."""
    return min(max((demanded_nm - torque_nm) * lag_rate, -limit_nm_s), limit_nm_s)


@part
def capacity_nm(position: float, kiss: float, most_nm: float) -> float:
    """What the clutch can carry."""
    return most_nm * min(max((position - kiss) / (1.0 - kiss), 0.0), 1.0)
