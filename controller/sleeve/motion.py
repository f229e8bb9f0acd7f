"""From where a sleeve stands, and the switches of its valves, to where the law says it goes."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from meshpoint.controller.sleeve.cylinder import (
    FOREVER,
    WAY,
    WAY_WORDS,
    carry,
)
from meshpoint.controller.sleeve.law import SleeveLaw
from meshpoint.kernels.records import Vector
from meshpoint.units import SECOND_US, US

NO_SWITCHES: Final = np.zeros((0, 3))


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
    m: float
    end_m_s: float
    state: Vector


class Ways(NamedTuple):
    """Where it takes a sleeve by several laws, one row each."""

    ways: Vector
    """Records `cylinder.Way`, times in s from the start on."""
    states: Vector
    """Records `cylinder.State`, at their ends."""

    def of(self, name: str) -> Vector:
        """One quantity of `cylinder.Way`, of each row."""
        column: Vector = self.ways.view(WAY)[name][:, 0]
        return column


def follow(
    law: SleeveLaw,
    unknowns: Vector,
    supply_pa: float,
    start: Start,
    switches: list[Switch],
    *,
    ending: int,
    until_us: float,
    level_m: float = FOREVER,
    direction: float = 1.0,
    seen: Vector | None = None,
    first_us: float = 0.0,
    from_m: Vector | None = None,
) -> Ways:
    """From `start` by the law, for each row of unknowns: what is learned, then by how much each
    switch's spool is late beyond its valve's learned delay. seen: takes, a row each, the places at
    first_us and every millisecond after. from_m: each row's own place to start from."""
    begin_us, count = start.time_us, len(unknowns)
    coils = [((time_us - begin_us) * US, valve, on) for time_us, valve, on in switches]
    states, ways = np.tile(start.state, (count, 1)), np.empty((count, WAY_WORDS))
    if from_m is not None:
        states[:, 0] = from_m
    carry(
        law.sheet,
        law.atmosphere_pa + supply_pa,
        start.stop_m,
        start.is_rest,
        np.array(coils, dtype=np.float64) if coils else NO_SWITCHES,
        unknowns,
        level_m,
        direction,
        (until_us - begin_us) * US,
        ending,
        (first_us - begin_us) * US,
        np.empty((count, 0)) if seen is None else seen,
        states,
        ways,
    )
    return Ways(ways, states)


def single(found: Ways, start: Start) -> Way:
    """The first of them, in sensor time."""
    crossed_s, speed = found.ways[0, :2].tolist()
    state, begin_us = found.states[0], start.time_us
    return Way(
        None if crossed_s < 0.0 else begin_us + crossed_s * SECOND_US,
        speed,
        float(state[0]),
        float(state[1]),
        state,
    )
