"""One main sleeve, followed from its last rest by the law and corrected by what is measured."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from meshpoint.controller.records import Vector
from meshpoint.controller.sensing.gearbox_view import SAMPLE_US, SleeveTrack
from meshpoint.controller.sleeve.cylinder import TO_TIME
from meshpoint.controller.sleeve.law import (
    GAIN,
    OFF,
    OFFSET,
    OFFSET_UNIT_M,
    ON,
    Prior,
    SleeveLaw,
)
from meshpoint.controller.sleeve.motion import Start, Switch, Way, follow

SAMPLE_SD_M: Final = 1e-4
"""Of a sample from the law: its noise, 0.04 mm, and what a law leaves out."""
REST_SD_M: Final = 5e-5
STILL_M: Final = 1.5e-4
"""Samples within this of each other are of a sleeve that rests."""
VENTED_US: Final = 60_000
"""So long after its last switch a sleeve that stands still is vented."""
SHORT_M: Final = 4e-4
"""Nearer to the faces than this a tooth may stop it."""
LOST_M: Final = 8e-4
"""The law is this far from what is measured: something else holds or moves the sleeve."""
SWITCH_SD_S: Final = 1e-3
"""Scatter of a valve from switch to switch, where none was learned."""
KEPT_US: Final = 400_000
"""Samples and switches older than this are of no movement under way."""
MOST_SWITCHES: Final = 8


@dataclass
class Movement:
    """What has been measured since a sleeve left its rest: times (us) and sensor's places (m)."""

    times_us: list[int] = field(default_factory=list)
    readings_m: list[float] = field(default_factory=list)


class TrackedSleeve:
    """One main sleeve."""

    def __init__(self, law: SleeveLaw, prior: Prior) -> None:
        self.law = law
        self.learned: Vector = prior.mean.copy()
        self.covariance: Vector = prior.covariance.copy()
        self.version = 0
        """Changes when more was learned."""
        self.start = Start(0, law.at_rest(0.0), True)
        self.rest_m = 0.0
        """The sensor's reading where the sleeve last rested."""
        self.switches: list[Switch] = []
        self.late_s: Vector = np.zeros(0)
        """By how much each switch's spool is later than its valve's learned delay."""
        self.late_sd_s: Vector = np.zeros(0)
        self.switch_sd_s = [SWITCH_SD_S, SWITCH_SD_S]
        """Scatter of each valve from switch to switch."""
        self.newest_us: int | None = None
        self.movement = Movement()
        self.is_free = True
        """No tooth stands in its way, and the law has been right since it left its rest."""

    @classmethod
    def of(cls, other: TrackedSleeve, state: Vector) -> TrackedSleeve:
        """The same sleeve as it would be at rest in this state, without switches."""
        at_rest = cls(other.law, Prior(other.learned, other.covariance))
        at_rest.start, at_rest.switch_sd_s = Start(0, state, True), other.switch_sd_s
        return at_rest

    def place_of(self, reading_m: float) -> float:
        """Where the sleeve is that the sensor shows there."""
        offset_m = self.learned[OFFSET] * OFFSET_UNIT_M
        return float((reading_m - offset_m) * math.exp(-self.learned[GAIN]))

    def commanded(self, valve: int, on: bool, time_us: int, now_us: int) -> None:
        """A coil switches then; replaces what was still to come of that valve."""
        if any(one == (time_us, valve, on) for one in self.switches):
            self._drop(lambda one: one.valve == valve and one.time_us > max(time_us, now_us))
            return
        self._drop(lambda one: one.valve == valve and one.time_us > now_us)
        if self.driven(valve, time_us) == on:
            return
        self._insert(Switch(time_us, valve, on))

    def _insert(self, switch: Switch) -> None:
        at = sum(one.time_us <= switch.time_us for one in self.switches)
        self.switches.insert(at, switch)
        self.late_s = np.insert(self.late_s, at, 0.0)
        self.late_sd_s = np.insert(self.late_sd_s, at, self.sd_of(switch))

    def expected(self, valve: int, switches: list[tuple[int, bool]], now_us: int) -> None:
        """What is to come of a valve is this."""
        wanted = [Switch(time_us, valve, on) for time_us, on in switches]
        self._drop(lambda one: one.valve == valve and one.time_us > now_us and one not in wanted)
        for one in wanted:
            if one not in self.switches and self.driven(valve, one.time_us) != one.on:
                self._insert(one)

    def withdrawn(self, valve: int, now_us: int) -> None:
        """What was still to come of a valve does not come."""
        self._drop(lambda one: one.valve == valve and one.time_us > now_us)

    def _drop(self, is_gone) -> None:  # type: ignore[no-untyped-def]
        keep = [k for k, one in enumerate(self.switches) if not is_gone(one)]
        if len(keep) < len(self.switches):
            self.switches = [self.switches[k] for k in keep]
            self.late_s, self.late_sd_s = self.late_s[keep], self.late_sd_s[keep]

    def sd_of(self, switch: Switch) -> float:
        """How uncertain a switch's spool is before anything is seen of it."""
        k = (ON if switch.on else OFF) + switch.valve
        return math.sqrt(self.covariance[k, k] + self.switch_sd_s[switch.valve] ** 2)

    def driven(self, valve: int, time_us: float) -> bool:
        """Whether a coil is on then, by the commands."""
        before = [one.on for one in self.switches if one.valve == valve and one.time_us <= time_us]
        return before[-1] if before else bool(self.start.state[4 + valve])

    def ahead(
        self,
        supply_pa: float,
        *,
        ending: int,
        until_us: float,
        switches: list[Switch] | None = None,
        learned: Vector | None = None,
        late_s: Vector | None = None,
        **asked: float | Vector,
    ) -> Way:
        """Where the sleeve goes, by the commands so far or by these."""
        if switches is None:
            switches, late_s = self.switches, self.late_s if late_s is None else late_s
        if late_s is None:
            known = dict(zip(self.switches, self.late_s.tolist(), strict=True))
            late_s = np.array([known.get(one, 0.0) for one in switches])
        return follow(
            self.law,
            self.learned if learned is None else learned,
            late_s,
            supply_pa,
            self.start,
            switches,
            ending=ending,
            until_us=until_us,
            **asked,  # type: ignore[arg-type]
        )

    def at(self, time_us: int, supply_pa: float) -> Way:
        """The state then."""
        return self.ahead(supply_pa, ending=TO_TIME, until_us=time_us)

    def take(self, track: SleeveTrack, supply_pa: float) -> None:
        """The newest samples."""
        count = len(track.samples_m)
        if self.newest_us is not None:
            count = min(count, (track.newest_us - self.newest_us) // SAMPLE_US)
        if count <= 0:
            return
        self.newest_us = track.newest_us
        fresh = range(count - 1, -1, -1)
        moves = self._moves_us()
        if moves is None or track.newest_us < moves:
            self._rest(track)
            return
        for k in fresh:
            self.movement.times_us.append(track.newest_us - k * SAMPLE_US)
            self.movement.readings_m.append(track.samples_m[k])
        self._correct(track, supply_pa)
        if self._is_over(track):
            self._settle(track)

    def _moves_us(self) -> float | None:
        """When the first switch's spool may move."""
        if not self.start.is_rest:
            return self.start.time_us
        if not self.switches:
            return None
        first = self.switches[0]
        k = (ON if first.on else OFF) + first.valve
        return first.time_us + (self.learned[k] - 3.0 * self.sd_of(first)) * 1e6

    def _rest(self, track: SleeveTrack) -> None:
        """It rests: where, by ten samples."""
        newest = track.samples_m[:10]
        self.rest_m = sum(newest) / len(newest)
        state = self.law.at_rest(self.place_of(self.rest_m))
        self.start = Start(track.newest_us, state, True)
        self.movement = Movement()
        self.is_free = True

    def _is_over(self, track: SleeveTrack) -> bool:
        last_us = max((one.time_us for one in self.switches), default=self.start.time_us)
        driven = any(self.driven(valve, track.newest_us) for valve in (0, 1))
        newest = track.samples_m[:10]
        still = max(newest) - min(newest) < STILL_M
        return not driven and still and track.newest_us - last_us > VENTED_US

    def _settle(self, track: SleeveTrack) -> None:
        """The movement is over."""
        self._drop(lambda one: one.time_us <= track.newest_us)
        self._rest(track)

    def _correct(self, track: SleeveTrack, supply_pa: float) -> None:
        """Goes on from what is measured where the law has lost it."""
        place_m = self.place_of(track.samples_m[0])
        expected = self.at(track.newest_us, supply_pa)
        touches = abs(place_m) > self.law.face_m - SHORT_M
        if not touches and abs(expected.m - place_m) < LOST_M:
            return
        self.is_free = False
        state = expected.state.copy()
        few = track.samples_m[: min(4, len(track.samples_m))]
        speed = (few[0] - few[-1]) / ((len(few) - 1) * SAMPLE_US * 1e-6)
        state[0] = max(-self.law.stroke_m, min(self.law.stroke_m, place_m))
        state[1] = speed if abs(speed) > 0.03 else 0.0
        at_us = track.newest_us
        for valve in (0, 1):
            state[4 + valve] = float(self._spool(valve, at_us))
        self.start = Start(at_us, state, False)
        self._drop(lambda one: self._spool_us(one) <= at_us)

    def _spool_us(self, switch: Switch) -> float:
        k = (ON if switch.on else OFF) + switch.valve
        late_s = dict(zip(self.switches, self.late_s.tolist(), strict=True)).get(switch, 0.0)
        return switch.time_us + (self.learned[k] + late_s) * 1e6

    def _spool(self, valve: int, time_us: float) -> bool:
        moved = [o.on for o in self.switches if o.valve == valve and self._spool_us(o) <= time_us]
        return moved[-1] if moved else bool(self.start.state[4 + valve])
