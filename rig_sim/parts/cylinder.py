"""A sleeve as a mass between two chambers, each fed or vented by a 3/2 valve of its own.

    m dv/dt = (p_A - p_B) A + F_d(x) - F_c sgn(v) - B v
    dp_A/dt = n (R T m'_A - p_A A v) / V_A,   dp_B/dt = n (R T m'_B + p_B A v) / V_B

with V_A = V_0 + A (s + x), V_B = V_0 + A (s - x), and the flows m' of ISO 6358 (`pneumatics`),
either way: a chamber is open to the supply while its spool is on, else to the air around. x is the
way from neutral, positive where chamber A pushes to. F_d are the detents: -D sin(pi x / w) within
w of neutral, and the same towards either end of the stroke. A sleeve that stands is held by static
friction.

`run_ahead` integrates by Runge-Kutta of fourth order up to the next thing that happens on the axis:
the sleeve begins to move or stops, meets a bound, or comes to rest with both chambers still.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Final

from meshpoint.kernels.jit import bare, inlined, piece
from meshpoint.kernels.structures import Floats, Record, Row, Vector
from meshpoint.rig_sim.parts.pneumatics import GAS_J_KGK, NORMAL_K, NORMAL_KG_M3, flow_share

CRITICAL: Final = 0.3
POLYTROPIC: Final = 1.2
STEP_S: Final = 1e-4
ROOT_S: Final = 1e-9
STILL_PA: Final = 20.0
"""A chamber so near to what it is open to is as good as there."""

# --- how `run_ahead` ends -----------------------------------------------------------------------
RUNS: Final = 0  # the samples are full, or the time asked for is over
RESTS: Final = 1  # it stands, and both chambers are still: nothing more until something changes
BREAKS: Final = 2  # it begins to move, in `direction`
STOPS: Final = 3  # its speed has come to zero
HIGH: Final = 4  # it is at `high_m`, going up
LOW: Final = 5  # it is at `low_m`, going down

COLUMNS: Final = 6
"""Of a sample: time since the beginning s, x m, v m/s, p_A and p_B Pa, and what air and detents
push with N."""


class AxialState(Vector):
    """What is integrated; a second record of the same fields holds its rates."""

    x_m: float
    v_m_s: float
    a_pa: float
    b_pa: float


class Cylinder(Record):
    """One sleeve's cylinder as built, and what moves in it. Pressures are absolute."""

    y: AxialState
    after: AxialState
    stages: Annotated[Row[AxialState], 4]
    area_m2: float
    dead_m3: float  # either side, pipe included, the piston at its end
    a_fill_m3_spa: float  # sonic conductances
    a_vent_m3_spa: float
    b_fill_m3_spa: float
    b_vent_m3_spa: float
    a_leak_m3_spa: float  # of a valve that does not close: from the supply, its spool off
    b_leak_m3_spa: float
    mass_kg: float
    added_friction: float  # by a fault, as a share of its own
    sliding_n: float
    static_n: float
    damping_nsm: float
    stroke_m: float  # from neutral to either end
    neutral_n: float  # strongest pull of the detent at neutral
    end_n: float  # and of those at the ends
    detent_m: float
    atmosphere_pa: float
    supply_pa: float
    a_on: int  # spools
    b_on: int
    direction: int  # in which it moves; 0: it stands
    jammed: int
    held: int  # direction in which something else holds it
    low_m: float  # bounds
    high_m: float
    walled: int  # direction in which a bound stops it for good; 0: neither


@piece
def _push_n(y: AxialState, c: Cylinder) -> float:
    """What air and detents push with, towards +x."""
    push = (y.a_pa - y.b_pa) * c.area_m2
    reach = c.detent_m
    if abs(y.x_m) < reach:
        push -= c.neutral_n * math.sin(math.pi * y.x_m / reach)
    left = c.stroke_m - abs(y.x_m)
    if left < reach:
        push += math.copysign(c.end_n * math.sin(math.pi * left / reach), y.x_m)
    return push


@inlined
def _flow(pa: float, spool: int, fill: float, vent: float, c: Cylinder) -> float:
    """What flows into a chamber, m3 Pa/s before heat and density."""
    if spool != 0:
        fed_pa, conductance = c.supply_pa, fill
    else:
        fed_pa, conductance = c.atmosphere_pa, vent
    inward = fed_pa * flow_share(fed_pa, pa, CRITICAL)
    outward = pa * flow_share(pa, fed_pa, CRITICAL)
    return conductance * (inward - outward)


@piece
def _rates(y: AxialState, rate: AxialState, c: Cylinder) -> None:
    swept = c.area_m2 * y.v_m_s
    flow = GAS_J_KGK * NORMAL_K * NORMAL_KG_M3
    a_m3 = c.dead_m3 + c.area_m2 * (c.stroke_m + y.x_m)
    b_m3 = c.dead_m3 + c.area_m2 * (c.stroke_m - y.x_m)
    a_flow = flow * _flow(y.a_pa, c.a_on, c.a_fill_m3_spa, c.a_vent_m3_spa, c)
    b_flow = flow * _flow(y.b_pa, c.b_on, c.b_fill_m3_spa, c.b_vent_m3_spa, c)
    if c.a_leak_m3_spa > 0.0 and c.a_on == 0:
        a_flow += flow * _flow(y.a_pa, 1, c.a_leak_m3_spa, 0.0, c)
    if c.b_leak_m3_spa > 0.0 and c.b_on == 0:
        b_flow += flow * _flow(y.b_pa, 1, c.b_leak_m3_spa, 0.0, c)
    rate.a_pa = POLYTROPIC * (a_flow - y.a_pa * swept) / a_m3
    rate.b_pa = POLYTROPIC * (b_flow + y.b_pa * swept) / b_m3
    rate.x_m = y.v_m_s
    rate.v_m_s = 0.0
    if c.direction != 0:
        force = _push_n(y, c) - c.direction * c.sliding_n - c.damping_nsm * y.v_m_s
        rate.v_m_s = force / c.mass_kg


@piece
def _step(c: Cylinder, h: float) -> None:
    """One step from `y` into `after`."""
    y, after, stages = c.y.vector, c.after.vector, c.stages
    _rates(c.y, stages[0], c)
    for stage in range(3):
        part_way = h if stage == 2 else 0.5 * h
        slope = stages[stage].vector
        for i in range(len(y)):
            after[i] = y[i] + part_way * slope[i]
        _rates(c.after, stages[stage + 1], c)
    k0, k1, k2, k3 = stages[0].vector, stages[1].vector, stages[2].vector, stages[3].vector
    for i in range(len(y)):
        after[i] = y[i] + h / 6.0 * (k0[i] + 2.0 * (k1[i] + k2[i]) + k3[i])


@piece
def _breaks(y: AxialState, c: Cylinder) -> int:
    """The direction in which a sleeve that stands begins to move, or 0."""
    push = _push_n(y, c)
    if abs(push) <= c.static_n or c.jammed != 0:
        return 0
    direction = 1 if push > 0.0 else -1
    at_bound = y.x_m >= c.high_m if direction > 0 else y.x_m <= c.low_m
    if direction == c.held or (at_bound and direction == c.walled):
        return 0
    return direction


@piece
def _happened(c: Cylinder) -> int:
    """What has happened by the state `after`; RUNS: nothing."""
    if c.direction == 0:
        return BREAKS if _breaks(c.after, c) != 0 else RUNS
    if c.direction > 0 and c.after.x_m >= c.high_m:
        return HIGH
    if c.direction < 0 and c.after.x_m <= c.low_m:
        return LOW
    if c.after.v_m_s * c.direction < 0.0:
        return STOPS
    return RUNS


@inlined
def _is_still(pa: float, spool: int, leak: float, c: Cylinder) -> bool:
    """A chamber between a leak and its vent is never said to be: its pressure goes with both."""
    if spool != 0:
        return abs(pa - c.supply_pa) < STILL_PA
    return leak == 0.0 and abs(pa - c.atmosphere_pa) < STILL_PA


@inlined
def _settle(c: Cylinder, code: int) -> None:
    """The state that has been reached becomes the present one."""
    c.y.x_m, c.y.v_m_s = c.after.x_m, c.after.v_m_s
    c.y.a_pa, c.y.b_pa = c.after.a_pa, c.after.b_pa
    if code == BREAKS:
        c.direction = _breaks(c.y, c)
    elif code == STOPS:
        c.direction, c.y.v_m_s = 0, 0.0
    elif code == HIGH:
        c.y.x_m = c.high_m
    elif code == LOW:
        c.y.x_m = c.low_m


@inlined
def _sample(samples: Floats, row: int, t: float, c: Cylinder) -> None:
    y = c.y
    samples[row, 0], samples[row, 1], samples[row, 2] = t, y.x_m, y.v_m_s
    samples[row, 3], samples[row, 4], samples[row, 5] = y.a_pa, y.b_pa, _push_n(y, c)


@bare
def run_ahead(cylinders: Sequence[Cylinder], duration_s: float, samples: Floats) -> tuple[int, int]:
    """Integrates the cylinder to the next thing that happens on its axis, at most for this long or
    until the samples are full. The number of samples, the first of them the beginning, and why it
    ended (RUNS to LOW)."""
    c = cylinders[0]
    t, count = 0.0, 1
    _sample(samples, 0, t, c)
    if c.direction == 0:
        c.direction = _breaks(c.y, c)
        if c.direction != 0:
            return 1, BREAKS
    while t < duration_s and count < samples.shape[0]:
        still = c.direction == 0 and _is_still(c.y.a_pa, c.a_on, c.a_leak_m3_spa, c)
        if still and _is_still(c.y.b_pa, c.b_on, c.b_leak_m3_spa, c):
            return count, RESTS
        h = min(STEP_S, duration_s - t)
        _step(c, h)
        code = _happened(c)
        if code != RUNS:
            low, high = 0.0, h
            while high - low > ROOT_S:
                middle = 0.5 * (low + high)
                _step(c, middle)
                found = _happened(c)
                if found != RUNS:
                    high, code = middle, found
                else:
                    low = middle
            _step(c, high)
            h = high
        _settle(c, code)
        t = duration_s if h == duration_s - t else t + h
        _sample(samples, count, t, c)
        count += 1
        if code != RUNS:
            return count, code
    return count, RUNS
