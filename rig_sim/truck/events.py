"""The truck plant's events: what is watched for, whether a step meets it, and when.

An event's instant is found with steps of the method itself, so the state there is as exact as at a
grid point. Kinematic events are a function of the state that turns positive; torque events are a
torque that leaves its limits, found by bisection.
"""

from __future__ import annotations

from typing import Final

from meshpoint.rig_sim.jit import inlined, part
from meshpoint.rig_sim.parts.engine import capacity_nm
from meshpoint.rig_sim.shared.angle_kernels import Floats
from meshpoint.rig_sim.truck.layout import (
    BEFORE,
    BEHIND,
    BOTTOM,
    BRAKE_SIGN,
    CAN_RELEASE,
    CARRIED,
    CLUTCH,
    CLUTCH_NM,
    FORCED,
    FRICTION_RATIO,
    GEAR,
    HELD,
    HIGH,
    HOLD,
    KISS,
    LASH,
    LAYSHAFT,
    LEAD,
    LEFT_BOTTOM,
    LEFT_TOP,
    LET_GO,
    LINK,
    LINK_SLIPS,
    LINKS,
    LOW,
    MAIN_BOX,
    NO_SLIP,
    OFFSET,
    PHASE,
    POSITION,
    PULL,
    REACHED,
    RELEASE_NM,
    SIGN,
    SLOTS,
    SPEED,
    STOPPED,
    TOP,
    WITH_LASH,
)
from meshpoint.rig_sim.truck.motion import rates
from meshpoint.rig_sim.truck.step import step

ROOT_S: Final = 1e-11
MAX_ITERATIONS: Final = 60
FIRM_NM: Final = 0.2
TORQUE_S: Final = 1e-9
WATCHES: Final = 2


@inlined
def _watched(y: Floats, watches: Floats, row: int) -> float:
    gear = int(watches[row, GEAR])
    phase: float = y[PHASE + gear] + watches[row, OFFSET]
    if watches[row, WITH_LASH] != 0.0:
        phase += y[LASH + 1 + gear]
    return phase


@inlined
def _beyond(y: Floats, event: int, slots: Floats, watches: Floats, g: Floats) -> float:
    """How far a state is beyond an event's limit: positive once the event has happened."""
    beyond: float
    if event >= STOPPED:
        beyond = -g[BRAKE_SIGN] * y[SPEED + LAYSHAFT]
    elif event >= NO_SLIP:
        slot = event - NO_SLIP
        before, behind = int(slots[slot, BEFORE]), int(slots[slot, BEHIND])
        ahead = slots[slot, FRICTION_RATIO] * y[SPEED + before] - y[SPEED + behind]
        beyond = -slots[slot, SIGN] * ahead
    elif event >= LEFT_BOTTOM:
        row = event - LEFT_BOTTOM
        beyond = watches[row, BOTTOM] - _watched(y, watches, row)
    else:
        row = event - LEFT_TOP
        beyond = _watched(y, watches, row) - watches[row, TOP]
    return beyond


@inlined
def _happened(
    y: Floats, after: Floats, event: int, slots: Floats, watches: Floats, g: Floats
) -> bool:
    """Whether the event lies within the step: what stands a hair outside must move on outwards."""
    end = _beyond(after, event, slots, watches, g)
    return end > 0.0 and end > _beyond(y, event, slots, watches, g)


@part
def _root(
    y: Floats,
    after: Floats,
    h: float,
    event: int,
    p: Floats,
    g: Floats,
    slots: Floats,
    watches: Floats,
    k: Floats,
    aux: Floats,
) -> float:
    """When in the step the event happens; `after` is then the state there (Illinois method)."""
    low, high = 0.0, h
    f_low = _beyond(y, event, slots, watches, g)
    f_high = _beyond(after, event, slots, watches, g)
    side = 0
    for iteration in range(MAX_ITERATIONS):
        last = f_low >= 0.0 or high - low < ROOT_S or iteration == MAX_ITERATIONS - 1
        if f_low >= 0.0:
            high = 0.0
        s = high
        if not last:
            s = (low * f_high - high * f_low) / (f_high - f_low)
            # a hair inside the bracket: an almost linear function lands on the root and would stay
            s = min(max(s, low + 0.5 * ROOT_S), high - 0.5 * ROOT_S)
        step(y, after, s, p, g, slots, k, aux)
        if last:
            break
        f = _beyond(after, event, slots, watches, g)
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
def first_event(
    y: Floats,
    after: Floats,
    h: float,
    p: Floats,
    g: Floats,
    slots: Floats,
    watches: Floats,
    k: Floats,
    aux: Floats,
) -> tuple[int, float]:
    """The first event of a step, and when; `after` becomes the state there."""
    found = REACHED
    stoppable = g[BRAKE_SIGN] != 0.0 and g[FORCED + int(g[LEAD + LAYSHAFT])] == 0.0
    for candidate in range(2 * WATCHES + SLOTS + 1):
        if candidate < WATCHES:
            event, asked = LEFT_TOP + candidate, watches[candidate, GEAR] >= 0.0
        elif candidate < 2 * WATCHES:
            row = candidate - WATCHES
            event, asked = LEFT_BOTTOM + row, watches[row, GEAR] >= 0.0
        elif candidate < 2 * WATCHES + SLOTS:
            slot = candidate - 2 * WATCHES
            event, asked = NO_SLIP + slot, slots[slot, SIGN] != 0.0
        else:
            event, asked = STOPPED, stoppable
        if asked and _happened(y, after, event, slots, watches, g):
            found = event
            h = _root(y, after, h, event, p, g, slots, watches, k, aux)
    return found, h


@inlined
def _torque_event(y: Floats, p: Floats, g: Floats, aux: Floats) -> int:
    """What the torques at the end of a step bring about."""
    for link in range(LINKS):
        if g[CARRIED + link] == 0.0:
            continue
        torque = aux[LINK + link]
        low, high = g[LOW + link], g[HIGH + link]
        if link == CLUTCH:
            high = capacity_nm(y[POSITION], p[KISS], p[CLUTCH_NM])
            low = -high
        if torque < low - FIRM_NM or torque > high + FIRM_NM:
            return LINK_SLIPS + link
    if g[RELEASE_NM] >= 0.0 and abs(aux[LINK + MAIN_BOX]) <= g[RELEASE_NM]:
        return CAN_RELEASE
    if g[HELD] != 0.0 and abs(aux[PULL]) > aux[HOLD] + FIRM_NM:
        return LET_GO
    return REACHED


@inlined
def torques_turn(
    y: Floats,
    after: Floats,
    h: float,
    p: Floats,
    g: Floats,
    slots: Floats,
    k: Floats,
    ahead: Floats,
    aux: Floats,
) -> tuple[int, float]:
    """Whether a torque leaves its limits in the step, and when (bisected); `after` and its rates
    `ahead` are then those of that instant."""
    found, low, high, s = REACHED, 0.0, h, h
    while True:
        rates(after, p, g, slots, ahead, aux)
        event = _torque_event(after, p, g, aux) if s > 0.0 else REACHED
        if event != REACHED:
            found, high = event, s
        else:
            low = s
        if found == REACHED:
            return REACHED, h
        if high - low < TORQUE_S and s == high:
            return found, high
        s = high if high - low < TORQUE_S else 0.5 * (low + high)
        step(y, after, s, p, g, slots, k, aux)
