"""From where a sleeve stands, and the switches of its valves, to where the law says it goes."""

from __future__ import annotations

import math
from operator import itemgetter
from typing import Final, NamedTuple

import numpy as np

from meshpoint.controller.records import Vector
from meshpoint.controller.sleeve.cylinder import (
    FOREVER,
    NOTHING_SEEN,
    WAY_WORDS,
    move,
)
from meshpoint.controller.sleeve.law import LEFT, OFF, ON, SleeveLaw
from meshpoint.units import SECOND_US, US

PLUS, MINUS = 0, 1
"""The valve that pushes towards +x, and the other."""


NO_SPOOLS: Final = [(0.0, 0, False)]
_TIME_S: Final = itemgetter(0)


class Switch(NamedTuple):
    """A valve's coil switches."""

    time_us: int
    valve: int
    on: bool


class Start(NamedTuple):
    """From where a sleeve is followed."""

    time_us: int
    state: Vector
    is_rest: bool
    """It rests, both chambers vented: it stays so until a valve moves."""
    stop_m: float = FOREVER
    """A tooth lets it get no further from neutral."""


class Way(NamedTuple):
    """Where the law takes a sleeve; times in sensor time, us."""

    crossed_us: float | None
    speed_m_s: float
    force_n: float
    turned_us: float | None
    furthest_m: float
    end_us: float
    m: float
    end_m_s: float
    state: Vector


def follow(
    law: SleeveLaw,
    learned: Vector,
    late_s: Vector,
    supply_pa: float,
    start: Start,
    switches: list[Switch],
    *,
    ending: int,
    until_us: float,
    level_m: float = FOREVER,
    direction: float = 1.0,
    seen: Vector = NOTHING_SEEN,
    first_us: float = 0.0,
) -> Way:
    """From `start` by the law, each switch's spool late by `late_s` beyond its valve's learned
    delay. seen: takes the places at first_us and every millisecond after."""
    begin_us: float = start.time_us
    known, late = learned.tolist(), late_s.tolist()
    spools = []
    for k, (time_us, valve, on) in enumerate(switches):
        delay_s = known[(ON if on else OFF) + valve] + late[k]
        spools.append(((time_us - begin_us) * US + max(delay_s, 0.0), valve, on))
    spools.sort(key=_TIME_S)
    if start.is_rest:
        moves_us = min(until_us, begin_us + spools[0][0] * SECOND_US) if spools else until_us
        if moves_us > begin_us:
            passed_s = (moves_us - begin_us) * US
            spools = [(time_s - passed_s, valve, on) for time_s, valve, on in spools]
            begin_us = moves_us
    x, way = start.state.copy(), np.zeros(WAY_WORDS)
    air_pa, left = law.atmosphere_pa, math.exp(known[LEFT])
    x[2], x[3] = air_pa + (x[2] - air_pa) * left, air_pa + (x[3] - air_pa) * left
    move(
        law.flat(learned, supply_pa, start.stop_m),
        x,
        np.array(spools or NO_SPOOLS, dtype=np.float64),
        len(spools),
        level_m,
        direction,
        (until_us - begin_us) * US,
        ending,
        (first_us - begin_us) * US,
        seen,
        way,
    )
    crossed_s, speed, force, turned_s, furthest, end_s = way.tolist()
    return Way(
        None if crossed_s < 0.0 else begin_us + crossed_s * SECOND_US,
        speed,
        force,
        None if turned_s < 0.0 else begin_us + turned_s * SECOND_US,
        furthest,
        begin_us + end_s * SECOND_US,
        float(x[0]),
        float(x[1]),
        x,
    )
