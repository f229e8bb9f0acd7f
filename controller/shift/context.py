"""What the states of the sequence share: the valves' commands, the record of the shift, how a shift
ends."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Final

from meshpoint.controller.estimate.reference import MeshChange, PhaseReferences
from meshpoint.controller.estimate.wheel_tracker import ESTIMATE_STALE_US
from meshpoint.controller.models.layshaft import BrakeInput
from meshpoint.controller.plan.gear_predictor import GearPredictor
from meshpoint.controller.plan.strategist import Plan, Strategist
from meshpoint.controller.settings.settings import MS_IN_US, ControllerSettings
from meshpoint.controller.settings.valve_name import DOG_VALVE, ValveName
from meshpoint.controller.shift.step_snapshot import RingingDetector, StepSnapshot, TorqueDecay
from meshpoint.controller.shift.table import ShiftRecord, Trigger
from meshpoint.controller.shift.valve_board import ValveBoard
from meshpoint.controller.sleeve.sleeves import Sleeves
from meshpoint.controller.sleeve.stroke import Stroke
from meshpoint.dbc.messages import ClutchAction, FaultCode, ShiftResult
from meshpoint.dbc.messages import ControllerState as State
from meshpoint.gearbox import DriveGear, GearboxSheet, MainGear, Sleeve
from meshpoint.gearbox.gears import MAIN_SLEEVES, SIDE_OF, DogGear, SplitGear
from meshpoint.units import US

SEQUENCE_CLUTCH_CLOSED_SHARE: Final = 0.98
FALL_US: Final = 20 * MS_IN_US
"""The rate at which the slip falls is taken from two predictions this far apart."""
DRIVEN_LATE_US: Final = 40 * MS_IN_US
"""A valve not reported driven this long after its activation time has been refused by the valve
side: the activation is sent again."""
BRAKE_GAUGES_US: Final = 75 * MS_IN_US
"""Of so long the brake's pressures are kept."""
SHUTS_US: Final = 25 * MS_IN_US
"""A sample is there this long after a valve's current of when the slowest valve has shut."""
SENSED_SHARE: Final = 0.005
"""Error of the clutch's measured position."""
PredictorSource = Callable[[GearPredictor], GearPredictor]
"""Replaces the predictor made from the estimates by another one; every phase reference then counts
as known."""


class ShiftContext:
    """What the sequence commands and remembers. Each state has a handler, a function of this
    context and the step's snapshot."""

    def __init__(
        self,
        sheet: GearboxSheet,
        settings: ControllerSettings,
        board: ValveBoard,
        references: PhaseReferences,
        armed: bool = True,
    ) -> None:
        self.armed = armed
        """Whether the outputs are armed. If not, no shift is begun: the guard would block all of
        it."""
        self.sheet = sheet
        self.settings = settings
        self.board = board
        self.brake = BrakeInput(0)
        """The brake valve's switches, as commanded; each step brings its delays as estimated."""
        self.references = references
        """Read here, never written."""
        self.mesh_changes: list[MeshChange] = []
        """Gears that have locked or leave the mesh; for `take_mesh_changes`."""
        self.strategist = Strategist(sheet, settings)
        self.sleeves = Sleeves(sheet)
        self.state = State.STARTING
        self.since_us = 0
        self.brake_gauges: deque[tuple[int, float]] = deque()
        """The brake's pressure (Pa, gauge) in each step of late, with the step's time."""
        self.freed_us = 0
        """When a sleeve between neutral and a gear was last sent to neutral, between shifts."""
        self._sampled_us = self._measured_us = 0
        """The oldest of the sleeves' newest samples, and the step that has brought it."""
        self.clutch = ClutchAction.OPEN
        self.engine_rad_s: float | None = None
        """The speed the engine is asked for; None: nothing is asked."""
        self.engine_share: float | None = None
        """The torque the engine is asked for, as a share of its reference torque; None: none."""
        self.closing_blocked = False
        """The guard has kept the clutch from closing in the step before."""
        self.catches_engine = False
        """Between shifts, the engine is asked for the gear's speed so that the clutch may close."""
        self.torque = TorqueDecay()
        self.rings = RingingDetector(sheet)
        self.shift: ShiftRecord | None = None
        self.finished: ShiftRecord | None = None
        """Set at the step that ends a shift, for its outcome frame."""
        self.ended_us: int | None = None
        """When the last shift ended."""
        self.decision: Plan | None = None
        """This step's decision, for the prediction frame."""
        self.fault = FaultCode.NONE
        self.strategy_error: str | None = None
        """What was wrong with a user's strategy in this step."""
        self.on_transition: Callable[[State, Trigger], None] | None = None
        """Is called at each change of state, before it; read-only."""
        self.predictor_source: PredictorSource | None = None
        self.free_predictor: GearPredictor | None = None
        """The last predictor before the sleeve entered its gear."""
        self.free_us = 0
        self.flank_us = 0
        """By then the tooth that was met last lies at a flank."""

    @property
    def running(self) -> ShiftRecord:
        """The shift under way."""
        if self.shift is None:
            raise RuntimeError(f"state {self.state.name} without a shift")
        return self.shift

    @property
    def tick_us(self) -> int:
        """From one step to the next."""
        return self.settings.timing.tick_us

    def is_measured(self, snapshot: StepSnapshot) -> bool:
        """Whether this step has a new read of the sensors: of a short tick not each one has."""
        return self._measured_us == snapshot.now_us

    def more_known_in_us(self, snapshot: StepSnapshot) -> int:
        """After how long the next step comes that has a new read of the sensors."""
        since_us = snapshot.now_us - self._measured_us
        return max(self.tick_us, self.settings.timing.measured_us - since_us)

    @property
    def target(self) -> DriveGear | None:
        """The gear being shifted to."""
        return self.shift.target if self.shift else None

    def enter(self, state: State, snapshot: StepSnapshot) -> None:
        """The next state begins."""
        self.state = state
        self.since_us = snapshot.now_us

    def late(self, snapshot: StepSnapshot, limit_ms: int) -> bool:
        """Whether the present state has lasted longer than this limit."""
        return snapshot.now_us - self.since_us > limit_ms * MS_IN_US

    def engine_carries(self, snapshot: StepSnapshot) -> bool:
        """Whether the engine's torque may go through the clutch into a gear."""
        view = snapshot.view
        return view.clutch_carries and view.main_gear is not MainGear.NEUTRAL

    def unloaded_us(self, snapshot: StepSnapshot, valve: ValveName | None) -> int | None:
        """The earliest activation (sensor time, us) of a valve that pulls a gear, or a step of
        splitter or range, out: the sleeve begins to move as the plates are likely to part, and its
        teeth are out no sooner than they surely have. None while it is not known that they will."""
        clutch, sheet = snapshot.view.clutch, self.sheet.clutch
        parted_us = clutch.falls_to_us(sheet.likely_open_share)
        surely_us = clutch.falls_to_us(max(0.0, sheet.surely_open_share - SENSED_SHARE))
        if parted_us is None or surely_us is None:
            return None
        moves_us, out_us = self.sleeves.pull_us(valve)
        return max(snapshot.earliest_us, round(parted_us - moves_us), round(surely_us - out_us))

    def switch_brake(self, on: bool, time_us: int, snapshot: StepSnapshot) -> None:
        """Commands the brake valve at a sensor time (us), and enters the switch in the filter's
        input."""
        self.board.schedule(ValveName.BRAKE, on, time_us, snapshot.now_us)
        self.brake.schedule(time_us, on, snapshot.now_us)

    def brake_off(self, now_us: int) -> None:
        """Switches the brake valve off now, and enters that in the filter's input."""
        self.board.off(ValveName.BRAKE)
        self.brake.schedule(now_us, False, now_us)

    def main_valves_rest(self, now_us: int) -> bool:
        """Whether no valve of the main box is driven or will be."""
        return self.valves_rest(now_us, MAIN_SLEEVES)

    def valves_rest(self, now_us: int, sleeves: tuple[Sleeve, ...]) -> bool:
        """The same of these sleeves."""
        valves = [DOG_VALVE[gear] for gear, side in SIDE_OF.items() if side.sleeve in sleeves]
        return all(self.board.command(valve).rests(now_us) for valve in valves)

    def is_shut(self, now_us: int) -> bool:
        """Whether samples are there of after the last valve shut that pushed a sleeve to neutral,
        or braked it there."""
        pushed_us = self.running.pushed_us
        return pushed_us is None or now_us > pushed_us + SHUTS_US

    def sense_sleeves(self, snapshot: StepSnapshot) -> None:
        """What this step's samples say of the main sleeves."""
        sampled_us = snapshot.view.oldest_us
        if sampled_us != self._sampled_us:
            self._sampled_us, self._measured_us = sampled_us, snapshot.now_us
        if math.isfinite(snapshot.supply_pa):
            self.sleeves.supply_pa = snapshot.supply_pa - self.sheet.air.atmosphere_pa
        self.sleeves.take(snapshot.view, snapshot.now_us)
        if any(self._turns_against(gear, snapshot) for gear in self.sleeves.reached()):
            self.fault = FaultCode.SLIP_AT_CONTACT
            if self.shift is not None:
                self.shift.grinds = True
        self.brake_gauges.append((snapshot.now_us, snapshot.view.brake_gauge_pa))
        # One that lies ahead is of a sensor clock that was set back since.
        while not 0 <= snapshot.now_us - self.brake_gauges[0][0] <= BRAKE_GAUGES_US:
            self.brake_gauges.popleft()

    def _turns_against(self, gear: DogGear, snapshot: StepSnapshot) -> bool:
        """Whether a gear may turn against its sleeve faster than the guard lets any be fired, by
        the measured speeds. Of the splitter it is the sleeve that comes from above."""
        slip_rad_s = snapshot.speeds.slip_rad_s(gear)
        if slip_rad_s is not None and isinstance(gear, SplitGear):
            slip_rad_s = -slip_rad_s
        return slip_rad_s is not None and self.settings.guard.may_be_outside(slip_rad_s)

    def notify_actuators(self, now_us: int) -> None:
        """What this step has commanded of the main sleeves' valves."""
        self.board.publish_to(self.sleeves, now_us)

    def take_mesh_changes(self) -> list[MeshChange]:
        """Which gears have locked or leave the mesh, since the last call."""
        changes, self.mesh_changes = self.mesh_changes, []
        return changes

    def all_off(self, now_us: int) -> None:
        """Switches all valves off now, and enters the brake's release in the filter's input."""
        self.board.all_off()
        self.brake.schedule(now_us, False, now_us)

    def end(
        self,
        snapshot: StepSnapshot,
        result: ShiftResult,
        fault: FaultCode,
        ended_us: int | None = None,
    ) -> None:
        """Ends the running shift with this result; all valves go off. ended_us: when a sensor
        showed it to be over, if not now."""
        shift = self.running
        if fault is FaultCode.NONE and shift.grinds:
            fault = FaultCode.SLIP_AT_CONTACT
        shift.result, shift.fault = result, fault
        shift.end_us = snapshot.now_us if ended_us is None else ended_us
        self.fault = fault
        self.finished, self.shift, self.ended_us = shift, None, snapshot.now_us
        self.engine_rad_s = self.engine_share = None
        self.all_off(snapshot.now_us)

    def give_up(self, snapshot: StepSnapshot, fault: FaultCode) -> Trigger:
        """Ends the shift with a fault, in whatever gear or neutral the gearbox is; returns the
        trigger."""
        gear = snapshot.view.main_gear
        if fault is FaultCode.POSITION_STALE or gear is None:
            self.end(snapshot, ShiftResult.ENDED_BETWEEN_GEARS, fault)
            return Trigger.GEAR_UNKNOWN
        neutral = gear is MainGear.NEUTRAL
        result = ShiftResult.ENDED_IN_NEUTRAL if neutral else ShiftResult.ENDED_IN_OLD_GEAR
        self.end(snapshot, result, fault)
        return Trigger.GAVE_UP

    def predictor(self, gear: MainGear, snapshot: StepSnapshot) -> GearPredictor | None:
        """A predictor for a gear; None while a speed is missing or the layshaft is not free."""
        if snapshot.main is None or not snapshot.layshaft.free:
            return None
        layshaft = snapshot.layshaft.latest()
        ahead_us = layshaft.time_us - snapshot.now_us
        if not layshaft.is_finite or ahead_us > ESTIMATE_STALE_US:
            return None
        predictor = GearPredictor(
            gear,
            self.sheet.main_mesh(gear).ratio,
            layshaft,
            snapshot.main,
            self.brake,
            snapshot.layshaft.model,
            self.references,
            0,
            0.0,
            0,
            0.0,
        )
        if self.state is State.HALTED:  # it may still move
            stroke, fire_us = self.sleeves.stroke(gear, snapshot.earliest_us), snapshot.earliest_us
        else:
            stroke, fire_us = self.sleeves.from_rest(gear), 0
        predictor = self.with_stroke(predictor, stroke, fire_us)
        return predictor if self.predictor_source is None else self.predictor_source(predictor)

    def with_stroke(self, predictor: GearPredictor, stroke: Stroke, fire_us: int) -> GearPredictor:
        """The predictor for a sleeve that makes this stroke when it is fired then."""
        delay_us = stroke.contact_us - fire_us
        stop_us = delay_us - self.sleeves.abort_after_us(predictor.gear)
        return replace(
            predictor,
            delay_us=delay_us,
            delay_sd_s=stroke.sd_us * US,
            stop_us=max(0, stop_us),
            contact_speed_m_s=stroke.contact_speed_m_s,
        )

    def reference_known(self, gear: MainGear) -> bool:
        """Whether the phase of a gear is known."""
        return self.predictor_source is not None or self.references.known(gear)

    def change_settings(self, settings: ControllerSettings) -> None:
        """Other settings from the next decision on."""
        self.settings = settings
        self.strategist = Strategist(self.sheet, settings)

    def ask_engine(self, gear: DriveGear, slip_rad_s: float, snapshot: StepSnapshot) -> None:
        """Asks the engine for the speed at which the gear has this slip (rad/s); asks for nothing
        if that speed is outside the engine's range, or the main shaft's speed is unknown."""
        wanted = self.engine_speed(gear, slip_rad_s, snapshot)
        least, most = self.settings.engine.least_rad_s, self.sheet.limits.input_max_rad_s
        usable = wanted is not None and least <= wanted <= most
        self.engine_rad_s = wanted if usable else None

    def engine_speed(
        self, gear: DriveGear, slip_rad_s: float, snapshot: StepSnapshot
    ) -> float | None:
        """The engine's speed (rad/s) at which the gear has this slip (rad/s), the clutch closed;
        None where the main shaft's speed is unknown."""
        main = snapshot.speeds.main
        if main is None:
            return None
        layshaft = (main + slip_rad_s) / self.sheet.main_mesh(gear.main).ratio
        return layshaft / self.sheet.split_mesh(gear.split).ratio
