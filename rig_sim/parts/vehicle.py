"""The vehicle behind the propeller shaft: resistance against speed, and the slope it stands on.

    F = m g (c_r cos a s(v / 0.1 m/s) + sin a) + rho/2 c_d A v |v|

s is `saturation.saturated`; v = w_propeller r / i_axle; the mass is felt at the propeller shaft as
m (r / i_axle)^2.
"""

from __future__ import annotations

from typing import Final

from meshpoint.kernels.jit import piece
from meshpoint.kernels.structures import Record
from meshpoint.rig_sim.parts.saturation import saturated

GRAVITY_M_S2: Final = 9.81
CREEP_M_S: Final = 0.1


class RoadLoad(Record):
    """The vehicle on its road, as built."""

    wheel_m: float  # wheel radius over axle ratio: vehicle speed = propeller speed x this
    rolling_n: float
    grade_n: float
    air_ns2_m2: float  # 1/2 rho c_d A


@piece
def resistance_n(speed_m_s: float, road: RoadLoad) -> float:
    """Rolling and air resistance, with the sign of the speed."""
    rolling = road.rolling_n * saturated(speed_m_s / CREEP_M_S)
    return rolling + road.air_ns2_m2 * speed_m_s * abs(speed_m_s)
