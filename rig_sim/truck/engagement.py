"""Gear against sleeve in the truck: faces that rub, flanks that strike, sleeves that are blocked.

At contact, and while it rests on a tooth, a sleeve pushed with force N is in FACE: it rubs with
mu N r against the slip; at no slip it sticks (BLOCKED) while the torque stays below mu_s N r. It
drops into the gap where |phi| < b/2, a chamfer c lets an approaching tooth in by c/r earlier. In
ENTER a flank met before the teeth overlap by x_ov throws the sleeve back (a ratchet). After that
the flank strikes with restitution e and the gear is LOCKED: it stays at its flank while the torque
presses it there, and crosses the gap, mesh backlash included, when the torque turns. Loss of a
strike: J_eq dw^2 (1 - e^2) / 2.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable
from typing import Final, Generic, NamedTuple, TypeVar

from meshpoint.dbc.messages import EngagementEvent
from meshpoint.gearbox.gears import (
    MAIN_SLEEVES,
    SIDE_OF,
    DogGear,
    MainGear,
    Sleeve,
    SplitGear,
)
from meshpoint.gearbox.sheet import GearboxSheet
from meshpoint.rig_sim.parts.cylinder import Cylinder
from meshpoint.rig_sim.shared.engagement import Engagement, Tally
from meshpoint.rig_sim.shared.sleeves import SleeveState
from meshpoint.rig_sim.truck import layout as at
from meshpoint.rig_sim.truck.as_built import AsBuilt
from meshpoint.rig_sim.truck.delays import TruckDelays
from meshpoint.rig_sim.truck.plant import TruckPlant
from meshpoint.rig_sim.truck.sleeves import TruckSleeve
from meshpoint.units import MM

SETTLED_RAD_S: Final = 0.02
"""A flank that would rebound more slowly than this stays in contact."""
TruckSleeveT = TypeVar("TruckSleeveT", bound=TruckSleeve)
DOG_SLEEVES: Final = (*MAIN_SLEEVES, Sleeve.SPLITTER)
ROW_OF_SLEEVE: Final = {name: row for row, name in enumerate(DOG_SLEEVES)}
"""Of the watches, and of the surfaces that rub."""


class Teeth(NamedTuple):
    """The dog teeth of a sleeve and its gears, as built."""

    half_rad: float
    """Half of the gap."""
    pitch_rad: float
    chamfer_rad: float
    flank_rad: float
    """From the middle of the gap to a flank, backlash of the gear's mesh included."""
    face_m: float
    """Friction torque on a face for each newton."""


class AxisTruth(NamedTuple):
    """A sleeve along its axis. Pairs: of the side it moves to with positive x, and of the
    other one."""

    position_m: float
    speed_m_s: float
    pressures_pa: tuple[float, float]
    """In the two chambers, absolute."""
    coils: tuple[bool, bool]
    """Whether the valves' coils are driven, at the truth's own instant."""
    spools: tuple[bool, bool]
    """Whether the valves feed their chambers."""


class TruckEngagement(Engagement[TruckSleeveT], Generic[TruckSleeveT]):
    """The teeth of sleeves and gears and what they do to the plant, however the sleeves move."""

    def __init__(
        self,
        sheet: GearboxSheet,
        built: AsBuilt,
        plant: TruckPlant,
        delays: TruckDelays,
        sleeves: dict[Sleeve, TruckSleeveT],
    ) -> None:
        super().__init__(sheet, plant, sleeves)
        self._truck = plant
        self._delays = delays
        self._sheet = sheet
        self._restitution = built["dog.restitution"]
        self._free_play = built["dog.free_play"] >= 0.5
        self._static_factor = built["dog.static_factor"]
        self._teeth = {name: self._teeth_of(name, built) for name in sleeves}
        self._tallies = dict.fromkeys(sleeves, Tally())
        self._face_since_us: dict[Sleeve, float] = {}
        self._stuck: dict[int, Sleeve] = {}
        """By link: the sleeve on whose face a tooth sticks."""

    def _teeth_of(self, name: Sleeve, built: AsBuilt) -> Teeth:
        dog, p = self._sheet.teeth_of(name), self._truck.p
        lash = p.split_lash if name is Sleeve.SPLITTER else p.main_lash
        half_rad = dog.backlash_rad / 2.0
        return Teeth(
            half_rad,
            dog.pitch_rad,
            built["dog.chamfer_mm"] * MM / dog.radius_m,
            half_rad + lash.half_rad,
            built["dog.face_friction"] * dog.radius_m,
        )

    def tally(self, name: Sleeve) -> Tally:
        """Impact energy, time on the tooth face, and ratchets of this sleeve's engagement so
        far."""
        tally = self._tallies[name]
        since_us = self._face_since_us.get(name)
        if since_us is None:
            return tally
        return tally._replace(face_us=tally.face_us + round(self._plant.time_us - since_us))

    @abstractmethod
    def reset_sleeve(self, name: Sleeve) -> None:
        """A main sleeve stands in neutral at once, all main valves off; nothing is recorded."""

    @abstractmethod
    def expected_contact_us(self, gear: DogGear, fire_us: float) -> tuple[float, float]:
        """When the sleeve of this gear would meet it, its coil switched on at `fire_us`, with all
        that is known now: from where it stands or moves, its valves as they are. Mean and standard
        deviation, us."""

    @abstractmethod
    def change_conditions(self, built: AsBuilt) -> None:
        """Another oil temperature, or another supply."""

    @abstractmethod
    def axis(self, name: Sleeve, time_us: float) -> AxisTruth:
        """A main sleeve along its axis at an instant; see `TruckTruth.axis`."""

    def jam(self, name: Sleeve, jammed: bool) -> None:
        """A main sleeve is stuck, or no more."""
        self.sleeves[name].jam(self._plant.time_us, jammed)

    @abstractmethod
    def alter(self, name: Sleeve, change: Callable[[Cylinder], None]) -> None:
        """A main sleeve's cylinder is another from now on; a pure delay has none."""

    def left(self, row: int, side: int) -> None:
        """The watched phase has left its span: the tooth reaches a gap from the face, or a flank
        from the gap. side: +1 at the upper end of the span, -1 at the lower."""
        name = DOG_SLEEVES[row]
        sleeve, time_us = self.sleeves[name], self._plant.time_us
        if sleeve.state is SleeveState.FACE:
            if self._another_meshed(name):
                self._truck.unwatch(row)
                self._block(name, time_us)
            else:
                self._drop_in(name, -side)
        elif sleeve.state is SleeveState.ENTER and sleeve.is_shallow:
            self._eject(name)
        else:
            self._strike(name, side)

    def no_slip(self, slot: int) -> None:
        """Sleeve face and tooth have the same speed: they stick if static friction holds them."""
        name, truck = DOG_SLEEVES[slot], self._truck
        gear = self.gear_at(name)
        joint = truck.shafts.joint(gear)
        truck.smooth(slot)
        if truck.chain.is_rigid(joint.link):
            return
        if isinstance(gear, SplitGear):
            truck.free(gear)  # the bench drives one side of a tooth that sticks, not both
        hold = self._static_factor * self._face_nm(name)
        truck.join(joint.link, joint.ratio, -hold, hold)
        self._stuck[joint.link] = name
        truck.find_torques()
        if abs(truck.link_nm(joint.link)) > hold:
            self.slips(joint.link)
        else:
            self._tallies[name] = self._tallies[name]._replace(blocked=True)
            self._note_now(EngagementEvent.BLOCKED, name)

    def slips(self, link: int) -> None:
        """The torque at a link exceeds static friction, or pulls the tooth off its flank."""
        truck = self._truck
        torque = truck.link_nm(link)
        name = self._stuck.pop(link, None)
        if name is not None:
            truck.chain.open(link)
            self._rub(name, math.copysign(1.0, torque))
            return
        lock = truck.shafts.locked_at(link)
        if lock is not None:
            truck.leave_flank(lock.gear)
            self._watch_gap(SIDE_OF[lock.gear].sleeve)

    @abstractmethod
    def can_release(self, link: int) -> None:
        """The torque on the teeth there no longer holds a sleeve that is to be pulled out."""

    def _wait_for(self, name: Sleeve, torque_nm: float) -> None:
        """A sleeve can be pulled out once its teeth carry no more than this; negative: nothing is
        waited for."""
        joint = self._truck.shafts.joint(self.gear_at(name))
        self._truck.g.release_nm[joint.link] = joint.arm * torque_nm if torque_nm >= 0.0 else -1.0

    def _wait_no_more(self, name: Sleeve) -> None:
        link = at.SPLITTER if name is Sleeve.SPLITTER else at.MAIN_BOX
        self._truck.g.release_nm[link] = -1.0

    def ready(self, gear: MainGear, drive_gear: int) -> None:
        """The bench's scripted return to a gear ends now."""
        super().ready(gear, drive_gear)
        self._truck.end_script()

    def _contact(self, name: Sleeve, time_us: float) -> None:
        gear, sleeve = self.gear_at(name), self.sleeves[name]
        phase, slip = self._truck.shafts.phase_rad(gear), self._plant.slip_rad_s(gear)
        blocked = self._another_meshed(name)
        inward = phase * slip < 0.0
        teeth = self._teeth[name]
        half = teeth.half_rad + (teeth.chamfer_rad if inward else 0.0)
        if abs(phase) < half and not blocked:
            sleeve.enter(time_us)
            self._meets(EngagementEvent.GAP_CONTACT, gear, phase, slip)
            self._watch_gap(name)
            return
        sleeve.rest_on_tooth(time_us)
        self._meets(EngagementEvent.TOOTH_CONTACT, gear, phase, slip)
        self._face(name)
        if blocked:
            self._truck.unwatch(ROW_OF_SLEEVE[name])
            self._block(name, time_us)

    def _face(self, name: Sleeve, thrown_back: bool = False) -> None:
        """The sleeve rests on a tooth: it rubs, and the phase is watched for the next gap."""
        self._face_since_us[name] = self._plant.time_us
        gear, (half, pitch, chamfer, _, _) = self.gear_at(name), self._teeth[name]
        # The chamfer admits a tooth that approaches the gap, not one that is leaving it.
        ahead = 0.0 if self._plant.slip_rad_s(gear) < 0.0 else chamfer
        low = half + chamfer - ahead
        high = pitch - half - ahead
        if thrown_back:
            # At either edge it must first move by the chamfer's width. Without that, a tooth with
            # almost no slip would enter and leave the gap endlessly, because friction on the face
            # moves it through the backlash of its mesh.
            low, high = half - chamfer, high + ahead + chamfer
        self._truck.watch(ROW_OF_SLEEVE[name], gear, (low, high), with_lash=True)
        self._rub(name)

    def _rub(self, name: Sleeve, sign: float = 0.0) -> None:
        torque = self._face_nm(name)
        if torque > 0.0:
            joint = self._truck.shafts.joint(self.gear_at(name))
            self._truck.rub(ROW_OF_SLEEVE[name], joint.link, joint.ratio, torque, sign)

    def _face_nm(self, name: Sleeve) -> float:
        """Friction torque on the face, at the link that the sleeve would make."""
        pressing_n = self.sleeves[name].pressing_n(self._plant.time_us)
        arm = self._truck.shafts.joint(self.gear_at(name)).arm
        return arm * (self._teeth[name].face_m * pressing_n)

    def _leave_face(self, name: Sleeve) -> None:
        since_us = self._face_since_us.pop(name, None)
        if since_us is None:
            return
        tally = self._tallies[name]
        spent_us = round(self._plant.time_us - since_us)
        self._tallies[name] = tally._replace(face_us=tally.face_us + spent_us)
        self._truck.smooth(ROW_OF_SLEEVE[name])
        self._truck.unwatch(ROW_OF_SLEEVE[name])
        for link in [link for link, stuck in self._stuck.items() if stuck is name]:
            del self._stuck[link]
            self._truck.chain.open(link)

    @abstractmethod
    def _renew_air(self, name: Sleeve) -> None:
        """The sleeve goes on with the air that there is now: it may have changed since its valve
        was switched."""

    def _drop_in(self, name: Sleeve, edge: int) -> None:
        gear, time_us = self.gear_at(name), self._plant.time_us
        slip = self._plant.slip_rad_s(gear)
        teeth = self._teeth[name]
        phase = edge * teeth.half_rad
        if teeth.chamfer_rad:
            phase = self._truck.shafts.phase_rad(gear)
        self._leave_face(name)
        self._renew_air(name)
        self.sleeves[name].enter(time_us)
        self._note(EngagementEvent.TOOTH_PASSED, gear, phase, slip)
        self._watch_gap(name)

    def _watch_gap(self, name: Sleeve) -> None:
        gear, row, teeth = self.gear_at(name), ROW_OF_SLEEVE[name], self._teeth[name]
        if self._truck.chain.is_rigid(self._truck.shafts.joint(gear).link):
            return
        if self.sleeves[name].is_shallow:
            self._truck.watch(row, gear, (-teeth.half_rad, teeth.half_rad), with_lash=True)
        else:
            self._truck.watch(row, gear, (-teeth.flank_rad, teeth.flank_rad), with_lash=False)

    def _eject(self, name: Sleeve) -> None:
        time_us, sleeve = self._plant.time_us, self.sleeves[name]
        sleeve.eject(time_us)
        tally = self._tallies[name]
        self._tallies[name] = tally._replace(ratchets=tally.ratchets + 1)
        self._face(name, thrown_back=True)

    def _strike(self, name: Sleeve, side: int) -> None:
        gear, truck, sleeve = self.gear_at(name), self._truck, self.sleeves[name]
        slip = self._plant.slip_rad_s(gear)
        if sleeve.state is SleeveState.ENTER:
            truck.free(gear)
        bounce = self._restitution if abs(slip) * self._restitution > SETTLED_RAD_S else 0.0
        joint = truck.shafts.joint(gear)
        lost = truck.strike(joint.link, joint.ratio, bounce)
        if bounce == 0.0:
            truck.unwatch(ROW_OF_SLEEVE[name])
            truck.engage(gear, side, self._free_play)
        if sleeve.state is SleeveState.ENTER:
            sleeve.lock()
            tally = self._tallies[name]
            self._tallies[name] = tally._replace(impact_j=tally.impact_j + lost)
            if bounce:
                truck.leave_flank(gear)
            phase = side * self._teeth[name].half_rad
            self._note(EngagementEvent.LOCKED, gear, phase, slip, tally=self._tallies[name])
            self._count_brake_in_gear(self._plant.time_us)

    def _unmesh(self, name: Sleeve) -> None:
        gear = self.gear_at(name)
        phase = self._truck.shafts.phase_rad(gear)
        slip = self._plant.slip_rad_s(gear)
        self._note(EngagementEvent.RELEASED, gear, phase, slip)
        self._tallies[name] = Tally()  # it may be pulled through onto the other gear, unfired
        self.sleeves[name].unmesh()
        self._truck.unwatch(ROW_OF_SLEEVE[name])
        if isinstance(gear, SplitGear):
            self._truck.part_splitter()
        else:
            self._truck.coast()

    def _give_up(self, name: Sleeve, was: SleeveState) -> None:
        """A sleeve returns to neutral without having locked."""
        self._leave_face(name)
        self._truck.unwatch(ROW_OF_SLEEVE[name])
        if was is not SleeveState.APPROACH:
            self._note_now(EngagementEvent.GIVEN_UP, name)

    def _note_now(self, event: EngagementEvent, name: Sleeve) -> None:
        gear = self.gear_at(name)
        phase, slip = self._truck.shafts.phase_rad(gear), self._plant.slip_rad_s(gear)
        self._note(event, gear, phase, slip, tally=self.tally(name))
