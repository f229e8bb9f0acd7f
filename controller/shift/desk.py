"""What the phases of a shift share: what they command, the record they fill, how a shift ends."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

from meshpoint.controller.motion.brake_input import BrakeInput
from meshpoint.controller.phase.reference import PhaseReferences
from meshpoint.controller.planning.outlook import Outlook
from meshpoint.controller.planning.phase_drift import PhaseDrifts
from meshpoint.controller.planning.sleeve_delay import SleeveDelays
from meshpoint.controller.planning.strategist import Plan, Strategist
from meshpoint.controller.settings import ControllerSettings
from meshpoint.controller.shift.moment import Moment
from meshpoint.controller.shift.table import ShiftRecord, Trigger
from meshpoint.controller.shift.valve_board import Valve, ValveBoard
from meshpoint.dbc.messages import ClutchAction, FaultCode, ShiftResult
from meshpoint.dbc.messages import ControllerState as State
from meshpoint.gearbox import DriveGear, GearboxSheet, MainGear

MS: Final = 1000
CLUTCH_OPEN_SHARE: Final = 0.02
CLUTCH_CLOSED_SHARE: Final = 0.98
FALL_US: Final = 20 * MS
"""Over this the fall of the slip is measured."""
SLEEVE_VALVE: Final = {
    MainGear.FIRST: Valve.MAIN_FIRST,
    MainGear.SECOND: Valve.MAIN_SECOND,
    MainGear.CRAWL: Valve.MAIN_CRAWL,
    MainGear.THIRD: Valve.MAIN_THIRD,
}
OPPOSITE: Final = {
    MainGear.FIRST: Valve.MAIN_SECOND,
    MainGear.SECOND: Valve.MAIN_FIRST,
    MainGear.CRAWL: Valve.MAIN_THIRD,
    MainGear.THIRD: Valve.MAIN_CRAWL,
}
"""The valve that pulls a gear out pushes toward the sleeve's other gear."""


OutlookSource = Callable[[Outlook], Outlook]
"""Makes another outlook of the one from the estimates; every reference then counts as known."""


class ShiftDesk:
    """The sequence's commands and memory; a phase is a function of it and the moment."""

    def __init__(
        self,
        sheet: GearboxSheet,
        settings: ControllerSettings,
        board: ValveBoard,
        brake: BrakeInput,
        references: PhaseReferences,
        armed: bool = True,
    ) -> None:
        self.armed = armed
        """Whether a shift may be begun: the guard would let nothing of it pass."""
        self.sheet = sheet
        self.settings = settings
        self.board = board
        self.brake = brake
        self.references = references
        self.strategist = Strategist(sheet, settings)
        self.delays = SleeveDelays(sheet)
        self.drifts = PhaseDrifts()
        self.state = State.STARTING
        self.since_us = 0
        self.clutch = ClutchAction.OPEN
        self.engine_rad_s: float | None = None
        """The speed the engine is asked for; None: nothing is asked."""
        self.shift: ShiftRecord | None = None
        self.finished: ShiftRecord | None = None
        """Set at the step that ends a shift, for its outcome frame."""
        self.decision: Plan | None = None
        """This step's decision, for the prediction frame."""
        self.fault = FaultCode.NONE
        self.outlook_source: OutlookSource | None = None
        self.free_outlook: Outlook | None = None
        """The last one before the sleeve entered its gear."""
        self.free_us = 0
        self.fired_outlook: Outlook | None = None
        """The one that the firing was decided by."""

    @property
    def running(self) -> ShiftRecord:
        """The shift under way."""
        if self.shift is None:
            raise RuntimeError(f"state {self.state.name} without a shift")
        return self.shift

    @property
    def target(self) -> DriveGear | None:
        """The gear being shifted to."""
        return self.shift.target if self.shift else None

    def enter(self, state: State, moment: Moment) -> None:
        """The next state begins."""
        self.state = state
        self.since_us = moment.now_us

    def late(self, moment: Moment, limit_ms: int) -> bool:
        """Whether the state has lasted longer."""
        return moment.now_us - self.since_us > limit_ms * MS

    def switch_brake(self, on: bool, time_us: int, moment: Moment) -> None:
        """The brake valve at a time, and what the filter is told of it."""
        self.board.schedule(Valve.BRAKE, on, time_us, moment.now_us)
        self.brake.schedule(time_us, on, moment.now_us)

    def all_off(self, now_us: int) -> None:
        """No valve is driven any more, and the filter is told."""
        self.board.all_off()
        self.brake.schedule(now_us, False, now_us)

    def end(self, moment: Moment, result: ShiftResult, fault: FaultCode) -> None:
        """The shift is over."""
        shift = self.running
        shift.result, shift.fault, shift.end_us = result, fault, moment.now_us
        self.fault = fault
        self.finished, self.shift = shift, None
        self.engine_rad_s = None
        self.all_off(moment.now_us)

    def give_up(self, moment: Moment, fault: FaultCode) -> Trigger:
        """The shift ends where the box stands, with the fault declared."""
        gear = moment.view.main_gear
        if fault is FaultCode.POSITION_STALE or gear is None:
            self.end(moment, ShiftResult.ENDED_BETWEEN_GEARS, fault)
            return Trigger.GEAR_UNKNOWN
        neutral = gear is MainGear.NEUTRAL
        result = ShiftResult.ENDED_IN_NEUTRAL if neutral else ShiftResult.ENDED_IN_OLD_GEAR
        self.end(moment, result, fault)
        return Trigger.GAVE_UP

    def outlook(self, gear: MainGear, moment: Moment) -> Outlook | None:
        """Predictions for a gear; None while a speed is missing or the model does not hold."""
        if moment.main is None or not moment.layshaft.free:
            return None
        if math.isfinite(moment.supply_pa):
            self.delays.supply_pa = moment.supply_pa - self.sheet.air.atmosphere_pa
        layshaft = moment.layshaft.latest()
        if not layshaft.is_finite:
            return None
        outlook = Outlook(
            gear,
            self.sheet.main_mesh(gear).ratio,
            layshaft,
            moment.main,
            self.brake,
            moment.layshaft.model,
            self.references,
            self.delays.delay_us(gear),
            self.delays.delay_sd_s(gear),
            self.drifts.rad_s(gear),
            self.drifts.spread_share(gear),
        )
        return outlook if self.outlook_source is None else self.outlook_source(outlook)

    def reference_known(self, gear: MainGear) -> bool:
        """Whether a gear's phase can be told."""
        return self.outlook_source is not None or self.references.known(gear)

    def change_settings(self, settings: ControllerSettings) -> None:
        """Other settings from the next decision on."""
        self.settings = settings
        self.strategist = Strategist(self.sheet, settings)

    def ask_engine(self, gear: DriveGear, slip_rad_s: float, moment: Moment) -> None:
        """Asks for the speed at which the gear has this slip; for none that an engine cannot do."""
        main = moment.speeds.main
        if main is None:
            self.engine_rad_s = None
            return
        layshaft = (main + slip_rad_s) / self.sheet.main_mesh(gear.main).ratio
        wanted = layshaft / self.sheet.split_mesh(gear.split).ratio
        limits = self.settings.engine
        usable = limits.least_rad_s <= wanted <= self.sheet.limits.input_max_rad_s
        self.engine_rad_s = wanted if usable else None
