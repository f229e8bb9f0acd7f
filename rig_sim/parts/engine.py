"""Engine torque and clutch capacity.

    dT/dt = clip((T_demand - T) / tau, +- rate)        first-order lag with a rate limit

T_demand: idle governor, k (w_idle - w); J1939 TSC1 speed control, k (w_asked - w), or torque
control; or in gear a driver who holds the main shaft's speed. Always within the engine's limits.
The clutch carries T_max (x - kiss) / (1 - kiss) at position x, and slips beyond it.
"""

from __future__ import annotations

from meshpoint.kernels.jit import piece
from meshpoint.kernels.structures import Record

IDLE, SPEED_CONTROL, TORQUE_CONTROL, DRIVE = range(4)
"""What the engine is asked for: idle, by TSC1 a speed or a torque, or in gear a speed held."""


class EngineLimits(Record):
    """The engine and its governor as built."""

    lag_rate: float  # 1 / tau, 1/s
    limit_nm_s: float
    least_nm: float
    most_nm: float
    governor_nms: float
    idle_rad_s: float


class ClutchPlates(Record):
    """The clutch as built."""

    most_nm: float
    kiss: float  # position at which the plates touch


@piece
def demand_nm(mode: int, target: float, omega_rad_s: float, engine: EngineLimits) -> float:
    """What the engine is asked for; `target` is rad/s, or Nm in torque control."""
    if mode == TORQUE_CONTROL:
        demand = target
    else:
        wanted = engine.idle_rad_s if mode == IDLE else target
        demand = engine.governor_nms * (wanted - omega_rad_s)
    return min(max(demand, engine.least_nm), engine.most_nm)


@piece
def torque_nm_s(demanded_nm: float, torque_nm: float, engine: EngineLimits) -> float:
    """How fast the torque follows."""
    wanted_nm_s = (demanded_nm - torque_nm) * engine.lag_rate
    return min(max(wanted_nm_s, -engine.limit_nm_s), engine.limit_nm_s)


@piece
def capacity_nm(position: float, plates: ClutchPlates) -> float:
    """What the clutch can carry."""
    share = (position - plates.kiss) / (1.0 - plates.kiss)
    return plates.most_nm * min(max(share, 0.0), 1.0)
