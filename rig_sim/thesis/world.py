"""The gearbox in its own time: plant, valves, sleeves, bench script and sensors, event by event.

Time is microseconds since power-up; scheduled instants are whole, those solved for are not. What
happens depends on the commands and their times alone, not on how the time between is cut up: a
search for the next event always looks as far as the next scheduled one.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from meshpoint.gearbox.gears import MAIN_GEARS, Sleeve, drive_gear
from meshpoint.gearbox.sheet import GearboxSheet
from meshpoint.rig_sim.orders import EngineRequest, FaultOrder
from meshpoint.rig_sim.settings import RigSettings, SettingsError
from meshpoint.rig_sim.shared.angles import Shafts
from meshpoint.rig_sim.shared.edge_ring import EdgeRead
from meshpoint.rig_sim.shared.engagement import GEAR_OF_VALVE, Engaged
from meshpoint.rig_sim.shared.node_state import NodeState
from meshpoint.rig_sim.shared.script import BenchScript
from meshpoint.rig_sim.shared.sensor_clock import SensorClock
from meshpoint.rig_sim.shared.sleeves import NEVER_US
from meshpoint.rig_sim.shared.start import draw_start, seeded
from meshpoint.rig_sim.shared.valve_drivers import Change, Order, Valve, ValveBank
from meshpoint.rig_sim.shared.world import READ_US, EncoderRead, PhaseRead, SensorRead, Truth
from meshpoint.rig_sim.thesis.clutch import ClutchActuator, Engine
from meshpoint.rig_sim.thesis.delays import Delays
from meshpoint.rig_sim.thesis.engagement import ThesisEngagement
from meshpoint.rig_sim.thesis.plant import ThesisPlant
from meshpoint.rig_sim.thesis.sensors import EdgeCapture, Encoder
from meshpoint.rig_sim.thesis.truth import ThesisTruth
from meshpoint.units import RPM, SECOND_US

OIL_K: Final = 353.15


class World:
    """Everything physical. Commands act at the instant given, to which the world has been run."""

    def __init__(self, sheet: GearboxSheet, settings: RigSettings) -> None:
        if sheet.has_dog_splitter:
            raise SettingsError(
                f'preset thesis with gearbox {sheet.name}: splitter.engagement = "dog", allowed is '
                f'"cones"; preset truck has both'
            )
        rng: np.random.Generator = seeded(settings.seed)
        start = draw_start(rng, sheet, settings)
        gear = drive_gear(settings.start_gear)
        self.sheet = sheet
        self.clock_start_us = start.clock_us
        self.clock = SensorClock(start.clock_us)
        self.node = NodeState()
        self.shafts = Shafts(sheet, start.angles, gear.split, gear.range_)
        self.plant = ThesisPlant(sheet, self.shafts, settings.main_speed_rpm * RPM)
        delays = Delays(rng, sheet)
        self.engagement = ThesisEngagement(sheet, self.plant, delays, gear.main)
        self.script = BenchScript(sheet, self.plant, self.engagement, delays, gear)
        self.plant.lock(gear.main, start.flank * sheet.dog.backlash_rad / 2.0)
        self.script.ramp_s = settings.return_ramp_s
        self.valves = ValveBank()
        self.clutch = ClutchActuator(sheet.clutch)
        self.edges = EdgeCapture(sheet.wheels, self._wheel_angles())
        self.encoder = Encoder()
        mesh = self.shafts.input_mesh
        self.engine = Engine(self.plant.layshaft_rad_s * mesh.ratio)
        self._brake_inputs: deque[tuple[float, bool]] = deque()
        self._read_us = 0
        self._stop_us: float | None = None
        self._event: tuple[float, tuple[Sleeve, int] | None] | None = None
        """What happens next, until something is commanded or happens."""

    def run_to(self, until_us: int) -> bool:
        """Go on to this instant, or to the next 10 ms read if that comes first: then True."""
        while True:
            if self._event is None:
                self._event = self._next_event()
            event_us, crossed = self._event
            if event_us > until_us:
                return False
            self._event = None
            self._move(event_us)
            if crossed is not None:
                self.engagement.crossed(*crossed)
            elif self.plant.time_us == self._stop_us:
                self.plant.stop()
            self._do_due(event_us)
            if event_us == self._read_us:
                self._read_us += READ_US
                return True

    def command_valves(self, orders: tuple[Order, ...], now_us: int) -> None:
        """A valid valve command, consumed now."""
        self._event = None
        clock_us = now_us + self.clock_start_us
        self._switched(self.valves.command(orders, clock_us, now_us), now_us)

    def renew_valves(self, now_us: int) -> bool:
        """The same valve command once more; False where it has to be taken in full."""
        if self._event is not None and self._event[0] < self._read_us:
            self._event = None  # it may have been the expiry
        return self.valves.renew(now_us)

    def all_valves_off(self, now_us: int) -> None:
        """Shutdown: no valve is driven from now on."""
        self._event = None
        self._switched(self.valves.all_off(), now_us)

    def return_to_gear(self, gear_number: int, main_rad_s: float, now_us: int) -> None:
        """The bench asks for the script."""
        self._event = None
        self._move(float(now_us))
        self.script.start(gear_number, main_rad_s)

    def command_clutch(self, close: bool, now_us: int) -> None:
        """A valid clutch command, consumed now."""
        self.clutch.command(close, now_us)

    def command_engine(self, request: EngineRequest, now_us: int) -> None:
        """The thesis has no engine: nothing follows."""

    def inject(self, order: FaultOrder, now_us: int) -> None:
        """The thesis's gearbox has no faults: each one asked for is reported once in the log."""
        text = f"fault {order.kind} ignored: preset thesis has none, preset truck has"
        self.engagement.lines.append((float(now_us), text))

    def edge_reads(self, now_us: int) -> list[EdgeRead]:
        """The read of all edge channels now, in the order of the wire contract."""
        return self.edges.read(now_us, self.clock)

    def sensors(self, now_us: int) -> SensorRead:
        """The slow sensors now."""
        air, clutch = self.sheet.air, self.clutch.position(now_us)
        input_rad_s = self.plant.layshaft_rad_s * self.shafts.input_mesh.ratio
        return SensorRead(
            air.atmosphere_pa + self.plant.brake_gauge_pa,
            air.atmosphere_pa + air.supply_gauge_pa,
            OIL_K,
            clutch,
            self.engine.speed_rad_s(now_us, clutch, input_rad_s),
        )

    def encoder_read(self, now_us: int) -> EncoderRead:
        """The reference encoder now."""
        return EncoderRead(*self.encoder.read(now_us))

    def phase_read(self) -> PhaseRead:
        """Main shaft and phases now."""
        shafts = self.shafts
        phases_rad = tuple([shafts.phase_rad(gear) for gear in MAIN_GEARS])
        return PhaseRead(shafts.main, self.plant.main_rad_s, phases_rad)

    def take_engaged(self) -> list[Engaged]:
        """What has happened between sleeves and gears since the last call."""
        engaged, self.engagement.engaged = self.engagement.engaged, []
        return engaged

    def take_lines(self) -> list[tuple[float, str]]:
        """Lines for the log since the last call, with their times."""
        lines, self.engagement.lines = self.engagement.lines, []
        return lines

    @property
    def truth(self) -> Truth:
        """The state, for tests."""
        return ThesisTruth(self)

    @property
    def as_built(self) -> dict[str, Any] | None:
        """This gearbox is as its sheet says."""
        return None

    def change_conditions(self, values: Mapping[str, float]) -> None:
        """The thesis's gearbox knows no conditions of work."""
        raise SettingsError(f"conditions: found {sorted(values)}, allowed with preset truck alone")

    @property
    def next_read_us(self) -> int:
        """When the sensors are read next."""
        return self._read_us

    def sleeve_samples_m(self, name: Sleeve, now_us: int) -> tuple[float, ...]:
        """Ten positions, 1 ms apart, the newest first."""
        sleeve = self.script.step_sleeve(name) or self.engagement.sleeves[name]
        if not sleeve.moves_after(now_us - READ_US):
            return (sleeve.position_m(now_us),) * 10
        return tuple(sleeve.position_m(now_us - 1000.0 * back) for back in range(10))

    def _next_event(self) -> tuple[float, tuple[Sleeve, int] | None]:
        activation_us, expiry_us = self.valves.activation_us, self.valves.expiry_us
        horizon_us = min(
            float(self._read_us),
            NEVER_US if activation_us is None else float(activation_us - self.clock_start_us),
            NEVER_US if expiry_us is None else float(expiry_us),
            self._brake_inputs[0][0] if self._brake_inputs else NEVER_US,
            self.engagement.next_us,
            self.script.next_us,
        )
        self._stop_us = self.plant.stop_us(horizon_us)
        if self._stop_us is not None:
            horizon_us = self._stop_us
        found = self.engagement.crossing(horizon_us)
        if found is None:
            return horizon_us, None
        crossing, name = found
        return crossing.time_us, (name, crossing.side)

    def _do_due(self, time_us: float) -> None:
        activation_us, expiry_us = self.valves.activation_us, self.valves.expiry_us
        if activation_us is not None and activation_us - self.clock_start_us <= time_us:
            self._switched(self.valves.activate(activation_us), activation_us - self.clock_start_us)
        if expiry_us is not None and expiry_us <= time_us:
            self._switched(self.valves.expire(expiry_us), expiry_us)
        while self._brake_inputs and self._brake_inputs[0][0] <= time_us:
            _, on = self._brake_inputs.popleft()
            self.plant.set_brake(on)
            self.engagement.brake_air(on)
        self.engagement.due(time_us)
        self.script.due(time_us)
        self.script.watch()

    def _switched(self, changes: list[Change], time_us: int) -> None:
        for valve, on in changes:
            if valve is Valve.BRAKE:
                delay_us = self.sheet.brake.valve_delay_s * SECOND_US
                self._brake_inputs.append((time_us + delay_us, on))
                self.engagement.switch(valve, on, time_us)
            elif valve in GEAR_OF_VALVE:
                self.engagement.switch(valve, on, time_us)
            elif on:
                text = f"valve {valve.name} ignored: splitter and range move with the bench script"
                self.engagement.lines.append((time_us, text))

    def _move(self, time_us: float) -> None:
        segment = self.plant.move_to(time_us)
        self.edges.add(segment)
        self.encoder.add(segment)

    def _wheel_angles(self) -> tuple[tuple[int, float], ...]:
        shafts = self.shafts
        return (shafts.input, shafts.layshaft, shafts.main, shafts.propeller)
