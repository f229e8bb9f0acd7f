"""The truck's equations of motion: from state and connections to rates of change.

Newton's second law for every group of rigidly linked bodies (thesis 4.5, 4.10, with the inertia by
splitter of 4.13 as the special case of input shaft and layshaft):

    (sum J_k r_k^2) dw/dt = sum r_k T_k

r_k is a body's speed over that of the group's leader. The torque a link carries follows from what
the bodies behind it need. Energies are integrated along with the motion.
"""

from __future__ import annotations

from meshpoint.kernels.jit import inlined
from meshpoint.rig_sim.parts.brake_disc import brake_nm, friction_share, heating_k_s
from meshpoint.rig_sim.parts.disturbance import chance_nm, judder, orders
from meshpoint.rig_sim.parts.drag import drag_nm
from meshpoint.rig_sim.parts.engine import capacity_nm, demand_nm, torque_nm_s
from meshpoint.rig_sim.parts.lash import lash_rad_s
from meshpoint.rig_sim.parts.pneumatics import chamber_pa_s, tank_pa_s
from meshpoint.rig_sim.truck import layout as at
from meshpoint.rig_sim.truck.driveline import load_propeller
from meshpoint.rig_sim.truck.layout import Rig, RigState


@inlined
def _load_bodies(y: RigState, rate: RigState, rig: Rig) -> float:
    """Torque on each body from outside, and its power. Returns the brake's torque."""
    p, g, torques = rig.p, rig.g, rig.torques
    speed = y.speed_rad_s
    gauge = y.brake_pa - p.air.atmosphere_pa
    share = friction_share(speed[at.LAYSHAFT], y.disc_k, p.brake)
    brake = brake_nm(gauge, share, p.brake)
    built = p.disturbance
    if built.is_on != 0 and brake > 0.0:
        brake *= judder(y.angle_rad[at.LAYSHAFT], built)
    drag_input = p.drag_input_nms * speed[at.INPUT]
    drag = drag_nm(speed[at.LAYSHAFT], p.drag_nm, p.drag_nms)
    drag_main = p.drag_main_nms * speed[at.MAIN]
    torques.body_nm[at.ENGINE] = y.engine_nm
    torques.body_nm[at.INPUT] = -drag_input
    torques.body_nm[at.LAYSHAFT] = -drag - g.brake_sign * brake
    torques.body_nm[at.MAIN] = -drag_main
    rate.work_j = y.engine_nm * speed[at.ENGINE]
    load_propeller(y, rate, rig)
    rate.brake_j = g.brake_sign * brake * speed[at.LAYSHAFT]
    rate.drag_j = (
        drag_input * speed[at.INPUT] + drag * speed[at.LAYSHAFT] + drag_main * speed[at.MAIN]
    )
    if p.drag_propeller_nm > 0.0:
        drag_pinion = drag_nm(speed[at.PROPELLER], p.drag_propeller_nm, 0.0)
        torques.body_nm[at.PROPELLER] -= drag_pinion
        rate.drag_j += drag_pinion * speed[at.PROPELLER]
    return brake


@inlined
def _shake(y: RigState, rate: RigState, rig: Rig) -> None:
    """Torque of chance on every body, and its work."""
    torques, speed, shaking = rig.torques, y.speed_rad_s, rig.shaking
    for k in range(at.BODIES):
        torque = chance_nm(shaking, k)
        torques.body_nm[k] += torque
        rate.work_j += torque * speed[k]


@inlined
def _drag_plates(y: RigState, rate: RigState, rig: Rig) -> float:
    """What the engine's orders put on it, and the drag of open clutch plates. Returns how uneven
    the engine makes the torque of plates that slip."""
    torques, built, speed = rig.torques, rig.p.disturbance, y.speed_rad_s
    share = orders(y.angle_rad[at.ENGINE], built)
    engine = abs(y.engine_nm) * share
    torques.body_nm[at.ENGINE] += engine
    rate.work_j += engine * speed[at.ENGINE]
    if rig.g.links[at.CLUTCH].carried == 0.0 and rig.contacts[at.PLATE].sign == 0.0:
        slip = speed[at.ENGINE] - speed[at.INPUT]
        drag = (1.0 + share) * drag_nm(slip, built.clutch_drag_nm, 0.0)
        torques.body_nm[at.ENGINE] -= drag
        torques.body_nm[at.INPUT] += drag
        rate.rub_j += drag * slip
    return 1.0 + share


@inlined
def _rub(y: RigState, rate: RigState, rig: Rig) -> None:
    """Friction of all surfaces that rub, and its power."""
    torques = rig.torques
    rate.rub_j = 0.0
    uneven = 1.0
    built = rig.p.disturbance
    if built.is_on != 0:
        uneven = _drag_plates(y, rate, rig)
    for i in range(at.CONTACTS):
        contact = rig.contacts[i]
        if contact.sign != 0.0:
            before, behind = contact.before, contact.behind
            torque = contact.friction_nm
            if i == at.PLATE:
                torque = uneven * capacity_nm(y.clutch, rig.p.plates)
            torque *= contact.sign
            torques.body_nm[before] -= contact.ratio * torque
            torques.body_nm[behind] += torque
            slip = contact.ratio * y.speed_rad_s[before] - y.speed_rad_s[behind]
            rate.rub_j += torque * slip


@inlined
def _accelerate(y: RigState, rate: RigState, rig: Rig) -> None:
    """Group by group; then what the rigid links carry."""
    g, torques = rig.g, rig.torques
    for k in range(at.BODIES):
        torques.group_nm[k] = 0.0
    for k in range(at.BODIES):
        torques.group_nm[g.bodies[k].lead] += g.bodies[k].rate * torques.body_nm[k]
    layshaft = g.bodies[at.LAYSHAFT]
    torques.pull_nm = torques.group_nm[layshaft.lead] / layshaft.rate
    for k in range(at.BODIES):
        body = g.bodies[k]
        if body.lead != k:
            continue
        if body.forced != 0:
            accel = body.accel_rad_s2
            given = body.group_kgm2 * accel - torques.group_nm[k]
            torques.body_nm[k] += given
            rate.work_j += given * y.speed_rad_s[k]
        else:
            accel = torques.group_nm[k] / body.group_kgm2
        rate.speed_rad_s[k] = accel
    for k in range(at.BODIES):
        rate.speed_rad_s[k] = g.bodies[k].rate * rate.speed_rad_s[g.bodies[k].lead]
        rate.angle_rad[k] = y.speed_rad_s[k]
    needed = 0.0
    for link in range(at.LINKS - 1, -1, -1):
        behind = link + 1
        needed += rig.p.inertia_kgm2[behind] * rate.speed_rad_s[behind] - torques.body_nm[behind]
        if g.links[link].carried == 0.0:
            needed = 0.0
        torques.link_nm[link] = needed
        needed *= g.links[link].carried


@inlined
def _move_in_backlash(y: RigState, rate: RigState, rig: Rig) -> None:
    """Phases of the gears, and where gears and input shaft lie in their meshes."""
    p, torques = rig.p, rig.torques
    for gear in range(at.GEARS):
        ratio = p.ratio[gear]
        rate.phase_rad[gear] = ratio * y.speed_rad_s[at.LAYSHAFT] - y.speed_rad_s[at.MAIN]
        needed = p.gear_inertia_kgm2 * ratio * rate.speed_rad_s[at.LAYSHAFT]
        needed += p.gear_drag_nms * rate.phase_rad[gear]
        if rig.g.meshed == gear:
            needed = torques.link_nm[at.MAIN_BOX]
        rate.lash_rad[gear] = lash_rad_s(y.lash_rad[gear], needed, p.main_lash)
    splitter = -torques.link_nm[at.SPLITTER]
    rate.input_lash_rad = lash_rad_s(y.input_lash_rad, splitter, p.input_lash)
    for gear in range(at.GEARS, p.dogs):
        ratio = p.ratio[gear]
        rate.phase_rad[gear] = ratio * y.speed_rad_s[at.LAYSHAFT] - y.speed_rad_s[at.INPUT]
        needed = p.gear_inertia_kgm2 * ratio * rate.speed_rad_s[at.LAYSHAFT]
        needed += p.gear_drag_nms * rate.phase_rad[gear]
        if rig.g.split_meshed == gear:
            needed = splitter
        rate.lash_rad[gear] = lash_rad_s(y.lash_rad[gear], needed, p.split_lash)


@inlined
def rates(y: RigState, rate: RigState, rig: Rig) -> None:
    """dy/dt at state y into `rate`; torques into those of the rig."""
    p, g = rig.p, rig.g
    brake = _load_bodies(y, rate, rig)
    if p.disturbance.is_on != 0:
        _shake(y, rate, rig)
    _rub(y, rate, rig)
    _accelerate(y, rate, rig)
    rig.torques.pull_nm += g.brake_sign * brake
    rig.torques.hold_nm = brake
    _move_in_backlash(y, rate, rig)
    rate.brake_pa = chamber_pa_s(y.brake_pa, y.supply_pa, g.valve, p.air)
    filling = rate.brake_pa if g.valve > 0.0 else 0.0
    rate.supply_pa = tank_pa_s(y.supply_pa, g.governed_pa, filling, p.air)
    rate.felt_pa = p.feeling_rate * (y.brake_pa - y.felt_pa)
    rate.disc_k = heating_k_s(rate.brake_j, y.disc_k, p.oil_k, p.brake)
    wanted = demand_nm(g.engine_mode, g.engine_target, y.speed_rad_s[at.ENGINE], p.engine)
    rate.engine_nm = torque_nm_s(wanted, y.engine_nm, p.engine)
    rate.clutch = g.clutch_rate
