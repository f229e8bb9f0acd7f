"""A sleeve's actuator as a double-acting cylinder between two valves.

    m dv/dt = (p_A - p_B) A - F_c sgn(v) - B v
    dp_A/dt = (n R T m'_A - n p_A A v) / V_A,   dp_B/dt = (-n R T m'_B + n p_B A v) / V_B

with the flows of ISO 6358 (`pneumatics`), V = dead volume + A x on the driven side, the rest of the
stroke on the other. The supply is taken as steady over the some 40 ms of a stroke. Integrated once
when the valve opens, at a fixed step (semi-implicit Euler in the motion), up to contact.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from meshpoint.rig_sim.jit import entry
from meshpoint.rig_sim.parts.pneumatics import GAS_J_KGK, NORMAL_K, NORMAL_KG_M3, flow_share
from meshpoint.rig_sim.records import Floats

CYLINDER_STEP_S: Final = 1e-5
EVERY: Final = 20
TRAVEL_SAMPLES: Final = 1024
CRITICAL: Final = 0.3
POLYTROPIC: Final = 1.2


class Cylinder(NamedTuple):
    """Piston area m2, dead volume m3, sonic conductance m3/(s Pa), moving mass kg, friction N,
    damping Ns/m, stroke m from neutral to either end."""

    area_m2: float
    dead_m3: float
    conductance_m3_spa: float
    mass_kg: float
    friction_n: float
    damping_nsm: float
    stroke_m: float


class Travel(NamedTuple):
    """A stroke to contact: time from the valve's opening, speed and force there, positions every
    EVERY steps. time_s is infinite where the sleeve never gets there."""

    time_s: float
    speed_m_s: float
    force_n: float
    samples_m: Floats


@entry
def _travel(
    cylinder: tuple[float, ...],
    supply_pa: float,
    atmosphere_pa: float,
    to_m: float,
    samples: Floats,
) -> tuple[float, float, float, int]:
    """Time, speed, force at contact and the number of samples."""
    area, dead, conductance, mass, friction, damping, stroke = cylinder
    per_pa = POLYTROPIC * GAS_J_KGK * NORMAL_K * NORMAL_KG_M3 * conductance
    p_a, p_b, x, v = atmosphere_pa, atmosphere_pa, 0.0, 0.0
    count = 0
    for i in range((samples.shape[0] - 1) * EVERY):
        if i % EVERY == 0:
            samples[count] = x
            count += 1
        volume_a = dead + area * (stroke + x)
        volume_b = dead + area * (stroke - x)
        in_a = per_pa * supply_pa * flow_share(supply_pa, p_a, CRITICAL)
        out_b = per_pa * p_b * flow_share(p_b, atmosphere_pa, CRITICAL)
        p_a += CYLINDER_STEP_S * (in_a - POLYTROPIC * p_a * area * v) / volume_a
        p_b += CYLINDER_STEP_S * (POLYTROPIC * p_b * area * v - out_b) / volume_b
        push = (p_a - p_b) * area
        if v == 0.0 and abs(push) <= friction:
            continue
        direction = 1.0 if v > 0.0 or (v == 0.0 and push > 0.0) else -1.0
        change = CYLINDER_STEP_S * (push - direction * friction - damping * v) / mass
        moved = v + change
        v = 0.0 if v * moved < 0.0 else moved
        if v < 0.0 and x <= 0.0:
            v = 0.0
        if x + CYLINDER_STEP_S * v >= to_m:
            rest = (to_m - x) / v
            samples[count] = to_m
            return i * CYLINDER_STEP_S + rest, v, (p_a - p_b) * area, count + 1
        x += CYLINDER_STEP_S * v
    return -1.0, 0.0, 0.0, count


def travel(cylinder: Cylinder, supply_pa: float, atmosphere_pa: float, to_m: float) -> Travel:
    """The stroke from neutral to contact at a supply pressure (absolute)."""
    samples = np.zeros(TRAVEL_SAMPLES)
    time_s, speed, force, count = _travel(tuple(cylinder), supply_pa, atmosphere_pa, to_m, samples)
    if time_s < 0.0:
        return Travel(float("inf"), 0.0, 0.0, samples[:count])
    return Travel(time_s, speed, force, samples[:count])
