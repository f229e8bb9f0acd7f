"""The truck's rotating parts: five bodies, brake, air, engine, and the four sensor wheels.

The state is at `time_us`; `advance` goes on to the next event. Everything else acts at that
instant: `chain` links and strikes bodies together, `rub` and `smooth` switch friction, `watch` asks
for the instant at which a gear's phase leaves a span.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from meshpoint.gearbox.gears import (
    MAIN_GEARS,
    SPLIT_GEARS,
    DogGear,
    MainGear,
    Range,
    Sleeve,
    Split,
    SplitGear,
)
from meshpoint.gearbox.sheet import GearboxSheet
from meshpoint.kernels.structures import Floats, RecordArray
from meshpoint.rig_sim.parts.disturbance import MERSENNE, NUMBERS, SOURCES
from meshpoint.rig_sim.parts.vehicle import CREEP_M_S
from meshpoint.rig_sim.shared.angle_kernels import settled, wrapped
from meshpoint.rig_sim.shared.angles import Angle, Shafts
from meshpoint.rig_sim.shared.rotation import Drive
from meshpoint.rig_sim.truck import layout as at
from meshpoint.rig_sim.truck.as_built import AsBuilt
from meshpoint.rig_sim.truck.chain import UNLIMITED, BodyChain
from meshpoint.rig_sim.truck.constants import SHAKEN, load_parameters
from meshpoint.rig_sim.truck.edges import TruckEdges
from meshpoint.rig_sim.truck.energy import Energy
from meshpoint.rig_sim.truck.gear_train import INDEX, InMesh, StepInMesh, TruckShafts
from meshpoint.rig_sim.truck.kernels import advance, advance_alone, sample
from meshpoint.rig_sim.truck.layout import Contact, Rig

CHANCE_STREAM: Final = 0xC4A


class Snapshot(NamedTuple):
    """What moves in a plant at an instant; what is linked to what only as the kernels see it."""

    time_us: float
    moving: bytes


class TruckPlant:
    """State, connections and events of everything that turns or carries air."""

    def __init__(
        self, sheet: GearboxSheet, built: AsBuilt, start: Shafts, gear: MainGear, main_rad_s: float
    ) -> None:
        self._sheet = sheet
        self.time_us = 0.0
        self._memory = RecordArray(Rig())
        self.rig = rig = self._memory.record
        self.p, self.y, self.g = rig.p, rig.y, rig.g
        load_parameters(self.p, sheet, built)
        for row in range(at.WATCHES):
            self.unwatch(row)
        self.shafts = TruckShafts(sheet, rig, start.split, start.range_)
        self.chain = BodyChain(rig)
        self.impacts_j = 0.0
        self._cones_nm = (built["synchro.splitter_nm"], built["synchro.range_nm"])
        self.constant_speed = built["vehicle.constant_speed"] >= 0.5
        self._load_angles(start)
        self.edges = TruckEdges(sheet, built, rig)
        self._load_speeds(gear, main_rad_s, built)
        self._load_chance(built)
        self._stored_at_start_j = self._stored_j()

    @property
    def layshaft_rad_s(self) -> float:
        """Layshaft speed."""
        return self.y.speed_rad_s[at.LAYSHAFT]

    @property
    def input_rad_s(self) -> float:
        """Input shaft speed."""
        return self.y.speed_rad_s[at.INPUT]

    @property
    def main_rad_s(self) -> float:
        """Main shaft speed."""
        return self.y.speed_rad_s[at.MAIN]

    @property
    def road_speed_m_s(self) -> float:
        """Speed of the vehicle."""
        y, p = self.y, self.p
        omega = y.speed_rad_s[at.PROPELLER]
        if p.twisting.stiff_nm_rad > 0.0:
            omega = y.vehicle_rad_s if p.twisting.tyre_nm_rad > 0.0 else y.wheels_rad_s
        return omega * p.road.wheel_m

    @property
    def brake_gauge_pa(self) -> float:
        """Gauge pressure between valve and brake."""
        return self.y.brake_pa - self.p.air.atmosphere_pa

    @property
    def supply_gauge_pa(self) -> float:
        """Gauge pressure of the tank."""
        return self.y.supply_pa - self.p.air.atmosphere_pa

    @property
    def drive(self) -> Drive:
        """What moves the layshaft."""
        if self.chain.is_rigid(at.MAIN_BOX):
            return Drive.LOCKED
        if self.g.held:
            return Drive.STOPPED
        return Drive.SCRIPTED if self.chain.is_forced(at.LAYSHAFT) else Drive.COASTING

    @property
    def energy(self) -> Energy:
        """The balance since power-up."""
        y = self.y
        return Energy(
            y.work_j,
            y.brake_j,
            y.drag_j,
            y.road_j,
            y.rub_j,
            self.impacts_j,
            y.twist_j,
            y.grade_j,
            self._stored_j() - self._stored_at_start_j,
        )

    def angle(self, body: int) -> Angle:
        """Whole turns and rest of a body, the input shaft with its backlash."""
        rest = self.y.angle_rad[body]
        if body == at.INPUT:
            rest += self.y.input_lash_rad
        return settled(self.rig.laps[body], rest)

    def ratio(self, gear: DogGear) -> float:
        """Gear speed over layshaft speed."""
        return self.p.ratio[INDEX[gear]]

    def slip_rad_s(self, gear: DogGear) -> float:
        """Speed of the gear less that of its sleeve."""
        sleeve = at.INPUT if isinstance(gear, SplitGear) else at.MAIN
        return self.ratio(gear) * self.layshaft_rad_s - self.y.speed_rad_s[sleeve]

    def main_box_nm(self) -> float:
        """What the gear in mesh puts on the main shaft now; 0 between the flanks."""
        self.find_torques()
        return self.rig.torques.link_nm[at.MAIN_BOX]

    def teeth_nm(self, gear: DogGear) -> float:
        """What a gear in mesh puts on its sleeve now; 0 between the flanks."""
        self.find_torques()
        joint = self.shafts.joint(gear)
        return joint.turn * self.rig.torques.link_nm[joint.link] / joint.arm

    @property
    def splitter_is_in(self) -> bool:
        """Whether one of its steps is in mesh."""
        if self._sheet.has_dog_splitter:
            return self.shafts.split_lock is not None
        return self.chain.is_rigid(at.SPLITTER)

    def load_nm(self, body: int) -> float:
        """Torque on a body from outside and from friction, now."""
        self.find_torques()
        return self.rig.torques.body_nm[body]

    def resistance_nm(self) -> float:
        """What road and slope take at the propeller shaft now; with rigid shafts all that acts on
        it."""
        if self.p.twisting.stiff_nm_rad == 0.0:
            return -self.load_nm(at.PROPELLER)
        self.find_torques()
        power, speed = self.rig.ahead.road_j + self.rig.ahead.grade_j, self.road_speed_m_s
        return power / speed * self.p.road.wheel_m if abs(speed) > CREEP_M_S else 0.0

    def link_nm(self, link: int) -> float:
        """What a rigid link puts on the body behind it, as last found by `advance`."""
        return self.rig.torques.link_nm[link]

    def advance(self, until_us: float, stop_us: float) -> int:
        """Go on to the next event, to `stop_us`, or to the last grid point up to `until_us`."""
        self.time_us, event = advance(
            self._memory.array, self.time_us, float(until_us), float(stop_us)
        )
        return event

    def advance_alone(self, stop_us: float) -> bool:
        """Go on to `stop_us`, nothing being done at events; whether the layshaft has come to rest
        before."""
        self.time_us, rests = advance_alone(self._memory.array, self.time_us, float(stop_us))
        return rests

    def sample(
        self, gear: MainGear, every_us: float, start_us: float, numbers: range
    ) -> tuple[Floats, bool]:
        """Go on alone through samples `every_us` since `start_us`, nothing being done at events.

        (n, 3): layshaft speed, main shaft speed, phase of the gear; NaN from where the shafts have
        come to rest on. And whether they have."""
        found = np.full((len(numbers), 3), np.nan)
        numbered = np.arange(numbers.start, numbers.stop, dtype=np.float64)
        stops_us = start_us + every_us * numbered
        self.time_us, rests = sample(self._memory.array, self.time_us, INDEX[gear], stops_us, found)
        return found, rests

    def snapshot(self) -> Snapshot:
        """A copy of all that moves or is connected, edges found included."""
        return Snapshot(self.time_us, self.rig.moving())

    def restore(self, snapshot: Snapshot) -> None:
        """Stand as at that instant; of this plant or of one of the same gearbox."""
        self.time_us = snapshot.time_us
        self.rig.set_moving(snapshot.moving)

    def find_torques(self) -> None:
        """Rates and torques at the present state into the scratch, going nowhere."""
        self.advance(-math.inf, math.inf)

    def watch(self, row: int, gear: DogGear, span: tuple[float, float], with_lash: bool) -> None:
        """Ask for the instant at which the gear's phase leaves a span: the phase is taken on the
        branch nearest to the span's middle. One that stands outside, on a chamfer, may move in; it
        leaves where it moves out from there."""
        index = INDEX[gear]
        phase = self.y.phase_rad[index]
        if with_lash:
            phase += self.y.lash_rad[index]
        middle = (span[0] + span[1]) / 2.0
        offset = wrapped(phase - middle, self.p.pitch_rad[index]) + middle - phase
        low, high = min(span[0], phase + offset), max(span[1], phase + offset)
        watch = self.rig.watches[row]
        watch.gear, watch.bottom_rad, watch.top_rad = index, low, high
        watch.offset_rad, watch.with_lash = offset, int(with_lash)

    def unwatch(self, row: int) -> None:
        """No more events of that row."""
        self.rig.watches[row].gear = -1

    def rub(self, slot: int, link: int, ratio: float, torque_nm: float, sign: float = 0.0) -> None:
        """Friction at a link from now on; the sign is that of the slip unless it is given."""
        slip = self.chain.slip_rad_s(link, ratio)
        direction = sign or math.copysign(1.0, slip)
        self.rig.contacts[slot] = Contact(direction, ratio, torque_nm, link, link + 1)

    def press(self, slot: int, torque_nm: float) -> None:
        """What rubs there is pressed otherwise from now on."""
        self.rig.contacts[slot].friction_nm = torque_nm

    def hold(self, link: int, torque_nm: float) -> None:
        """What sticks at a link holds this much, either way, from now on."""
        self.g.links[link].low_nm, self.g.links[link].high_nm = -torque_nm, torque_nm

    def smooth(self, slot: int) -> None:
        """No friction there any more."""
        self.rig.contacts[slot].sign = 0.0

    def rubs(self, slot: int) -> bool:
        """Whether there is friction."""
        return self.rig.contacts[slot].sign != 0.0

    def strike(self, link: int, ratio: float, restitution: float) -> float:
        """An impact at a link that stays open; returns its loss, J."""
        driven = self.chain.is_driven(link) or self.chain.is_driven(link + 1)
        before = self.chain.kinetic_j() if driven else 0.0
        lost = self.chain.impact(link, ratio, restitution)
        self.impacts_j += lost
        if driven:
            # what the bench drives goes on as before: the impulse is its work
            self.y.work_j += self.chain.kinetic_j() - before + lost
        return lost

    def join(
        self, link: int, ratio: float, low_nm: float = -UNLIMITED, high_nm: float = UNLIMITED
    ) -> float:
        """Link rigidly; returns what the impact has taken, J."""
        lost = self.strike(link, ratio, 0.0)
        self.chain.join(link, ratio, low_nm, high_nm)
        return lost

    def engage(self, gear: DogGear, flank: int, limited: bool) -> None:
        """The gear's tooth is at a flank: it drives until the torque turns, or for good."""
        joint = self.shafts.joint(gear)
        side = joint.turn * flank
        low = 0.0 if limited and side > 0 else -UNLIMITED
        high = 0.0 if limited and side < 0 else UNLIMITED
        if isinstance(gear, SplitGear):
            self.shafts.split = gear.split
        self.free(gear)
        self.join(joint.link, joint.ratio, low, high)
        self._mesh(gear, INDEX[gear], flank)

    def leave_flank(self, gear: DogGear) -> None:
        """The tooth is between the flanks of its gap, still in mesh."""
        self.chain.open(self.shafts.joint(gear).link)
        self._mesh(gear, -1, 0)

    def _mesh(self, gear: DogGear, index: int, flank: int) -> None:
        if isinstance(gear, SplitGear):
            self.g.split_meshed, self.shafts.split_lock = index, StepInMesh(gear, flank)
        else:
            self.g.meshed, self.shafts.lock = index, InMesh(gear, flank)

    def part_splitter(self) -> None:
        """The splitter's dog teeth have left each other."""
        self.chain.open(at.SPLITTER)
        self.g.split_meshed, self.shafts.split_lock = -1, None

    def coast(self) -> None:
        """No gear and no bench holds the layshaft."""
        self.shafts.lock = None
        self.g.meshed = -1
        self.chain.open(at.MAIN_BOX)
        self.free_layshaft()

    def free(self, gear: DogGear) -> None:
        """Torques alone move the shaft that a gear's teeth are about to move."""
        if isinstance(gear, SplitGear):
            self.chain.free(at.INPUT)
        else:
            self.free_layshaft()

    def free_layshaft(self) -> None:
        """Torques alone move the layshaft from now on; at rest the brake may catch it again."""
        self.g.held = 0
        self.chain.free(at.LAYSHAFT)

    def stop(self) -> None:
        """The layshaft has come to rest: the brake holds it if it can, else it turns back."""
        self.find_torques()
        pull, hold = self.rig.torques.pull_nm, self.rig.torques.hold_nm
        for k in self.chain.group(at.LAYSHAFT):
            self.y.speed_rad_s[k] = 0.0
        if abs(pull) <= hold:
            self.g.held = 1
            self.chain.force(at.LAYSHAFT, 0.0)
        else:
            self.g.brake_sign = math.copysign(1.0, pull)

    def let_go(self) -> None:
        """The brake cannot hold the layshaft any more."""
        self.g.held = 0
        self.g.brake_sign = math.copysign(1.0, self.rig.torques.pull_nm)
        self.chain.free(at.LAYSHAFT)

    def script_layshaft(self, accel_rad_s2: float) -> None:
        """The bench drives the layshaft at constant acceleration."""
        self.shafts.lock = None
        self.g.meshed = -1
        self.g.held = 0
        self.g.brake_sign = 1.0
        self.chain.open(at.MAIN_BOX)
        self.chain.force(at.LAYSHAFT, accel_rad_s2)

    def script_main(self, accel_rad_s2: float) -> None:
        """The bench drives the main shaft at constant acceleration."""
        self.chain.force(at.MAIN, accel_rad_s2)
        self._take_wheels_along()

    def script_input(self, accel_rad_s2: float) -> None:
        """The bench drives an input shaft that is in no step, at constant acceleration."""
        self.chain.force(at.INPUT, accel_rad_s2)

    def end_script(self) -> None:
        """The bench lets the main shaft go."""
        if not self.constant_speed:
            self.chain.free(at.MAIN)

    def set_steps(self, split: Split, range_: Range, moving: frozenset[Sleeve]) -> None:
        """Splitter or range sleeve has arrived, but for those still moving; no angle jumps. While
        the bench drives the shafts speeds follow at once, as work of the bench; else the cones
        bring them together."""
        self.shafts.split, self.shafts.range_ = split, range_
        scripted = self.chain.is_forced(at.LAYSHAFT) and not self.g.held
        before = self.chain.kinetic_j()
        splitter_nm, range_nm = self._cones_nm
        for name, link, slot, ratio, torque_nm in (
            (Sleeve.SPLITTER, at.SPLITTER, at.CONE_SPLITTER, self.shafts.split_ratio, splitter_nm),
            (Sleeve.RANGE, at.RANGE, at.CONE_RANGE, self.shafts.range_ratio, range_nm),
        ):
            if name in moving and not scripted:
                continue  # between its steps, without a cone
            if name is Sleeve.SPLITTER and self._sheet.has_dog_splitter:
                continue  # it has no cone
            if scripted:
                self.smooth(slot)
                self.chain.place(link, ratio)
            elif not self.chain.is_rigid(link) and not self.rubs(slot):
                self.rub(slot, link, ratio, torque_nm)
        self.y.work_j += self.chain.kinetic_j() - before
        self._take_wheels_along()

    def cone_holds(self, slot: int) -> None:
        """A synchroniser has brought both sides to one speed: the sleeve goes in."""
        self.smooth(slot)
        if slot == at.CONE_SPLITTER:
            self.join(at.SPLITTER, self.shafts.split_ratio)
        else:
            self.join(at.RANGE, self.shafts.range_ratio)
            self._take_wheels_along()

    def _take_wheels_along(self) -> None:
        """Where the bench drives the propeller shaft the vehicle goes with it; its work as well."""
        if self.p.twisting.stiff_nm_rad > 0.0 and self.chain.is_driven(at.PROPELLER):
            before = self._stored_j()
            self.y.wheels_rad_s = self.y.vehicle_rad_s = self.y.speed_rad_s[at.PROPELLER]
            self.y.twist_rad = self.y.tyre_rad = 0.0
            self.y.work_j += self._stored_j() - before

    def _stored_j(self) -> float:
        y, shafts = self.y, self.p.twisting
        stored_j = self.chain.kinetic_j()
        if shafts.stiff_nm_rad > 0.0:
            twist_rad = max(abs(y.twist_rad) - shafts.half_lash_rad, 0.0)
            stored_j += 0.5 * shafts.wheels_kgm2 * y.wheels_rad_s**2
            stored_j += 0.5 * shafts.stiff_nm_rad * twist_rad**2
        if shafts.tyre_nm_rad > 0.0:
            stored_j += 0.5 * shafts.vehicle_kgm2 * y.vehicle_rad_s**2
            stored_j += 0.5 * shafts.tyre_nm_rad * y.tyre_rad**2
        return stored_j

    def set_brake(self, valve: float) -> None:
        """The brake valve's input u (4.1), its delay over."""
        self.g.valve = valve

    def take_air(self, share: float) -> None:
        """A sleeve's stroke has taken this share of the tank's air."""
        self.y.supply_pa *= 1.0 - share

    def change_conditions(self, built: AsBuilt) -> None:
        """Other oil, load, slope or supply from now on; what the load's inertia brings is the
        bench's work."""
        before = self._stored_j()
        load_parameters(self.p, self._sheet, built)
        self.chain.rebuild()
        self.y.work_j += self._stored_j() - before
        self._govern(built)
        self.edges.warm(built)

    def _govern(self, built: AsBuilt) -> None:
        """Where the compressor's governor holds the tank."""
        air = self._sheet.air
        governed_pa = air.supply_gauge_pa + built["air.supply_offset_bar"] * 1e5
        self.g.governed_pa = governed_pa + air.atmosphere_pa

    def without_chance(self) -> None:
        """From now on chance brings nothing new: what there is of it dies out, as is expected."""
        self.p.disturbance.spread_nm[:] = [0.0] * SOURCES

    def _load_chance(self, built: AsBuilt) -> None:
        """The numbers of chance, and its torques at power-up."""
        self.rig.shaking.count = -1
        if not self.p.disturbance.is_on:
            return
        rng = np.random.Generator(np.random.PCG64([built.teeth_seed, CHANCE_STREAM]))
        self.rig.chance.first[:] = rng.standard_normal(NUMBERS).tolist()
        self.rig.chance.second[:] = rng.standard_normal(NUMBERS).tolist()
        self.rig.shaking.seeds[:] = rng.integers(1, MERSENNE, SOURCES).tolist()
        begin = rng.standard_normal(SOURCES).tolist()
        sd_nm = [built[f"disturbance.{name}_nm"] for name in SHAKEN]
        self.rig.shaking.chance_nm[:] = [z * sd for z, sd in zip(begin, sd_nm, strict=True)]

    def _load_angles(self, start: Shafts) -> None:
        wheels = (start.input, start.layshaft, start.main, start.propeller)
        for body, (turns, rest) in zip(range(at.INPUT, at.BODIES), wheels, strict=True):
            self.rig.laps[body], self.y.angle_rad[body] = turns, rest
        for gear in MAIN_GEARS:
            self.y.phase_rad[INDEX[gear]] = start.phase_rad(gear)
        if start.lock is not None:
            # at its flank the gear has taken up the backlash of its mesh as well
            lash = math.copysign(self.p.main_lash.half_rad, start.lock.phase_rad)
            self.y.phase_rad[INDEX[start.lock.gear]] += lash
            self.y.lash_rad[INDEX[start.lock.gear]] = -lash

    def start_splitter(self, gear: SplitGear, flank: int, phases_rad: tuple[float, ...]) -> None:
        """At power-up: the step that dog teeth hold, at which flank, and where the other's teeth
        stand."""
        for each, phase_rad in zip(SPLIT_GEARS, phases_rad, strict=True):
            self.y.phase_rad[INDEX[each]] = phase_rad
        half_rad = self._sheet.teeth_of(Sleeve.SPLITTER).backlash_rad / 2.0
        lash_rad = flank * self.p.split_lash.half_rad
        self.y.phase_rad[INDEX[gear]] = flank * half_rad + lash_rad
        self.y.lash_rad[INDEX[gear]] = -lash_rad

    def _load_speeds(self, gear: MainGear, main_rad_s: float, built: AsBuilt) -> None:
        y, g, shafts = self.y, self.g, self.shafts
        air = self._sheet.air
        g.brake_sign = 1.0
        g.meshed = g.split_meshed = -1
        g.release_nm[:] = [-1.0] * at.LINKS
        self._govern(built)
        y.supply_pa = g.governed_pa
        y.brake_pa = y.felt_pa = air.atmosphere_pa
        y.disc_k = self.p.oil_k
        y.clutch = 1.0
        layshaft = main_rad_s / self.ratio(gear)
        input_ = layshaft / shafts.split_ratio
        y.speed_rad_s[:] = (
            input_,
            input_,
            layshaft,
            main_rad_s,
            main_rad_s * shafts.range_ratio,
        )
        if self.p.plates.kiss < 1.0:
            self.chain.place(at.CLUTCH, 1.0)
        self.chain.place(at.SPLITTER, shafts.split_ratio)
        self.chain.place(at.RANGE, shafts.range_ratio)
        y.wheels_rad_s = y.vehicle_rad_s = y.speed_rad_s[at.PROPELLER]
        if self.constant_speed:
            self.chain.force(at.MAIN, 0.0)
