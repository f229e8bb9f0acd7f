"""What a sleeve's stroke comes to: contact with a gear's teeth, a stop, or a rest in neutral.

Contact is when it meets the teeth, by the law, and how sure that is. What the law leaves of a
gear's contacts has a bias, and a scatter from stroke to stroke: a normal law with unknown mean and
variance (normal-inverse-gamma). Where the law explains a stroke, the bias is what it leaves of the
contact; where it does not, all of the difference is.

A sleeve in flight is stopped short of the teeth by its valve off and the opposite one on in one
instant, that one off again after some 10 ms. A pulse of one valve leaves a sleeve at rest in
neutral. Times are integer microseconds of the sensor clock.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Final, NamedTuple

import numpy as np

from meshpoint.controller.estimate.figures import Estimate
from meshpoint.controller.settings.valve_name import ValveName
from meshpoint.controller.sleeve.cylinder import OFF, ON, PARAMETERS, TO_LEVEL, TO_REST, TO_TURN
from meshpoint.controller.sleeve.driven import (
    DrivenSleeve,
    Switch,
    Way,
    Ways,
    single,
    valve_towards,
)
from meshpoint.controller.sleeve.tracked import Contact
from meshpoint.gearbox.sheet import SleeveActuator
from meshpoint.kernels.records import Vector
from meshpoint.units import SECOND_US, US

LONGEST_US: Final = 500_000
"""No sleeve takes longer to its gear."""

PRIOR_SAMPLES: Final = 0.5
"""Weight of no bias, in contacts."""
PRIOR_SCATTER_SAMPLES: Final = 4.0
"""Weight of the data sheet's scatter, in contacts."""
SHARE_OF_SCATTER: Final = 0.6
"""Scatter within one gear of one gearbox, as a share of the data sheet's scatter."""
LEAST_SCATTER_S: Final = 1e-4
MOST_SAMPLES: Final = 60.0
"""Largest weight of past contacts: older ones are forgotten, so that a slow drift is followed."""
FAR_S: Final = 0.02
"""A contact this far from what is expected is not learned: something else held the sleeve up."""

STOPS_US: Final = 40_000
"""A sleeve that is stopped in flight stands within this time, or is not stopped."""
RESTS_US: Final = 400_000
LEAST_MARGIN_M: Final = 2e-4
SURE: Final = 2.5
"""A sleeve that is stopped stays short of the teeth with law and switches this many standard
deviations off to the bad side."""
LONGEST_PULSE_US: Final = 14_000
SHORTEST_PULSE_US: Final = 9_000
"""The step that aborts sends the pulse's beginning, the next one its end."""
PULSE_STEP_US: Final = 500
ALONE_SHARE: Final = 0.4
"""A sleeve that stops by itself within this share of its way to the teeth is not braked."""
NEARLY_M: Final = 1e-4
ABORT_STEP_US: Final = 250

LONGEST_PULL_US: Final = 60_000
PULL_STEP_US: Final = 100
NEAR_NEUTRAL_M: Final = 1e-3
NEAR_TEETH_M: Final = 1e-3
LATE_SDS: Final = 4.2
"""A valve shuts by no more of its standard deviations later than expected."""


class Place(NamedTuple):
    """A sleeve at an instant."""

    m: float
    """From neutral, in the sensor's direction, its offset and gain taken out."""
    speed_m_s: float
    is_moving: bool


class Stroke(NamedTuple):
    """A stroke until it meets the gear's teeth."""

    contact_us: int
    sd_us: float
    freedom: float
    """From how many contacts the scatter is known: degrees of freedom of the contact's Student
    law."""
    contact_speed_m_s: float


class Halt(NamedTuple):
    """A sleeve stopped in flight: the valve that drives it goes off at the abort, the opposite one
    comes on then and goes off at `off_us`."""

    at_us: int
    off_us: int
    m: float
    """Where it will stand."""
    sd_m: float


class Pulse(NamedTuple):
    """One valve on, then off, so that the sleeve comes to rest in neutral."""

    valve: ValveName
    on_us: int
    off_us: int
    m: float
    """Where it comes to rest."""


def to_contact(sleeve: DrivenSleeve, direction: int, switches: list[Switch]) -> Way:
    """Until it meets the teeth."""
    ways = _ways(sleeve, direction, switches, sleeve.unknowns(switches)[np.newaxis])
    return single(ways, sleeve.start)


def contact_sd_s(
    sleeve: DrivenSleeve, direction: int, switches: list[Switch], contact_us: float
) -> float:
    """Deviation of that contact."""

    def late_s(unknowns: Vector) -> Vector:
        crossed_s = _ways(sleeve, direction, switches, unknowns).of("crossed_s")
        late_us = sleeve.start.time_us + SECOND_US * crossed_s - contact_us
        return np.nan_to_num(US * np.where(crossed_s < 0.0, np.nan, late_us))

    return sleeve.sd(late_s, switches, 0.0)


def _ways(sleeve: DrivenSleeve, direction: int, switches: list[Switch], unknowns: Vector) -> Ways:
    last_us = max((one.time_us for one in switches), default=sleeve.start.time_us)
    return sleeve.ways(
        unknowns,
        switches,
        ending=TO_LEVEL,
        until_us=last_us + LONGEST_US,
        level_m=direction * sleeve.law.face_m,
        direction=float(direction),
    )


class ContactChance:
    """Bias and scatter of the contacts with one gear."""

    def __init__(self, sleeve: SleeveActuator) -> None:
        scatter_s = max(SHARE_OF_SCATTER * sleeve.delay_sd_s, LEAST_SCATTER_S)
        self.bias_s = 0.0
        """By how much contacts come later than the law says."""
        self.weight = PRIOR_SAMPLES
        self.freedom = PRIOR_SCATTER_SAMPLES
        """From how many contacts the scatter is known: degrees of freedom of the next contact."""
        self._squares_s2 = PRIOR_SCATTER_SAMPLES * scatter_s**2

    @property
    def scatter_s(self) -> float:
        """Standard deviation from stroke to stroke."""
        return math.sqrt(self._squares_s2 / self.freedom)

    @property
    def samples(self) -> int:
        """How many contacts have been seen."""
        return round(self.weight - PRIOR_SAMPLES)

    def set(self, bias_s: float, weight: float, scatter_s: float, freedom: float) -> None:
        """Goes on from these."""
        self.bias_s, self.weight, self.freedom = bias_s, weight, freedom
        self._squares_s2 = scatter_s**2 * freedom

    def learn(self, contact: Contact, expected_sd_s: float) -> bool:
        """One contact. expected_sd_s: of what was expected, without the chance of a stroke. False
        where it is too far from that."""
        error_s = (contact.measured_us - contact.expected_us) * US - self.bias_s
        if abs(error_s) > FAR_S:
            return False
        explained_us = contact.usual_us if contact.fitted_us is None else contact.fitted_us
        left_s = (contact.measured_us - explained_us) * US
        scatter2 = self.scatter_s**2
        share = scatter2 / (scatter2 + expected_sd_s**2)
        if contact.fitted_us is None:
            share *= self.weight / (self.weight + 1.0)
        self._squares_s2 += share * error_s**2
        self.freedom += 1.0
        self.bias_s += (left_s - self.bias_s) / (self.weight + 1.0)
        self.weight += 1.0
        if self.weight > MOST_SAMPLES:
            fade = MOST_SAMPLES / self.weight
            self.weight *= fade
            self.freedom *= fade
            self._squares_s2 *= fade
        return True


def aborted(switches: list[Switch], direction: int, at_us: int, pulse_us: int) -> list[Switch]:
    """The switches of a sleeve on its way there that is stopped so."""
    kept = [one for one in switches if one.time_us < at_us]
    valve = valve_towards(direction)
    off = Switch(at_us, valve, False)
    if pulse_us == 0:
        return [*kept, off]
    pulse = Switch(at_us, 1 - valve, True), Switch(at_us + pulse_us, 1 - valve, False)
    return [*kept, off, *pulse]


def latest_from_neutral_us(sleeve: DrivenSleeve, direction: int) -> int:
    """The latest abort after which a sleeve that rests in neutral and is fired at 0 stops short, or
    0; by bisection: the later the abort, the further it gets."""
    fired = [Switch(0, valve_towards(direction), True)]
    if not stops(sleeve, direction, fired, 0):
        return 0
    contact_us = to_contact(sleeve, direction, fired).crossed_us or 0.0
    early, late = 0, max(int(contact_us), 1)
    while late - early > ABORT_STEP_US:
        middle = (early + late) // 2
        in_time = stops(sleeve, direction, fired, middle)
        early, late = (middle, late) if in_time else (early, middle)
    return early


def halted(sleeve: DrivenSleeve, direction: int, at_us: int) -> Halt:
    """How a sleeve on its way there is stopped from then on, and where it will stand."""
    fired = [one for one in sleeve.switches if one.time_us < at_us]
    alone_m = _expected_m(sleeve, direction, aborted(fired, direction, at_us, 0))
    is_near = alone_m < ALONE_SHARE * sleeve.law.face_m
    stops_by_itself = is_near and stops(sleeve, direction, fired, at_us, 0)
    pulse_us = 0 if stops_by_itself else SHORTEST_PULSE_US
    longest = aborted(fired, direction, at_us, LONGEST_PULSE_US)
    short_m = _expected_m(sleeve, direction, longest) + NEARLY_M
    while 0 < pulse_us < LONGEST_PULSE_US:
        if _expected_m(sleeve, direction, aborted(fired, direction, at_us, pulse_us)) <= short_m:
            break
        pulse_us += PULSE_STEP_US
    switches = aborted(fired, direction, at_us, pulse_us)
    way = sleeve.ahead(ending=TO_REST, until_us=at_us + RESTS_US, switches=switches)
    gets_m = partial(_gets_m, sleeve, direction, switches)
    sd_m = sleeve.sd(gets_m, switches, _expected_m(sleeve, direction, switches))
    return Halt(at_us, at_us + pulse_us, way.m, sd_m)


def stops(
    sleeve: DrivenSleeve,
    direction: int,
    fired: list[Switch],
    at_us: int,
    pulse_us: int = LONGEST_PULSE_US,
) -> bool:
    """Whether a sleeve that is aborted so stops short of the teeth by the margin."""
    switches = aborted(fired, direction, at_us, pulse_us)
    limit_m = sleeve.law.face_m - LEAST_MARGIN_M
    expected_m = _expected_m(sleeve, direction, switches)
    if expected_m > limit_m:
        return False
    gets_m = partial(_gets_m, sleeve, direction, switches)
    bad_side = sleeve.unknowns_at(SURE, gets_m, switches, expected_m)
    # Followed by the law, not extrapolated: once out of its detent a sleeve goes on to the teeth.
    return bool(gets_m(bad_side[np.newaxis])[0] <= limit_m)


def _expected_m(sleeve: DrivenSleeve, direction: int, switches: list[Switch]) -> float:
    """As far as it gets by these switches."""
    return float(_gets_m(sleeve, direction, switches, sleeve.unknowns(switches)[np.newaxis])[0])


def _gets_m(
    sleeve: DrivenSleeve, direction: int, switches: list[Switch], unknowns: Vector
) -> Vector:
    """The same for each row of unknowns."""
    found = sleeve.ways(
        unknowns,
        switches,
        ending=TO_TURN,
        until_us=switches[-1].time_us + STOPS_US,
        level_m=direction * sleeve.law.stroke_m,
        direction=float(direction),
    )
    return direction * found.of("furthest_m")


def rests_at_m(sleeve: DrivenSleeve, at_us: int, pulse: tuple[Switch, ...] = ()) -> float:
    """Where it comes to rest by its switches until then and by this pulse."""
    switches = [one for one in sleeve.switches if one.time_us <= at_us]
    return sleeve.ahead(ending=TO_REST, until_us=at_us + RESTS_US, switches=[*switches, *pulse]).m


def may_be_thrown(sleeve: DrivenSleeve, direction: int) -> bool:
    """Whether a sleeve on its way to neutral may come near the opposite teeth, where the valve that
    set it going shuts as late as it may by what is seen."""
    valve = valve_towards(direction)
    off = [one for one in sleeve.switches if one.valve == valve and not one.on]
    if not off:
        return False
    unknowns = sleeve.unknowns(sleeve.switches)
    late_s = min(LATE_SDS * sleeve.sd_of(off[-1]), sleeve.law.late_s)
    unknowns[PARAMETERS + sleeve.switches.index(off[-1])] += late_s
    level_m = direction * (sleeve.law.face_m - NEAR_TEETH_M)
    way = sleeve.to_level(direction, level_m, off[-1].time_us + RESTS_US, unknowns)
    return way.crossed_us is not None


def pulse_of(direction: int, on_us: int, length_us: int) -> tuple[Switch, Switch]:
    """The valve that pushes there on, and off again."""
    valve = valve_towards(direction)
    return Switch(on_us, valve, True), Switch(on_us + length_us, valve, False)


def pulse_to_neutral_us(sleeve: DrivenSleeve, direction: int, on_us: int, sure_sds: float) -> int:
    """How long the valve that pushes there has to be on.

    Between the shortest pulse that gets there and the longest that does not go beyond, in the
    middle: the detent makes good for what the law does not know. The longest is not passed either
    where the valve makes the pulse this many standard deviations longer: one that falls short costs
    another push, one that throws the sleeve through may send it against turning teeth."""
    ends_us = []
    for level_m in (-NEAR_NEUTRAL_M, NEAR_NEUTRAL_M):
        short_us, long_us = 0, LONGEST_PULL_US
        while long_us - short_us > PULL_STEP_US:
            middle_us = (short_us + long_us) // 2
            m = rests_at_m(sleeve, on_us, pulse_of(direction, on_us, middle_us))
            is_beyond = direction * m > level_m
            short_us, long_us = (short_us, middle_us) if is_beyond else (middle_us, long_us)
        ends_us.append(short_us)
    shortest_us, longest_us = ends_us
    longer_s = math.hypot(*map(sleeve.sd_of, pulse_of(direction, on_us, longest_us)))
    sure_us = longest_us - int(sure_sds * longer_s * SECOND_US)
    return max(shortest_us, min((shortest_us + longest_us) // 2, sure_us))


class LawFigures(NamedTuple):
    """Of a sleeve on its way to one gear, at the data sheet's supply pressure. Deviations are by
    the law itself: they do not hold what it leaves out."""

    movements: int
    """From how many movements of the sleeve the law was learned."""
    on_delay_s: Estimate
    """Of the valve that pushes there: from its current to its spool's movement."""
    off_delay_s: Estimate
    contact_s: Estimate
    """From the valve's current to contact, from neutral."""


def law_figures(sleeve: DrivenSleeve, direction: int, movements: int) -> LawFigures:
    """Of a sleeve that rests in neutral."""
    valve, (mean, covariance) = valve_towards(direction), sleeve.known

    def of(place: int) -> Estimate:
        return Estimate(float(mean[place]), math.sqrt(covariance[place, place]))

    fired = [Switch(0, valve, True)]
    sleeve.supply_pa = sleeve.law.sheet_pa
    sleeve.switch_sd_s = [0.0, 0.0]  # the chance of a stroke is no part of it
    contact_us = to_contact(sleeve, direction, fired).crossed_us or 0.0
    contact = Estimate(contact_us * US, contact_sd_s(sleeve, direction, fired, contact_us))
    return LawFigures(movements, of(ON + valve), of(OFF + valve), contact)
