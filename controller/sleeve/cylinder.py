"""A main sleeve between its two chambers: one kernel that carries it on from any state.

    m dv/dt = (p+ - p-) A - F_c sgn(v) - B v - F_d sin(pi x / w) |x| < w
    dp/dt   = n (R T rho0 q - p dV/dt) / V,        V = V0 + A (L +- x)

x is the sleeve's place from neutral, p+ the pressure that pushes it towards +x. q is the flow
through a valve by ISO 6358: conductance C from the supply where the valve is on, C times the vent's
share to the air around where it is off. Pressures are absolute; air at 20 degC, polytropic.
"""

from __future__ import annotations

import math
from typing import Annotated, Final

import numpy as np

from meshpoint.controller.jit import compiled, inlined, record_on
from meshpoint.controller.records import WORD_BYTES, Vector, layout_of

STEP_S: Final = 1e-4
GAS_J_KGK: Final = 287.05
AIR_K: Final = 293.15
NORMAL_KG_M3: Final = 1.185
"""Density of the air at which ISO 6358 states a conductance: 1 bar, 20 degC, 65 % humidity."""
POLYTROPIC: Final = 1.2
CRITICAL: Final = 0.3
"""Pressure ratio below which the flow is choked."""
LAMINAR: Final = 0.99
"""Above this ratio the flow falls linearly to nothing (ISO 6358-1, Annex): no infinite slope."""
STATIC_SHARE: Final = 1.25
"""Friction of a sleeve that rests, over that of one that moves."""
FOREVER: Final = 1e9
DRIVEN: Final = POLYTROPIC * GAS_J_KGK * AIR_K * NORMAL_KG_M3
EDGE: Final = math.sqrt(1.0 - ((LAMINAR - CRITICAL) / (1.0 - CRITICAL)) ** 2) / (1.0 - LAMINAR)

TO_TIME, TO_LEVEL, TO_TURN, TO_REST = 0, 1, 2, 3
"""Where `move` ends, if not before: at `until_s`; as the level is crossed; as the sleeve turns or
stops; as it rests with both valves off."""


class Law:
    """The figures of one sleeve."""

    area_m2: float
    mass_kg: float
    stroke_m: float
    detent_m: float
    atmosphere_pa: float
    supply_pa: float
    """Absolute."""
    feed: Annotated[Vector, 2]
    """Conductance of the valve that pushes towards +x, and of the other, m3/(s Pa)."""
    friction_n: float
    damping_nsm: float
    dead_m3: float
    vent: float
    """Conductance of the way out over that of the way in."""
    stop_m: float
    """How far the sleeve gets to either side: its stroke, or a tooth that it rests on."""
    detent_n: float


class State:
    """A sleeve at an instant."""

    x_m: float
    speed_m_s: float
    pressure_pa: Annotated[Vector, 2]
    open_: Annotated[Vector, 2]
    """1 where a valve's spool lets the supply in, 0 where it vents."""


class Way:
    """What became of it."""

    crossed_s: float
    """When the level was crossed; -1 where it was not."""
    crossed_m_s: float
    crossed_n: float
    """Speed towards the level there, and the force of the air."""
    turned_s: float
    """When the sleeve first stopped or turned after it had moved; -1 where it did not."""
    furthest_m: float
    """The furthest place towards the level."""
    end_s: float


LAW: Final = layout_of(Law)
STATE: Final = layout_of(State)
WAY: Final = layout_of(Way)
LAW_WORDS: Final = LAW.itemsize // WORD_BYTES
STATE_WORDS: Final = STATE.itemsize // WORD_BYTES
WAY_WORDS: Final = WAY.itemsize // WORD_BYTES


@inlined
def _share(from_pa: float, to_pa: float) -> float:
    """Flow over the choked flow."""
    if from_pa <= to_pa:
        return 0.0
    ratio = to_pa / from_pa
    if ratio <= CRITICAL:
        return 1.0
    if ratio > LAMINAR:
        return EDGE * (1.0 - ratio)
    part = (ratio - CRITICAL) / (1.0 - CRITICAL)
    return math.sqrt(1.0 - part * part)


@inlined
def _flow(on: float, feed: float, vent: float, supply_pa: float, air_pa: float, pa: float) -> float:
    """Flow into a chamber, m3/s of normal air times Pa."""
    outer = supply_pa if on > 0.0 else air_pa
    c = feed if on > 0.0 else feed * vent
    return c * (outer * _share(outer, pa) - pa * _share(pa, outer))


@compiled
def move(  # noqa: C901
    law_at: Vector,
    x: Vector,
    switches: Vector,
    count: int,
    level_m: float,
    direction: float,
    until_s: float,
    ending: int,
    first_s: float,
    seen: Vector,
    way_at: Vector,
) -> None:
    """Carries the state `x` on in place. switches[:count]: time (s), valve (0 pushes to +x), on; in
    order of time, as the spools move. seen: takes the places (m) at first_s and each 1 ms after."""
    law = record_on(law_at, LAW)
    state = record_on(x, STATE)
    way = record_on(way_at, WAY)
    area, dead, stroke = law.area_m2, law.dead_m3, law.stroke_m
    feed0, feed1, vent = law.feed[0], law.feed[1], law.vent
    supply, air = law.supply_pa, law.atmosphere_pa
    mass, friction, damping = law.mass_kg, law.friction_n, law.damping_nsm
    detent, width = law.detent_n, law.detent_m
    static = STATIC_SHARE * friction
    place, speed = state.x_m, state.speed_m_s
    p0, p1 = state.pressure_pa[0], state.pressure_pa[1]
    on0, on1 = state.open_[0], state.open_[1]
    way.crossed_s = way.turned_s = -1.0
    way.crossed_m_s = way.crossed_n = 0.0
    way.furthest_m = place
    t = 0.0
    j = 0
    k = 0
    while k < seen.shape[0] and first_s + 1e-3 * k <= 0.0:
        seen[k] = place
        k += 1
    pull = (p0 - p1) * area
    if abs(place) < width:
        pull -= detent * math.sin(math.pi * place / width)
    while t < until_s:
        while j < count and switches[j, 0] <= t + 1e-12:
            if switches[j, 1] == 0.0:
                on0 = switches[j, 2]
            else:
                on1 = switches[j, 2]
            j += 1
        h = min(STEP_S, until_s - t)
        if j < count:
            h = min(h, switches[j, 0] - t)
        if k < seen.shape[0]:
            h = min(h, first_s + 1e-3 * k - t)
        h = max(h, 1e-9)
        volume0 = dead + area * (stroke + place)
        volume1 = dead + area * (stroke - place)
        flow0 = _flow(on0, feed0, vent, supply, air, p0)
        flow1 = _flow(on1, feed1, vent, supply, air, p1)
        grown0 = (DRIVEN * flow0 - POLYTROPIC * p0 * area * speed) / volume0
        grown1 = (DRIVEN * flow1 + POLYTROPIC * p1 * area * speed) / volume1
        held = 0.0
        if abs(place) < width:
            held = detent * math.sin(math.pi * place / width)
        before = pull
        pull = (p0 + h * grown0 - p1 - h * grown1) * area - held
        moved = 0.0
        if speed == 0.0:
            if abs(pull) > static:
                # It breaks away within the step: the rest of it is in motion.
                part = 1.0
                if abs(before) < static:
                    part = (abs(pull) - static) / max(abs(pull - before), 1e-9)
                side = 1.0 if pull > 0.0 else -1.0
                speed = min(part, 1.0) * h * (pull - side * friction) / mass
                moved = 0.5 * min(part, 1.0) * h * speed
            elif ending == TO_REST and j >= count and on0 + on1 == 0.0:
                empty = max(p0, p1) - air < 0.5 * static / area
                if empty:
                    break
        else:
            side = 1.0 if speed > 0.0 else -1.0
            # The damping is taken at the step's end, the rest at its beginning.
            new = (speed + h * (0.5 * (before + pull) - side * friction) / mass) / (
                1.0 + h * damping / mass
            )
            if new * speed <= 0.0:
                moved = 0.5 * h * speed * (speed / (speed - new)) if new != speed else 0.0
                new = 0.0
                if way.turned_s < 0.0:
                    way.turned_s = t + h
            else:
                moved = 0.5 * h * (speed + new)
            speed = new
        p0 += h * grown0
        p1 += h * grown1
        t += h
        if moved != 0.0:
            to_level = direction * (level_m - place)
            if way.crossed_s < 0.0 and to_level > 0.0 and direction * moved >= to_level:
                way.crossed_s = t - h * (1.0 - to_level / (direction * moved))
                way.crossed_m_s = direction * speed
                way.crossed_n = direction * (p0 - p1) * area
            place += moved
            if abs(place) >= law.stop_m:
                place = math.copysign(law.stop_m, place)
                speed = 0.0
                if way.turned_s < 0.0:
                    way.turned_s = t
            if direction * (place - way.furthest_m) > 0.0:
                way.furthest_m = place
        while k < seen.shape[0] and first_s + 1e-3 * k <= t + 1e-9:
            seen[k] = place
            k += 1
        if ending == TO_LEVEL and way.crossed_s >= 0.0:
            break
        if ending == TO_TURN and way.turned_s >= 0.0 and j >= count:
            break
    while k < seen.shape[0]:
        seen[k] = place
        k += 1
    way.end_s = t
    state.x_m, state.speed_m_s = place, speed
    state.pressure_pa[0], state.pressure_pa[1] = p0, p1
    state.open_[0], state.open_[1] = on0, on1


NOTHING_SEEN: Final = np.zeros(0)


def warm_up() -> None:
    """Compiles it, or loads what was compiled before."""
    law, state, way = np.ones(LAW_WORDS), np.ones(STATE_WORDS), np.zeros(WAY_WORDS)
    move(law, state, np.zeros((1, 3)), 0, 1.0, 1.0, 0.0, TO_TIME, FOREVER, NOTHING_SEEN, way)
