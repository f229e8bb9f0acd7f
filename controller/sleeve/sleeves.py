"""The room's one door: what the rest of the controller asks and says of the main sleeves."""

from __future__ import annotations

from typing import Final, NamedTuple

from meshpoint.controller.measure.gearbox_view import GearboxView
from meshpoint.controller.settings.learned import (
    SleeveLawRecord,
    SleeveLawRecords,
    SleeveRecord,
    SleeveRecords,
)
from meshpoint.controller.settings.valve_name import DOG_VALVE, ValveName
from meshpoint.controller.sleeve.cylinder import ON
from meshpoint.controller.sleeve.driven import DrivenSleeve, Switch, valve_towards
from meshpoint.controller.sleeve.law import SleeveLaw, known_from, law_record
from meshpoint.controller.sleeve.stroke import (
    FAR_S,
    LONGEST_PULSE_US,
    LONGEST_US,
    NEAR_NEUTRAL_M,
    SHORTEST_PULSE_US,
    ContactChance,
    Halt,
    LawFigures,
    Place,
    Pulse,
    Stroke,
    aborted,
    contact_sd_s,
    halted,
    latest_from_neutral_us,
    law_figures,
    may_be_thrown,
    pulse_of,
    pulse_to_neutral_us,
    rests_at_m,
    stops,
    to_contact,
)
from meshpoint.controller.sleeve.tracked import Contact, TrackedSleeve
from meshpoint.gearbox import GearboxSheet, Sleeve
from meshpoint.gearbox.gears import MAIN_GEARS, MAIN_SLEEVES, SIDE_OF, DogGear
from meshpoint.units import SECOND_US, US

PLACE_STEP_M: Final = 1e-5
SUPPLY_STEP_PA: Final = 1e3
"""A stroke from rest is worked out anew for another place or supply pressure of this size."""
ABORT_SUPPLY_PA: Final = 2e4
"""The last abort is worked out anew where the supply has changed by so much."""
A_LITTLE_US: Final = 2_000
"""A pulse towards neutral is longer by no more than this than the last that the sleeve has
withstood from there or nearer: one too long throws it through, whatever the law says."""
LEAST_PUSH_US: Final = 5_000
"""A first push of a sleeve that stands before a gear's teeth may be as long as this."""
LONGER_US: Final = 4_000
"""By so much longer is a gear pulled for each pull of this shift that has left it in."""
FIRST_SHARE: Final = 0.7
TAUGHT: Final = 10
"""The first one is no longer than the data sheet's sleeve takes. As long as the law was learned
from fewer movements than these, it is no longer than this share of it, and no later pull is longer
than one that has brought the sleeve out of the gear: the rest of the way it is pushed."""
SURE_SDS: Final = 3.0
"""A pulse towards neutral throws no sleeve through where its valve makes it longer by this many
standard deviations."""
RUN_ON_SHARE: Final = 0.5
CLEAR_M: Final = 1.0e-3
REACT_US: Final = 15_000
"""The guard takes a longer pulse for a firing, but for one that the next command ends: see
docs/guard.md, "A pulse stops short". It goes by half of this clearance; the rest is what its
position sensor may be wrong by."""
LEAST_SUPPLY_SHARE: Final = 0.1


class Side(NamedTuple):
    """A gear's side of its sleeve."""

    sleeve: Sleeve
    direction: int
    valve: int
    """The valve that pushes there: 0 towards +x, 1 towards -x."""


_SIDES: Final = {
    gear: Side(side.sleeve, side.direction, valve_towards(side.direction))
    for gear, side in SIDE_OF.items()
}
_OF_VALVE: Final = {DOG_VALVE[gear]: side for gear, side in _SIDES.items()}
_GEAR_AT: Final = {(side.sleeve, side.direction): gear for gear, side in _SIDES.items()}
_VALVES: Final = {(side.sleeve, side.valve): name for name, side in _OF_VALVE.items()}


class Sleeves:
    """The sleeves with dog teeth of a gearbox, each a mass between two chambers: those of the main
    box, and the splitter's where it has such teeth."""

    def __init__(self, sheet: GearboxSheet) -> None:
        self._law = SleeveLaw(sheet)
        prior = self._law.prior(sheet)
        sleeve = sheet.sleeve
        self._least_s = sleeve.valve_delay_s
        way_s = (sleeve.stroke_m - sleeve.to_contact_m) / sleeve.speed_m_s
        self._least_out_us = SECOND_US * max(0.0, way_s - sleeve.delay_limit_s)
        """From a sleeve's first motion until its teeth are out, at least; the guard's too."""
        self._valve_us = SECOND_US * sleeve.valve_delay_s
        self._least_stroke_us = SECOND_US * (sleeve.delay_s - sleeve.delay_limit_s) - self._valve_us
        """From the valve's opening to contact from neutral, by the data sheet."""
        self._spread_us = SECOND_US * (sleeve.delay_limit_s + sleeve.valve_delay_tolerance_s)
        """By so much longer than its current a pulse may be, its valve late to shut."""
        self._now_us = 0
        self._expected: dict[ValveName, list[tuple[int, bool]]] = {}
        self._abort_after: dict[DogGear, tuple[tuple[int, int], int]] = {}
        """By gear: for what it was worked out, and so long after a firing the last abort comes."""
        self._learned: set[Sleeve] = set()
        """Those of which this step has learned something."""
        sleeves = (*MAIN_SLEEVES, Sleeve.SPLITTER) if sheet.has_dog_splitter else MAIN_SLEEVES
        self._gears = sheet.dog_gears
        self._sleeves = {sleeve: TrackedSleeve(self._law, prior) for sleeve in sleeves}
        self.supply_pa = self._law.sheet_pa
        self._chances = {gear: ContactChance(sheet.sleeve) for gear in self._gears}
        self._neutral_sd_s = {gear: self._law_sd_s(gear) for gear in self._gears}
        """Deviation of the contact from neutral by what is known of the law, no chance in it."""
        self.contacts: dict[DogGear, Contact] = {}
        """The newest contact with each gear."""
        self._from_rest: dict[DogGear, tuple[tuple[int, int, int], Stroke]] = {}
        self._tell_scatter()
        self._unlearned = DrivenSleeve(self._law, prior)
        self._sheets_pulse_us: dict[tuple[int, float], int] = {}

    def _side(self, valve: ValveName) -> Side | None:
        """The side that a valve pushes to; None of one that is none of this room's."""
        side = _OF_VALVE.get(valve)
        return side if side is not None and side.sleeve in self._sleeves else None

    def _of(self, gear: DogGear) -> tuple[Side, TrackedSleeve]:
        """A gear's side, and its sleeve."""
        side = _SIDES[gear]
        return side, self._sleeves[side.sleeve]

    def expected(self, valve: ValveName, switches: list[tuple[int, bool]]) -> None:
        """A valve's coil switches then (time, on), in this order, and not otherwise: known in
        advance, or since. Said once or in each step. Valves of cones are none of this room's."""
        side = self._side(valve)
        if side is not None and switches != self._expected.get(valve):
            self._expected[valve] = switches
            self._sleeves[side.sleeve].expected(side.valve, switches, self._now_us)

    def take(self, view: GearboxView, now_us: int) -> None:
        """Each step: the newest position samples. Where a movement is over, it is learned from."""
        self._now_us = now_us
        self._learned.clear()
        for sleeve, tracked in self._sleeves.items():
            track = view.tracks.get(sleeve)
            if track is None:
                continue
            before, version = tracked.contact, tracked.version
            tracked.take(track)
            if tracked.version != version:
                self._learned.add(sleeve)
            if tracked.contact is not None and tracked.contact is not before:
                self._learn_contact(_GEAR_AT[sleeve, tracked.contact.direction], tracked.contact)

    def _learn_contact(self, gear: DogGear, contact: Contact) -> None:
        self.contacts[gear] = contact
        if self._chances[gear].learn(contact, self._neutral_sd_s[gear]):
            self._neutral_sd_s[gear] = self._law_sd_s(gear)
            self._tell_scatter()

    def _tell_scatter(self) -> None:
        self._from_rest.clear()
        self._abort_after.clear()
        for gear in self._gears:
            side = _SIDES[gear]
            self._sleeves[side.sleeve].switch_sd_s[side.valve] = self._chances[gear].scatter_s

    def reached(self) -> list[DogGear]:
        """The gears to whose teeth a sleeve has come by the newest samples, whatever sent it
        there."""
        sides = [(gear, _SIDES[gear]) for gear in self._gears]
        return [gear for gear, s in sides if self._sleeves[s.sleeve].reached == s.direction]

    def contact_us(self, gear: DogGear, fired_us: int) -> float | None:
        """When the sleeve that was fired then came to this gear's teeth, as measured; None before
        it did."""
        side = _SIDES[gear]
        met_us = self._sleeves[side.sleeve].met_us.get(side.direction)
        return met_us if met_us is not None and met_us > fired_us else None

    @property
    def supply_pa(self) -> float:
        """Present supply pressure, gauge."""
        return self._supply_pa

    @supply_pa.setter
    def supply_pa(self, gauge_pa: float) -> None:
        self._supply_pa = max(gauge_pa, LEAST_SUPPLY_SHARE * self._law.sheet_pa)
        for tracked in self._sleeves.values():
            tracked.supply_pa = self._supply_pa

    def place(self, sleeve: Sleeve, at_us: int) -> Place:
        """Where a sleeve is then, by the law and the commands so far."""
        way = self._sleeves[sleeve].at(at_us)
        return Place(way.m, way.end_m_s, way.end_m_s != 0.0)

    def stroke(self, gear: DogGear, fire_us: int) -> Stroke:
        """The contact, if the valve towards the gear switches on then, from where the sleeve is
        then."""
        side, tracked = self._of(gear)
        return self._stroke(gear, tracked, tracked.fired(side.direction, fire_us))

    def stroke_after(self, gear: DogGear, halt: Halt, fire_us: int) -> Stroke:
        """The contact, if a sleeve on its way to this gear is stopped so, and fired again then."""
        side, tracked = self._of(gear)
        pulse_us = halt.off_us - halt.at_us
        stopped = aborted(tracked.switches, side.direction, halt.at_us, pulse_us)
        return self._stroke(gear, tracked, [*stopped, Switch(fire_us, side.valve, True)])

    def from_neutral(self, gear: DogGear) -> Stroke:
        """A stroke from neutral at the present supply pressure: `contact_us` is its delay."""
        side, tracked = self._of(gear)
        return self._stroke(gear, tracked.at_rest(0.0), [Switch(0, side.valve, True)])

    def from_rest(self, gear: DogGear) -> Stroke:
        """The same from where the sleeve stands, or stood before it moved; from neutral, where that
        is in a gear."""
        side, tracked = self._of(gear)
        rest_m = tracked.place_of(tracked.rest_m)
        if abs(rest_m) >= self._law.face_m:
            rest_m = 0.0
        steps = rest_m / PLACE_STEP_M, self._supply_pa / SUPPLY_STEP_PA
        key = (tracked.version, round(steps[0]), round(steps[1]))
        known = self._from_rest.get(gear)
        if known is None or known[0] != key:
            switches = [Switch(0, side.valve, True)]
            known = key, self._stroke(gear, tracked.at_rest(rest_m), switches)
            self._from_rest[gear] = known
        return known[1]

    def _stroke(self, gear: DogGear, tracked: DrivenSleeve, switches: list[Switch]) -> Stroke:
        side, chance = _SIDES[gear], self._chances[gear]
        way = to_contact(tracked, side.direction, switches)
        if way.crossed_us is None:
            last_us = max((one.time_us for one in switches), default=tracked.start.time_us)
            return Stroke(last_us + LONGEST_US, SECOND_US * FAR_S, chance.freedom, 0.0)
        way_share = abs(side.direction * self._law.face_m - tracked.start.state[0])
        bias_s = chance.bias_s * min(1.0, way_share / self._law.face_m)
        sd_s = contact_sd_s(tracked, side.direction, switches, way.crossed_us)
        contact_us = round(way.crossed_us + SECOND_US * bias_s)
        return Stroke(contact_us, SECOND_US * sd_s, chance.freedom, way.speed_m_s)

    def _law_sd_s(self, gear: DogGear) -> float:
        side = _SIDES[gear]
        tracked = self._sleeves[side.sleeve].at_rest(0.0)
        switches = [Switch(0, side.valve, True)]
        tracked.switch_sd_s = [0.0, 0.0]
        crossed_us = to_contact(tracked, side.direction, switches).crossed_us
        contact_us = LONGEST_US if crossed_us is None else crossed_us
        return contact_sd_s(tracked, side.direction, switches, contact_us)

    def stops(self, gear: DogGear, fire_us: int, at_us: int) -> bool:
        """Whether a sleeve fired at `fire_us` stops short of the teeth by the margin, if it is
        aborted then."""
        side, tracked = self._of(gear)
        return stops(tracked, side.direction, tracked.fired(side.direction, fire_us), at_us)

    def abort_after_us(self, gear: DogGear) -> int:
        """So long after a firing from neutral the sleeve can last be stopped short of the teeth. In
        a step that learns from a movement, which takes long enough, by what was known before."""
        side, tracked = self._of(gear)
        known = (tracked.version, round(self._supply_pa / ABORT_SUPPLY_PA))
        found = self._abort_after.get(gear)
        if found is None or (found[0] != known and side.sleeve not in self._learned):
            last_us = latest_from_neutral_us(tracked.at_rest(0.0), side.direction)
            found = self._abort_after[gear] = known, last_us
        return found[1]

    def abort(self, gear: DogGear, at_us: int) -> Halt:
        """How a sleeve on its way to this gear is stopped from then on, and where it will stand."""
        side, tracked = self._of(gear)
        return halted(tracked, side.direction, at_us)

    def to_neutral(self, sleeve: Sleeve, at_us: int) -> Pulse | None:
        """The pulse that brings a sleeve to rest in neutral: towards it from before the teeth or
        between unloaded ones, against the motion where it would, or may, fly past. None where it
        comes to rest there by itself, is off its law, or falls short and does not stand yet."""
        tracked = self._sleeves[sleeve]
        if not tracked.stands:
            return self.brake(sleeve, at_us)
        stands_m = tracked.place_of(tracked.rest_m)  # whatever pull of its detent the law sees
        if abs(stands_m) < NEAR_NEUTRAL_M or tracked.waits(at_us):
            return None
        direction = 1 if stands_m < 0.0 else -1
        most_us = self._withstands_us(sleeve, direction, stands_m)
        return self._pulse(sleeve, at_us, direction, most_us)

    def brake(self, sleeve: Sleeve, at_us: int) -> Pulse | None:
        """The same of one that moves. None for one that stands."""
        tracked, place = self._sleeves[sleeve], self.place(sleeve, at_us)
        rests_m = rests_at_m(tracked, at_us)
        goes = 1 if place.speed_m_s > 0.0 else -1
        valve = valve_towards(-goes)
        # One that was braked before may go back to where it came from.
        was_braked = any(one.valve == valve for one in tracked.switches)
        is_known = place.is_moving and tracked.is_free and not tracked.is_off_its_law
        if was_braked or not is_known or goes * rests_m < -NEAR_NEUTRAL_M:
            return None
        if goes * rests_m >= NEAR_NEUTRAL_M:  # a longer pulse would set it going the other way
            return self._pulse(sleeve, at_us, -goes, LONGEST_PULSE_US, sure_sds=0.0)
        if may_be_thrown(tracked, goes):  # once that is seen, a brake comes too late
            return Pulse(_VALVES[sleeve, valve], at_us, at_us + SHORTEST_PULSE_US, rests_m)
        return None

    def pull_us(self, valve: ValveName | None) -> tuple[float, float]:
        """From a valve's current until the sleeve it pulls begins to move, as expected, and until
        its teeth may be out, at the earliest: with cones (no sleeve of this room) at once."""
        side = None if valve is None else self._side(valve)
        if side is None:
            return self._valve_us, self._valve_us
        moves_us = SECOND_US * float(self._sleeves[side.sleeve].known.mean[ON + side.valve])
        return moves_us, self._valve_us + self._least_out_us

    def rests(self, gear: DogGear) -> bool:
        """Whether a gear's sleeve stands, and what its last movement showed has been learned."""
        return self._sleeves[_SIDES[gear].sleeve].rests

    def pull_out(self, gear: DogGear, on_us: int, in_vain: int = 0) -> Pulse:
        """The pulse that takes a sleeve out of this gear and leaves it at rest in neutral: a longer
        one for each pull in vain, a shorter one where that may throw it through."""
        side = _SIDES[gear]
        from_m = side.direction * self._law.stroke_m
        longer_us = in_vain * LONGER_US
        most_us = self._withstands_us(side.sleeve, -side.direction, from_m, longer_us)
        return self._pulse(side.sleeve, on_us, -side.direction, most_us, longer_us)

    def _withstands_us(
        self, sleeve: Sleeve, direction: int, from_m: float, longer_us: int = 0
    ) -> int:
        """Longest pulse towards neutral that cannot overshoot into the other gear; bounded
        separately in and out of gear, since torque on the teeth adds friction."""
        tracked, in_gear = self._sleeves[sleeve], abs(from_m) > self._law.in_gear_m
        clear = (self._law.face_m - CLEAR_M + abs(from_m)) / self._law.face_m
        bound_us = RUN_ON_SHARE * self._least_stroke_us * clear ** (1.0 / 3.0)
        is_taught = tracked.movements >= TAUGHT
        if in_gear:
            most_us = max(bound_us, REACT_US) * (1.0 if is_taught else FIRST_SHARE)
        else:
            most_us = max(bound_us - self._spread_us, LEAST_PUSH_US)
        first_us = min(self._by_sheet_us(direction, from_m), int(most_us)) + longer_us
        before = tracked.withstood.get((direction, in_gear))
        if before is None or before.from_m > abs(from_m) + PLACE_STEP_M:
            return first_us
        return max(first_us, before.long_us + (A_LITTLE_US if is_taught or not in_gear else 0))

    def _by_sheet_us(self, direction: int, from_m: float) -> int:
        """The pulse that brings the data sheet's sleeve to neutral. Gears are pulled from the same
        place each time: what was found is kept."""
        found = self._sheets_pulse_us.get((direction, from_m))
        if found is None:
            found = pulse_to_neutral_us(self._unlearned.at_rest(from_m), direction, 0, 0.0)
            if abs(from_m) == self._law.stroke_m:
                self._sheets_pulse_us[direction, from_m] = found
        return found

    def _pulse(
        self, sleeve: Sleeve, on_us: int, direction: int, most_us: int, longer_us: int = 0,
        sure_sds: float = SURE_SDS,
    ) -> Pulse:  # fmt: skip
        tracked = self._sleeves[sleeve]
        by_law_us = pulse_to_neutral_us(tracked, direction, on_us, sure_sds)
        long_us = min(most_us, by_law_us + longer_us)
        rests_m = rests_at_m(tracked, on_us, pulse_of(direction, on_us, long_us))
        return Pulse(_VALVES[sleeve, valve_towards(direction)], on_us, on_us + long_us, rests_m)

    def records(self) -> SleeveRecords:
        """What a calibration file keeps of the main gears whose contacts have been seen."""
        return SleeveRecords(**{gear.name.lower(): self.record(gear) for gear in MAIN_GEARS})

    def record(self, gear: DogGear) -> SleeveRecord | None:
        """That of one gear; None where no contact of it has been seen."""
        chance = self._chances[gear]
        if chance.samples == 0:
            return None
        supply_pa, self.supply_pa = self.supply_pa, self._law.sheet_pa
        contact_us = self.from_neutral(gear).contact_us
        self.supply_pa = supply_pa
        delay_s = max(contact_us * US, self._least_s)
        return SleeveRecord(delay_s, chance.weight, chance.scatter_s, chance.freedom)

    def laws(self) -> SleeveLawRecords:
        """What it keeps of the main sleeves whose law was learned."""
        return SleeveLawRecords(**{each.name.lower(): self.law(each) for each in MAIN_SLEEVES})

    def law(self, sleeve: Sleeve) -> SleeveLawRecord | None:
        """That of one sleeve; None where it was not learned."""
        tracked = self._sleeves[sleeve]
        return law_record(tracked.known, tracked.movements) if tracked.movements > 0 else None

    def law_figures(self, gear: DogGear) -> LawFigures:
        """What is known of the law by which the sleeve goes to this gear."""
        side, tracked = self._of(gear)
        return law_figures(tracked.at_rest(0.0), side.direction, tracked.movements)

    def restore(self, records: SleeveRecords, laws: SleeveLawRecords) -> None:
        """Goes on from records; what is without one stays as the data sheet says."""
        for sleeve in MAIN_SLEEVES:
            tracked = self._sleeves[sleeve]
            law: SleeveLawRecord | None = getattr(laws, sleeve.name.lower())
            if law is not None:
                tracked.set_prior(known_from(law))
                tracked.movements = law.movements
        supply_pa, self.supply_pa = self.supply_pa, self._law.sheet_pa
        for gear in MAIN_GEARS:
            chance, record = self._chances[gear], records.of(gear)
            if record is not None:
                bias_s = record.delay_s - self.from_neutral(gear).contact_us * US
                chance.set(bias_s, record.samples, record.scatter_s, record.scatter_samples)
                self._neutral_sd_s[gear] = self._law_sd_s(gear)
        self.supply_pa = supply_pa
        self._tell_scatter()
