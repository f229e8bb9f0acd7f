"""The truck plant's events: which are watched, whether one happens within a step, and when.

An event's instant is found with steps of the method itself, so the state there is as exact as at a
grid point. Kinematic events are a function of the state that turns positive; torque events are a
torque that leaves its limits, found by bisection.
"""

from __future__ import annotations

import math
from typing import Final

from meshpoint.kernels.jit import inlined, piece
from meshpoint.rig_sim.parts.disturbance import orders
from meshpoint.rig_sim.parts.engine import capacity_nm
from meshpoint.rig_sim.truck import layout as at
from meshpoint.rig_sim.truck.layout import PhaseWatch, Rig, RigState
from meshpoint.rig_sim.truck.motion import rates
from meshpoint.rig_sim.truck.step import step

EVENT_ROOT_S: Final = 1e-11
EVENT_ITERATIONS: Final = 60
TORQUE_MARGIN_NM: Final = 0.2
TORQUE_S: Final = 1e-9
SHAKEN_TORQUE_S: Final = 1e-6
"""Where torques of chance turn, they do this often, and slowly: under 1 mNm in a microsecond."""
AT_FLANK_RAD: Final = 1e-7
MEETING_HALVINGS: Final = 22
RETURN_HALVINGS: Final = 12
NEWTON_ITERATIONS: Final = 8


@inlined
def _watched(y: RigState, watch: PhaseWatch) -> float:
    phase = y.phase_rad[watch.gear] + watch.offset_rad
    if watch.with_lash != 0:
        phase += y.lash_rad[watch.gear]
    return phase


@inlined
def _beyond(y: RigState, event: int, rig: Rig) -> float:
    """How far a state is beyond an event's limit: positive once the event has happened."""
    beyond: float
    if event >= at.MEETS_FLANK:
        flank = rig.p.twisting.half_lash_rad * (2.0 * (event - at.MEETS_FLANK) - 1.0)
        since = rig.y.twist_rad - flank
        if abs(since) < AT_FLANK_RAD:  # begins there, and may go either way
            beyond = -1.0
        else:
            beyond = (flank - y.twist_rad) * math.copysign(1.0, since)
    elif event >= at.STOPPED:
        beyond = -rig.g.brake_sign * y.speed_rad_s[at.LAYSHAFT]
    elif event >= at.NO_SLIP:
        contact = rig.contacts[event - at.NO_SLIP]
        before, behind = contact.before, contact.behind
        ahead = contact.ratio * y.speed_rad_s[before] - y.speed_rad_s[behind]
        beyond = -contact.sign * ahead
    elif event >= at.LEFT_BOTTOM:
        watch = rig.watches[event - at.LEFT_BOTTOM]
        beyond = watch.bottom_rad - _watched(y, watch)
    else:
        watch = rig.watches[event - at.LEFT_TOP]
        beyond = _watched(y, watch) - watch.top_rad
    return beyond


@inlined
def _happened(event: int, rig: Rig) -> bool:
    """Whether the event lies within the step. A state slightly beyond the limit counts only if it
    moves further out."""
    end = _beyond(rig.after, event, rig)
    return end > 0.0 and end > _beyond(rig.y, event, rig)


@inlined
def _is_shaken(rig: Rig) -> bool:
    """Whether torques may turn twice in a step. In the profile `clean` they hardly do; there a
    return counts from the beginning of its step, as it always has."""
    return rig.p.disturbance.is_on != 0 or rig.p.twisting.stiff_nm_rad > 0.0


@inlined
def _return(
    event: int, h: float, f_low: float, f_high: float, rig: Rig
) -> tuple[float, float, float, float]:
    """A step that begins at the limit and ends beyond it may lie within it in between: a tooth that
    leaves its flank and comes back to it. The bracket of its return, else of its beginning."""
    high, s = h, h
    for _ in range(RETURN_HALVINGS):
        s *= 0.5
        step(rig, s)
        f = _beyond(rig.after, event, rig)
        if f < 0.0:
            return s, high, f, f_high
        high, f_high = s, f
    return 0.0, h, f_low, f_high


@inlined
def _arrival(event: int, low: float, high: float, rig: Rig) -> float:
    """When a watched phase without lash leaves its span, by Newton's method from the bracket's end;
    `after` is then the state there. -1 where it does not converge, or the phase has lash.

    A third of the steps of `_root`, which counts where teeth rattle."""
    top = event < at.LEFT_BOTTOM
    watch = rig.watches[event - at.LEFT_TOP if top else event - at.LEFT_BOTTOM]
    speed, s = rig.after.speed_rad_s, high
    for _ in range(NEWTON_ITERATIONS):
        step(rig, s)
        sleeve = at.MAIN if watch.gear < at.GEARS else at.INPUT
        away = rig.p.ratio[watch.gear] * speed[at.LAYSHAFT] - speed[sleeve]
        if not top:
            away = -away
        if watch.with_lash != 0 or away <= 0.0:
            break
        change = _beyond(rig.after, event, rig) / away
        if abs(change) < EVENT_ROOT_S:
            return s
        s = min(max(s - change, low), high)
    return -1.0


@piece
def _root(event: int, h: float, rig: Rig) -> float:
    """When in the step the event happens; `after` is then the state there (Illinois method)."""
    low, high = 0.0, h
    f_low = _beyond(rig.y, event, rig)
    f_high = _beyond(rig.after, event, rig)
    if _is_shaken(rig):
        if f_low >= 0.0:
            low, high, f_low, f_high = _return(event, h, f_low, f_high, rig)
        if f_low < 0.0 and event < at.NO_SLIP:
            s = _arrival(event, low, high, rig)
            if s >= 0.0:
                return s
    side = 0
    for iteration in range(EVENT_ITERATIONS):
        last = f_low >= 0.0 or high - low < EVENT_ROOT_S or iteration == EVENT_ITERATIONS - 1
        if f_low >= 0.0:
            high = 0.0
        s = high
        if not last:
            s = (low * f_high - high * f_low) / (f_high - f_low)
            # a hair inside the bracket: an almost linear function lands on the root and would stay
            s = min(max(s, low + 0.5 * EVENT_ROOT_S), high - 0.5 * EVENT_ROOT_S)
        step(rig, s)
        if last:
            break
        f = _beyond(rig.after, event, rig)
        if f >= 0.0:
            high, f_high = s, f
            if side == 1:
                f_low *= 0.5
            side = 1
        else:
            low, f_low = s, f
            if side == -1:
                f_high *= 0.5
            side = -1
    return high


@inlined
def _meeting(event: int, h: float, rig: Rig) -> float:
    """When in the step a flank of the final drive is met or left; `after` is then the state there.

    By the cubic through the twist's ends and its speeds: the torque is continuous there and bends
    alone, so that a nanosecond is of no account, and no step is spent on a search."""
    y, after = rig.y, rig.after
    v0 = (y.speed_rad_s[at.PROPELLER] - y.wheels_rad_s) * h
    v1 = (after.speed_rad_s[at.PROPELLER] - after.wheels_rad_s) * h
    flank = rig.p.twisting.half_lash_rad * (2.0 * (event - at.MEETS_FLANK) - 1.0)
    start, length = y.twist_rad - flank, after.twist_rad - y.twist_rad
    a, b = v0 + v1 - 2.0 * length, 3.0 * length - 2.0 * v0 - v1
    low, high = 0.0, 1.0
    for _ in range(MEETING_HALVINGS):
        x = 0.5 * (low + high)
        if (start + x * (v0 + x * (b + x * a))) * start > 0.0:
            low = x
        else:
            high = x
    step(rig, high * h)
    return high * h


@inlined
def first_event(h: float, rig: Rig) -> tuple[int, float]:
    """The first event of a step and its time; `after` becomes the state then."""
    found = at.REACHED
    layshaft = rig.g.bodies[at.LAYSHAFT]
    stoppable = rig.g.brake_sign != 0.0 and rig.g.bodies[layshaft.lead].forced == 0
    flanked = rig.p.twisting.half_lash_rad > 0.0
    for candidate in range(2 * at.WATCHES + at.CONTACTS + 3):
        if candidate < at.WATCHES:
            event, asked = at.LEFT_TOP + candidate, rig.watches[candidate].gear >= 0
        elif candidate < 2 * at.WATCHES:
            row = candidate - at.WATCHES
            event, asked = at.LEFT_BOTTOM + row, rig.watches[row].gear >= 0
        elif candidate < 2 * at.WATCHES + at.CONTACTS:
            contact = candidate - 2 * at.WATCHES
            event, asked = at.NO_SLIP + contact, rig.contacts[contact].sign != 0.0
        elif candidate == 2 * at.WATCHES + at.CONTACTS:
            event, asked = at.STOPPED, stoppable
        else:
            side = candidate - 2 * at.WATCHES - at.CONTACTS - 1
            event, asked = at.MEETS_FLANK + side, flanked
        if asked and _happened(event, rig):
            found = event
            h = _meeting(event, h, rig) if event >= at.MEETS_FLANK else _root(event, h, rig)
    return found, h


@inlined
def _torque_event(rig: Rig) -> int:
    """The torque event that the torques at the end of a step cause, if any."""
    g, torques = rig.g, rig.torques
    for i in range(at.LINKS):
        link = g.links[i]
        if link.carried == 0.0:
            continue
        torque = torques.link_nm[i]
        low, high = link.low_nm, link.high_nm
        if i == at.CLUTCH:
            high = capacity_nm(rig.after.clutch, rig.p.plates)
            if rig.p.disturbance.is_on != 0:  # as uneven as when the plates slip
                high *= 1.0 + orders(rig.after.angle_rad[at.ENGINE], rig.p.disturbance)
            low = -high
        if torque < low - TORQUE_MARGIN_NM or torque > high + TORQUE_MARGIN_NM:
            return at.LINK_SLIPS + i
    for i in range(at.LINKS):
        if g.release_nm[i] >= 0.0 and abs(torques.link_nm[i]) <= g.release_nm[i]:
            return at.CAN_RELEASE + i
    if g.held != 0 and abs(torques.pull_nm) > torques.hold_nm + TORQUE_MARGIN_NM:
        return at.LET_GO
    return at.REACHED


@inlined
def torques_turn(h: float, rig: Rig) -> tuple[int, float]:
    """Whether a torque leaves its limits in the step, and when (bisected); `after` and its rates
    `ahead` are then those of that instant."""
    found, low, high, s = at.REACHED, 0.0, h, h
    near_s = SHAKEN_TORQUE_S if _is_shaken(rig) else TORQUE_S
    while True:
        rates(rig.after, rig.ahead, rig)
        event = _torque_event(rig) if s > 0.0 else at.REACHED
        if event != at.REACHED:
            found, high = event, s
        else:
            low = s
        if found == at.REACHED:
            return at.REACHED, h
        if high - low < near_s and s == high:
            return found, high
        s = high if high - low < near_s else 0.5 * (low + high)
        step(rig, s)
