"""The room's one door: what the rest of the controller asks and says of the main sleeves."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from meshpoint.controller.calibration.learned import (
    SleeveLawRecord,
    SleeveLawRecords,
    SleeveRecord,
    SleeveRecords,
)
from meshpoint.controller.records import Vector
from meshpoint.controller.sensing.gearbox_view import GearboxView
from meshpoint.controller.sleeve.answers import Halt, Place, Pulse, Stroke
from meshpoint.controller.sleeve.contact_chance import FAR_S, ContactChance
from meshpoint.controller.sleeve.cylinder import TO_LEVEL, TO_REST, TO_TURN
from meshpoint.controller.sleeve.fit import slopes
from meshpoint.controller.sleeve.law import ON, SleeveLaw
from meshpoint.controller.sleeve.law_record import known_from, law_record
from meshpoint.controller.sleeve.motion import Switch, Way
from meshpoint.controller.sleeve.tracked import Contact, TrackedSleeve
from meshpoint.controller.valve_name import SLEEVE_VALVE, ValveName
from meshpoint.gearbox import GearboxSheet, MainGear, Sleeve
from meshpoint.gearbox.gears import MAIN_GEARS, MAIN_SLEEVES, SLEEVE_OF_MAIN
from meshpoint.units import SECOND_US, US

LONGEST_US: Final = 500_000
"""No sleeve takes longer to its gear."""
PLACE_STEP_M: Final = 1e-5
SUPPLY_STEP_PA: Final = 1e3
"""A stroke from rest is worked out anew for another place or supply pressure of this size."""
STOPS_US: Final = 40_000
"""A sleeve that is stopped in flight stands within this time, or is not stopped."""
RESTS_US: Final = 400_000
REST_SD_M: Final = 5e-5
"""How well the place of a resting sleeve is known, its sensor's offset and gain aside."""
LEAST_MARGIN_M: Final = 2e-4
SURE: Final = 2.5
"""Standard deviations by which a sleeve stops short of the teeth."""
LONGEST_PULSE_US: Final = 14_000
SHORTEST_PULSE_US: Final = 9_000
"""The step that aborts sends the pulse's beginning, the next one its end."""
PULSE_STEP_US: Final = 500
NEARLY_M: Final = 1e-4
ABORT_STEP_US: Final = 250
LONGEST_PULL_US: Final = 60_000
PULL_STEP_US: Final = 100
ABORT_SUPPLY_PA: Final = 2e4
"""The last abort is worked out anew where the supply has changed by so much."""
NEAR_NEUTRAL_M: Final = 1e-3
LEAST_SUPPLY_SHARE: Final = 0.1


class Side(NamedTuple):
    """A gear's side of its sleeve."""

    sleeve: Sleeve
    direction: int
    valve: int
    """The valve that pushes there: 0 towards +x, 1 towards -x."""


_SIDES: Final = {
    gear: Side(side.sleeve, side.direction, 0 if side.direction > 0 else 1)
    for gear, side in SLEEVE_OF_MAIN.items()
}
_OF_VALVE: Final = {SLEEVE_VALVE[gear]: _SIDES[gear] for gear in MAIN_GEARS}
_GEAR_AT: Final = {(side.sleeve, side.direction): gear for gear, side in _SIDES.items()}
_VALVES: Final = {(side.sleeve, side.valve): name for name, side in _OF_VALVE.items()}


class Sleeves:
    """The main sleeves of a gearbox, each a mass between two chambers."""

    def __init__(self, sheet: GearboxSheet) -> None:
        self._law = SleeveLaw(sheet)
        prior = self._law.prior(sheet)
        self._sheet_pa = sheet.air.supply_gauge_pa
        sleeve = sheet.sleeve
        self._least_s = sleeve.valve_delay_s
        way_s = (sleeve.stroke_m - sleeve.to_contact_m) / sleeve.speed_m_s
        self._least_out_us = SECOND_US * max(0.0, way_s - sleeve.delay_limit_s)
        """A gear's teeth are out no sooner after its sleeve begins to move, by the data sheet: the
        guard goes by it too."""
        self.supply_pa = self._sheet_pa
        """Present supply pressure, gauge."""
        self._valve_us = SECOND_US * sleeve.valve_delay_s
        self._now_us = 0
        self._expected: dict[ValveName, list[tuple[int, bool]]] = {}
        self._abort_after: dict[MainGear, tuple[tuple[int, int], int]] = {}
        """By gear: for what it was worked out, and so long after a firing the last abort comes."""
        self._sleeves = {sleeve: TrackedSleeve(self._law, prior) for sleeve in MAIN_SLEEVES}
        self._chances = {gear: ContactChance(sheet.sleeve) for gear in MAIN_GEARS}
        self._neutral_sd_s = {gear: self._law_sd_s(gear) for gear in MAIN_GEARS}
        """Deviation of the contact from neutral by what is known of the law, no chance in it."""
        self._contacts: dict[Sleeve, Contact | None] = dict.fromkeys(MAIN_SLEEVES)
        self._from_rest: dict[MainGear, tuple[tuple[int, int, int], Stroke]] = {}
        self._tell_scatter()

    def commanded(self, valve: ValveName, on: bool, time_us: int) -> None:
        """A main valve's coil switches then (known in advance, or since); this replaces what was
        still to come of that valve. Other valves are none of this room's."""
        side = _OF_VALVE.get(valve)
        if side is not None:
            self._sleeves[side.sleeve].commanded(side.valve, on, time_us, self._now_us)

    def expected(self, valve: ValveName, switches: list[tuple[int, bool]]) -> None:
        """A main valve's coil switches then (time, on), in this order, and not otherwise. Said once
        or in each step."""
        side = _OF_VALVE.get(valve)
        if side is not None and switches != self._expected.get(valve):
            self._expected[valve] = switches
            self._sleeves[side.sleeve].expected(side.valve, switches, self._now_us)

    def withdrawn(self, valve: ValveName, now_us: int) -> None:
        """A switch still to come does not come."""
        side = _OF_VALVE.get(valve)
        if side is not None:
            self._sleeves[side.sleeve].withdrawn(side.valve, now_us)

    def take(self, view: GearboxView, now_us: int) -> None:
        """Each step: the newest position samples. Where a movement is over, it is learned from."""
        self._now_us = now_us
        for sleeve, tracked in self._sleeves.items():
            track = view.tracks.get(sleeve)
            if track is None:
                continue
            tracked.take(track, self._supply_pa)
            if tracked.contact is not self._contacts[sleeve]:
                self._learn_contact(sleeve, tracked)

    def _learn_contact(self, sleeve: Sleeve, tracked: TrackedSleeve) -> None:
        contact = self._contacts[sleeve] = tracked.contact
        if contact is None:
            return
        gear = _GEAR_AT[sleeve, contact.direction]
        if self._chances[gear].learn(contact, self._neutral_sd_s[gear]):
            self._neutral_sd_s[gear] = self._law_sd_s(gear)
            self._tell_scatter()

    def _tell_scatter(self) -> None:
        self._from_rest.clear()
        for gear, side in _SIDES.items():
            self._sleeves[side.sleeve].switch_sd_s[side.valve] = self._chances[gear].scatter_s

    def contact_us(self, gear: MainGear, fired_us: int) -> float | None:
        """When the sleeve that was fired then came to this gear's teeth, as measured; None before
        it did."""
        side = _SIDES[gear]
        met_us = self._sleeves[side.sleeve].met_us.get(side.direction)
        return met_us if met_us is not None and met_us > fired_us else None

    @property
    def _supply_pa(self) -> float:
        return max(self.supply_pa, LEAST_SUPPLY_SHARE * self._sheet_pa)

    def place(self, sleeve: Sleeve, at_us: int) -> Place:
        """Where a sleeve is then, by the law and the commands so far."""
        tracked = self._sleeves[sleeve]
        way = tracked.at(at_us, self._supply_pa)
        sd_m = math.hypot(
            REST_SD_M, way.end_m_s * max(map(tracked.sd_of, tracked.switches), default=0.0)
        )
        return Place(way.m, way.end_m_s, sd_m, way.end_m_s != 0.0)

    def passes_us(self, sleeve: Sleeve, level_m: float, direction: int) -> float | None:
        """When a sleeve comes by a place in this direction, by the commands so far; None where it
        does not get there."""
        way = self._sleeves[sleeve].ahead(
            self._supply_pa,
            ending=TO_LEVEL,
            until_us=self._now_us + LONGEST_US,
            level_m=level_m,
            direction=float(direction),
        )
        return way.crossed_us

    def stroke(self, gear: MainGear, fire_us: int) -> Stroke:
        """The contact, if the valve towards the gear switches on then, from where the sleeve is
        then."""
        side = _SIDES[gear]
        tracked = self._sleeves[side.sleeve]
        return self._stroke(gear, tracked, self._fired(tracked, side, fire_us))

    def stroke_after(self, gear: MainGear, halt: Halt, fire_us: int) -> Stroke:
        """The contact, if a sleeve on its way to this gear is stopped so, and fired again then."""
        side = _SIDES[gear]
        tracked = self._sleeves[side.sleeve]
        stopped = _aborted(tracked.switches, side, halt.at_us, halt.off_us - halt.at_us)
        return self._stroke(gear, tracked, [*stopped, Switch(fire_us, side.valve, True)])

    def from_neutral(self, gear: MainGear) -> Stroke:
        """A stroke from neutral at the present supply pressure: `contact_us` is its delay."""
        side = _SIDES[gear]
        tracked = self._sleeves[side.sleeve].at_rest(0.0)
        return self._stroke(gear, tracked, [Switch(0, side.valve, True)])

    def from_rest(self, gear: MainGear) -> Stroke:
        """The same from where the sleeve stands, or stood before it moved; from neutral, where that
        is in a gear."""
        side = _SIDES[gear]
        tracked = self._sleeves[side.sleeve]
        rest_m = tracked.place_of(tracked.rest_m)
        if abs(rest_m) >= self._law.face_m:
            rest_m = 0.0
        key = (
            tracked.version,
            round(rest_m / PLACE_STEP_M),
            round(self._supply_pa / SUPPLY_STEP_PA),
        )
        known = self._from_rest.get(gear)
        if known is None or known[0] != key:
            switches = [Switch(0, side.valve, True)]
            known = key, self._stroke(gear, tracked.at_rest(rest_m), switches)
            self._from_rest[gear] = known
        return known[1]

    def _stroke(self, gear: MainGear, tracked: TrackedSleeve, switches: list[Switch]) -> Stroke:
        side, chance = _SIDES[gear], self._chances[gear]
        way = self._to_contact(tracked, side, switches)
        if way.crossed_us is None:
            last_us = max((one.time_us for one in switches), default=tracked.start.time_us)
            return Stroke(last_us + LONGEST_US, SECOND_US * FAR_S, chance.freedom, 0.0, 0.0)
        way_share = abs(side.direction * self._law.face_m - tracked.start.state[0])
        bias_s = chance.bias_s * min(1.0, way_share / self._law.face_m)
        sd_s = self._contact_sd_s(tracked, side, switches, way.crossed_us)
        contact_us = round(way.crossed_us + SECOND_US * bias_s)
        return Stroke(contact_us, SECOND_US * sd_s, chance.freedom, way.speed_m_s, way.force_n)

    def _law_sd_s(self, gear: MainGear) -> float:
        side = _SIDES[gear]
        tracked = self._sleeves[side.sleeve].at_rest(0.0)
        switches = [Switch(0, side.valve, True)]
        tracked.switch_sd_s = [0.0, 0.0]
        way = self._to_contact(tracked, side, switches)
        crossed_us = LONGEST_US if way.crossed_us is None else way.crossed_us
        return self._contact_sd_s(tracked, side, switches, crossed_us)

    def last_abort_us(self, gear: MainGear, fire_us: int) -> int | None:
        """The latest "driving valve off, opposite one on" (coils) at which a sleeve fired at
        `fire_us` still stops short of the teeth by the margin. None where it cannot be stopped any
        more, or stands already."""
        side = _SIDES[gear]
        tracked = self._sleeves[side.sleeve]
        fired = self._fired(tracked, side, fire_us)
        contact_us = self._to_contact(tracked, side, fired).crossed_us
        if contact_us is None:
            return None
        return self._latest(tracked, side, fired, max(fire_us, self._now_us), int(contact_us))

    def abort_after_us(self, gear: MainGear) -> int:
        """So long after a firing from neutral the sleeve can last be stopped short of the teeth."""
        side = _SIDES[gear]
        tracked = self._sleeves[side.sleeve]
        known = (tracked.version, round(self._supply_pa / ABORT_SUPPLY_PA))
        found = self._abort_after.get(gear)
        if found is None or found[0] != known:
            rested, fired = tracked.at_rest(0.0), [Switch(0, side.valve, True)]
            contact_us = self._to_contact(rested, side, fired).crossed_us or 0.0
            last_us = self._latest(rested, side, fired, 0, int(contact_us))
            found = self._abort_after[gear] = (known, 0 if last_us is None else last_us)
        return found[1]

    def abort(self, gear: MainGear, at_us: int) -> Halt:
        """How a sleeve on its way to this gear is stopped from then on, and where it will stand."""
        side = _SIDES[gear]
        tracked = self._sleeves[side.sleeve]
        fired = [one for one in tracked.switches if one.time_us < at_us]
        on_us = max((one.time_us for one in fired if one.valve == side.valve), default=at_us)
        stops_by_itself = at_us - on_us <= self._valve_us and self._stops(
            tracked, side, fired, at_us, 0
        )
        pulse_us = 0 if stops_by_itself else SHORTEST_PULSE_US
        longest = _aborted(fired, side, at_us, LONGEST_PULSE_US)
        best = self._stopped(tracked, side, longest).furthest_m
        short_m = side.direction * best + NEARLY_M
        while 0 < pulse_us < LONGEST_PULSE_US:
            way = self._stopped(tracked, side, _aborted(fired, side, at_us, pulse_us))
            if way.turned_us is not None and side.direction * way.furthest_m <= short_m:
                break
            pulse_us += PULSE_STEP_US
        switches = _aborted(fired, side, at_us, pulse_us)
        way = tracked.ahead(
            self._supply_pa, ending=TO_REST, until_us=at_us + RESTS_US, switches=switches
        )
        sd_m = self._stop_sd_m(tracked, side, fired, at_us, pulse_us)
        return Halt(at_us, at_us + pulse_us, way.m, sd_m)

    def to_neutral(self, sleeve: Sleeve, at_us: int) -> Pulse | None:
        """The pulse that brings a sleeve to rest in neutral, from where it is then, before the
        teeth or between unloaded ones: towards neutral, or against its motion where it would fly
        past. None where it comes to rest there by itself."""
        tracked = self._sleeves[sleeve]
        kept = [one for one in tracked.switches if one.time_us <= at_us]
        left = tracked.ahead(
            self._supply_pa, ending=TO_REST, until_us=at_us + RESTS_US, switches=kept
        )
        if abs(left.m) < NEAR_NEUTRAL_M:
            return None
        return self._pulse(tracked, sleeve, at_us, 1 if left.m < 0.0 else -1)

    def pull_us(self, valve: ValveName | None) -> tuple[float, float]:
        """From a valve's current until the sleeve that it pulls begins to move, as expected, and
        until the teeth that part then may be out, at the earliest. Those of splitter and range,
        which are none of this room's, part as their sleeve moves."""
        side = None if valve is None else _OF_VALVE.get(valve)
        if side is None:
            return self._valve_us, self._valve_us
        moves_us = SECOND_US * float(self._sleeves[side.sleeve].known.mean[ON + side.valve])
        return moves_us, self._valve_us + self._least_out_us

    def pull_out(self, gear: MainGear, on_us: int) -> Pulse:
        """The pulse that takes a sleeve out of this gear and leaves it at rest in neutral."""
        side = _SIDES[gear]
        return self._pulse(self._sleeves[side.sleeve], side.sleeve, on_us, -side.direction)

    def records(self) -> SleeveRecords:
        """What a calibration file keeps of the gears whose contacts have been seen."""
        supply_pa, self.supply_pa = self.supply_pa, self._sheet_pa
        gears = {
            gear.name.lower(): SleeveRecord(
                delay_s=max(self.from_neutral(gear).contact_us * US, self._least_s),
                samples=chance.weight,
                scatter_s=chance.scatter_s,
                scatter_samples=chance.freedom,
            )
            for gear, chance in self._chances.items()
            if chance.samples > 0
        }
        self.supply_pa = supply_pa
        return SleeveRecords(**gears)

    def laws(self) -> SleeveLawRecords:
        """What it keeps of the sleeves whose law was learned."""
        laws = {
            sleeve.name.lower(): law_record(tracked.known, tracked.movements)
            for sleeve, tracked in self._sleeves.items()
            if tracked.movements > 0
        }
        return SleeveLawRecords(**laws)

    def restore(self, records: SleeveRecords, laws: SleeveLawRecords) -> None:
        """Goes on from records; what is without one stays as the data sheet says."""
        for sleeve, tracked in self._sleeves.items():
            law: SleeveLawRecord | None = getattr(laws, sleeve.name.lower())
            if law is not None:
                tracked.known, tracked.movements = known_from(law), law.movements
        supply_pa, self.supply_pa = self.supply_pa, self._sheet_pa
        for gear, chance in self._chances.items():
            record = records.of(gear)
            if record is not None:
                bias_s = record.delay_s - self.from_neutral(gear).contact_us * US
                chance.set(bias_s, record.samples, record.scatter_s, record.scatter_samples)
                self._neutral_sd_s[gear] = self._law_sd_s(gear)
        self.supply_pa = supply_pa
        self._tell_scatter()

    def _pulse(self, tracked: TrackedSleeve, sleeve: Sleeve, on_us: int, direction: int) -> Pulse:
        valve = 0 if direction > 0 else 1
        kept = [one for one in tracked.switches if one.time_us <= on_us]
        # Between the shortest pulse that gets there and the longest that does not go beyond, in the
        # middle: the detent makes good for what the law does not know.
        ends_us = []
        for level_m in (-NEAR_NEUTRAL_M, NEAR_NEUTRAL_M):
            short_us, long_us = 0, LONGEST_PULL_US
            while long_us - short_us > PULL_STEP_US:
                middle_us = (short_us + long_us) // 2
                way = self._pulsed(tracked, kept, valve, on_us, middle_us)
                is_beyond = direction * way.m > level_m
                short_us, long_us = (short_us, middle_us) if is_beyond else (middle_us, long_us)
            ends_us.append(short_us)
        short_us = sum(ends_us) // 2
        way = self._pulsed(tracked, kept, valve, on_us, short_us)
        switch = Switch(on_us, valve, True)
        sd_m = 2.0 * self._law.face_m * tracked.sd_of(switch) / max(1e-6, short_us * 1e-6)
        name = _VALVES[sleeve, valve]
        off_us, arrival_us = on_us + short_us, round(way.end_us)
        return Pulse(name, on_us, off_us, arrival_us, way.m, sd_m)

    def _pulsed(
        self, tracked: TrackedSleeve, kept: list[Switch], valve: int, on_us: int, pulse_us: int
    ) -> Way:
        pulse = [Switch(on_us, valve, True), Switch(on_us + pulse_us, valve, False)]
        return tracked.ahead(
            self._supply_pa, ending=TO_REST, until_us=on_us + RESTS_US, switches=kept + pulse
        )

    def _fired(self, tracked: TrackedSleeve, side: Side, fire_us: int) -> list[Switch]:
        """The switches so far, with the valve towards the gear on from then: what this replaces is
        left out."""
        fire = Switch(fire_us, side.valve, True)
        if fire in tracked.switches:
            return tracked.switches
        kept = [o for o in tracked.switches if o.valve != side.valve or o.time_us < fire_us]
        return kept if tracked.driven(side.valve, fire_us) else [*kept, fire]

    def _to_contact(
        self,
        tracked: TrackedSleeve,
        side: Side,
        switches: list[Switch],
        unknowns: Vector | None = None,
    ) -> Way:
        last_us = max((one.time_us for one in switches), default=tracked.start.time_us)
        return tracked.ahead(
            self._supply_pa,
            ending=TO_LEVEL,
            until_us=last_us + LONGEST_US,
            switches=switches,
            unknowns=unknowns,
            level_m=side.direction * self._law.face_m,
            direction=float(side.direction),
        )

    def _contact_sd_s(
        self, tracked: TrackedSleeve, side: Side, switches: list[Switch], contact_us: float
    ) -> float:
        def crossed_s(unknowns: Vector) -> Vector:
            crossed_us = self._to_contact(tracked, side, switches, unknowns).crossed_us
            return np.array([0.0 if crossed_us is None else (crossed_us - contact_us) * US])

        return _sd(crossed_s, tracked, switches, 0.0)

    def _stopped(
        self,
        tracked: TrackedSleeve,
        side: Side,
        switches: list[Switch],
        unknowns: Vector | None = None,
    ) -> Way:
        """As far as it gets, if it is aborted by these switches."""
        return tracked.ahead(
            self._supply_pa,
            ending=TO_TURN,
            until_us=switches[-1].time_us + STOPS_US,
            switches=switches,
            unknowns=unknowns,
            level_m=side.direction * self._law.stroke_m,
            direction=float(side.direction),
        )

    def _latest(
        self,
        tracked: TrackedSleeve,
        side: Side,
        fired: list[Switch],
        earliest_us: int,
        contact_us: int,
    ) -> int | None:
        """By bisection: the later the abort, the further it gets."""

        def stops(at_us: int) -> bool:
            return self._stops(tracked, side, fired, at_us, LONGEST_PULSE_US)

        if not stops(earliest_us):
            return None
        early, late = earliest_us, max(contact_us, earliest_us + 1)
        while late - early > ABORT_STEP_US:
            middle = (early + late) // 2
            early, late = (middle, late) if stops(middle) else (early, middle)
        return early

    def _stops(
        self, tracked: TrackedSleeve, side: Side, fired: list[Switch], at_us: int, pulse_us: int
    ) -> bool:
        """Whether a sleeve that is aborted so stops short of the teeth by the margin."""
        way = self._stopped(tracked, side, _aborted(fired, side, at_us, pulse_us))
        short_m = self._law.face_m - side.direction * way.furthest_m
        if short_m < LEAST_MARGIN_M:
            return False
        return short_m >= SURE * self._stop_sd_m(tracked, side, fired, at_us, pulse_us)

    def _stop_sd_m(
        self, tracked: TrackedSleeve, side: Side, fired: list[Switch], at_us: int, pulse_us: int
    ) -> float:
        """Deviation of the place to which an aborted sleeve gets."""
        switches = _aborted(fired, side, at_us, pulse_us)

        def furthest_m(unknowns: Vector) -> Vector:
            return np.array([self._stopped(tracked, side, switches, unknowns).furthest_m])

        base_m = self._stopped(tracked, side, switches).furthest_m
        return _sd(furthest_m, tracked, switches, base_m)


def _sd(
    of: Callable[[Vector], Vector], tracked: TrackedSleeve, switches: list[Switch], base: float
) -> float:
    """Deviation of a figure by what is not known of law and switches."""
    slope = slopes(of, tracked.unknowns(switches), np.array([base]))[0]
    variance = float(slope @ tracked.covariance_with(switches) @ slope)
    return math.sqrt(max(variance, 0.0))


def _aborted(fired: list[Switch], side: Side, at_us: int, pulse_us: int) -> list[Switch]:
    kept = [one for one in fired if one.time_us < at_us]
    other = 1 - side.valve
    if pulse_us == 0:
        return [*kept, Switch(at_us, side.valve, False)]
    return [
        *kept,
        Switch(at_us, side.valve, False),
        Switch(at_us, other, True),
        Switch(at_us + pulse_us, other, False),
    ]
