"""Air: the brake's chamber and the tank it is filled from.

Flow through a valve by ISO 6358, with p1 before and p2 behind it, r = p2 / p1:

    m' = p1 C rho_0                                   r <= b (choked)
    m' = p1 C rho_0 sqrt(1 - ((r - b) / (1 - b))^2)   r > b

linear in 1 - r from r = 0.99 on, where the square root's slope has no end (ISO 6358-3). Chamber:
dp/dt = n R T m' / V. Selectable instead: the first order of thesis 4.1,
dp/dt = (u p_supply - p) / tau on gauge pressure. Tank: what fills the chamber leaves it, and the
compressor brings it back to the governed pressure at a first-order rate.
"""

from __future__ import annotations

import math
from typing import Final

from meshpoint.kernels.jit import piece
from meshpoint.kernels.structures import Record

FIRST_ORDER: Final = 0.0
LAMINAR_FROM: Final = 0.99
GAS_J_KGK: Final = 287.05
NORMAL_K: Final = 293.15
NORMAL_KG_M3: Final = 1.185


class BrakeAir(Record):
    """The brake's chamber, its valve and the tank as built."""

    model: float  # FIRST_ORDER, or by ISO 6358
    rate: float  # 1 / tau of 4.1, 1/s
    fill: float  # choked filling rate per Pa of supply, 1/s
    exhaust: float  # choked exhaust rate per Pa of chamber, 1/s
    critical: float  # pressure ratio b up to which the flow is choked
    atmosphere_pa: float
    droop: float  # brake volume over tank volume
    recovery: float  # of the tank's pressure, 1/s


@piece
def flow_share(before_pa: float, behind_pa: float, critical: float) -> float:
    """Mass flow over that of the choked valve, 0..1; the flow goes downhill only."""
    if before_pa <= behind_pa:
        return 0.0
    ratio = behind_pa / before_pa
    if ratio <= critical:
        return 1.0
    if ratio > LAMINAR_FROM:
        edge = (LAMINAR_FROM - critical) / (1.0 - critical)
        return math.sqrt(1.0 - edge * edge) * (1.0 - ratio) / (1.0 - LAMINAR_FROM)
    part_way = (ratio - critical) / (1.0 - critical)
    return math.sqrt(1.0 - part_way * part_way)


@piece
def chamber_pa_s(pa: float, supply_pa: float, valve: float, air: BrakeAir) -> float:
    """How fast the pressure in the chamber rises."""
    ambient_pa = air.atmosphere_pa
    if air.model == FIRST_ORDER:
        return air.rate * (valve * (supply_pa - ambient_pa) - (pa - ambient_pa))
    if valve > 0.0:
        return air.fill * supply_pa * flow_share(supply_pa, pa, air.critical)
    return -air.exhaust * pa * flow_share(pa, ambient_pa, air.critical)


@piece
def tank_pa_s(pa: float, governed_pa: float, filling_pa_s: float, air: BrakeAir) -> float:
    """How fast the tank's pressure rises: compressor less what fills the chamber."""
    return air.recovery * (governed_pa - pa) - air.droop * max(filling_pa_s, 0.0)


def choked_rate(conductance_m3_spa: float, volume_m3: float, polytropic: float) -> float:
    """n R T C rho_0 / V: how fast a chamber fills per Pa before the valve, 1/s."""
    per_pa = polytropic * GAS_J_KGK * NORMAL_K * NORMAL_KG_M3
    return per_pa * conductance_m3_spa / volume_m3
