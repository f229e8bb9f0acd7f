"""Backlash of the constant meshes, taken as massless: a wheel lies at one flank or the other.

    dy/dt = (-h s(T / T_s) - y) / tau

y is how far the driven wheel is ahead of the exact gearing, h half the backlash, T the torque that
the mesh must put on the driven wheel: a wheel that is pulled forward lags by h, one that runs ahead
leads. tau, some milliseconds, stands for the flight between the flanks. No energy is stored.
"""

from __future__ import annotations

from typing import Final

from meshpoint.kernels.jit import piece
from meshpoint.kernels.structures import Record
from meshpoint.rig_sim.parts.saturation import saturated

LASH_FIRM_NM: Final = 0.5  # T_s; s is `saturation.saturated`


class Backlash(Record):
    """Of a mesh as built."""

    half_rad: float
    rate: float  # 1 / tau, 1/s


@piece
def lash_rad_s(y_rad: float, torque_nm: float, lash: Backlash) -> float:
    """How fast the wheel moves in its backlash."""
    return (-lash.half_rad * saturated(torque_nm / LASH_FIRM_NM) - y_rad) * lash.rate
