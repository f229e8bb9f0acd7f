"""One main sleeve as its valves drive it, and how well that is known.

From where it stands and the switches of its valves the law says where it goes; law and switches are
known with a covariance, and so is the way.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from meshpoint.controller.sleeve.cylinder import (
    DETENT,
    FEED,
    FOREVER,
    LEFT,
    OFF,
    ON,
    PARAMETERS,
    TO_LEVEL,
    TO_TIME,
    WAY,
    WAY_WORDS,
    carry,
)
from meshpoint.controller.sleeve.law import Figures, Prior, SleeveLaw, slopes
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


def valve_towards(direction: int) -> int:
    """The valve that pushes there."""
    return 0 if direction > 0 else 1


class DrivenSleeve:
    """One main sleeve."""

    def __init__(self, law: SleeveLaw, prior: Prior) -> None:
        self.law = law
        self.known = prior
        """At the last rest."""
        self.learned: Vector = prior.mean
        self.supply_pa = law.sheet_pa
        """Gauge."""
        self.late_s: Vector = np.zeros(0)
        """By how much each switch's spool is later than its valve's learned delay."""
        self.joint: Vector = prior.covariance
        """Covariance of both."""
        self.start = Start(0, law.at_rest(0.0), True)
        self.switches: list[Switch] = []
        self.switch_sd_s = [0.0, 0.0]
        """Scatter of each valve from switch to switch."""

    def at_rest(self, x_m: float) -> DrivenSleeve:
        """The same sleeve as it would be at rest there, without switches."""
        other = DrivenSleeve(self.law, self.known)
        other.start, other.switch_sd_s = Start(0, self.law.at_rest(x_m), True), self.switch_sd_s
        other.supply_pa = self.supply_pa
        return other

    # ---- switches

    def expected(self, valve: int, switches: list[tuple[int, bool]], now_us: int) -> None:
        """Its coils switch then: replaces what was still to come of that valve."""
        if not (switches[0][1] or self.switches or self.start.state[4 + valve]):
            return  # off, as it is
        wanted = [Switch(time_us, valve, on) for time_us, on in switches]
        self._keep(lambda one: one.valve != valve or one.time_us <= now_us or one in wanted)
        for one in wanted:
            if one not in self.switches and self.driven(valve, one.time_us) != one.on:
                self._insert(one)

    def driven(self, valve: int, time_us: float) -> bool:
        """Whether a coil is on then, by the commands."""
        before = [one.on for one in self.switches if one.valve == valve and one.time_us <= time_us]
        return before[-1] if before else bool(self.start.state[4 + valve])

    def fired(self, direction: int, fire_us: int) -> list[Switch]:
        """The switches so far, with the valve that pushes there on from then: what this replaces is
        left out."""
        valve = valve_towards(direction)
        fire = Switch(fire_us, valve, True)
        if fire in self.switches:
            return self.switches
        kept = [one for one in self.switches if one.valve != valve or one.time_us < fire_us]
        return kept if self.driven(valve, fire_us) else [*kept, fire]

    def _insert(self, switch: Switch) -> None:
        at = sum(one.time_us <= switch.time_us for one in self.switches)
        self.switches.insert(at, switch)
        self.late_s = np.insert(self.late_s, at, 0.0)
        row = PARAMETERS + at
        self.joint = np.insert(np.insert(self.joint, row, 0.0, axis=0), row, 0.0, axis=1)
        self.joint[row, row] = self.switch_sd_s[switch.valve] ** 2

    def _keep(self, stays: Callable[[Switch], bool]) -> None:
        keep = [k for k, one in enumerate(self.switches) if stays(one)]
        if len(keep) == len(self.switches):
            return
        self.switches = [self.switches[k] for k in keep]
        self.late_s = self.late_s[keep]
        rows = [*range(PARAMETERS), *(PARAMETERS + k for k in keep)]
        self.joint = self.joint[np.ix_(rows, rows)]

    # ---- how well it is known

    def prior_of_movement(self) -> Prior:
        """What is known of law and switches before anything is seen of a movement."""
        size = PARAMETERS + len(self.switches)
        mean, covariance = np.zeros(size), np.zeros((size, size))
        mean[:PARAMETERS], covariance[:PARAMETERS, :PARAMETERS] = self.known
        for k, one in enumerate(self.switches, PARAMETERS):
            covariance[k, k] = self.switch_sd_s[one.valve] ** 2
        return Prior(mean, covariance)

    def late_of(self, switch: Switch) -> float:
        """By how much its spool is late beyond its valve's delay, as far as it is known."""
        known = self.switches.index(switch) if switch in self.switches else None
        return 0.0 if known is None else float(self.late_s[known])

    def unknowns(self, switches: list[Switch]) -> Vector:
        """What is learned, then the chance of each of these switches, as expected."""
        return np.array([*self.learned, *map(self.late_of, switches)])

    def covariance_with(self, switches: list[Switch]) -> Vector:
        """Covariance of what is learned and of these switches' chance."""
        rows = [PARAMETERS + self.switches.index(o) if o in self.switches else -1 for o in switches]
        size = len(self.joint)
        whole = np.zeros((size + 1, size + 1))
        whole[:size, :size] = self.joint
        at = [*range(PARAMETERS), *rows]
        covariance = whole[np.ix_(at, at)]
        for k, one in enumerate(switches):
            if rows[k] < 0:
                own = PARAMETERS + k
                covariance[own, :] = covariance[:, own] = 0.0
                covariance[own, own] = self.switch_sd_s[one.valve] ** 2
        return covariance

    def sd(self, of: Figures, switches: list[Switch], base: float) -> float:
        """Deviation of a figure, which is `base`, by what is not known of law and switches."""
        slope, spread = self._spread(of, switches, base)
        return math.sqrt(max(float(slope @ spread), 0.0))

    def unknowns_at(self, sds: float, of: Figures, switches: list[Switch], base: float) -> Vector:
        """The likeliest unknowns for which a figure, which is `base`, is that many of its
        deviations greater, to first order."""
        slope, spread = self._spread(of, switches, base)
        sd = math.sqrt(max(float(slope @ spread), 0.0))
        return self.unknowns(switches) + (sds / sd * spread if sd > 0.0 else 0.0)

    def _spread(self, of: Figures, switches: list[Switch], base: float) -> tuple[Vector, Vector]:
        """How a figure grows with each unknown, and its covariance with each."""
        delays = {(ON if one.on else OFF) + one.valve for one in switches}
        own = range(PARAMETERS, PARAMETERS + len(switches))
        left = () if self.start.is_rest else (LEFT,)
        moved_by = [*delays, *range(FEED, DETENT + 1), *left, *own]
        slope = slopes(of, self.unknowns(switches), base, moved_by)
        return slope, self.covariance_with(switches) @ slope

    def sd_of(self, switch: Switch) -> float:
        """How uncertain it is when a switch's spool moves."""
        covariance = self.covariance_with([switch])
        pick = np.zeros(len(covariance))
        pick[(ON if switch.on else OFF) + switch.valve] = pick[-1] = 1.0
        return math.sqrt(max(float(pick @ covariance @ pick), 0.0))

    def spool_us(self, switch: Switch) -> float:
        """When its spool moves, as expected."""
        k = (ON if switch.on else OFF) + switch.valve
        return switch.time_us + (float(self.learned[k]) + self.late_of(switch)) * SECOND_US

    # ---- where it goes

    def ways(
        self,
        unknowns: Vector,
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
        """Where the sleeve goes by these switches, for each row of unknowns: what is learned, then
        by how much each switch's spool is late beyond its valve's learned delay. seen: takes, a row
        each, the places at first_us and every millisecond after. from_m: each row's own place to
        start from."""
        start, count = self.start, len(unknowns)
        begin_us = start.time_us
        coils = [((time_us - begin_us) * US, valve, on) for time_us, valve, on in switches]
        states, ways = np.empty((count, start.state.size)), np.empty((count, WAY_WORDS))
        states[:] = start.state
        if from_m is not None:
            states[:, 0] = from_m
        carry(
            self.law.sheet,
            self.law.atmosphere_pa + self.supply_pa,
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

    def ahead(
        self,
        *,
        ending: int,
        until_us: float,
        switches: list[Switch] | None = None,
        unknowns: Vector | None = None,
        level_m: float = FOREVER,
        direction: float = 1.0,
    ) -> Way:
        """Where the sleeve goes, by the commands so far or by these. unknowns: other ones than
        those expected."""
        if switches is None:
            switches = self.switches
        if unknowns is None:
            unknowns = self.unknowns(switches)
        found = self.ways(
            unknowns[np.newaxis], switches, ending=ending, until_us=until_us, level_m=level_m,
            direction=direction,
        )  # fmt: skip
        return single(found, self.start)

    def at(self, time_us: int) -> Way:
        """The state then."""
        return self.ahead(ending=TO_TIME, until_us=time_us)

    def to_level(
        self, direction: int, level_m: float, until_us: float, unknowns: Vector | None = None
    ) -> Way:
        """Until the sleeve comes by a place in this direction."""
        return self.ahead(
            ending=TO_LEVEL,
            until_us=until_us,
            unknowns=unknowns,
            level_m=level_m,
            direction=float(direction),
        )
