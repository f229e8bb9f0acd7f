"""A main sleeve between its two chambers: one kernel that carries it on from any state.

    m dv/dt = (p+ - p-) A - F_c sgn(v) - B v - F(x)
    F(x)  = F_d sin(pi x / w), |x| < w;    - F_e sgn(x) sin(pi (L - |x|) / w), |x| > L - w
    dp/dt   = n (R T rho0 q - p dV/dt) / V,        V = V0 + A (L +- x)

x is the sleeve's place from neutral, p+ the pressure that pushes it towards +x. q is the flow
through a valve by ISO 6358: conductance C from the supply where the valve is on, C times the vent's
share to the air around where it is off. Pressures are absolute; air at 20 degC, polytropic.
Integrated in second order: pressures by Adams and Bashforth, motion by the trapezoidal rule.
"""

from __future__ import annotations

import math
from typing import Annotated, Final

import numpy as np

from meshpoint.kernels.jit import compiled, inlined, record_on
from meshpoint.kernels.records import WORD_BYTES, Vector, layout_of

STEP_S: Final = 4e-4
"""Longest step; contacts come out within 20 us (tests/controller/test_sleeve_equations.py)."""
STEP_SHARE: Final = 0.5
"""Of the time in which a chamber's pressure comes near its end: no step is longer (Adams and
Bashforth's stability)."""
LEAST_STEP_S: Final = 5e-5
"""Chambers that would need shorter ones are off by a per cent of their pressure at their end."""
SHORT_SHARE: Final = 0.2
"""Of a step: the rates of one before it that was shorter than this are not extrapolated."""
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

ON, OFF, FEED = 0, 2, 4
"""Each of two: of the valve that pushes towards +x, and of the other."""
FRICTION, DAMPING, DEAD, VENT, DETENT, IN_GEAR, OFFSET, GAIN, LEFT = range(6, 15)
PARAMETERS: Final = 15
"""What is learned of a sleeve: two on delays and two off delays (s), two logarithms of how fast a
chamber fills, those of friction, damping, dead volume and vent share; the force of the detent in
neutral and of those in gear (kN); the position sensor's offset (mm) and the logarithm of its gain;
and of one movement alone, the logarithm of the pressures left in the chambers as it begins over
those that the law expects."""
DETENT_UNIT_N: Final = 1e3

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
    in_gear_n: float
    """Of the detents that hold it in its gears."""


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
    """Speed towards the level there."""
    turned_s: float
    """When the sleeve first stopped or turned after it had moved; -1 where it did not."""
    furthest_m: float
    """The furthest place towards the level."""


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


@inlined
def _detent_n(law: Law, place: float) -> float:
    """What the detents push with, towards -x."""
    width, left = law.detent_m, law.stroke_m - abs(place)
    if abs(place) < width:
        return law.detent_n * math.sin(math.pi * place / width)
    if left < width:
        return -math.copysign(law.in_gear_n, place) * math.sin(math.pi * left / width)
    return 0.0


@inlined
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
    static = STATIC_SHARE * friction
    place, speed = state.x_m, state.speed_m_s
    p0, p1 = state.pressure_pa[0], state.pressure_pa[1]
    on0, on1 = state.open_[0], state.open_[1]
    way.crossed_s = way.turned_s = -1.0
    way.crossed_m_s = 0.0
    way.furthest_m = place
    # The chamber is smallest where the sleeve is at its end.
    quickest = DRIVEN * EDGE * max(feed0, feed1) * max(1.0, vent) / dead
    longest_s = min(STEP_S, max(STEP_SHARE / quickest, LEAST_STEP_S))
    rate0 = rate1 = last_s = 0.0
    t = 0.0
    j = 0
    k = 0
    while k < seen.shape[0] and first_s + 1e-3 * k <= 0.0:
        seen[k] = place
        k += 1
    pull = (p0 - p1) * area - _detent_n(law, place)
    while t < until_s:
        while j < count and switches[j, 0] <= t + 1e-12:
            if switches[j, 1] == 0.0:
                on0 = switches[j, 2]
            else:
                on1 = switches[j, 2]
            j += 1
            last_s = 0.0
        h = min(longest_s, until_s - t)
        if j < count:
            h = min(h, switches[j, 0] - t)
        if k < seen.shape[0]:
            h = min(h, first_s + 1e-3 * k - t)
        h = max(h, 1e-9)
        volume0 = dead + area * (stroke + place)
        volume1 = dead + area * (stroke - place)
        flow0 = _flow(on0, feed0, vent, supply, air, p0)
        flow1 = _flow(on1, feed1, vent, supply, air, p1)
        before0, before1 = rate0, rate1
        rate0 = (DRIVEN * flow0 - POLYTROPIC * p0 * area * speed) / volume0
        rate1 = (DRIVEN * flow1 + POLYTROPIC * p1 * area * speed) / volume1
        # Adams and Bashforth's second order; Euler's step where a spool has just moved.
        more = 0.5 * h / last_s if last_s > SHORT_SHARE * h else 0.0
        p0 += h * (rate0 + more * (rate0 - before0))
        p1 += h * (rate1 + more * (rate1 - before1))
        last_s = h
        before = pull
        pull = (p0 - p1) * area - _detent_n(law, place + h * speed)
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
            damped = 0.5 * h * damping / mass
            new = speed * (1.0 - damped) + h * (0.5 * (before + pull) - side * friction) / mass
            new /= 1.0 + damped
            if new * speed <= 0.0:
                moved = 0.5 * h * speed * (speed / (speed - new)) if new != speed else 0.0
                new = 0.0
                if way.turned_s < 0.0:
                    way.turned_s = t + h
            else:
                moved = 0.5 * h * (speed + new)
            speed = new
        t += h
        if moved != 0.0:
            to_level = direction * (level_m - place)
            if way.crossed_s < 0.0 and to_level > 0.0 and direction * moved >= to_level:
                way.crossed_s = t - h * (1.0 - to_level / (direction * moved))
                way.crossed_m_s = direction * speed
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
    state.x_m, state.speed_m_s = place, speed
    state.pressure_pa[0], state.pressure_pa[1] = p0, p1
    state.open_[0], state.open_[1] = on0, on1


@compiled
def carry(
    sheet_at: Vector,
    supply_pa: float,
    stop_m: float,
    is_rest: bool,
    switches: Vector,
    unknowns: Vector,
    level_m: float,
    direction: float,
    until_s: float,
    ending: int,
    first_s: float,
    seen: Vector,
    states: Vector,
    ways: Vector,
) -> None:
    """Carries the states on in place, one for each row of unknowns: what is learned of the law,
    then by how much each switch's spool is late beyond its valve's delay.

    sheet_at: the law by the data sheet. is_rest: it stays as it is until a spool moves. switches:
    time (s), valve, on, in order of the coils. All times are from the start on. seen, states, ways:
    a row each; a row of seen takes the places at first_s and each 1 ms after."""
    law_at, spools = sheet_at.copy(), np.empty((switches.shape[0], 3))
    sheet, law = record_on(sheet_at, LAW), record_on(law_at, LAW)
    law.supply_pa = supply_pa
    law.stop_m = min(sheet.stop_m, stop_m)
    sheet_m3 = sheet.dead_m3 + sheet.area_m2 * sheet.stroke_m
    count = switches.shape[0]
    for row in range(unknowns.shape[0]):
        known = unknowns[row]
        law.friction_n = sheet.friction_n * math.exp(known[FRICTION])
        law.damping_nsm = sheet.damping_nsm * math.exp(known[DAMPING])
        law.dead_m3 = sheet.dead_m3 * math.exp(known[DEAD])
        law.vent = sheet.vent * math.exp(known[VENT])
        law.detent_n = max(known[DETENT], 0.0) * DETENT_UNIT_N
        law.in_gear_n = max(known[IN_GEAR], 0.0) * DETENT_UNIT_N
        # A stroke's time goes with the rate at which a chamber fills: a larger chamber has a valve
        # that lets through as much more.
        larger = (law.dead_m3 + law.area_m2 * law.stroke_m) / sheet_m3
        for valve in range(2):
            law.feed[valve] = sheet.feed[valve] * larger * math.exp(known[FEED + valve])
        for k in range(count):
            valve, on = int(switches[k, 1]), switches[k, 2]
            delay_s = known[(ON if on > 0.0 else OFF) + valve] + known[PARAMETERS + k]
            moves_s = switches[k, 0] + max(delay_s, 0.0)
            at = k
            while at > 0 and spools[at - 1, 0] > moves_s:
                spools[at] = spools[at - 1]
                at -= 1
            spools[at, 0], spools[at, 1], spools[at, 2] = moves_s, valve, on
        rests_s = 0.0
        if is_rest:
            rests_s = max(min(spools[0, 0], until_s) if count > 0 else until_s, 0.0)
            for k in range(count):
                spools[k, 0] -= rests_s
        x, left = states[row], math.exp(known[LEFT])
        for k in range(2, 4):
            x[k] = law.atmosphere_pa + (x[k] - law.atmosphere_pa) * left
        move(
            law_at, x, spools, count, level_m, direction, until_s - rests_s, ending,
            first_s - rests_s, seen[row], ways[row],
        )  # fmt: skip
        way = record_on(ways[row], WAY)
        if way.crossed_s >= 0.0:
            way.crossed_s += rests_s
        if way.turned_s >= 0.0:
            way.turned_s += rests_s


NOTHING_SEEN: Final = np.zeros((1, 0))


def warm_up() -> None:
    """Compiles it, or loads what was compiled before."""
    sheet = np.ones(LAW_WORDS)
    carry(
        sheet, 1.0, 1.0, False, np.zeros((0, 3)), np.zeros((1, PARAMETERS)), 1.0, 1.0, 0.0,
        TO_TIME, FOREVER, NOTHING_SEEN, np.ones((1, STATE_WORDS)), np.zeros((1, WAY_WORDS)),
    )  # fmt: skip
