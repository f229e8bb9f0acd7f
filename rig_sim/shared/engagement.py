"""Gear against sleeve: valve effects on the two main sleeves, the contact rule, locking.

Phase is the angle of a gear tooth from the middle of the sleeve's gap; it grows with the slip, the
gear's speed less the sleeve's. At contact |phase| < b/2 is a gap. Else the sleeve rests on the
tooth until the slip, which may turn round meanwhile, has carried the tooth to a gap. In the gap the
slip carries the tooth on to a flank, +b/2 or -b/2: there the gear locks and the layshaft follows
the main shaft.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import Counter
from enum import IntEnum
from typing import Final, Generic, NamedTuple, TypeVar

from meshpoint.dbc.messages import EngagementEvent
from meshpoint.gearbox.gears import MAIN_SLEEVES, SIDE_OF, DogGear, MainGear, Sleeve, SplitGear
from meshpoint.gearbox.sheet import GearboxSheet
from meshpoint.rig_sim.shared.rotation import Rotation
from meshpoint.rig_sim.shared.sleeves import MainSleeve, SleeveState
from meshpoint.rig_sim.shared.valve_drivers import Valve
from meshpoint.units import RPM

GEAR_OF_VALVE: Final[dict[Valve, MainGear]] = {
    Valve.MAIN_FIRST: MainGear.FIRST,
    Valve.MAIN_SECOND: MainGear.SECOND,
    Valve.MAIN_CRAWL: MainGear.CRAWL,
    Valve.MAIN_THIRD: MainGear.THIRD,
}
VALVE_OF_MAIN: Final = {gear: valve for valve, gear in GEAR_OF_VALVE.items()}
DOG_OF_VALVE: Final[dict[Valve, DogGear]] = {
    **GEAR_OF_VALVE,
    Valve.SPLIT_LOW: SplitGear.LOW_SPLIT,
    Valve.SPLIT_HIGH: SplitGear.HIGH_SPLIT,
}
VALVE_OF_DOG: Final = {gear: valve for valve, gear in DOG_OF_VALVE.items()}
"""The same of all sleeves that may have dog teeth."""
GRINDS_RAD_S: Final = 130.0 * RPM
"""Dog teeth that meet at more slip than this are damaged: no controller may fire or push a sleeve
so. The slip that a controller's guard allows, 120 rpm, and the 10 rpm by which it may err."""
MOVED_ON_US: Final = 40_000
"""A pulse of the brake that began with a sleeve at its gear's teeth (`AT_TEETH`), none in mesh, may
turn the gear into its gap: its valve is off again within this time."""
AT_TEETH: Final = (SleeveState.FACE, SleeveState.ENTER)
GEAR_AT: Final = {(where.sleeve, where.direction): gear for gear, where in SIDE_OF.items()}


class Violation(IntEnum):
    """States that a controller must never cause."""

    TWO_GEARS = 0  # a second gear at its sleeve while one is in mesh
    # air let into the brake in gear, or its valve on when a gear locks: but for a short pulse that
    # began as the sleeve stood on a tooth or went in
    BRAKE_IN_GEAR = 1
    BOTH_VALVES = 2  # both valves of one sleeve on
    SLIP_AT_CONTACT = 3  # a sleeve at a gear that turns against it faster than GRINDS_RAD_S


class Tally(NamedTuple):
    """Impact energy (J), time on a tooth face (us) and ratchets of an engagement since its
    firing."""

    impact_j: float = 0.0
    face_us: int = 0
    ratchets: int = 0
    blocked: bool = False


NO_TALLY: Final = Tally()


class Engaged(NamedTuple):
    """An event between gear and sleeve; slip before any impact. drive_gear: Ready only."""

    event: EngagementEvent
    gear: DogGear
    time_us: float
    phase_rad: float
    slip_rad_s: float
    drive_gear: int = 0
    tally: Tally = NO_TALLY


SleeveT = TypeVar("SleeveT", bound=MainSleeve)


class Engagement(ABC, Generic[SleeveT]):
    """The sleeves with dog teeth, their valves, and what happened to them; common to all
    presets."""

    def __init__(
        self, sheet: GearboxSheet, plant: Rotation, sleeves: dict[Sleeve, SleeveT]
    ) -> None:
        self._plant = plant
        self._half_rad = sheet.dog.backlash_rad / 2.0
        self._pitch_rad = sheet.dog.pitch_rad
        self.sleeves = sleeves
        self._energised: set[Valve] = set()
        self._blocked: set[Sleeve] = set()
        self._pulsed_us: float | None = None
        """Since when the brake's valve is on that went on with a sleeve at its gear's teeth."""
        self.scripted = False
        self.violations: Counter[Violation] = Counter()
        self.engaged: list[Engaged] = []
        self.lines: list[tuple[float, str]] = []

    @property
    def next_us(self) -> float:
        """When a contact, the end of an overlap or an arrival in neutral is due."""
        return min(sleeve.next_us for sleeve in self.sleeves.values())

    def gear_at(self, name: Sleeve) -> DogGear:
        """The gear a sleeve is at, or moves to or from."""
        return GEAR_AT.get((name, self.sleeves[name].side), MainGear.NEUTRAL)

    def switch(self, valve: Valve, on: bool, time_us: float) -> None:
        """A valve of a sleeve with dog teeth or the brake valve has been switched."""
        (self._energised.add if on else self._energised.discard)(valve)
        if valve is Valve.BRAKE:
            self._count_pulse(on, time_us)
            return
        where = SIDE_OF[DOG_OF_VALVE[valve]]
        opposite = VALVE_OF_DOG[GEAR_AT[where.sleeve, -where.direction]]
        if on and opposite in self._energised:
            self._violate(Violation.BOTH_VALVES, time_us, f"both valves of {where.sleeve.name} on")
        if self.scripted:
            if on:
                self._say(time_us, f"valve {valve.name} ignored: the bench moves the sleeves")
        else:
            self._drive(where.sleeve, where.direction, on, opposite in self._energised, time_us)

    def brake_air(self, on: bool) -> None:
        """The brake valve's delay is over: air comes in, or goes out."""
        self.moment(EngagementEvent.BRAKE_FILLS if on else EngagementEvent.BRAKE_EMPTIES)
        if on:
            self._count_brake_in_gear(self._plant.time_us)

    def moment(self, event: EngagementEvent) -> None:
        """Clutch or brake has done something; no gear takes part in it."""
        time_us = self._plant.time_us
        self.engaged.append(Engaged(event, MainGear.NEUTRAL, time_us, 0.0, 0.0))
        self._say(time_us, event.name)

    @abstractmethod
    def due(self, time_us: float) -> None:
        """Do what is due now; the plant stands at this instant."""

    @abstractmethod
    def script_release(
        self, time_us: float, duration_s: float, names: tuple[Sleeve, ...] = MAIN_SLEEVES
    ) -> None:
        """The bench moves these sleeves to neutral, within this time."""

    @abstractmethod
    def script_engage(self, gear: DogGear, time_us: float) -> None:
        """The bench moves the sleeve of this gear in."""

    def ready(self, gear: MainGear, drive_gear: int) -> None:
        """The bench's return to a gear has ended here."""
        phase = self._plant.shafts.phase_rad(gear) if gear else 0.0
        slip = self._plant.slip_rad_s(gear) if gear else 0.0
        self._note(EngagementEvent.READY, gear, phase, slip, drive_gear)

    @abstractmethod
    def _drive(
        self, name: Sleeve, direction: int, on: bool, is_opposed: bool, time_us: float
    ) -> None:
        """The coil that moves a sleeve this way has been switched; is_opposed: the opposite one is
        on."""

    @abstractmethod
    def _contact(self, name: Sleeve, time_us: float) -> None:
        """The sleeve has reached the gear."""

    @abstractmethod
    def _unmesh(self, name: Sleeve) -> None:
        """The teeth leave each other."""

    def _meets(
        self, event: EngagementEvent, gear: DogGear, phase_rad: float, slip_rad_s: float
    ) -> None:
        """A sleeve has come to this gear, at a gap or a tooth; whatever has sent it there."""
        self._note(event, gear, phase_rad, slip_rad_s)
        if abs(slip_rad_s) > GRINDS_RAD_S and not self.scripted:
            text = f"{gear.name} met at {slip_rad_s / RPM:+.0f} rpm"
            self._violate(Violation.SLIP_AT_CONTACT, self._plant.time_us, text)

    def _another_meshed(self, name: Sleeve) -> bool:
        """Whether the main box is in another gear."""
        others = [each for each in MAIN_SLEEVES if name in MAIN_SLEEVES and each is not name]
        return any(self.sleeves[each].meshed for each in others)

    def _block(self, name: Sleeve, time_us: float) -> None:
        self._blocked.add(name)
        gear = self.gear_at(name)
        self._violate(Violation.TWO_GEARS, time_us, f"{gear.name} pushed while a gear is in mesh")

    def _count_pulse(self, on: bool, time_us: float) -> None:
        """The brake's valve has been switched: a pulse is looked at again as it ends, since nothing
        else may be due until then."""
        if self._pulsed_us is not None and time_us - self._pulsed_us > MOVED_ON_US:
            self._violate_in_gear(time_us)
        at_teeth = any(self.sleeves[name].state in AT_TEETH for name in MAIN_SLEEVES)
        is_pulse = on and at_teeth and self._plant.shafts.lock is None
        self._pulsed_us = time_us if is_pulse else None

    def _count_brake_in_gear(self, time_us: float) -> None:
        pulsed_us = self._pulsed_us
        is_pulse = pulsed_us is not None and time_us - pulsed_us <= MOVED_ON_US
        if Valve.BRAKE in self._energised and not is_pulse:
            self._violate_in_gear(time_us)

    def _violate_in_gear(self, time_us: float) -> None:
        lock = self._plant.shafts.lock
        if lock is not None:
            self._violate(Violation.BRAKE_IN_GEAR, time_us, f"brake on in gear {lock.gear.name}")

    def _violate(self, kind: Violation, time_us: float, text: str) -> None:
        self.violations[kind] += 1
        self._say(time_us, f"VIOLATION {kind.name}: {text}")

    def _note(
        self,
        event: EngagementEvent,
        gear: DogGear,
        phase_rad: float,
        slip_rad_s: float,
        drive_gear: int = 0,
        tally: Tally = NO_TALLY,
    ) -> None:
        time_us = self._plant.time_us
        self.engaged.append(Engaged(event, gear, time_us, phase_rad, slip_rad_s, drive_gear, tally))
        where = f" drive gear {drive_gear}" if event is EngagementEvent.READY else ""
        self._say(
            time_us,
            f"{event.name} {gear.name}{where} phase {math.degrees(phase_rad):+.3f} deg"
            f" slip {slip_rad_s / RPM:+.2f} rpm",
        )

    def _say(self, time_us: float, text: str) -> None:
        self.lines.append((time_us, text))
