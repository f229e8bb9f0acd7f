"""The truck plant's inner loop: fixed steps cut at events, and the edges found in each step.

Classical Runge-Kutta of fourth order on a grid of fixed instants. A step is cut only at scheduled
instants and at events found in it, never by how far the caller wants to go: so what happens does
not depend on how often anybody asks. An event's instant is found with steps of the method itself,
so the state there is as exact as at a grid point. Within a step an angle is the cubic through its
end angles and speeds; an edge lies where the cubic meets it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

from rig_sim.engine import capacity_nm
from rig_sim.jit import SOURCES, entry, inlined, part
from rig_sim.kernels import TAU, Floats, Integers, wrapped
from rig_sim.truck_layout import (
    ANGLE,
    BEFORE,
    BEHIND,
    BODIES,
    BOTTOM,
    BRAKE_PA,
    BRAKE_SIGN,
    CAN_RELEASE,
    CARRIED,
    CHANNELS,
    CLUTCH,
    CLUTCH_NM,
    COUNT,
    DUE,
    EXTRA,
    EXTRA_EDGE_US,
    FIRST_EDGES,
    FORCED,
    FRICTION_RATIO,
    GEAR,
    HELD,
    HIGH,
    HISTORY,
    HISTORY_US,
    HOLD,
    INPUT,
    JITTERS,
    KISS,
    LAP,
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
    MISSING,
    NO_SLIP,
    OFFSET,
    PHASE,
    POSITION,
    PULL,
    REACHED,
    RELEASE_NM,
    SIGN,
    SILENT,
    SLOTS,
    SPEED,
    STATES,
    STEP_US,
    STOPPED,
    TOOTH,
    TOP,
    WITH_LASH,
)
from rig_sim.truck_motion import rates

SECOND_US: Final = 1e6
ROOT_S: Final = 1e-11
MAX_ITERATIONS: Final = 60
FIRM_NM: Final = 0.2
TORQUE_S: Final = 1e-9
WATCHES: Final = 2
FINE_US: Final = 250.0
QUIET_PA_S: Final = 1e4


@part
def step(
    y: Floats, after: Floats, h: float, p: Floats, g: Floats, slots: Floats, k: Floats, aux: Floats
) -> None:
    """One Runge-Kutta step from y into `after`. k[0] holds the rates at y; k[1..3] are scratch."""
    for stage in range(3):
        part_way = h if stage == 2 else 0.5 * h
        for i in range(STATES):
            after[i] = y[i] + part_way * k[stage, i]
        rates(after, p, g, slots, k[stage + 1], aux)
    for i in range(STATES):
        after[i] = y[i] + h / 6.0 * (k[0, i] + 2.0 * (k[1, i] + k[2, i]) + k[3, i])


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
def _first_event(
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
def _torques_turn(
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


@part
def _time_in_step(start: float, end: float, v0: float, v1: float, h: float, at: float) -> float:
    """When the cubic from `start` to `end` with end slopes v0, v1 reaches `at`; in [0, h]."""
    way = end - start
    a = (v0 + v1) * h - 2.0 * way
    b = 3.0 * way - (2.0 * v0 + v1) * h
    c = v0 * h
    x = (at - start) / way
    for _ in range(MAX_ITERATIONS):
        error = start + x * (c + x * (b + x * a)) - at
        slope = c + x * (2.0 * b + 3.0 * x * a)
        if slope <= 0.0:
            return h * min(max((at - start) / way, 0.0), 1.0)
        change = error / slope
        x -= change
        if abs(change) < 1e-9:
            break
    return h * min(max(x, 0.0), 1.0)


@part
def _write(ring: Integers, channel: int, pointers: Integers, time_us: float) -> None:
    ring[channel, pointers[channel, COUNT] % ring.shape[1]] = math.floor(time_us)
    pointers[channel, COUNT] += 1


@inlined
def _capture(
    y: Floats,
    after: Floats,
    laps: Integers,
    t_us: float,
    h: float,
    teeth: Integers,
    table: Floats,
    first: Floats,
    jitter_s: Floats,
    pointers: Integers,
    faults: Integers,
    ring: Integers,
) -> None:
    """All edges of a step into the capture rings.

    table    (channels, teeth) angle of each edge of the as-built wheel, rad
    first    (channels, FIRST_EDGES) error of the first edges after power-up, rad
    jitter_s (JITTERS,) times turned into angle at the present speed
    """
    for channel in range(CHANNELS):
        body = INPUT + channel // 2
        start, end = y[ANGLE + body], after[ANGLE + body]
        v0, v1 = y[SPEED + body], after[SPEED + body]
        if body == INPUT:
            start += y[LASH]
            end += after[LASH]
            drift = (after[LASH] - y[LASH]) / h
            v0 += drift
            v1 += drift
        if end <= start:
            continue
        while True:
            tooth, count = pointers[channel, TOOTH], pointers[channel, COUNT]
            at = table[channel, tooth] + TAU * (pointers[channel, LAP] - laps[body])
            at += v0 * jitter_s[(count * 733 + channel * 509) % JITTERS]
            if count < FIRST_EDGES:
                at += first[channel, count]
            if at > end:
                break
            silent = faults[channel, SILENT] != 0 or faults[channel, MISSING] == tooth + 1
            if not silent:
                s = _time_in_step(start, end, v0, v1, h, max(at, start))
                time_us = t_us + s * SECOND_US
                _write(ring, channel, pointers, time_us)
                for extra in range(faults[channel, EXTRA]):
                    _write(ring, channel, pointers, time_us + EXTRA_EDGE_US * (extra + 1))
            pointers[channel, TOOTH] = tooth + 1
            if tooth + 1 == teeth[channel // 2]:
                pointers[channel, TOOTH] = 0
                pointers[channel, LAP] += 1


@inlined
def _settle(y: Floats, laps: Integers, pitch: float, watches: Floats) -> None:
    """Angles back into a turn and free phases into a pitch; a watched phase keeps its branch."""
    for k in range(BODIES):
        if y[ANGLE + k] >= TAU:
            y[ANGLE + k] -= TAU
            laps[k] += 1
        elif y[ANGLE + k] < 0.0:
            y[ANGLE + k] += TAU
            laps[k] -= 1
    for gear in range(4):
        before = y[PHASE + gear]
        if before >= 0.5 * pitch or before < -0.5 * pitch:
            y[PHASE + gear] = wrapped(before, pitch)
            for watch in range(WATCHES):
                if int(watches[watch, GEAR]) == gear:
                    watches[watch, OFFSET] += before - y[PHASE + gear]


@inlined
def _next_grid_us(t_us: float, p: Floats, rate: Floats) -> float:
    """The next grid point; filling and exhausting have kinks, so a finer grid while air moves."""
    grid_us: float = p[STEP_US]
    if abs(rate[BRAKE_PA]) > QUIET_PA_S:
        grid_us = min(grid_us, FINE_US)
    return (math.floor(t_us / grid_us) + 1.0) * grid_us


@inlined
def _copy(source: Floats, target: Floats) -> None:
    for i in range(STATES):
        target[i] = source[i]


@inlined
def _remember(t_us: float, y: Floats, laps: Integers, history: Floats) -> None:
    """The layshaft's angle and speed, every 2 ms, for the reference encoder."""
    count = math.floor(t_us / HISTORY_US)
    if count * HISTORY_US == t_us:
        row = int(count) % HISTORY
        history[row, 0] = laps[LAYSHAFT]
        history[row, 1] = y[ANGLE + LAYSHAFT]
        history[row, 2] = y[SPEED + LAYSHAFT]


def _make_advance(sources: int) -> Callable[..., tuple[float, int]]:
    def advance(
        t_us: float,
        until_us: float,
        stop_us: float,
        pitch: float,
        y: Floats,
        laps: Integers,
        p: Floats,
        g: Floats,
        slots: Floats,
        watches: Floats,
        scratch: Floats,
        history: Floats,
        teeth: Integers,
        table: Floats,
        first: Floats,
        jitter_s: Floats,
        pointers: Integers,
        faults: Integers,
        ring: Integers,
    ) -> tuple[float, int]:
        """Go on to the next event, to `stop_us`, or to the last grid point up to `until_us`.

        Everything is updated in place; returns the time reached and why it ended there. scratch is
        (7, STATES): rates, three stages, the state after the step, torques, the rates there.
        """
        _ = sources
        k, after, aux, ahead = scratch[:4], scratch[4], scratch[5], scratch[6]
        end_us, is_first = t_us, True
        while True:
            if not is_first:
                end_us = min(_next_grid_us(t_us, p, k[0]), stop_us)
                if end_us > until_us:
                    return t_us, REACHED
            h = (end_us - t_us) / SECOND_US
            event = REACHED
            _copy(y, after)
            if h > 0.0:
                step(y, after, h, p, g, slots, k, aux)
                event, s = _first_event(y, after, h, p, g, slots, watches, k, aux)
                if event != REACHED:
                    h = s
                    end_us = t_us + s * SECOND_US
            turned, s = _torques_turn(y, after, h, p, g, slots, k, ahead, aux)
            if turned != REACHED and (event == REACHED or s < h - 2.0 * TORQUE_S):
                event, h = turned, s
                end_us = t_us + s * SECOND_US
            if h > 0.0:
                _capture(
                    y, after, laps, t_us, h, teeth, table, first, jitter_s, pointers, faults, ring
                )
                _copy(after, y)
                _settle(y, laps, pitch, watches)
            _copy(ahead, k[0])
            t_us = end_us
            _remember(t_us, y, laps, history)
            if event != REACHED:
                return t_us, event
            if t_us == stop_us:
                return t_us, DUE
            is_first = False

    return entry(advance)


advance = _make_advance(SOURCES)
