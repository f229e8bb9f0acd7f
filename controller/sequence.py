"""The shift sequence: a table of states, a handler each (thesis 2.2).

An upshift opens the clutch, takes the old gear out, brakes the layshaft, lets the brake go, fires
the sleeve, sees by position that the gear is in, and closes the valve and the clutch.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from controller.brake_input import BrakeInput
from controller.gearbox_view import GearboxView
from controller.layshaft import LayshaftTracker
from controller.outlook import Outlook
from controller.reference import PhaseReferences
from controller.settings import ControllerSettings
from controller.shafts import ShaftState
from controller.shift import TRANSITIONS, ShiftRecord, Trigger
from controller.strategy import Plan, Strategist
from controller.valves import Valve, ValveBoard
from dbc.messages import ClutchAction, FaultCode, ShiftDecision, ShiftResult, Strategy
from dbc.messages import ControllerState as State
from gearbox import DriveGear, GearboxSheet, MainGear
from gearbox.gears import DRIVE_GEARS, SLEEVE_OF_MAIN, main_box_only

MS = 1000
CLUTCH_OPEN_SHARE = 0.02
CLUTCH_CLOSED_SHARE = 0.98
SLEEVE_VALVE = {
    MainGear.FIRST: Valve.MAIN_FIRST,
    MainGear.SECOND: Valve.MAIN_SECOND,
    MainGear.CRAWL: Valve.MAIN_CRAWL,
    MainGear.THIRD: Valve.MAIN_THIRD,
}
OPPOSITE = {
    MainGear.FIRST: Valve.MAIN_SECOND,
    MainGear.SECOND: Valve.MAIN_FIRST,
    MainGear.CRAWL: Valve.MAIN_THIRD,
    MainGear.THIRD: Valve.MAIN_CRAWL,
}
"""The valve that pulls a gear out pushes toward the sleeve's other gear."""
DRIVEN_LATE_US = 40 * MS
"""A valve not reported driven this long after its activation was refused: try again."""
FALL_US = 20 * MS
"""Over this the fall of the slip is measured."""
KEEP_US = 3 * MS
"""A firing this near to the earliest possible one stands: planned anew, it could by a hair come out
too early to be sent, and the gap would be lost for one that comes a pitch later."""
RELEASE_HORIZON_US = 90 * MS
"""A release further ahead is not sent yet: the valve side takes at most 100 ms."""


@dataclass(frozen=True)
class Moment:
    """What the sequence sees at one step, all in the sensor clock."""

    now_us: int
    earliest_us: int
    """The earliest activation that can still arrive in time."""
    view: GearboxView
    layshaft: LayshaftTracker
    main: ShaftState | None
    usable: bool
    """Positions and speeds come from channels that are VALID."""
    brake_driven: bool
    """The valve side reports the brake valve driven or about to be."""


OutlookSource = Callable[[Outlook], Outlook]
"""Makes another outlook of the one from the estimates; every reference then counts as known."""


class ShiftSequence:
    """Decides; the valve board, the clutch action and the record are what it decides."""

    def __init__(
        self,
        sheet: GearboxSheet,
        settings: ControllerSettings,
        board: ValveBoard,
        brake: BrakeInput,
        references: PhaseReferences,
    ) -> None:
        self._sheet = sheet
        self._settings = settings
        self._board = board
        self._brake = brake
        self._references = references
        self._strategist = Strategist(sheet, settings)
        self.state = State.STARTING
        self.since_us = 0
        self.clutch = ClutchAction.OPEN
        self.shift: ShiftRecord | None = None
        self.finished: ShiftRecord | None = None
        """Set at the step that ends a shift, for its outcome frame."""
        self.decision: Plan | None = None
        """This step's decision, for the prediction frame."""
        self.fault = FaultCode.NONE
        self.outlook_source: OutlookSource | None = None
        self._free_outlook: Outlook | None = None
        """The last one before the sleeve entered its gear."""
        self._free_us = 0
        self._handlers: dict[State, Callable[[Moment], Trigger | None]] = {
            State.STARTING: self._find_gear,
            State.IN_GEAR: self._stay,
            State.NEUTRAL: self._stay,
            State.CLUTCH_OPENING: self._open_clutch,
            State.DISENGAGING: self._disengage,
            State.SYNCHRONISING: self._synchronise,
            State.COASTING: self._coast,
            State.ENGAGING: self._engage,
            State.RETRACTING: self._retract,
            State.CLUTCH_CLOSING: self._close_clutch,
        }

    def change_settings(self, settings: ControllerSettings) -> None:
        """Other settings from the next decision on."""
        self._settings = settings
        self._strategist = Strategist(self._sheet, settings)

    def step(self, moment: Moment) -> None:
        """One decision. Goes on through states that have nothing to wait for."""
        self.finished = self.decision = None
        for _ in range(len(State)):
            trigger = self._handlers[self.state](moment)
            if trigger is None:
                return
            self._enter(TRANSITIONS[self.state, trigger], moment)

    def request(self, number: int, moment: Moment) -> str | None:
        """A gear is asked for. Returns a line for the log where it is refused."""
        if self.state not in (State.IN_GEAR, State.NEUTRAL):
            return None
        current = moment.view.gear_number
        if number == current:
            return None
        reason = self._impossible(moment.view, number)
        record = ShiftRecord(
            current,
            number if number in DRIVE_GEARS else -1,
            DRIVE_GEARS.get(number, DRIVE_GEARS[1]),
            moment.now_us,
            self._settings.strategy,
        )
        if reason is not None:
            record.result, record.fault = ShiftResult.REFUSED, FaultCode.REQUEST_IMPOSSIBLE
            record.end_us = moment.now_us
            self.finished, self.fault = record, record.fault
            return f"request for gear {number} refused: {reason}"
        self.shift, self.fault = record, FaultCode.NONE
        self._enter(TRANSITIONS[self.state, Trigger.REQUESTED], moment)
        return None

    def _impossible(self, view: GearboxView, number: int) -> str | None:
        if number not in DRIVE_GEARS:
            return "gears are 1 to 14"
        current, target = view.gear_number, DRIVE_GEARS[number]
        if current == 0 and target.split is view.split and target.range_ is view.range_:
            return None
        if current < 1:
            return "from where the box stands it moves splitter or range"
        if not main_box_only(current, number):
            return f"from {current} it moves splitter or range, or nothing"
        old, new = DRIVE_GEARS[current].main, DRIVE_GEARS[number].main
        if self._sheet.main_mesh(new).ratio < self._sheet.main_mesh(old).ratio:
            return f"from {current} it is a downshift, which needs the engine"
        return None

    def _enter(self, state: State, moment: Moment) -> None:
        self.state = state
        self.since_us = moment.now_us

    def _late(self, moment: Moment, limit_ms: int) -> bool:
        return moment.now_us - self.since_us > limit_ms * MS

    def _end(self, moment: Moment, result: ShiftResult, fault: FaultCode) -> None:
        shift = self._running
        shift.result, shift.fault, shift.end_us = result, fault, moment.now_us
        self.fault = fault
        self.finished, self.shift = shift, None
        for valve in Valve:
            self._board.off(valve)
        self._brake.schedule(moment.now_us, False, moment.now_us)

    def _give_up(self, moment: Moment, fault: FaultCode) -> Trigger:
        neutral = moment.view.gear_number == 0
        result = ShiftResult.ENDED_IN_NEUTRAL if neutral else ShiftResult.ENDED_IN_OLD_GEAR
        self._end(moment, result, fault)
        return Trigger.GAVE_UP

    @property
    def _running(self) -> ShiftRecord:
        if self.shift is None:
            raise RuntimeError(f"state {self.state.name} without a shift")
        return self.shift

    @property
    def target(self) -> DriveGear | None:
        """The gear being shifted to."""
        return self.shift.target if self.shift else None

    def outlook(self, gear: MainGear, moment: Moment) -> Outlook | None:
        """Predictions for a gear; None while a speed is missing."""
        if moment.main is None or not moment.layshaft.free:
            return None
        outlook = Outlook(
            gear,
            self._sheet.main_mesh(gear).ratio,
            moment.layshaft.latest(),
            moment.main,
            self._brake,
            moment.layshaft.model,
            self._references,
            round(self._sheet.sleeve.delay_s * 1e6),
            self._sheet.sleeve.delay_sd_s,
        )
        return outlook if self.outlook_source is None else self.outlook_source(outlook)

    def _reference_known(self, gear: MainGear) -> bool:
        return self.outlook_source is not None or self._references.known(gear)

    # -- states ------------------------------------------------------------------------------

    def _find_gear(self, moment: Moment) -> Trigger | None:
        if not moment.usable:
            return None
        return self._stay(moment)

    def _stay(self, moment: Moment) -> Trigger | None:
        self.clutch = ClutchAction.CLOSE
        gear = moment.view.main_gear if moment.view.complete else None
        if gear is None:
            return None
        if gear is MainGear.NEUTRAL:
            return Trigger.FOUND_IN_NEUTRAL if self.state is not State.NEUTRAL else None
        return Trigger.FOUND_IN_GEAR if self.state is not State.IN_GEAR else None

    def _open_clutch(self, moment: Moment) -> Trigger | None:
        self.clutch = ClutchAction.OPEN
        if (moment.view.clutch_closed or 0.0) <= CLUTCH_OPEN_SHARE:
            return Trigger.CLUTCH_OPEN
        if self._late(moment, self._settings.limits.clutch_ms):
            return self._give_up(moment, FaultCode.CLUTCH_STUCK)
        return None

    def _disengage(self, moment: Moment) -> Trigger | None:
        gear = moment.view.main_gear
        if gear is MainGear.NEUTRAL:
            for valve in OPPOSITE.values():
                self._board.off(valve)
            return Trigger.MAIN_BOX_NEUTRAL
        if self._late(moment, self._settings.limits.disengage_ms):
            return self._give_up(moment, FaultCode.DISENGAGE_FAILED)
        if gear is not None:
            valve = OPPOSITE[gear]
            if not self._board.command(valve).on:
                self._board.schedule(valve, True, moment.earliest_us, moment.now_us)
                self._references.released()
            elif moment.now_us - self._board.command(valve).time_us > 4 * DRIVEN_LATE_US:
                self._board.schedule(valve, True, moment.earliest_us, moment.now_us)
        return None

    def _synchronise(self, moment: Moment) -> Trigger | None:
        shift, now = self._running, moment.now_us
        if self._late(moment, self._settings.limits.synchronise_ms) or not moment.usable:
            fault = FaultCode.SYNCHRONISE_FAILED if moment.usable else FaultCode.SPEED_STALE
            return self._give_up(moment, fault)
        outlook = self.outlook(shift.target.main, moment)
        if outlook is None:
            return None
        if shift.release_us is not None and now >= shift.release_us:
            return Trigger.BRAKE_RELEASED
        self._keep_braking(moment)
        if shift.release_us is None or shift.release_us > moment.earliest_us:
            self._plan_release(outlook, moment)
        return None

    def _keep_braking(self, moment: Moment) -> None:
        command = self._board.command(Valve.BRAKE)
        refused = command.on and not moment.brake_driven
        if not command.on and not command.before:
            self._switch_brake(True, moment.earliest_us, moment)
        elif refused and moment.now_us - command.time_us > DRIVEN_LATE_US:
            self._brake.schedule(moment.now_us, False, moment.now_us)
            self._switch_brake(True, moment.earliest_us, moment)

    def _plan_release(self, outlook: Outlook, moment: Moment) -> None:
        shift = self._running
        command = self._board.command(Valve.BRAKE)
        on_us = command.time_us if command.on else moment.now_us
        earliest_us = max(moment.earliest_us, on_us)
        aimed = self._aims_at(shift.target.main)
        release_us, contact_us = self._strategist.release(outlook, earliest_us, aimed)
        horizon_us = moment.now_us + RELEASE_HORIZON_US
        if shift.release_us is not None:
            # A release once sent is moved, never taken back: its slot holds the newest time.
            release_us = min(release_us, horizon_us)
        decision = ShiftDecision.BRAKE
        if release_us <= horizon_us and moment.now_us >= on_us:
            shift.release_us = release_us
            self._switch_brake(False, release_us, moment)
            decision = ShiftDecision.RELEASE
        slip = outlook.slip_rad_s(contact_us, release_us)
        self.decision = Plan(decision, 0, contact_us, 0.0, 0.0, slip)

    def _switch_brake(self, on: bool, time_us: int, moment: Moment) -> None:
        self._board.schedule(Valve.BRAKE, on, time_us, moment.now_us)
        self._brake.schedule(time_us, on, moment.now_us)

    def _coast(self, moment: Moment) -> Trigger | None:
        shift = self._running
        if self._late(moment, self._settings.limits.synchronise_ms) or not moment.usable:
            fault = FaultCode.SYNCHRONISE_FAILED if moment.usable else FaultCode.SPEED_STALE
            return self._give_up(moment, fault)
        outlook = self.outlook(shift.target.main, moment)
        if outlook is None:
            return None
        if shift.plan is not None and shift.plan.fire_us < moment.earliest_us + KEEP_US:
            shift.attempts += 1
            shift.measured_contact_us = None
            self._free_outlook = None
            self.decision = shift.plan._replace(decision=ShiftDecision.COMMITTED)
            return Trigger.FIRED
        if outlook.slip_rad_s(moment.now_us) < self._settings.window.least_rad_s:
            return self._give_up(moment, FaultCode.SYNCHRONISE_FAILED)
        self._plan_firing(outlook, moment)
        return None

    def _aims_at(self, gear: MainGear) -> bool:
        return self._settings.strategy is Strategy.TARGET_PHASE and self._reference_known(gear)

    def _plan_firing(self, outlook: Outlook, moment: Moment) -> None:
        shift = self._running
        valve = SLEEVE_VALVE[shift.target.main]
        if shift.attempts == 0:
            shift.reference_known = self._reference_known(shift.target.main)
        aimed = self._aims_at(shift.target.main)
        shift.strategy = Strategy.TARGET_PHASE if aimed else Strategy.SPEED_WINDOW
        plan = None
        if aimed:
            plan = self._strategist.target_phase(outlook, moment.earliest_us)
        low = self._settings.window.contact_low_rad_s
        if not aimed or (plan is None and outlook.slip_rad_s(moment.earliest_us) < low):
            plan = self._strategist.speed_window(outlook, moment.now_us, moment.earliest_us)
        if plan is not None and plan.fire_us > moment.now_us + RELEASE_HORIZON_US:
            plan = None  # not sent yet, like a release: the valve side would refuse it
        if plan is None:
            self._board.off(valve)
            waiting = ShiftDecision.WAIT_FOR_GAP if aimed else ShiftDecision.WAIT_FOR_SLIP
            self.decision = self._strategist.plan_at(outlook, moment.earliest_us, waiting)._replace(
                fire_us=0, contact_us=0
            )
        else:
            self._board.schedule(valve, True, plan.fire_us, moment.now_us)
            self.decision = plan
        shift.plan = plan

    def _engage(self, moment: Moment) -> Trigger | None:
        shift = self._running
        gear = shift.target.main
        side = SLEEVE_OF_MAIN[gear]
        track = moment.view.tracks[side.sleeve]
        outlook = self.outlook(gear, moment)
        if outlook is not None:
            self._free_outlook, self._free_us = outlook, moment.now_us
        if shift.measured_contact_us is None:
            level = self._sheet.sleeve.to_contact_m - 1e-5
            crossing = track.crossing_us(level, side.direction)
            if crossing is not None:
                shift.measured_contact_us = round(crossing)
                if self._free_outlook is not None and self._references.known(gear):
                    shift.estimated_phase_rad = self._strategist.plan_at(
                        self._free_outlook, round(crossing), ShiftDecision.NONE
                    ).phase_rad
        if moment.view.main_gear is gear:
            self._references.locked(gear, self._flank_slip_rad_s())
            self._end(moment, ShiftResult.ENGAGED, FaultCode.NONE)
            return Trigger.ENGAGED
        if self._late(moment, self._settings.limits.engage_ms) or not moment.usable:
            self._board.off(SLEEVE_VALVE[gear])
            return Trigger.BLOCKED
        return None

    def _flank_slip_rad_s(self) -> float:
        """The slip that carried the tooth to its flank; 0 where its sign cannot be told.

        Slip falls while the layshaft is free. A positive one that is too small to cross the whole
        gap before it reverses may have left the tooth on either flank."""
        outlook = self._free_outlook
        if outlook is None:
            return 0.0
        slip = outlook.slip_rad_s(self._free_us)
        later = outlook.slip_rad_s(self._free_us + FALL_US)
        if slip <= 0.0:
            return later
        fall_rad_s2 = (slip - later) / (FALL_US * 1e-6)
        crosses = slip * slip > 2.0 * self._sheet.dog.backlash_rad * fall_rad_s2
        return slip if crosses else 0.0

    def _retract(self, moment: Moment) -> Trigger | None:
        shift = self._running
        self._board.off(SLEEVE_VALVE[shift.target.main])
        shift.plan = None
        if moment.view.main_gear is not MainGear.NEUTRAL:
            if self._late(moment, self._settings.limits.disengage_ms):
                return self._give_up(moment, FaultCode.ENGAGE_FAILED)
            return None
        if shift.attempts >= self._settings.limits.attempts or not moment.usable:
            return self._give_up(moment, FaultCode.ENGAGE_FAILED)
        return Trigger.RETRACTED

    def _close_clutch(self, moment: Moment) -> Trigger | None:
        self.clutch = ClutchAction.CLOSE
        closed = (moment.view.clutch_closed or 0.0) >= CLUTCH_CLOSED_SHARE
        if closed or self._late(moment, self._settings.limits.clutch_ms):
            return self._stay(moment)
        return None
