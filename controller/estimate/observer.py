"""From messages to state: teeth, shafts, sleeves, phase references. Decides nothing."""

from __future__ import annotations

from meshpoint.controller.estimate.baselines import BaselineTracker, CruiseTracker
from meshpoint.controller.estimate.brake_model import BrakeModel
from meshpoint.controller.estimate.layshaft_tracker import CrossingTracker, LayshaftModels
from meshpoint.controller.estimate.loaded_driveline import Load, LoadedDriveline
from meshpoint.controller.estimate.main_tracker import DrivelineSpec, MainTracker
from meshpoint.controller.estimate.reference import MeshChange, PhaseReferences
from meshpoint.controller.estimate.reference_recovery import LockedGear, ReferenceRecovery
from meshpoint.controller.measure.clock import JUMP_US, SensorClockEstimate
from meshpoint.controller.measure.gearbox_view import (
    NO_SAMPLES,
    GearboxView,
    PressureSampler,
    PressureSamples,
    PressureZero,
)
from meshpoint.controller.measure.inputs import StepInputs
from meshpoint.controller.measure.wheel_edges import BRAKED_RAD_S2, NO_EDGES, EdgeBatch, WheelEdges
from meshpoint.controller.models.layshaft import (
    BrakeInput,
    LayshaftState,
    first_order_law,
    free_motion,
)
from meshpoint.controller.models.swing import ShaftState
from meshpoint.controller.models.thesis import layshaft_model
from meshpoint.controller.settings.learned import BrakeRecord, NoiseRecord, SwingRecords
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.edges import EDGES, EdgeMessages
from meshpoint.dbc.j1939 import torque_share
from meshpoint.dbc.messages import Estimator, GearboxSensors, ValveStatus
from meshpoint.dbc.sensor_time import unwrap
from meshpoint.gearbox import GearboxSheet, MainGear, Range, Split
from meshpoint.gearbox.gears import DRIVE_GEARS
from meshpoint.gearbox.kinematics import are_finite

DRAGGED_US = 30_000
"""For this long after a change of splitter or range, edges from during the change still arrive."""

LayshaftTracker = BaselineTracker | CrossingTracker
"""Angle, speed and brake pressure of the layshaft at any time near now."""


class Observer:
    """Estimates and measurements of the gearbox, updated at each step."""

    def __init__(
        self, sheet: GearboxSheet, settings: ControllerSettings, estimator: Estimator
    ) -> None:
        wheels, tuning = sheet.wheels, settings.crossing_filter.of(sheet)
        self._sheet = sheet
        self._tuning = tuning
        brake = self.brake_input = BrakeInput(round(sheet.brake.valve_delay_s * 1e6))
        """The brake valve's switches, as commanded, with their delays as learned."""
        self.clock = SensorClockEstimate()
        self._sensors_stamp: int | None = None
        self.view = GearboxView(sheet)
        self.references = PhaseReferences(sheet)
        self._sampler = PressureSampler()
        self._zero = PressureZero(sheet.brake.time_constant_s)
        self._split = Split.HIGH
        self._layshaft_wheel = WheelEdges.of(wheels.layshaft)
        self._main_wheel = WheelEdges.of(wheels.main, BRAKED_RAD_S2)
        self.brake = BrakeModel(sheet, tuning.gain_sd, tuning.drag_sd_nm)
        self.loaded = LoadedDriveline(sheet)
        self._torque_nm: float | None = None
        """The engine's, as it said last."""
        self.layshaft: LayshaftTracker
        self._main: CruiseTracker | MainTracker
        self._learners: tuple[CrossingTracker, MainTracker] | None = None
        """The trackers of both shafts, where they learn: the baselines know the data sheet and
        nothing more."""
        self.recovery: ReferenceRecovery | None = None
        """What outlives lost tooth numbers; the baselines know no teeth by which to find them."""
        if estimator is Estimator.CROSSING:
            layshaft = self.layshaft = CrossingTracker(
                tuning, brake, self.brake, wheels.layshaft.teeth, wheels.layshaft.missing,
                sheet.shafts.friction_nms,
            )  # fmt: skip
            main = self._main = MainTracker(
                tuning,
                wheels.main.teeth,
                wheels.main.missing,
                (sheet.range_.low.ratio, sheet.range_.high.ratio),
                DrivelineSpec(sheet.axle, sheet.dog.backlash_rad / 2.0),
            )
            self._learners = layshaft, main
            self.recovery = ReferenceRecovery(sheet, self.references, layshaft.teeth, main.teeth)
        else:
            self.layshaft = BaselineTracker(estimator, settings, brake, wheels.layshaft.pitch_rad)
            self._main = CruiseTracker(settings.cruise_filter, wheels.main.pitch_rad)
        self._model_layshaft()
        self.valves: ValveStatus | None = None
        self._lost = (0, 0, 0)
        self._reported_late = 0
        self._split_us = self._range_us = -DRAGGED_US
        """When splitter and range were last between their steps."""
        self._dragged = self._main_dragged = False
        self._main_free = self._is_shifting = False
        self._locked = LockedGear(sheet, self.references, self.recovery)

    def take_brake(self, record: BrakeRecord) -> None:
        """Sets the brake's model as learned in earlier runs."""
        self.brake.restore(record)
        self._model_layshaft()

    def noise(self) -> NoiseRecord | None:
        """What a calibration file keeps of scatter and disturbance; None before they were
        learned."""
        if self._learners is None or self._learners[0].noise_shifts == 0:
            return None
        layshaft, main = self._learners
        edge, torque, memory = layshaft.noise
        known = edge, main.edge_time, torque, memory, layshaft.friction
        return NoiseRecord.of(*known, shifts=layshaft.noise_shifts)

    def take_noise(self, record: NoiseRecord) -> None:
        """Sets scatter and disturbance as learned in earlier runs."""
        if self._learners is None:
            return
        layshaft, main = self._learners
        edge, own, torque, memory, friction = record.figures
        layshaft.take_noise(record.shifts, (edge, torque, memory), friction)
        main.take_edge_time(*own)
        self._model_layshaft()

    def swings(self) -> SwingRecords:
        """What a calibration file keeps of the driveline's swing."""
        if self._learners is None:
            return SwingRecords()
        _, main = self._learners
        return SwingRecords(main.record(Range.LOW), main.record(Range.HIGH))

    def take_swings(self, records: SwingRecords) -> None:
        """Sets the driveline's swing as learned in earlier runs."""
        if self._learners is None:
            return
        _, main = self._learners
        for step, record in ((Range.LOW, records.low), (Range.HIGH, records.high)):
            if record is not None:
                main.restore(step, record)

    def _model_layshaft(self) -> None:
        sheet, split = self._sheet, self._split
        thesis = layshaft_model(sheet, split)
        law = first_order_law(1.0 / sheet.brake.time_constant_s, sheet.air.supply_gauge_pa)
        disturbance = friction_nms = None
        if self._learners is not None:
            layshaft, _ = self._learners
            law = self.brake.law()
            self.brake_input.set_delays(self.brake.off_delay_us, self.brake.on_delay_us)
            disturbance, friction_nms = layshaft.disturbance, layshaft.friction.value
        motion = free_motion(sheet, split, law, self._tuning, disturbance, friction_nms)
        self.layshaft.set_models(LayshaftModels(motion, thesis, sheet.inertia_kgm2(split)))

    def take(self, inputs: StepInputs, now_us: int, events: list[str]) -> None:
        """One step's messages, at `now_us` of the controller's clock."""
        self._learn_on()
        self._see_synchronisers(now_us)
        layshaft = self._read(self._layshaft_wheel, EDGES["layshaft"], inputs, now_us)
        main = self._read(self._main_wheel, EDGES["main"], inputs, now_us)
        for sleeves in inputs.sleeves_main:
            self.view.sleeves_main(sleeves, self.clock.stamp(sleeves.sample_time_us, now_us))
        for aux in inputs.sleeves_aux:
            self.view.sleeves_aux(aux, self.clock.stamp(aux.sample_time_us, now_us))
        self.view.work_out()
        pressures = self._sensors(inputs.sensors, now_us)
        self.valves = inputs.valve_status or self.valves
        jumped = self._lose_what_broke(events)
        if jumped:
            layshaft, main, pressures = NO_EDGES, NO_EDGES, NO_SAMPLES
            self.loaded.lose()
        if not self.layshaft.free and self._is_free:
            layshaft, main = self._take_in_gear(layshaft, main)
        self._see_whether_free(events)
        self._main.edges(main)
        if self._main_dragged:
            # The filter cannot follow a synchroniser, which changes the speed by 400 rpm in 20 ms.
            self._main.lose_speed()
        self.layshaft.edges(layshaft, pressures)
        self._see_load(inputs)
        if self.recovery is not None:
            self.recovery.measure(events, self._layshaft_wheel.sensor.renumbered)

    def _learn_on(self) -> bool:
        """A part of what shifts have shown that takes longer than a tick to be learned; whether
        there was one."""
        if self._learners is None:
            return False
        layshaft, main = self._learners
        learning, learned = layshaft.is_learning or main.is_learning, layshaft.learned
        layshaft.learn()
        main.learn()
        if layshaft.learned != learned:
            self._model_layshaft()
        return learning

    def finish_learning(self) -> None:
        """Learns at once what is left to be learned: no step comes any more."""
        while self._learn_on():
            pass

    @property
    def learned(self) -> int:
        """Changes as soon as a shift has been learned from."""
        if self._learners is None:
            return 0
        layshaft, main = self._learners
        return layshaft.learned + main.learned

    def _see_load(self, inputs: StepInputs) -> None:
        """Follows what loads the gear in mesh."""
        if inputs.engine:
            said = inputs.engine[-1]
            share, _ = torque_share(
                said.actual_engine_torque_fraction, said.actual_engine_torque_fine_fraction
            )
            known = None if share is None else share * self._sheet.engine.reference_nm
            self._torque_nm = known
        if self._learners is None:
            return
        view, (tracker, shaft) = self.view, self._learners
        has_input = view.split is not None or not self._sheet.has_dog_splitter
        number = view.gear_number if has_input else view.number_with(self._split)
        gear = DRIVE_GEARS.get(number)
        if gear is None or tracker.free:
            return
        shafts, torque_nm = shaft.shafts(gear.range_), self._torque_nm
        if shafts is None or torque_nm is None or view.clutch_closed is None:
            return
        load = Load(torque_nm, view.clutch_carries and has_input, tracker.own_drag_nm, has_input)
        self.loaded.take(gear, tracker.placed, shaft.placed, load, shafts)

    def _see_synchronisers(self, now_us: int) -> None:
        """Notes changes of splitter and range: their synchronisers accelerate the shafts
        strongly."""
        if self.view.split is None:
            self._split_us = now_us
        if self.view.range_ is None:
            self._range_us = now_us
        layshaft = now_us - self._split_us < DRAGGED_US
        main = now_us - self._range_us < DRAGGED_US
        self._layshaft_wheel.set_dragged(layshaft)
        self._main_wheel.set_dragged(main)
        self._main_dragged, self._dragged = main, layshaft or main

    def _sensors(self, sensors: list[GearboxSensors], now_us: int) -> PressureSamples:
        """Clutch, air supply, and the brake's pressure as measured, gauge."""
        atmosphere_pa = self._sheet.air.atmosphere_pa
        pressures: list[tuple[int, float]] = []
        for sample in sensors:
            sampled_us = self._sampled_us(sample.sample_time_us, now_us)
            self.view.clutch.take(sampled_us, sample.clutch_position_fraction)
            gauge_pa = sample.brake_pressure_pa - atmosphere_pa
            self.view.brake_gauge_pa = gauge_pa
            gauge_pa = self._zero.take(sampled_us, gauge_pa, self._brake_driven)
            pressures.append((sampled_us, gauge_pa))
            self.view.supply_pa = sample.supply_pressure_pa
            self.brake.supply_pa = sample.supply_pressure_pa - atmosphere_pa
        return self._sampler.take(pressures)

    def _sampled_us(self, stamp: int, now_us: int) -> int:
        """When pressures and clutch were sampled: by them a clock that was set back is found."""
        before, self._sensors_stamp = self._sensors_stamp, stamp
        if before is not None and unwrap(stamp, before) < before:
            return self.clock.set_back(stamp, now_us)
        return self.clock.stamp(stamp, now_us)

    @property
    def _brake_driven(self) -> bool:
        """Whether the brake's valve is on, or will be: what is not known counts as on."""
        valves = self.valves
        return valves is None or bool(valves.brake_energised or valves.brake_pending)

    def _read(
        self, wheel: WheelEdges, of: EdgeMessages, inputs: StepInputs, now_us: int
    ) -> EdgeBatch:
        return wheel.read(inputs.edges[of.rise], inputs.edges[of.fall], self.clock, now_us)

    def _lose_what_broke(self, events: list[str]) -> bool:
        """Whether the sensor clock has jumped: what came in this step is of two clocks then."""
        if self.clock.late != self._reported_late:
            self._reported_late = self.clock.late
            events.append(
                f"sensor frames come over {JUMP_US // 1000} ms late: bus or machine overloaded"
            )
        before = self._lost
        if self._losses == before:
            return False
        jumped = self.clock.jumps != before[0]
        if jumped:
            self._layshaft_wheel.restart()
            self._main_wheel.restart()
            events.append("sensor clock jumped: teeth and phases start anew")
        self._lost = self._losses
        lost = (self._lost[1] != before[1], self._lost[2] != before[2])
        if self.recovery is not None:
            self.recovery.lost(*lost)
        self.references.lose_all()
        for tracker, numbers_lost in zip((self.layshaft, self._main), lost, strict=True):
            if numbers_lost:
                tracker.restart()
            else:
                tracker.lose_speed()
        events.append("tooth numbers lost: phase references unknown again")
        return jumped

    @property
    def _losses(self) -> tuple[int, int, int]:
        """How often the clock has jumped, and either wheel has lost its numbers."""
        return self.clock.jumps, self._layshaft_wheel.broken, self._main_wheel.broken

    @property
    def _is_free(self) -> bool:
        """Whether clutch and main box leave both shafts to themselves."""
        view = self.view
        if not view.complete:
            return False
        steps_in = view.split is not None and view.range_ is not None and not self._dragged
        return view.clutch_parted and view.main_box_free and steps_in

    def _take_in_gear(self, layshaft: EdgeBatch, main: EdgeBatch) -> tuple[EdgeBatch, EdgeBatch]:
        """A gear has come out during this read: the edges from before are of shafts that it still
        drove. The trackers take those now; returns the rest."""
        since_us = self.view.free_since_us
        driven, layshaft = layshaft.split(since_us)
        self.layshaft.edges(driven, NO_SAMPLES)
        driven, main = main.split(since_us)
        self._main.edges(driven)
        return layshaft, main

    def _see_whether_free(self, events: list[str]) -> None:
        view = self.view
        if not view.complete:
            return
        if view.split is not None and view.split is not self._split:
            self._split = view.split
            self._model_layshaft()
        newest = self._layshaft_wheel.newest
        if newest is None:
            return
        free = self._is_free
        self.layshaft.set_free(free, newest.time_us, events, self._is_shifting)
        if self._learners is not None:
            _, main = self._learners
            self._main_free = free or self._main_stays_free
            main.set_free(self._main_free, view.range_, events, view.oldest_us, self.loaded)

    @property
    def _main_stays_free(self) -> bool:
        """Whether the main shaft, left to itself in this shift, still is: by main box and range.
        What clutch and splitter do with the layshaft, as it is raised, does not concern it."""
        view = self.view
        is_apart = view.main_box_free and view.range_ is not None and not self._main_dragged
        return self._main_free and self._is_shifting and is_apart

    def main_at(self, time_us: float) -> ShaftState | None:
        """The main shaft at a sensor time."""
        state = self._main.at(time_us)
        return state if state is not None and are_finite(state[:6]) else None

    def layshaft_at(self, time_us: float) -> LayshaftState | None:
        """The layshaft at a sensor time."""
        state = self.layshaft.at(time_us)
        return state if state is not None and state.is_finite else None

    @property
    def brake_delays_us(self) -> tuple[int, int]:
        """From the brake valve's switch off, and on, to the pressure's first reaction, as
        learned."""
        return self.brake_input.off_delay_us, self.brake_input.on_delay_us

    def take_commands(
        self, brake: BrakeInput, changes: list[MeshChange], is_shifting: bool
    ) -> None:
        """What a step has commanded of the brake's valve, which gear comes into mesh or leaves it,
        and whether a shift is under way."""
        self._is_shifting = is_shifting
        self.brake_input.follow(brake)
        for change in changes:
            self.references.take(change)

    def learn(self, events: list[str]) -> None:
        """Watches a gear that has just locked until its phase reference is known."""
        view = self.view
        if not view.complete:
            return
        gear = view.main_gear
        if gear is None or gear is MainGear.NEUTRAL:
            self._locked.released(events)
            return
        if not self.references.watches(gear):
            return
        newest = [w.newest.time_us for w in (self._layshaft_wheel, self._main_wheel) if w.newest]
        if len(newest) < 2 or not self._locked.is_due(max(newest)):
            return
        layshaft, main = self.layshaft_at(max(newest)), self.main_at(max(newest))
        if layshaft is not None and main is not None:
            self._locked.measure(gear, layshaft, main, events)
