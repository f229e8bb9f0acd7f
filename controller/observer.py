"""From messages to state: teeth, shafts, sleeves, phase references. Decides nothing."""

from __future__ import annotations

from controller.brake_input import BrakeInput
from controller.clock import SensorClock
from controller.edges import EdgeBatch, EdgeFrame, WheelEdges
from controller.gearbox_view import GearboxView
from controller.inputs import StepInputs
from controller.kinematics import are_finite, slip_rad_s
from controller.layshaft import LayshaftTracker
from controller.predictor import LayshaftState, layshaft_model
from controller.reference import PhaseReferences
from controller.settings import ControllerSettings
from controller.shafts import CruiseTracker, ShaftState
from dbc.messages import (
    EdgesLayshaftFall,
    EdgesLayshaftRise,
    EdgesMainFall,
    EdgesMainRise,
    Estimator,
    ValveStatus,
)
from gearbox import GearboxSheet, MainGear, Split

LOCKED_SLIP_RAD_S = 0.1
"""A gear whose slip is below this (1 rpm) turns with its sleeve: its tooth lies on the flank."""
CLUTCH_OPEN_SHARE = 0.05


class Observer:
    """Everything the controller knows of the gearbox.

    One layshaft tracker for each of `estimators`, all on the same edges; the controller has one,
    a comparison has several."""

    def __init__(
        self,
        sheet: GearboxSheet,
        settings: ControllerSettings,
        brake: BrakeInput,
        estimators: tuple[Estimator, ...],
    ) -> None:
        wheels = sheet.wheels
        self._sheet = sheet
        self.clock = SensorClock()
        self.view = GearboxView(sheet)
        self.references = PhaseReferences(sheet)
        self._split = Split.HIGH
        self._layshaft_wheel = WheelEdges(wheels.layshaft.teeth, wheels.layshaft.duty_share)
        self._main_wheel = WheelEdges(wheels.main.teeth, wheels.main.duty_share)
        model = layshaft_model(sheet, self._split)
        self.trackers = [
            LayshaftTracker(estimator, settings, brake, model, wheels.layshaft.pitch_rad)
            for estimator in estimators
        ]
        self.layshaft = self.trackers[0]
        self._main = CruiseTracker(settings.cruise_filter, wheels.main.pitch_rad)
        self.valves: ValveStatus | None = None
        self._lost = (0, 0, 0)

    def take(self, inputs: StepInputs, now_us: int, events: list[str]) -> None:
        """One step's messages, at `now_us` of the controller's clock."""
        layshaft = self._read(
            self._layshaft_wheel, inputs, EdgesLayshaftRise, EdgesLayshaftFall, now_us
        )
        main = self._read(self._main_wheel, inputs, EdgesMainRise, EdgesMainFall, now_us)
        for sleeves in inputs.sleeves_main:
            self.view.sleeves_main(sleeves, self.clock.stamp(sleeves.sample_time_us, now_us))
        for aux in inputs.sleeves_aux:
            self.view.sleeves_aux(aux, self.clock.stamp(aux.sample_time_us, now_us))
        self.view.work_out()
        for sensors in inputs.sensors:
            self.view.clutch_closed = sensors.clutch_position_fraction
            self.view.supply_pa = sensors.supply_pressure_pa
        self.valves = inputs.valve_status or self.valves
        self._lose_what_broke(events)
        self._main.edges(main)
        for tracker in self.trackers:
            tracker.edges(layshaft)
        self._see_whether_free()

    def _read(
        self, wheel: WheelEdges, inputs: StepInputs, rise: type, fall: type, now_us: int
    ) -> EdgeBatch:
        risen: list[EdgeFrame] = inputs.edges[rise]
        return wheel.read(risen, inputs.edges[fall], self.clock, now_us)

    def _lose_what_broke(self, events: list[str]) -> None:
        jumps, layshaft, main = (
            self.clock.jumps,
            self._layshaft_wheel.broken,
            self._main_wheel.broken,
        )
        if (jumps, layshaft, main) == self._lost:
            return
        if jumps != self._lost[0]:
            self._layshaft_wheel.restart()
            self._main_wheel.restart()
            events.append("sensor clock jumped: teeth and phases start anew")
        self._lost = (self.clock.jumps, self._layshaft_wheel.broken, self._main_wheel.broken)
        self.references.lose_all()
        for tracker in self.trackers:
            tracker.restart()
        self._main.restart()
        events.append("tooth numbers lost: phase references unknown again")

    def _see_whether_free(self) -> None:
        view = self.view
        if not view.complete:
            return
        if view.split is not None and view.split is not self._split:
            self._split = view.split
            for tracker in self.trackers:
                tracker.model = layshaft_model(self._sheet, self._split)
        clutch_open = (view.clutch_closed or 0.0) < CLUTCH_OPEN_SHARE
        free = clutch_open and view.main_box_free and view.split is not None
        free = free and view.range_ is not None
        newest = self._layshaft_wheel.newest
        if newest is not None:
            for tracker in self.trackers:
                tracker.set_free(free, newest.time_us)

    def main_at(self, time_us: float) -> ShaftState | None:
        """The main shaft at a sensor time."""
        state = self._main.at(time_us)
        return state if state is not None and are_finite(state) else None

    def layshaft_at(self, time_us: float) -> LayshaftState | None:
        """The layshaft at a sensor time."""
        state = self.layshaft.at(time_us)
        return state if state is not None and are_finite(state) else None

    def learn(self, time_us: float, events: list[str]) -> None:
        """Watches a gear that has just locked until its phase reference is known."""
        if not self.view.complete:
            return
        gear = self.view.main_gear
        if gear is None or gear is MainGear.NEUTRAL:
            self.references.released()
            return
        layshaft, main = self.layshaft_at(time_us), self.main_at(time_us)
        if layshaft is None or main is None:
            return
        ratio = self._sheet.main_mesh(gear).ratio
        slip = slip_rad_s(ratio, layshaft.omega_rad_s, main.omega_rad_s)
        if abs(slip) > LOCKED_SLIP_RAD_S:
            self.references.slips(slip)
            return
        if self.references.watch(gear, layshaft.theta_rad, main.theta_rad):
            events.append(f"phase reference of {gear.name.lower()} learned")
