"""What a log holds of a gearbox, taken apart: runs in neutral, contacts of sleeves, closings of the
clutch. Nothing is estimated here, and nothing but sensor frames and valve commands is used.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np

from meshpoint.controller.measure.clock import SensorClockEstimate
from meshpoint.controller.measure.gearbox_view import GearboxView
from meshpoint.controller.measure.inputs import StepInputs
from meshpoint.controller.measure.wheel_edges import EdgeBatch, WheelEdges
from meshpoint.controller.settings.valve_name import DOG_VALVE
from meshpoint.controller.sleeve.sleeves import Sleeves
from meshpoint.controller.sleeve.tracked import Contact
from meshpoint.dbc.edges import EDGES
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.link import Receiver
from meshpoint.dbc.messages import (
    EEC1,
    GearboxSensors,
    ValveCommand,
)
from meshpoint.dbc.node import Node
from meshpoint.gearbox import GearboxSheet, Range, Sleeve, Split
from meshpoint.gearbox.gears import SIDE_OF, DogGear
from meshpoint.identify.thinning import Thinned
from meshpoint.identify.valve_switches import (
    BRAKE,
    VALVE_OF_GEAR,
    Switch,
    ValveSwitches,
)
from meshpoint.kernels.records import Vector
from meshpoint.units import SECOND_US

LAYSHAFT, MAIN = EDGES["layshaft"], EDGES["main"]
STEP_US: Final = 10_000
MOST_FREE_S: Final = 1.5
"""Of a longer run in neutral no more is kept: nothing is learned of a gearbox that coasts."""
PAST_US: Final = 2_000_000
"""Switches and pressures so long before a run in neutral are of no effect on it."""
CLEAR_SHARE: Final = 0.6
"""A sleeve within this share of its way to the teeth touches none, whatever its sensor's offset."""
KEPT_ENGINE: Final = 200
"""Samples of the engine's speed: 2 s."""
OPEN, HIGH = 0.02, 0.98
"""A clutch beyond these shares of its travel is at its end."""
LEAST_CLOSING: Final = 6
"""Samples of a closing clutch."""
MOVED_M: Final = 0.5e-3
"""A sleeve that goes this far within a frame or two moves: some times the sensors' noise."""


@dataclass
class Wheel:
    """Edges of a wheel in one run, in order of time."""

    time_us: Vector
    theta_rad: Vector
    place: Vector
    """Which of the wheel's edges: twice the tooth, one more for a falling one; modulo the
    wheel's."""


@dataclass(frozen=True)
class FreeRun:
    """The layshaft in neutral with its clutch open, up to the next contact. Sensor clock, us."""

    start_us: int
    end_us: int
    split: Split
    range_: Range | None
    layshaft: Wheel
    main: Wheel
    brake: tuple[Switch, ...]
    """Switches of the brake's valve, those of some time before included."""
    pressure: Vector
    """Samples (2, n): time and absolute pressure at the brake (Pa)."""
    supply_pa: float
    """Absolute, mean over the run."""
    engine: Vector
    """Samples (2, n): time and engine speed (rad/s)."""


class Closing(NamedTuple):
    """The clutch closing: position 0 open to 1 closed, and engine speeds at their own times."""

    time_us: Vector
    closed: Vector
    engine_us: Vector
    engine_rad_s: Vector


@dataclass
class LogContent:
    """All that was found. What is kept is limited, whatever the log's length."""

    runs: Thinned[FreeRun] = field(default_factory=Thinned)
    contacts: Thinned[tuple[DogGear, Contact]] = field(default_factory=Thinned)
    """Sleeves that came to a gear's teeth."""
    closings: Thinned[Closing] = field(default_factory=Thinned)
    messages: Counter[str] = field(default_factory=Counter)
    inexact: int = 0
    """Firings of such a sleeve at no commanded time."""
    late: int = 0
    """Commands whose activation had passed by the log's clock when they came."""
    empty_pa: list[float] = field(default_factory=list)
    """Pressures at the brake long after its valve went off."""
    sleeves: Sleeves | None = None
    """What a controller would have learned of the sleeves with dog teeth."""
    moved: set[Sleeve] = field(default_factory=set)
    """Those of them that have moved."""


class _Trajectory:
    """Edges of one wheel while the gearbox is in neutral."""

    def __init__(self, edges: WheelEdges, teeth: int) -> None:
        self._edges, self._count = edges, 2 * teeth
        self._kept: list[EdgeBatch] = []
        self._broken = 0

    def begin(self) -> None:
        self._kept.clear()
        self._broken = self._edges.broken

    def add(self, batch: EdgeBatch) -> None:
        if batch.time_us.size:
            self._kept.append(batch)

    def wheel(self, start_us: int, end_us: int) -> Wheel | None:
        """Of the run; None where teeth were lost in it or none came."""
        if not self._kept or self._edges.broken != self._broken:
            return None
        time_us = np.concatenate([batch.time_us for batch in self._kept])
        theta = np.concatenate([batch.theta_rad for batch in self._kept])
        place = np.concatenate([2 * batch.tooth + batch.falling for batch in self._kept])
        inside = (time_us > start_us) & (time_us <= end_us)
        return Wheel(time_us[inside], theta[inside], place[inside] % self._count)


class LogReader:
    """Takes a log's frames in their order; `finish` gives what it holds."""

    def __init__(self, sheet: GearboxSheet) -> None:
        self._sheet = sheet
        self.content = LogContent()
        self._sensors, self._commands = Receiver(Node.TRANSMISSION_CONTROL), Receiver(Node.BENCH)
        self._clock = SensorClockEstimate()
        self._view = GearboxView(sheet)
        wheels = sheet.wheels
        self._layshaft, self._main = WheelEdges.of(wheels.layshaft), WheelEdges.of(wheels.main)
        self._trajectories = (
            _Trajectory(self._layshaft, wheels.layshaft.teeth),
            _Trajectory(self._main, wheels.main.teeth),
        )
        self._valves = ValveSwitches(sheet.dog_gears)
        self._inputs = StepInputs()
        self._pressure: list[tuple[int, float]] = []
        self._supply: list[float] = []
        self._free_us: int | None = None
        self._split: Split | None = None
        self._last_us = 0
        self.content.sleeves = self._sleeves = Sleeves(sheet)
        self._told_us: dict[DogGear, int] = {}
        """The newest switch of each gear's valve that the sleeves know of."""
        self._closing = _ClosingTrack(self.content)
        self._next_us: int | None = None

    def take(self, now_us: int, frame: Frame) -> None:
        """A frame, and the log's time in us that never goes back."""
        if self._next_us is None:
            self._next_us = now_us + STEP_US
        while now_us >= self._next_us:
            self._step(self._next_us)
            self._next_us = max(self._next_us + STEP_US, now_us - STEP_US)
        message = self._sensors.receive(frame).message
        if message is not None:
            self.content.messages[type(message).__name__] += 1
            self._inputs.take(message)
            # As it comes: a step stamps what came before it anew, and later.
            if isinstance(message, GearboxSensors):
                self._clock.stamp(message.sample_time_us, now_us)
            elif isinstance(message, (*LAYSHAFT, *MAIN)):
                self._clock.stamp(message.read_time_us, now_us)
            if isinstance(message, EEC1) and message.engine_speed_rad_s is not None:
                self._closing.engine(self._clock.now_us(now_us), message.engine_speed_rad_s)
            return
        message = self._commands.receive(frame).message
        if isinstance(message, ValveCommand):
            self.content.messages["ValveCommand"] += 1
            self._valves.take(message, self._clock.now_us(now_us))

    def finish(self) -> LogContent:
        """The log has ended."""
        if self._next_us is not None:
            self._step(self._next_us)
        self.content.late = self._valves.late
        return self.content

    def _step(self, now_us: int) -> None:
        inputs, clock, view = self._inputs, self._clock, self._view
        self._inputs = StepInputs()
        edges = inputs.edges
        layshaft = self._layshaft.read(edges[LAYSHAFT.rise], edges[LAYSHAFT.fall], clock, now_us)
        main = self._main.read(edges[MAIN.rise], edges[MAIN.fall], clock, now_us)
        for sleeves in inputs.sleeves_main:
            time_us = clock.stamp(sleeves.sample_time_us, now_us)
            view.sleeves_main(sleeves, time_us)
        for aux in inputs.sleeves_aux:
            view.sleeves_aux(aux, clock.stamp(aux.sample_time_us, now_us))
        view.work_out()
        for sensors in inputs.sensors:
            self._take_sensors(sensors, clock.stamp(sensors.sample_time_us, now_us))
        sensor_now = clock.now_us(now_us)
        if inputs.sleeves_main:
            self._move_sleeves(sensor_now)
        self._follow(layshaft, main)

    def _move_sleeves(self, now_us: int) -> None:
        """Gives the sleeves what their valves have done, and where they are."""
        for gear in self._sheet.dog_gears:
            told_us = self._told_us.get(gear, 0)
            switches = self._valves.of(VALVE_OF_GEAR[gear], now_us)
            new = [switch for switch in switches if switch.time_us > told_us]
            if new:
                self.content.inexact += sum(one.on and not one.exact for one in new)
                self._sleeves.expected(DOG_VALVE[gear], [(one.time_us, one.on) for one in new])
                self._told_us[gear] = new[-1].time_us
        if self._supply:
            self._sleeves.supply_pa = self._supply[-1] - self._sheet.air.atmosphere_pa
        before = dict(self._sleeves.contacts)
        self._sleeves.take(self._view, now_us)
        for met, contact in self._sleeves.contacts.items():
            if contact is not before.get(met):
                self.content.contacts.add((met, contact))
        for sleeve in {SIDE_OF[gear].sleeve for gear in self._sheet.dog_gears}:
            samples_m = self._view.tracks[sleeve].samples_m
            if max(samples_m) - min(samples_m) > MOVED_M:
                self.content.moved.add(sleeve)

    def _take_sensors(self, message: GearboxSensors, time_us: int) -> None:
        self._view.clutch.take(time_us, message.clutch_position_fraction)
        self._closing.clutch(time_us, message.clutch_position_fraction)
        self._pressure.append((time_us, message.brake_pressure_pa))
        self._supply.append(message.supply_pressure_pa)
        switches = self._valves.of(BRAKE, time_us)
        if switches and not switches[-1].on:
            rest_us = 10.0 * self._sheet.brake.time_constant_s * SECOND_US
            if time_us - switches[-1].time_us > rest_us and len(self.content.empty_pa) < 1000:
                self.content.empty_pa.append(message.brake_pressure_pa)
        if self._free_us is None and len(self._pressure) > PAST_US // STEP_US:
            del self._pressure[:-50], self._supply[:-50]
            self._valves.forget(time_us - PAST_US)

    def _is_free(self) -> bool:
        view = self._view
        if not (view.complete and view.clutch_parted):
            return False
        if view.split is None or view.split is not self._split:
            return False
        clear_m = CLEAR_SHARE * self._sheet.sleeve.to_contact_m
        return all(
            abs(view.tracks[sleeve].position_m) < clear_m
            for sleeve in (Sleeve.FIRST_SECOND, Sleeve.CRAWL_THIRD)
        )

    def _follow(self, layshaft: EdgeBatch, main: EdgeBatch) -> None:
        view = self._view
        free, sample_us = self._is_free(), view.oldest_us
        if self._split is not view.split:
            self._split = view.split
        if not free:
            self._end()
            return
        if self._free_us is None:
            self._free_us = sample_us
            for trajectory in self._trajectories:
                trajectory.begin()
            return
        self._last_us = sample_us
        if sample_us - self._free_us > MOST_FREE_S * SECOND_US:
            return
        for trajectory, batch in zip(self._trajectories, (layshaft, main), strict=True):
            trajectory.add(batch)

    def _end(self) -> None:
        start_us, self._free_us = self._free_us, None
        if start_us is None or self._split is None:
            return
        end_us = min(self._last_us, start_us + int(MOST_FREE_S * SECOND_US))
        layshaft, main = (trajectory.wheel(start_us, end_us) for trajectory in self._trajectories)
        if layshaft is None or main is None:
            return
        past_us = start_us - PAST_US
        switches = self._valves.of(BRAKE, end_us)
        samples = [pair for pair in self._pressure if start_us - 3 * STEP_US <= pair[0] <= end_us]
        count = max(1, len(samples))
        self.content.runs.add(
            FreeRun(
                start_us,
                end_us,
                self._split,
                self._view.range_,
                layshaft,
                main,
                tuple(switch for switch in switches if past_us <= switch.time_us <= end_us),
                np.array(samples, dtype=np.float64).reshape(-1, 2).T,
                float(np.mean(self._supply[-count:])) if self._supply else 0.0,
                self._closing.engine_since(start_us - 3 * STEP_US),
            )
        )


class _ClosingTrack:
    """Follows the clutch from open to closed, and the engine beside it."""

    def __init__(self, content: LogContent) -> None:
        self._content = content
        self._clutch: list[tuple[int, float]] = []
        self._engine: list[tuple[int, float]] = []

    def engine(self, time_us: int, rad_s: float) -> None:
        """A speed that came at this time."""
        self._engine.append((time_us, rad_s))
        del self._engine[:-KEPT_ENGINE]

    def engine_since(self, start_us: int) -> Vector:
        """Times and speeds (2, n) from then on."""
        kept = [pair for pair in self._engine if pair[0] >= start_us]
        return np.array(kept, dtype=np.float64).reshape(-1, 2).T

    def clutch(self, time_us: int, closed: float) -> None:
        """A sample of the clutch."""
        clutch = self._clutch
        falls = bool(clutch) and closed < clutch[-1][1]
        if closed < HIGH and not falls:
            if closed <= OPEN:
                clutch.clear()
            clutch.append((time_us, closed))
            return
        if len(clutch) < LEAST_CLOSING or clutch[0][1] > OPEN:
            clutch.clear()
            return
        times, shares = np.array(clutch).T
        clutch.clear()
        inside = [pair for pair in self._engine if pair[0] >= times[0] - 10 * STEP_US]
        if len(inside) > 5:
            engine = np.array(inside).T
            self._content.closings.add(Closing(times, shares, engine[0], engine[1]))
