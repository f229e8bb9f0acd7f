"""Drag of bearings, seals and oil on a shaft.

    T = T_0 s(w / 1 rad/s) + c w

s is `saturation.saturated`; c is the thesis's c_tot (4.11); the constant part has the shape of
(EU) 2017/2400, Annex VI, which gives 12.5 Nm + 12.5 Nm n / 1000 rpm at the input of a 2,500 Nm box
as the value of a gearbox that nobody has measured. Both parts grow as the oil gets thicker,
exp(-k (T - 80 degC)), which is the local slope of the Vogel equation for gear oils.
"""

from __future__ import annotations

import math
from typing import Final

from meshpoint.kernels.jit import piece
from meshpoint.rig_sim.parts.saturation import saturated

WARM_K: Final = 353.15


@piece
def drag_nm(omega_rad_s: float, constant_nm: float, viscous_nms: float) -> float:
    """Torque against the rotation, with the sign of the speed."""
    return constant_nm * saturated(omega_rad_s) + viscous_nms * omega_rad_s


def thickening(oil_k: float, per_k: float) -> float:
    """Factor on the drag at an oil temperature; 1 at 80 degC."""
    return math.exp(-per_k * (oil_k - WARM_K))
