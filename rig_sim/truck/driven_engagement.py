"""The truck's sleeves as masses between two chambers: valves, axial events, and the teeth.

A coil that is switched reaches its spool after a drawn delay; the spool changes the air, and the
axis is integrated ahead to its next event (`axial_motion`). The bodies act on the axis when a
tooth is met, a gap found, a flank struck or a torque gone; the axis on the bodies through these
events and the force on a face or against a loaded flank, which they get once a millisecond while
air flows.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from copy import deepcopy
from typing import Final

from meshpoint.gearbox.gears import (
    MAIN_SLEEVES,
    SIDE_OF,
    DogGear,
    MainGear,
    Sleeve,
)
from meshpoint.gearbox.sheet import GearboxSheet
from meshpoint.rig_sim.parts.cylinder import BREAKS, HIGH, LOW, STOPS, Cylinder
from meshpoint.rig_sim.shared.engagement import GEAR_AT, VALVE_OF_DOG, Tally
from meshpoint.rig_sim.shared.sleeves import NEVER_US, SleeveState
from meshpoint.rig_sim.truck import layout as at
from meshpoint.rig_sim.truck.as_built import AsBuilt
from meshpoint.rig_sim.truck.axial_motion import LONGEST_STROKE_US
from meshpoint.rig_sim.truck.delays import TruckDelays
from meshpoint.rig_sim.truck.driven_sleeve import DrivenSleeve, Spool
from meshpoint.rig_sim.truck.engagement import ROW_OF_SLEEVE, AxisTruth, TruckEngagement
from meshpoint.rig_sim.truck.plant import TruckPlant
from meshpoint.rig_sim.truck.sleeve_valves import SleeveValves
from meshpoint.rig_sim.truck.sleeves import axial
from meshpoint.units import SECOND_US

SUPPLY_SHARE: Final = 0.002
"""A tank that has changed by less is the one that a chamber is being filled from."""
OUT_OF_MESH: Final = (SleeveState.NEUTRAL, SleeveState.APPROACH, SleeveState.RETRACT)


class DrivenEngagement(TruckEngagement[DrivenSleeve]):
    """The sleeves with dog teeth, the valves that drive them, and what they do to the plant."""

    def __init__(
        self,
        sheet: GearboxSheet,
        built: AsBuilt,
        plant: TruckPlant,
        delays: TruckDelays,
        engaged: tuple[DogGear, ...],
    ) -> None:
        self.valves = SleeveValves(delays, sheet, built)
        self._axes = {
            name: axial(built, sheet.teeth_of(name).radius_m) for name in self.valves.cylinders
        }
        sides = {SIDE_OF[gear].sleeve: SIDE_OF[gear].direction for gear in engaged}
        sleeves = {
            name: DrivenSleeve(sheet.sleeve, sides.get(name, 0), self._axes[name], each)
            for name, each in self.valves.cylinders.items()
        }
        super().__init__(sheet, built, plant, delays, sleeves)

    def reset_sleeve(self, name: Sleeve) -> None:
        """A main sleeve stands in neutral at once, all main valves off; nothing is recorded."""
        self._leave_face(name)
        self._energised.clear()
        self._truck.unwatch(ROW_OF_SLEEVE[name])
        self._wait_no_more(name)
        self.sleeves[name] = DrivenSleeve(
            self._sheet.sleeve, 0, self._axes[name], self.valves.cylinders[name]
        )

    def alter(self, name: Sleeve, change: Callable[[Cylinder], None]) -> None:
        """The sleeve's cylinder is another from now on, also after `reset_sleeve`."""
        change(self.valves.cylinders[name])
        sleeve = self.sleeves[name]
        sleeve.motion.cut(self._plant.time_us)
        change(sleeve.cylinder)
        self._renew_air(name)

    def due(self, time_us: float) -> None:
        """Does what is due now; the plant has been advanced to this time."""
        for name, sleeve in self.sleeves.items():
            self._axial(name, sleeve, time_us)
            while sleeve.spools and sleeve.spools[0].due_us <= time_us:
                self._spool(name, sleeve, time_us)
                self._axial(name, sleeve, time_us)
            if sleeve.look_us <= time_us:
                self._look(name, sleeve, time_us)
                self._axial(name, sleeve, time_us)

    def can_release(self, link: int) -> None:
        """The torque on the teeth there no longer holds a sleeve that is to be pulled out."""
        self._truck.g.release_nm[link] = -1.0
        for name, sleeve in self.sleeves.items():
            if sleeve.waits and (name is Sleeve.SPLITTER) == (link == at.SPLITTER):
                sleeve.go(self._plant.time_us)

    def script_release(
        self, time_us: float, duration_s: float, names: tuple[Sleeve, ...] = MAIN_SLEEVES
    ) -> None:
        """The bench moves these sleeves to neutral, within this time."""
        for name in names:
            sleeve = self.sleeves[name]
            was = sleeve.state
            self._wait_no_more(name)
            if was in (SleeveState.FACE, SleeveState.ENTER):
                self._give_up(name, was)
                sleeve.unmesh()
            sleeve.script_to_neutral(time_us, duration_s)

    def script_engage(self, gear: DogGear, time_us: float) -> None:
        """The bench moves the sleeve of this gear in, by its own valve."""
        self._tallies[SIDE_OF[gear].sleeve] = Tally()
        self._switch_spool(gear, True, time_us)

    def ready(self, gear: MainGear, drive_gear: int) -> None:
        """The bench's scripted return to a gear ends now: its valve goes off."""
        super().ready(gear, drive_gear)
        if gear:
            self._switch_spool(gear, False, self._plant.time_us)
        if Sleeve.SPLITTER in self.sleeves and (split := self.gear_at(Sleeve.SPLITTER)):
            self._switch_spool(split, False, self._plant.time_us)

    def expected_contact_us(self, gear: DogGear, fire_us: float) -> tuple[float, float]:
        """When the sleeve of this gear would meet it, its coil switched on at `fire_us`, with all
        that is known now: from where it stands or moves, its valves as they are, but not their
        chance. Mean and standard deviation, us."""
        where = SIDE_OF[gear]
        mean_s, sd_s = self.valves.expected_s(VALVE_OF_DOG[gear], fire_us)
        spool_us = max(fire_us + mean_s * SECOND_US, self._plant.time_us)
        sleeve = self.sleeves[where.sleeve]
        found_us = NEVER_US
        if sleeve.state in OUT_OF_MESH and not sleeve.meshed:
            found_us = self._alone_us(sleeve, where.direction, spool_us)
        if found_us == NEVER_US:
            found_us = spool_us + self.valves.stroke_s(gear, self._truck.y.supply_pa) * SECOND_US
        return found_us, sd_s * SECOND_US

    def axis(self, name: Sleeve, time_us: float) -> AxisTruth:
        """A main sleeve along its axis at an instant; see `TruckTruth.axis`."""
        motion = self.sleeves[name].motion
        y = motion.state(time_us)
        plus, minus = (VALVE_OF_DOG[GEAR_AT[name, side]] in self._energised for side in (1, -1))
        return AxisTruth(y.x_m, y.v_m_s, (y.a_pa, y.b_pa), (plus, minus), motion.spools(time_us))

    def change_conditions(self, built: AsBuilt) -> None:
        """Another oil temperature, or another supply."""
        self.valves.change_conditions(built)
        for name in self.sleeves:
            self._renew_air(name)

    def _alone_us(self, live: DrivenSleeve, side: int, spool_us: float) -> float:
        """When a copy of a sleeve meets its gear, nothing in its way."""
        sleeve = deepcopy(live)
        time_us = self._plant.time_us
        fired = Spool(spool_us, side, True, spool_us)
        spools = sorted([*sleeve.spools, fired], key=lambda spool: spool.expected_us)
        until_us = spool_us + LONGEST_STROKE_US
        sleeve.go_on(time_us)
        while time_us < until_us:
            end_us = sleeve.motion.end_us
            if spools and spools[0].expected_us <= end_us:
                spool = spools.pop(0)
                time_us = max(spool.expected_us, time_us)
                self._feed(sleeve, spool, time_us)
                continue
            time_us = end_us
            code = sleeve.motion.code
            if code in (HIGH, LOW) and sleeve.cylinder.y.x_m != 0.0:
                return time_us if (code == HIGH) == (side > 0) else NEVER_US
            sleeve.go_on(time_us)
        return NEVER_US

    def _drive(
        self,
        name: Sleeve,
        direction: int,
        on: bool,
        is_opposed: bool,  # noqa: ARG002
        time_us: float,
    ) -> None:
        sleeve = self.sleeves[name]
        if on and sleeve.jammed:
            self._say(time_us, f"activation of {name.name} lost: jammed")
        if on and sleeve.state in OUT_OF_MESH:
            self._tallies[name] = Tally()
        self._switch_spool(GEAR_AT[name, direction], on, time_us)

    def _switch_spool(self, gear: DogGear, on: bool, time_us: float) -> None:
        """The spool follows the coil after its delay, and never before it has followed an earlier
        switch."""
        where = SIDE_OF[gear]
        spools = self.sleeves[where.sleeve].spools
        valve = VALVE_OF_DOG[gear]
        mean_s = self.valves.expected_s(valve, time_us)[0] if on else self.valves.mean_s(valve, on)
        expected_us = time_us + mean_s * SECOND_US
        due_us = time_us + self.valves.draw_s(valve, on, time_us) * SECOND_US
        for ahead in spools:
            if ahead.side == where.direction:
                due_us = max(due_us, ahead.due_us)
                expected_us = max(expected_us, ahead.expected_us)
        spools.append(Spool(due_us, where.direction, on, expected_us))
        spools.sort(key=lambda spool: spool.due_us)

    def _spool(self, name: Sleeve, sleeve: DrivenSleeve, time_us: float) -> None:
        if sleeve.waits:
            self._wait_no_more(name)
        spool = sleeve.spools.pop(0)
        self._feed(sleeve, spool, time_us)
        if spool.on:
            self._truck.take_air(self._delays.air_share())

    def _feed(self, sleeve: DrivenSleeve, spool: Spool, time_us: float) -> None:
        sleeve.motion.cut(time_us)
        self._load(sleeve.cylinder)
        sleeve.spool(time_us, spool.side, spool.on)

    def _renew_air(self, name: Sleeve) -> None:
        sleeve, time_us = self.sleeves[name], self._plant.time_us
        sleeve.motion.cut(time_us)
        self._load(sleeve.cylinder)
        sleeve.go_on(time_us)

    def _load(self, cylinder: Cylinder) -> None:
        cylinder.supply_pa = self._truck.y.supply_pa
        self.valves.set_friction(cylinder)

    def _axial(self, name: Sleeve, sleeve: DrivenSleeve, time_us: float) -> None:
        """What the axis has come to, until something comes later."""
        while sleeve.motion.end_us <= time_us:
            code = sleeve.motion.code
            if code in (HIGH, LOW):
                self._at_bound(name, sleeve, 1 if code == HIGH else -1, time_us)
            elif code == BREAKS:
                self._sets_out(name, sleeve, time_us)
            elif code == STOPS:
                self._stops(name, sleeve, time_us)
            if sleeve.motion.end_us <= time_us:
                sleeve.go_on(time_us)

    def _at_bound(self, name: Sleeve, sleeve: DrivenSleeve, direction: int, time_us: float) -> None:
        if not sleeve.meshed:
            if sleeve.cylinder.y.x_m == 0.0:
                sleeve.set_out(direction)
            else:
                sleeve.side = direction
                self._contact(name, time_us)
        elif direction != sleeve.side:
            self._apart(name, sleeve)
        elif sleeve.is_shallow:
            sleeve.is_shallow = False
            self._watch_gap(name)
        else:
            sleeve.motion.stop()

    def _sets_out(self, name: Sleeve, sleeve: DrivenSleeve, time_us: float) -> None:
        """A sleeve that stood begins to move."""
        direction = sleeve.cylinder.direction
        if sleeve.state is SleeveState.FACE:
            self._give_up(name, SleeveState.FACE)
            sleeve.set_out(direction)
        elif not sleeve.meshed:
            sleeve.set_out(direction)
        elif sleeve.state is SleeveState.LOCKED and direction != sleeve.side:
            limit_nm = self._limit_nm(sleeve, time_us)
            if self.scripted or abs(self._truck.teeth_nm(self.gear_at(name))) <= limit_nm:
                sleeve.state = SleeveState.RETRACT
            else:
                sleeve.wait()
                self._wait_for(name, limit_nm)

    def _stops(self, name: Sleeve, sleeve: DrivenSleeve, time_us: float) -> None:
        face_m = self._sheet.sleeve.to_contact_m
        if sleeve.meshed and abs(sleeve.position_m(time_us)) <= face_m:  # moved by the bench
            self._apart(name, sleeve)
            return
        sleeve.stand()
        if not sleeve.meshed:
            self._blocked.discard(name)

    def _apart(self, name: Sleeve, sleeve: DrivenSleeve) -> None:
        """The teeth have left each other."""
        if sleeve.state is SleeveState.ENTER:
            self._give_up(name, SleeveState.ENTER)
            sleeve.unmesh()
        else:
            self._unmesh(name)

    def _look(self, name: Sleeve, sleeve: DrivenSleeve, time_us: float) -> None:
        """The tank as it is now to an open spool, and the force from now on to the tooth it presses
        on or the flank it is held at."""
        fed_pa, supply_pa = sleeve.cylinder.supply_pa, self._truck.y.supply_pa
        if sleeve.fed and abs(supply_pa - fed_pa) > SUPPLY_SHARE * fed_pa:
            self._renew_air(name)
        if sleeve.waits:
            limit_nm = self._limit_nm(sleeve, time_us)
            if limit_nm > 0.0:
                self._wait_for(name, limit_nm)
            else:
                self._wait_no_more(name)
                sleeve.pull_no_more(time_us)
        elif (link := self._sticks_at(name)) is not None:
            self._truck.hold(link, self._static_factor * self._face_nm(name))
        elif self._truck.rubs(ROW_OF_SLEEVE[name]):
            self._truck.press(ROW_OF_SLEEVE[name], self._face_nm(name))
        elif sleeve.state is SleeveState.FACE:
            self._rub(name)
        sleeve.look_again(time_us)

    def _sticks_at(self, name: Sleeve) -> int | None:
        """The link that a tooth makes which sticks on the sleeve's face."""
        return next((link for link, stuck in self._stuck.items() if stuck is name), None)

    def _limit_nm(self, sleeve: DrivenSleeve, time_us: float) -> float:
        """Torque at the flank up to which the air pulls the sleeve out."""
        if sleeve.axis.hold_per_nm == 0.0:
            return math.inf
        return sleeve.force_at_n(time_us, -sleeve.side) / sleeve.axis.hold_per_nm
