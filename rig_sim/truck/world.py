"""The truck in its own time: plant, air, clutch, engine, sleeves, script, sensors and faults.

The plant goes from event to event and never stops between them because somebody looks: a command
that arrives at an instant is put in the queue for that instant, and the plant cuts a step there
when it gets to it.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Final

import numpy as np

from meshpoint.gearbox.gears import SPLIT_GEAR, DogGear, DriveGear, Sleeve, drive_gear
from meshpoint.gearbox.sheet import GearboxSheet
from meshpoint.rig_sim.orders import EngineRequest, FaultOrder
from meshpoint.rig_sim.settings import RigSettings, SettingsError
from meshpoint.rig_sim.shared.angles import Shafts
from meshpoint.rig_sim.shared.edge_ring import EdgeRead
from meshpoint.rig_sim.shared.engagement import VALVE_OF_DOG, Engaged
from meshpoint.rig_sim.shared.node_state import NodeState
from meshpoint.rig_sim.shared.script import BenchScript
from meshpoint.rig_sim.shared.sensor_clock import SensorClock
from meshpoint.rig_sim.shared.sleeves import NEVER_US
from meshpoint.rig_sim.shared.start import draw_start, seeded
from meshpoint.rig_sim.shared.valve_drivers import Change, Order, Valve, ValveBank
from meshpoint.rig_sim.shared.world import READ_US, EncoderRead, PhaseRead, SensorRead, Truth
from meshpoint.rig_sim.truck import layout as at
from meshpoint.rig_sim.truck.as_built import AsBuilt, as_built_sheet, draw_as_built
from meshpoint.rig_sim.truck.clutch import TruckClutch, TruckEngine
from meshpoint.rig_sim.truck.delayed_engagement import DelayedEngagement
from meshpoint.rig_sim.truck.delays import TruckDelays
from meshpoint.rig_sim.truck.driven_engagement import DrivenEngagement
from meshpoint.rig_sim.truck.engagement import TruckEngagement
from meshpoint.rig_sim.truck.faults import FaultInjector
from meshpoint.rig_sim.truck.plant import TruckPlant
from meshpoint.rig_sim.truck.position_sensors import PositionSensors
from meshpoint.rig_sim.truck.pressure_sensors import PressureSensors
from meshpoint.rig_sim.truck.truth import TruckTruth
from meshpoint.units import RPM, SECOND_US

STEP_VALVES: Final[dict[Valve, tuple[Sleeve, int]]] = {
    Valve.SPLIT_LOW: (Sleeve.SPLITTER, -1),
    Valve.SPLIT_HIGH: (Sleeve.SPLITTER, 1),
    Valve.RANGE_LOW: (Sleeve.RANGE, -1),
    Valve.RANGE_HIGH: (Sleeve.RANGE, 1),
}
LINK_OF: Final = {Sleeve.SPLITTER: at.SPLITTER, Sleeve.RANGE: at.RANGE}
CONE_OF: Final = {Sleeve.SPLITTER: at.CONE_SPLITTER, Sleeve.RANGE: at.CONE_RANGE}


CONDITIONS: Final = frozenset(
    ("oil.temperature_c", "vehicle.mass_kg", "vehicle.slope_percent", "air.supply_offset_bar")
)
"""As-built values that change from one day's work to the next."""
SPLITTER_STREAM: Final = 0x5917
MOST_EVENTS: Final = 100_000
"""Largest number of events in 10 ms: with more the simulation would not advance, so it is stopped
with an error."""


class TruckWorld:
    """Everything physical. See `rig_world.RigWorld`."""

    def __init__(self, sheet: GearboxSheet, settings: RigSettings) -> None:
        rng: np.random.Generator = seeded(settings.seed)
        start = draw_start(rng, sheet, settings)
        gear = drive_gear(settings.start_gear)
        self.built: AsBuilt = draw_as_built(settings.seed, settings.as_built, settings.profile)
        self.sheet = as_built_sheet(sheet, self.built)
        self.clock_start_us = start.clock_us
        self.clock = SensorClock(start.clock_us)
        self.node = NodeState()
        shafts = Shafts(self.sheet, start.angles, gear.split, gear.range_)
        shafts.lock_gear(gear.main, start.flank * self.sheet.dog.backlash_rad / 2.0)
        shafts.follow()
        main_rad_s = settings.main_speed_rpm * RPM
        self.plant = TruckPlant(self.sheet, self.built, shafts, gear.main, main_rad_s)
        self.plant.engage(gear.main, start.flank, self.built["dog.free_play"] >= 0.5)
        if self.sheet.has_dog_splitter:
            self._start_splitter(gear, settings.seed)
        self.delays = TruckDelays(rng, self.sheet, self.built)
        moved = DrivenEngagement if self.built["sleeve.model"] >= 0.5 else DelayedEngagement
        self.engagement: TruckEngagement[Any] = moved(
            self.sheet, self.built, self.plant, self.delays, self._engaged(gear)
        )
        self.script = BenchScript(self.sheet, self.plant, self.engagement, self.delays, gear)
        self.script.ramp_s = settings.return_ramp_s
        self.valves = ValveBank()
        self.clutch = TruckClutch(self.plant, self.sheet.clutch, self.engagement.moment)
        self.engine = TruckEngine(self.plant)
        self.positions = PositionSensors(self.built)
        self.pressures = PressureSensors(self.built, self.sheet.air.atmosphere_pa)
        self.faults = FaultInjector(self)
        self._dog_valves = {VALVE_OF_DOG[gear] for gear in self.sheet.dog_gears}
        self._steps_driven = dict.fromkeys(STEP_VALVES, False)
        self._follows_us: dict[Valve, float] = {}
        """When a valve that a fault makes late follows its coil."""
        self._queue: list[tuple[float, int, Callable[[], None]]] = []
        self._asked = 0
        self._read_us = 0
        self._due_us = self._next_due()
        for scheduled in settings.faults:
            self._at(float(scheduled.at_us), partial(self.faults.begin, scheduled.order))

    def _engaged(self, gear: DriveGear) -> tuple[DogGear, ...]:
        """The gears in which sleeves with dog teeth stand at the start."""
        return (gear.main, SPLIT_GEAR[gear.split]) if self.sheet.has_dog_splitter else (gear.main,)

    def _start_splitter(self, gear: DriveGear, seed: int) -> None:
        """Where the splitter's dog teeth stand, and at which flank: draws of their own, so that a
        seed stays what it was."""
        own = np.random.Generator(np.random.PCG64([seed, SPLITTER_STREAM]))
        half_rad = self.sheet.teeth_of(Sleeve.SPLITTER).pitch_rad / 2.0
        low_rad, high_rad = own.uniform(-half_rad, half_rad, 2).tolist()
        flank = 1 if own.random() < 0.5 else -1
        held = SPLIT_GEAR[gear.split]
        self.plant.start_splitter(held, flank, (low_rad, high_rad))
        self.plant.engage(held, flank, self.built["dog.free_play"] >= 0.5)

    def handle(self, event: int) -> None:
        """Act on what `plant.advance` has returned (`layout`: DUE and those that follow)."""
        time_us = self.plant.time_us
        if event == at.DUE:
            while self._queue and self._queue[0][0] <= time_us:
                heapq.heappop(self._queue)[2]()
            self.clutch.due(time_us)
            self.engine.due(time_us)
            self.engagement.due(time_us)
            self.script.due(time_us)
        elif event >= at.LINK_SLIPS:
            self._torque_event(event)
        elif event == at.STOPPED:
            self.plant.stop()
        elif event >= at.NO_SLIP:
            self._no_slip(event - at.NO_SLIP)
        elif event >= at.LEFT_BOTTOM:
            self.engagement.left(event - at.LEFT_BOTTOM, -1)
        else:
            self.engagement.left(event - at.LEFT_TOP, 1)
        if self.engagement.scripted:
            # The bench moves the shafts: there is nothing left for the cones to do.
            self.script.splitter.go_in(time_us)
            self.script.range_.go_in(time_us)
        self.script.watch()
        self.engine.settle()

    def run_to(self, until_us: int) -> bool:
        """Go on to this instant, or to the next 10 ms read if that comes first: then True."""
        target_us = min(until_us, self._read_us)
        events = 0
        while not (self.plant.time_us == target_us < self._due_us):
            # a fault may change the clock that the valves go by: they are never run ahead of it
            self._run_valves(min(target_us, self._due_us))
            event = self.plant.advance(target_us, self._due_us)
            if event == at.REACHED:
                break
            events += 1
            if events > MOST_EVENTS:
                raise RuntimeError(f"over {MOST_EVENTS} events of the gearbox by {target_us} us")
            self.handle(event)
            self._due_us = self._next_due()
        if self._read_us > until_us:
            return False
        self._read_us += READ_US
        return True

    def command_valves(self, orders: tuple[Order, ...], now_us: int) -> None:
        """A valid valve command, consumed now."""
        self._switched(self.valves.command(orders, self.clock.at(now_us), now_us), float(now_us))

    def renew_valves(self, now_us: int) -> bool:
        """The same valve command once more; False where it has to be taken in full."""
        return self.valves.renew(now_us)

    def all_valves_off(self, now_us: float) -> None:
        """Shutdown: no valve is driven from now on."""
        self._switched(self.valves.all_off(), now_us)

    def command_clutch(self, close: bool, now_us: int) -> None:
        """A valid clutch command, consumed now."""
        time_us = float(now_us)
        if not self.clutch.renew(close, time_us):
            self._at(time_us, partial(self.clutch.command, close, time_us))

    def command_engine(self, request: EngineRequest, now_us: int) -> None:
        """A TSC1 frame, consumed now."""
        time_us = float(now_us)
        self._at(time_us, partial(self.engine.request, request, time_us))

    def return_to_gear(self, gear_number: int, main_rad_s: float, now_us: int) -> None:
        """The bench asks for the script."""
        self._at(float(now_us), partial(self.script.start, gear_number, main_rad_s))

    def inject(self, order: FaultOrder, now_us: int) -> None:
        """The bench asks for a fault."""
        self._at(float(now_us), partial(self.faults.begin, order))

    def change_conditions(self, values: Mapping[str, float]) -> None:
        """Other oil, load, slope and supply from now on (`CONDITIONS`), by name."""
        unknown = set(values) - CONDITIONS
        if unknown:
            raise SettingsError(
                f"conditions: found {sorted(unknown)}, allowed {sorted(CONDITIONS)}"
            )
        self.built = self.built.changed(values)
        self.delays.change_conditions(self.built)
        self.engagement.change_conditions(self.built)
        self.plant.change_conditions(self.built)

    def later(self, delay_us: float, action: Callable[[], None]) -> None:
        """Do something this much after the plant's present instant."""
        self._at(self.plant.time_us + delay_us, action)

    @property
    def next_read_us(self) -> int:
        """When the sensors are read next."""
        return self._read_us

    @property
    def truth(self) -> Truth:
        """The state, for tests."""
        return TruckTruth(self)

    @property
    def as_built(self) -> dict[str, Any]:
        """What was drawn for this gearbox."""
        return self.built.to_json()

    def edge_reads(self, now_us: int) -> list[EdgeRead]:
        """The read of all edge channels now, in the order of the wire contract."""
        read = self.plant.edges.read(now_us, self.clock)
        return self.faults.edges.pass_on(read)

    def sensors(self, now_us: int) -> SensorRead:
        """The slow sensors now."""
        y = self.plant.y
        felt_pa = y.felt_pa if self.plant.p.feeling_rate > 0.0 else y.brake_pa
        read = SensorRead(
            self.pressures.brake_pa(felt_pa, now_us),
            self.pressures.supply_pa(y.supply_pa, now_us),
            self.plant.p.oil_k,
            min(max(y.clutch, 0.0), 1.0),
            max(y.speed_rad_s[at.ENGINE], 0.0),
            y.engine_nm / self.plant.p.engine.most_nm,
        )
        return self.faults.slow.pass_on(read)

    def sleeve_samples_m(self, name: Sleeve, now_us: int) -> tuple[float, ...]:
        """Ten positions, 1 ms apart, the newest first, as the sensor has them."""
        moving = self.script.step_sleeve(name) or self.engagement.sleeves[name]
        if moving.moves_after(now_us - READ_US):
            true_m = tuple([moving.position_m(now_us - 1000.0 * back) for back in range(10)])
        else:
            true_m = (moving.position_m(now_us),) * 10
        return self.positions.read(name, true_m, now_us)

    def encoder_read(self, now_us: int) -> EncoderRead:
        """The reference encoder now."""
        return EncoderRead(*self.plant.edges.encoder(now_us, self.plant.layshaft_rad_s))

    def phase_read(self) -> PhaseRead:
        """Main shaft and phases now."""
        plant = self.plant
        return PhaseRead(plant.angle(at.MAIN), plant.main_rad_s, plant.shafts.phases_rad())

    def take_engaged(self) -> list[Engaged]:
        """What has happened between sleeves and gears since the last call."""
        engaged, self.engagement.engaged = self.engagement.engaged, []
        return engaged

    def take_lines(self) -> list[tuple[float, str]]:
        """Lines for the log since the last call, with their times."""
        lines, self.engagement.lines = self.engagement.lines, []
        return lines

    def _at(self, time_us: float, action: Callable[[], None]) -> None:
        self._asked += 1
        heapq.heappush(self._queue, (time_us, self._asked, action))
        self._due_us = min(self._due_us, time_us)

    def _next_due(self) -> float:
        return min(
            self._queue[0][0] if self._queue else NEVER_US,
            self.engagement.next_us,
            self.script.next_us,
            self.clutch.next_us,
            self.engine.next_us,
        )

    def _torque_event(self, event: int) -> None:
        if event == at.LET_GO:
            self.plant.let_go()
        elif event >= at.CAN_RELEASE:
            self.engagement.can_release(event - at.CAN_RELEASE)
        elif event == at.LINK_SLIPS + at.CLUTCH:
            self.clutch.slips()
        else:
            self.engagement.slips(event - at.LINK_SLIPS)

    def _no_slip(self, slot: int) -> None:
        if slot == at.PLATE:
            self.clutch.grips()
        elif slot == at.CONE_RANGE or (
            slot == at.CONE_SPLITTER and not self.sheet.has_dog_splitter
        ):
            self.plant.cone_holds(slot)
            name = Sleeve.SPLITTER if slot == at.CONE_SPLITTER else Sleeve.RANGE
            self.script.steps[name].go_in(self.plant.time_us)
        else:
            self.engagement.no_slip(slot)

    def _run_valves(self, until_us: float) -> None:
        """The valve drivers are logic alone: they may run ahead of the plant. Activations go by the
        sensor clock, the expiry by the drivers' own time."""
        valves = self.valves
        while True:
            clock_us, expiry_us = valves.activation_us, valves.expiry_us
            due_us = NEVER_US if clock_us is None else self.clock.when(clock_us)
            if expiry_us is not None and expiry_us < due_us:
                if expiry_us > until_us:
                    return
                self._switched(valves.expire(expiry_us), float(expiry_us))
            elif clock_us is None or due_us > until_us:
                return
            else:
                self._switched(valves.activate(clock_us), due_us)

    def _switched(self, changes: list[Change], time_us: float) -> None:
        # A clock that has jumped ahead may leave an activation behind: it is switched now.
        time_us = max(time_us, self.plant.time_us)
        for change in changes:
            self._at(time_us, partial(self.switch, change.valve, change.on))

    def switch(self, valve: Valve, on: bool) -> None:
        """The valve's coil is switched now; what the air does comes later."""
        extra_us = self.faults.valve_delay_us(valve, on)
        if extra_us is None:
            self.faults.miss(valve, on)
            return
        time_us = self.plant.time_us
        # One that is late to open, and switched off meanwhile, does not open after that.
        due_us = max(time_us + extra_us, self._follows_us.get(valve, time_us))
        if due_us > time_us:
            self._follows_us[valve] = due_us
            self._at(due_us, partial(self._open, valve, on))
        else:
            self._open(valve, on)

    def _open(self, valve: Valve, on: bool) -> None:
        time_us = self.plant.time_us
        if valve is Valve.BRAKE:
            delay_us = self.delays.brake_valve_s() * SECOND_US
            self.later(delay_us, partial(self._brake_air, on))
            self.engagement.switch(valve, on, time_us)
        elif valve in self._dog_valves:
            self.engagement.switch(valve, on, time_us)
        else:
            self._steps_driven[valve] = on
            if on:
                self._change_over(*STEP_VALVES[valve])
            else:
                delay_us = self.sheet.sleeve.valve_delay_s * SECOND_US
                self.later(delay_us, partial(self._step_air_out, valve))

    def _brake_air(self, on: bool) -> None:
        """The brake valve has moved: air comes in, or goes out."""
        self.plant.set_brake(float(on))
        self.engagement.brake_air(on)

    def _change_over(self, name: Sleeve, side: int) -> None:
        """Splitter or range by its valve: out of the old step, then the cones, then in."""
        sleeve = self.script.steps[name]
        if (sleeve.side == side and not sleeve.loose) or self.engagement.scripted:
            return
        if sleeve.jammed:
            text = f"activation of {name.name} lost: jammed"
            self.engagement.lines.append((self.plant.time_us, text))
            return
        delay_us = self.sheet.sleeve.valve_delay_s * SECOND_US
        sleeve.change_over(self.plant.time_us, side, self.delays.draw_s(), baulked=True)
        self.plant.take_air(self.delays.air_share())
        self.later(delay_us, partial(self.plant.chain.open, LINK_OF[name]))

    def _step_air_out(self, valve: Valve) -> None:
        """A valve of splitter or range is off and its cylinder empty, unless it was driven anew:
        what still stands before its cones or rubs on them is free again."""
        name, side = STEP_VALVES[valve]
        sleeve = self.script.steps[name]
        if self._steps_driven[valve] or sleeve.side != side or self.engagement.scripted:
            return
        if sleeve.baulked and not sleeve.loose:
            sleeve.let_go(self.plant.time_us)
            self.plant.smooth(CONE_OF[name])
