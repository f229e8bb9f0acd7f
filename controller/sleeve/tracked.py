"""One main sleeve, followed from its last rest by the law and corrected by what is measured."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np

from meshpoint.controller.measure.gearbox_view import SAMPLE_US, SleeveTrack
from meshpoint.controller.sleeve.cylinder import FOREVER, GAIN, LEFT, OFFSET, PARAMETERS, TO_TIME
from meshpoint.controller.sleeve.driven import DrivenSleeve, Start, Way, valve_towards
from meshpoint.controller.sleeve.law import LEFT_SD, OFFSET_UNIT_M, Prior, SleeveLaw, fit
from meshpoint.kernels.records import Vector
from meshpoint.units import SECOND_US, US

AT_TEETH_M: Final = 2e-4
"""What its sensor may be wrong by: no nearer to the teeth than this it touches none."""
STANDS_US: Final = 40_000
"""So long after its last switch a sleeve that stands still stays where it is."""
VENTED_PA: Final = 2e3
"""A chamber with no more than this above the air around is vented."""
SHORT_M: Final = 4e-4
"""Nearer to the faces than this a tooth may stop it."""
LOST_M: Final = 8e-4
"""The law is this far from what is measured: something else holds or moves the sleeve."""
UNEXPLAINED_M: Final = 2e-4
"""A movement whose samples are this far from the law, rms, is of something else."""
LEAST_WAY_M: Final = 3e-3
UNLIKELY_SDS: Final = 4.5
"""A figure this far from the data sheet's is no figure of this sleeve."""
MOST_SAMPLES: Final = 110
FADES: Final = 0.002
"""From one movement to the next, this much of what is known fades to what the sheet says."""
REST_SAMPLES: Final = 8
STOP_SD_M: Final = 1e-4
"""Deviation of a sleeve's stop in its gear from the sheet's stroke."""
NEUTRAL_M: Final = 1.5e-3
MOVED_M: Final = 1e-3
MOST_IN_VAIN: Final = 3
"""After more pushes in vain of a sleeve between teeth the next one is no longer than a first one,
and waits until both chambers have vented: of a sensor that is stuck they would throw the sleeve.
Before the teeth it is cold oil that holds a sleeve, for many more."""
VENTS_US: Final = 300_000
LEAST_SAMPLES: Final = 6
STARTED_M: Final = 2e-4
SPEED_SAMPLES: Final = 4
SLOWEST_M_S: Final = 0.02
FIRST_FIT, LATER_FIT, LAST_FIT = 2, 1, 4
"""Iterations."""


@dataclass
class Movement:
    """What has been measured since a sleeve left its rest: times (us) and sensor's places (m)."""

    times_us: list[int] = field(default_factory=list)
    readings_m: list[float] = field(default_factory=list)


class Contact(NamedTuple):
    """A sleeve has come to a gear's teeth. Times in us of the sensor clock."""

    direction: int
    fired_us: int
    from_m: float
    """Where it stood before."""
    measured_us: float
    expected_us: float
    """By what was known before it moved."""
    usual_us: float
    """By what is known now, without the chance of this stroke."""
    fitted_us: float | None
    """By what is known now of this stroke; None where the law does not explain it."""


class Push(NamedTuple):
    """A pulse towards neutral."""

    long_us: int
    from_m: float
    """So far from neutral the sleeve stood."""


class TrackedSleeve(DrivenSleeve):
    """One main sleeve, and what its movements have taught of it."""

    def __init__(self, law: SleeveLaw, prior: Prior) -> None:
        super().__init__(law, prior)
        self._sheet = prior
        self.movements = 0
        """From how many movements the law was learned."""
        self.withstood: dict[tuple[int, bool], Push] = {}
        """By direction, and whether out of a gear: the last push towards neutral that did not throw
        it through."""
        self._in_vain = 0
        """How many pushes in a row have left it where it stood, between teeth, by its sensor."""
        self.version = 0
        """Changes when more was learned."""
        self.rest_m = 0.0
        """The sensor's reading where the sleeve last rested."""
        self.newest_us: int | None = None
        self.movement = Movement()
        self.rests = True
        """It stands, and what its last movement showed has been learned."""
        self._switched_us = 0
        """When a switch last came that is no longer among those above."""
        self._left_m: Vector = np.zeros(0)
        """What the fit of this movement leaves of its samples."""
        self.is_free = True
        """No tooth stands in its way, and the law has been right since it left its rest."""
        self.contact: Contact | None = None
        """The newest contact."""
        self.reached = 0
        """The side on which these samples show it come to a gear's teeth, or past them; 0: neither.
        Whatever the law says."""
        self.met_us: dict[int, float] = {}
        """When it last came to the teeth on either side, as measured; whatever the law says."""

    def set_prior(self, known: Prior) -> None:
        """This is known from now on, and nothing of a movement."""
        self.known = known
        self.version += 1
        self._forget_movement()

    def place_of(self, reading_m: float) -> float:
        """Where the sleeve is that the sensor shows there."""
        return _place_m(self.learned, reading_m)

    def take(self, track: SleeveTrack) -> None:
        """The newest samples."""
        count, self.reached = len(track.samples_m), 0
        if self.newest_us is not None and track.newest_us < self.newest_us:
            self._begin_anew(track)
        if self.newest_us is not None:
            count = min(count, (track.newest_us - self.newest_us) // SAMPLE_US)
        if count <= 0:
            return
        self.newest_us = track.newest_us
        self.reached = self._reaches(track, count)
        moves_us = self._moves_us()
        if moves_us is None or track.newest_us < moves_us:
            self._rest(track)
            return
        self.rests = False
        for k in range(count - 1, -1, -1):
            self.movement.times_us.append(track.newest_us - k * SAMPLE_US)
            self.movement.readings_m.append(track.samples_m[k])
        if self.is_free:
            self._follow(track)
        else:
            self._go_on(track)
            for direction in (-1, 1):
                self._see_contact(track, direction)
        if self._is_over(track):
            self._settle(track)

    def _reaches(self, track: SleeveTrack, count: int) -> int:
        """The side on which it comes to teeth within this count of the newest samples."""
        level_m = self.law.face_m - AT_TEETH_M
        newest_m = self.place_of(track.samples_m[0])
        direction = 1 if newest_m > 0.0 else -1
        if direction * newest_m < level_m:
            return 0
        before_m = self.place_of(track.samples_m[: count + 1][-1])
        return direction if direction * before_m < level_m else 0

    def _begin_anew(self, track: SleeveTrack) -> None:
        """The sensors' clock has gone back: nothing of before holds but what was learned."""
        self.newest_us, self.contact, self.met_us, self._switched_us = None, None, {}, 0
        self.switches, self.late_s = [], np.zeros(0)
        self._forget_movement()
        self.start = Start(track.newest_us, self.start.state, True)
        self._rest(track)

    def _moves_us(self) -> float | None:
        """The earliest at which a sleeve at rest may begin to move; None while nothing moves it."""
        if not self.rests:
            return self.start.time_us
        if not self.switches:
            return None
        first = self.switches[0]
        return self.spool_us(first) - 3.0 * self.sd_of(first) * SECOND_US

    def _rest(self, track: SleeveTrack) -> None:
        """It rests: where, by its newest samples; its chambers may vent for some time yet."""
        newest = track.samples_m[:REST_SAMPLES]
        self.rest_m = math.fsum(newest) / len(newest)
        state = self.law.at_rest(self.place_of(self.rest_m))
        if not self.start.is_rest:
            pressures = self.at(track.newest_us).state[2:4]
            self.learned = self.known.mean
            if max(pressures) > self.law.atmosphere_pa + VENTED_PA:
                state[2:4] = pressures
        is_vented = bool(max(state[2:4]) == self.law.atmosphere_pa)
        self.start = Start(track.newest_us, state, is_vented)
        self.movement = Movement()
        self.rests = self.is_free = True

    @property
    def stands(self) -> bool:
        """Whether it rests and no valve is to move it."""
        return self.rests and not self.switches

    def waits(self, at_us: int) -> bool:
        """Whether it is not to be pushed to neutral yet, after pushes in vain."""
        return self._in_vain > MOST_IN_VAIN and at_us - self._switched_us < VENTS_US

    @property
    def last_switch_us(self) -> int:
        """When a valve of it last switches, as far as commanded."""
        return max((one.time_us for one in self.switches), default=self._switched_us)

    def _is_over(self, track: SleeveTrack) -> bool:
        driven = any(self.driven(valve, track.newest_us) for valve in (0, 1))
        return not driven and track.is_still and track.newest_us - self.last_switch_us > STANDS_US

    def _settle(self, track: SleeveTrack) -> None:
        """The movement is over: what it showed is known from now on."""
        self._see_push()
        if self.is_free:
            self._learn()
        self._switched_us = self.last_switch_us
        self._keep(lambda one: one.time_us > track.newest_us)
        place_m = self.place_of(track.samples_m[0])
        if abs(place_m) > self.law.in_gear_m > abs(self.place_of(self.rest_m)):
            # One that was pulled in vain stands anywhere near its stop.
            self._see_stop(track.samples_m[0], 1 if place_m > 0.0 else -1)
        self._rest(track)

    def _see_push(self) -> None:
        """By how long a pulse it was pushed towards neutral, and not beyond. One that has hardly
        moved it out of a gear says nothing: torque on the teeth may have held it."""
        from_m = float(self.start.state[0])
        direction = -1 if from_m > 0.0 else 1
        own = [one for one in self.switches if one.valve == valve_towards(direction)]
        place_m = self.place_of(self.movement.readings_m[-1])
        if len(own) < 2 or not own[0].on or direction * place_m > NEUTRAL_M:
            return
        in_gear = abs(from_m) > self.law.in_gear_m
        way_m = max(abs(reading - self.rest_m) for reading in self.movement.readings_m)
        is_between = abs(from_m) > self.law.face_m
        self._in_vain = self._in_vain + 1 if is_between and way_m <= MOVED_M else 0
        if not in_gear and self._in_vain > MOST_IN_VAIN:
            self.withstood.pop((direction, in_gear), None)
        elif abs(from_m) > NEUTRAL_M and (way_m > MOVED_M or not in_gear):
            push = Push(own[1].time_us - own[0].time_us, abs(from_m))
            self.withstood[direction, in_gear] = push

    def _follow(self, track: SleeveTrack) -> None:
        """The law is fitted to what has been seen; it ends where a tooth may stop the sleeve."""
        seen = self.movement
        touched = self._touched()
        count = min(len(seen.times_us) if touched is None else touched, MOST_SAMPLES)
        moved = any(abs(m - self.rest_m) > STARTED_M for m in seen.readings_m[:count])
        left_m = 0.0
        if count >= LEAST_SAMPLES and moved:
            iterations = LAST_FIT if touched is not None else FIRST_FIT
            left_m = self._fit(count, iterations)
        if touched is not None:
            self._meet(track, touched)
        elif (
            abs(left_m) > LOST_M
            or abs(self.at(track.newest_us).m - self.place_of(track.samples_m[0])) > 3.0 * LOST_M
        ):
            self._forget_movement()
            self._go_on(track)

    def _touched(self) -> int | None:
        """The first sample at which a tooth may hold the sleeve; None where it is clear of them."""
        limit_m, from_m = self.law.face_m - SHORT_M, self.start.state[0]
        for k, reading in enumerate(self.movement.readings_m):
            place_m = self.place_of(reading)
            if abs(place_m) > limit_m and not (abs(from_m) > limit_m and place_m * from_m > 0.0):
                return k
        return None

    def _fit(self, count: int, iterations: int) -> float:
        """Returns how far the newest sample is from what was fitted (m)."""
        times = np.array(self.movement.times_us[:count])
        first_us = int(times[0])
        at = (times - first_us) // SAMPLE_US

        def readings(unknowns: Vector) -> Vector:
            scale, offset_m = np.exp(unknowns[:, GAIN]), unknowns[:, OFFSET] * OFFSET_UNIT_M
            seen = np.empty((len(unknowns), int(at[-1]) + 1))
            self.ways(
                unknowns, self.switches, ending=TO_TIME, until_us=float(times[-1]) + 1.0, seen=seen,
                first_us=first_us, from_m=(self.rest_m - offset_m) / scale,
            )  # fmt: skip
            return seen[:, at] * scale[:, np.newaxis] + offset_m[:, np.newaxis]

        begin = np.array([*self.learned, *self.late_s])
        measured = np.array(self.movement.readings_m[:count])
        fitted = fit(readings, measured, self.prior_of_movement(), begin, iterations)
        self.learned, self.late_s = fitted.mean[:PARAMETERS], fitted.mean[PARAMETERS:]
        self.joint, self._left_m = fitted.covariance, fitted.left_m
        return float(fitted.left_m[-1])

    @property
    def is_off_its_law(self) -> bool:
        """Whether it moves otherwise than any law says, by what has been seen of it."""
        left = self._left_m
        return len(left) >= LEAST_SAMPLES and float(np.mean(left**2)) > UNEXPLAINED_M**2

    @property
    def _is_explained(self) -> bool:
        """Whether the law explains the movement by figures that the sheet makes likely. A sleeve
        that hardly moved is held by something else."""
        left, readings = self._left_m, self.movement.readings_m
        if len(left) < LEAST_SAMPLES or self.is_off_its_law:
            return False
        if max(abs(reading - self.rest_m) for reading in readings) < LEAST_WAY_M:
            return False
        off = (self.learned - self._sheet.mean) / np.sqrt(np.diag(self._sheet.covariance))
        return bool(np.max(np.abs(off)) < UNLIKELY_SDS)

    def _learn(self) -> None:
        """What the movement showed is known from now on, if the law explains it."""
        if self._is_explained:
            mean, covariance = self.learned.copy(), self.joint[:PARAMETERS, :PARAMETERS]
            faded = (1.0 - FADES) * covariance + FADES * self._sheet.covariance
            faded[LEFT, :] = faded[:, LEFT] = mean[LEFT] = 0.0
            faded[LEFT, LEFT] = LEFT_SD**2
            self.known = Prior(mean, faded)
            self.version += 1
            self.movements += 1
        else:
            self._forget_movement()
        self._left_m = np.zeros(0)

    def _forget_movement(self) -> None:
        prior = self.prior_of_movement()
        self.learned, self.late_s = prior.mean[:PARAMETERS], prior.mean[PARAMETERS:]
        self.joint = prior.covariance

    def _meet(self, track: SleeveTrack, touched: int) -> None:
        """It comes to a gear's teeth."""
        direction = 1 if self.place_of(self.movement.readings_m[touched]) > 0.0 else -1
        fitted, is_explained = self._way_in(direction), self._is_explained
        valve = valve_towards(direction)
        fires = [one for one in self.switches if one.on and one.valve == valve]
        found = self.learned, self.late_s, self.joint
        if is_explained:
            measured_us = self._see_contact(track, direction, fitted.speed_m_s)
            self._forget_movement()
        else:
            self._forget_movement()
            measured_us = self._see_contact(track, direction)
        expected = self._way_in(direction)
        if fires and measured_us is not None and expected.crossed_us is not None:
            chance = self.unknowns(self.switches)
            chance[PARAMETERS:] = 0.0
            if is_explained:
                chance[:PARAMETERS] = found[0]
            explained = self._way_in(direction, chance).crossed_us
            self.contact = Contact(
                direction,
                fires[-1].time_us,
                float(self.start.state[0]),
                measured_us,
                expected.crossed_us,
                expected.crossed_us if explained is None else explained,
                fitted.crossed_us if is_explained else None,
            )
        self.learned, self.late_s, self.joint = found
        readings = self.movement.readings_m
        newest = tuple(reversed(readings[-REST_SAMPLES:]))
        self._go_on(SleeveTrack(self.movement.times_us[-1], newest))
        self._learn()

    def _way_in(self, direction: int, unknowns: Vector | None = None) -> Way:
        until_us = self.movement.times_us[-1] + 100_000
        level_m = direction * self.law.face_m
        return self.to_level(direction, level_m, until_us, unknowns=unknowns)

    def _see_contact(
        self, track: SleeveTrack, direction: int, speed_m_s: float = 0.0
    ) -> float | None:
        """The contact by the newest samples: where the sleeve comes near the teeth, then at the
        law's speed; without one, as fast as it came there."""
        level_m = direction * (self.law.face_m - SHORT_M)
        reading_m = direction * float(_reading_m(self.learned, np.array(level_m)))
        passed_us = track.crossing_us(reading_m, direction)
        if passed_us is None:
            return None
        if speed_m_s == 0.0:
            at = int(track.newest_us - passed_us) // SAMPLE_US
            near = track.samples_m[at : at + SPEED_SAMPLES]
            speed_m_s = direction * (near[0] - near[-1]) / ((len(near) - 1) * SAMPLE_US * US)
        met_us = passed_us + SHORT_M / max(speed_m_s, SLOWEST_M_S) * SECOND_US
        self.met_us[direction] = met_us
        return met_us

    def _go_on(self, track: SleeveTrack) -> None:
        """Goes on from what is measured: teeth, or something else, hold or move the sleeve."""
        self._see_push()
        self.is_free = False
        at_us = track.newest_us
        state = self.at(at_us).state.copy()
        self.learned = self.learned.copy()
        self.learned[LEFT] = 0.0
        few = track.samples_m[:4]
        span_s = max(len(few) - 1, 1) * SAMPLE_US * US
        speed_m_s = (few[0] - few[-1]) / span_s
        most_m = self.law.stroke_m
        state[0] = max(-most_m, min(most_m, self.place_of(track.samples_m[0])))
        state[1] = speed_m_s if abs(speed_m_s) > 0.03 else 0.0
        newest = [abs(self.place_of(reading)) for reading in track.samples_m[:REST_SAMPLES]]
        is_on_tooth = all(abs(place_m - self.law.face_m) < SHORT_M for place_m in newest)
        stop_m = abs(float(state[0])) if is_on_tooth else FOREVER
        self.start = Start(at_us, state, False, stop_m)
        self._switched_us = self.last_switch_us
        self._keep(lambda one: self.spool_us(one) > at_us)

    def _see_stop(self, reading_m: float, direction: int) -> None:
        """It stands at its stop in a gear: what the sensor shows there."""
        mean, covariance = self.known.mean.copy(), self.known.covariance
        shown = _reading_m(mean, np.array([direction * self.law.stroke_m]))[0]
        slope = np.zeros(PARAMETERS)
        slope[OFFSET], slope[GAIN] = OFFSET_UNIT_M, direction * self.law.stroke_m
        spread = covariance @ slope
        gain = spread / (float(slope @ spread) + STOP_SD_M**2)
        spread = covariance - np.outer(gain, slope @ covariance)
        self.set_prior(Prior(mean + gain * (reading_m - shown), spread))


def _place_m(learned: Vector, reading_m: float) -> float:
    offset_m = learned[OFFSET] * OFFSET_UNIT_M
    return float((reading_m - offset_m) * math.exp(-learned[GAIN]))


def _reading_m(learned: Vector, place_m: Vector) -> Vector:
    reading_m: Vector = place_m * math.exp(learned[GAIN]) + learned[OFFSET] * OFFSET_UNIT_M
    return reading_m
