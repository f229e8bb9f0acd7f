"""The truck's equations of motion: from state and connections to rates of change.

Newton's second law for every group of rigidly linked bodies (thesis 4.5, 4.10, with the inertia by
splitter of 4.13 as the special case of input shaft and layshaft):

    (sum J_k r_k^2) dw/dt = sum r_k T_k

r_k is a body's speed over that of the group's leader. The torque a link carries follows from what
the bodies behind it need. Energies are integrated along with the motion.
"""

from __future__ import annotations

from meshpoint.rig_sim.jit import inlined
from meshpoint.rig_sim.parts.brake_disc import brake_nm, friction_share, heating_k_s
from meshpoint.rig_sim.parts.drag import drag_nm
from meshpoint.rig_sim.parts.engine import capacity_nm, demand_nm, torque_nm_s
from meshpoint.rig_sim.parts.lash import lash_rad_s
from meshpoint.rig_sim.parts.pneumatics import chamber_pa_s, tank_pa_s
from meshpoint.rig_sim.shared.angle_kernels import Floats
from meshpoint.rig_sim.truck.driveline import load_propeller
from meshpoint.rig_sim.truck.layout import (
    ACCEL,
    ANGLE,
    ATMOSPHERE_PA,
    BEFORE,
    BEHIND,
    BODIES,
    BRAKE_GAIN,
    BRAKE_J,
    BRAKE_MODEL,
    BRAKE_PA,
    BRAKE_RATE,
    BRAKE_SIGN,
    CARRIED,
    CLUTCH_NM,
    CLUTCH_RATE,
    COOLING_W_K,
    CRITICAL,
    DISC_K,
    DISC_REFERENCE_K,
    DISC_REFERENCE_RAD_S,
    DRAG_INPUT_NMS,
    DRAG_J,
    DRAG_MAIN_NMS,
    DRAG_NM,
    DRAG_NMS,
    DROOP,
    ENGINE,
    ENGINE_LAG_RATE,
    ENGINE_MAX_NM,
    ENGINE_MIN_NM,
    ENGINE_MODE,
    ENGINE_NM_S,
    ENGINE_TARGET,
    EXHAUST,
    FADE_PER_K,
    FADE_PER_RAD_S,
    FILL,
    FORCED,
    FRICTION_NM,
    FRICTION_RATIO,
    GEAR_DRAG_NMS,
    GEAR_INERTIA,
    GOVERNED_PA,
    GOVERNOR_NMS,
    GROUP,
    HEAT_J_K,
    HOLD,
    IDLE_RAD_S,
    INERTIA,
    INPUT,
    KISS,
    LASH,
    LASH_INPUT_RAD,
    LASH_MAIN_RAD,
    LASH_RATE,
    LAYSHAFT,
    LEAD,
    LINK,
    LINKS,
    LOAD,
    MAIN,
    MAIN_BOX,
    MESHED,
    OIL_K,
    PHASE,
    PLATE,
    POSITION,
    PULL,
    RATE,
    RATIO,
    RECOVERY,
    RUB_J,
    SIGN,
    SLOTS,
    SPEED,
    SPLITTER,
    SUM,
    SUPPLY_PA,
    TORQUE,
    TOUCH_PA,
    VALVE,
    WORK_J,
)


@inlined
def _loads(y: Floats, p: Floats, g: Floats, slots: Floats, rate: Floats, aux: Floats) -> float:
    """Torque on each body from outside and from friction; their powers. Returns the brake's."""
    gauge = y[BRAKE_PA] - p[ATMOSPHERE_PA]
    share = friction_share(
        y[SPEED + LAYSHAFT],
        y[DISC_K],
        p[FADE_PER_K],
        p[FADE_PER_RAD_S],
        p[DISC_REFERENCE_K],
        p[DISC_REFERENCE_RAD_S],
    )
    brake = brake_nm(gauge, p[TOUCH_PA], p[BRAKE_GAIN], share)
    drag_input = p[DRAG_INPUT_NMS] * y[SPEED + INPUT]
    drag = drag_nm(y[SPEED + LAYSHAFT], p[DRAG_NM], p[DRAG_NMS])
    drag_main = p[DRAG_MAIN_NMS] * y[SPEED + MAIN]
    aux[LOAD + ENGINE] = y[TORQUE]
    aux[LOAD + INPUT] = -drag_input
    aux[LOAD + LAYSHAFT] = -drag - g[BRAKE_SIGN] * brake
    aux[LOAD + MAIN] = -drag_main
    rate[WORK_J] = y[TORQUE] * y[SPEED + ENGINE]
    load_propeller(y, p, g, rate, aux)
    rate[BRAKE_J] = g[BRAKE_SIGN] * brake * y[SPEED + LAYSHAFT]
    rate[DRAG_J] = (
        drag_input * y[SPEED + INPUT] + drag * y[SPEED + LAYSHAFT] + drag_main * y[SPEED + MAIN]
    )
    rate[RUB_J] = 0.0
    for slot in range(SLOTS):
        sign = slots[slot, SIGN]
        if sign != 0.0:
            before, behind = int(slots[slot, BEFORE]), int(slots[slot, BEHIND])
            ratio = slots[slot, FRICTION_RATIO]
            torque = slots[slot, FRICTION_NM]
            if slot == PLATE:
                torque = capacity_nm(y[POSITION], p[KISS], p[CLUTCH_NM])
            torque *= sign
            aux[LOAD + before] -= ratio * torque
            aux[LOAD + behind] += torque
            rate[RUB_J] += torque * (ratio * y[SPEED + before] - y[SPEED + behind])
    return brake


@inlined
def _accelerations(y: Floats, p: Floats, g: Floats, rate: Floats, aux: Floats) -> None:
    """Group by group; then what the rigid links carry."""
    for k in range(BODIES):
        aux[SUM + k] = 0.0
    for k in range(BODIES):
        aux[SUM + int(g[LEAD + k])] += g[RATE + k] * aux[LOAD + k]
    aux[PULL] = aux[SUM + int(g[LEAD + LAYSHAFT])]
    for k in range(BODIES):
        if int(g[LEAD + k]) != k:
            continue
        if g[FORCED + k] != 0.0:
            accel = g[ACCEL + k]
            given = g[GROUP + k] * accel - aux[SUM + k]
            aux[LOAD + k] += given
            rate[WORK_J] += given * y[SPEED + k]
        else:
            accel = aux[SUM + k] / g[GROUP + k]
        rate[SPEED + k] = accel
    for k in range(BODIES):
        rate[SPEED + k] = g[RATE + k] * rate[SPEED + int(g[LEAD + k])]
        rate[ANGLE + k] = y[SPEED + k]
    needed = 0.0
    for link in range(LINKS - 1, -1, -1):
        behind = link + 1
        needed += p[INERTIA + behind] * rate[SPEED + behind] - aux[LOAD + behind]
        if g[CARRIED + link] == 0.0:
            needed = 0.0
        aux[LINK + link] = needed
        needed *= g[CARRIED + link]


@inlined
def rates(y: Floats, p: Floats, g: Floats, slots: Floats, rate: Floats, aux: Floats) -> None:
    """dy/dt at state y into `rate`; torques into `aux`."""
    brake = _loads(y, p, g, slots, rate, aux)
    _accelerations(y, p, g, rate, aux)
    aux[PULL] += g[BRAKE_SIGN] * brake
    aux[HOLD] = brake
    for gear in range(4):
        ratio = p[RATIO + gear]
        rate[PHASE + gear] = ratio * y[SPEED + LAYSHAFT] - y[SPEED + MAIN]
        needed = p[GEAR_INERTIA] * ratio * rate[SPEED + LAYSHAFT]
        needed += p[GEAR_DRAG_NMS] * rate[PHASE + gear]
        if int(g[MESHED]) == gear:
            needed = aux[LINK + MAIN_BOX]
        rate[LASH + 1 + gear] = lash_rad_s(
            y[LASH + 1 + gear], needed, p[LASH_MAIN_RAD], p[LASH_RATE]
        )
    rate[LASH] = lash_rad_s(y[LASH], -aux[LINK + SPLITTER], p[LASH_INPUT_RAD], p[LASH_RATE])
    rate[BRAKE_PA] = chamber_pa_s(
        y[BRAKE_PA],
        y[SUPPLY_PA],
        p[ATMOSPHERE_PA],
        g[VALVE],
        p[BRAKE_MODEL],
        p[BRAKE_RATE],
        p[FILL],
        p[EXHAUST],
        p[CRITICAL],
    )
    filling = rate[BRAKE_PA] if g[VALVE] > 0.0 else 0.0
    rate[SUPPLY_PA] = tank_pa_s(y[SUPPLY_PA], g[GOVERNED_PA], p[RECOVERY], p[DROOP], filling)
    rate[DISC_K] = heating_k_s(rate[BRAKE_J], y[DISC_K], p[OIL_K], p[HEAT_J_K], p[COOLING_W_K])
    wanted = demand_nm(
        g[ENGINE_MODE],
        g[ENGINE_TARGET],
        y[SPEED + ENGINE],
        p[IDLE_RAD_S],
        p[GOVERNOR_NMS],
        p[ENGINE_MIN_NM],
        p[ENGINE_MAX_NM],
    )
    rate[TORQUE] = torque_nm_s(wanted, y[TORQUE], p[ENGINE_LAG_RATE], p[ENGINE_NM_S])
    rate[POSITION] = g[CLUTCH_RATE]
