"""The shift sequence: a table of states, a handler each (thesis 2.2).

Up: clutch open, old gear out, brake the layshaft, release the brake, fire the sleeve, see by
position that the gear is in, close valve and clutch. Down: the engine first brings the layshaft
above the new gear's speed, through the closed clutch; from there it falls as on the way up.
Splitter and range move while the main box is in neutral.

The handlers of states between shifts are here (starting, in gear, in neutral, clutch closing,
faulted), those of a shift in a file for each part of it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

from meshpoint.controller.measure.gearbox_view import GearboxView
from meshpoint.controller.settings.settings import MS_IN_US
from meshpoint.controller.settings.strategy_file import StrategyError
from meshpoint.controller.shift.context import SEQUENCE_CLUTCH_CLOSED_SHARE, ShiftContext
from meshpoint.controller.shift.disengage import (
    bring_to_neutral,
    disengage,
    has_left_neutral,
    open_clutch,
)
from meshpoint.controller.shift.engage import CALLS, engage, hold, recall, retract, strikes_first
from meshpoint.controller.shift.engine import part_clutch, raise_speed, too_slow
from meshpoint.controller.shift.group_change import change_splitter, change_steps
from meshpoint.controller.shift.legs import engagement, leg_done, next_leg, set_goal
from meshpoint.controller.shift.splitter import has_not_moved, is_between
from meshpoint.controller.shift.step_snapshot import FREE_STATES, MISSING, StepSnapshot
from meshpoint.controller.shift.synchronise import coast, synchronise
from meshpoint.controller.shift.table import (
    NEUTRAL_WANTED,
    STEPS_ARE_IN,
    TRANSITIONS,
    ShiftRecord,
    Trigger,
)
from meshpoint.dbc.messages import ClutchAction, Engagement, FaultCode, ShiftResult, Strategy
from meshpoint.dbc.messages import ControllerState as State
from meshpoint.gearbox import DriveGear, MainGear, Sleeve
from meshpoint.gearbox.gears import DRIVE_GEARS
from meshpoint.units import SECOND_US

FREE_AGAIN_US: Final = 300 * MS_IN_US
"""A sleeve that has not come to neutral is tried again after so long."""

Handler = Callable[[ShiftContext, StepSnapshot], Trigger | None]
RAISE_ROOM: Final = 1.11
"""For a lower gear, and out of neutral, the engine raises the input shaft by so much above the
speed that the gear will have: the slip that is asked for, and what the engine overshoots."""
SLIP_ROW: Final = 3
"""While the guard forbids each contact for its slip, the gear is too slow, or the main shaft swings
too far for it: the engine brings the gear above its sleeve again."""
FAULT_OF_ROW: Final = {
    6: FaultCode.BRAKE_LIMIT,
    9: FaultCode.INPUT_OVERSPEED,
    10: FaultCode.DISENGAGE_REFUSED,
    11: FaultCode.LOW_SUPPLY,
}
"""The fault for a shift that a row of the guard's table has ended; GUARD_BLOCKED for other rows."""


def find_gear(context: ShiftContext, snapshot: StepSnapshot) -> Trigger | None:
    """After power-up: waits until everything a shift needs is there and the guard lets valves be
    driven, then finds the gear: who reads that a gear is in may ask for another. A sleeve that
    stands between neutral and a gear is brought to neutral first."""
    if snapshot.lost in MISSING:
        return None
    if snapshot.view.complete and snapshot.view.main_gear is None:
        _free_sleeves(context, snapshot)
        return None
    found = watch_gear(context, snapshot)
    return found if snapshot.is_self_tested else None


def watch_gear(context: ShiftContext, snapshot: StepSnapshot) -> Trigger | None:
    """In gear or in neutral with the clutch closed; follows the gear that the positions show."""
    context.clutch = ClutchAction.CLOSE
    _catch_engine(context, snapshot)
    gear = snapshot.view.main_gear if snapshot.view.complete else None
    if gear is None:
        return None
    if gear is MainGear.NEUTRAL:
        return Trigger.FOUND_IN_NEUTRAL if context.state is not State.NEUTRAL else None
    return Trigger.FOUND_IN_GEAR if context.state is not State.IN_GEAR else None


def _catch_engine(context: ShiftContext, snapshot: StepSnapshot) -> None:
    """Where the guard lets no clutch close because the engine turns too differently, it is asked
    for the gear's speed until the clutch has closed: a controller that starts, or comes back, while
    the truck rolls and the engine idles."""
    gear = DRIVE_GEARS.get(snapshot.view.gear_number) if snapshot.view.complete else None
    is_closed = (snapshot.view.clutch_closed or 0.0) >= SEQUENCE_CLUTCH_CLOSED_SHARE
    context.catches_engine |= context.closing_blocked
    if not context.catches_engine:
        return
    if gear is None or is_closed:
        context.catches_engine, context.engine_rad_s = False, None
    else:
        context.ask_engine(gear, 0.0, snapshot)


def close_clutch(context: ShiftContext, snapshot: StepSnapshot) -> Trigger | None:
    """After a shift: the engine is asked for the gear's speed and the clutch closes.

    The clutch stays open while a sleeve is between neutral and a gear."""
    limit_ms = context.settings.limits.clutch_ms
    if is_between(context, snapshot):
        bring_to_neutral(context, snapshot, stands=True, sleeves=(Sleeve.SPLITTER,))
    if snapshot.view.main_gear is None or is_between(context, snapshot):
        context.clutch = ClutchAction.OPEN
        return Trigger.GEAR_UNKNOWN if context.late(snapshot, limit_ms) else None
    closes = strikes_first(context, snapshot.now_us)
    context.clutch = ClutchAction.CLOSE if closes else ClutchAction.OPEN
    gear = DRIVE_GEARS.get(snapshot.view.gear_number)
    if gear is not None:
        context.ask_engine(gear, 0.0, snapshot)
    late = context.late(snapshot, limit_ms)
    if late and context.fault is FaultCode.NONE:
        context.fault = FaultCode.CLUTCH_STUCK
    if late or (snapshot.view.clutch_closed or 0.0) >= SEQUENCE_CLUTCH_CLOSED_SHARE:
        context.engine_rad_s = None
        return watch_gear(context, snapshot)
    return None


def wait_for_position(context: ShiftContext, snapshot: StepSnapshot) -> Trigger | None:
    """Faulted: it is unknown which gear is in mesh. The clutch stays open until the position
    sensors show a gear or neutral again; a sleeve that they show in between is brought to
    neutral."""
    context.clutch = ClutchAction.OPEN
    if snapshot.lost is FaultCode.POSITION_STALE:
        return None
    if snapshot.view.main_gear is None:
        # The shift that has just ended has tried.
        if snapshot.now_us - context.since_us > FREE_AGAIN_US:
            _free_sleeves(context, snapshot)
        return None
    if snapshot.view.main_gear is MainGear.NEUTRAL:
        return Trigger.FOUND_IN_NEUTRAL
    return Trigger.FOUND_IN_GEAR


def _free_sleeves(context: ShiftContext, snapshot: StepSnapshot) -> None:
    """Brings sleeves that stand between neutral and a gear to neutral, the clutch open; one that
    has not come is tried again after a while, so that it does not take all the air."""
    context.clutch = ClutchAction.OPEN
    is_ready = snapshot.is_self_tested and context.armed and snapshot.view.clutch_parted
    # Another time where the sensors' clock has gone back since.
    if is_ready and not 0 <= snapshot.now_us - context.freed_us <= FREE_AGAIN_US:
        context.freed_us = snapshot.now_us
        bring_to_neutral(context, snapshot, stands=True)


HANDLERS: Final[dict[State, Handler]] = {
    State.STARTING: find_gear,
    State.IN_GEAR: watch_gear,
    State.NEUTRAL: watch_gear,
    State.CLUTCH_OPENING: open_clutch,
    State.DISENGAGING: disengage,
    State.SPLITTER_CHANGING: change_splitter,
    State.STEPS_CHANGING: change_steps,
    State.SYNCHRONISING: synchronise,
    State.SPEED_RAISING: raise_speed,
    State.CLUTCH_PARTING: part_clutch,
    State.COASTING: coast,
    State.ENGAGING: engage,
    State.HALTED: hold,
    State.RETRACTING: retract,
    State.CLUTCH_CLOSING: close_clutch,
    State.FAULTED: wait_for_position,
}


class ShiftSequence(ShiftContext):
    """The state machine of a shift. Its decisions are the valve board's commands, the clutch and
    engine requests, and the record of the shift."""

    def step(self, snapshot: StepSnapshot) -> None:
        """One decision. Passes through several states if these need not wait for anything."""
        self.finished = self.decision = self.strategy_error = None
        if snapshot.brake_delays_us is not None:
            self.brake.set_delays(*snapshot.brake_delays_us)
        self.sense_sleeves(snapshot)
        if not self._rests(snapshot):
            # Forgotten once over: a sensor clock that restarts may come by that time again.
            self.ended_us = None
        self.torque.take(
            snapshot.now_us,
            snapshot.engine_torque_share,
            snapshot.engine_torque_step,
            snapshot.engine_rad_s,
        )
        self.rings.measure(self.state, snapshot)
        if self.engine_share is not None and not self.engine_carries(snapshot):
            self.engine_share = None
        if self.shift is not None and snapshot.lost is not FaultCode.NONE:
            self._go(self.give_up(snapshot, snapshot.lost), snapshot)
        elif self.state in FREE_STATES and snapshot.supply_pa < self.settings.limits.supply_low_pa:
            self._go(self.give_up(snapshot, FaultCode.LOW_SUPPLY), snapshot)
        elif self.state in NEUTRAL_WANTED and _shows_a_gear(snapshot.view):
            self._go(self._brought_in(snapshot), snapshot)
        elif self.state in NEUTRAL_WANTED and has_left_neutral(snapshot):
            self._go(self._out_of_neutral(snapshot), snapshot)
        for _ in range(len(State)):
            trigger = self._handle(snapshot)
            if trigger is None:
                return
            self._go(trigger, snapshot)

    def _handle(self, snapshot: StepSnapshot) -> Trigger | None:
        try:
            return HANDLERS[self.state](self, snapshot)
        except StrategyError as error:
            self.strategy_error, self.decision = str(error), None
            return self.give_up(snapshot, FaultCode.SYNCHRONISE_FAILED)

    def _brought_in(self, snapshot: StepSnapshot) -> Trigger:
        """A gear is in mesh that this shift has not fired: the shift ends, well if it is the one
        asked for. Nobody saw how its teeth met: nothing is learned of its phase."""
        asked = DRIVE_GEARS.get(snapshot.view.gear_number) == self.running.target
        if asked and self.state in STEPS_ARE_IN:
            return leg_done(self, snapshot)
        return self.give_up(snapshot, FaultCode.SYNCHRONISE_FAILED)

    def _out_of_neutral(self, snapshot: StepSnapshot) -> Trigger:
        """A sleeve has not come to rest in neutral: it is brought there, brake and clutch
        released."""
        self.all_off(snapshot.now_us)
        self.clutch, self.engine_rad_s = ClutchAction.OPEN, None
        self.running.plan = self.running.release_us = None
        self.running.returns += 1
        return Trigger.LEFT_NEUTRAL

    def _go(self, trigger: Trigger, snapshot: StepSnapshot) -> None:
        if self.on_transition is not None:
            self.on_transition(self.state, trigger)
        self.enter(TRANSITIONS[self.state, trigger], snapshot)

    def blocked(self, row: int, snapshot: StepSnapshot) -> None:
        """The guard has blocked this step's valve command, so all valves are off. The state tries
        again until `limits.blocks` commands of the shift have been blocked, by as many reads of the
        sensors; then the shift ends."""
        self.all_off(snapshot.now_us)
        if self.shift is None:
            return
        self.shift.blocks += self.is_measured(snapshot)
        plan = self.shift.plan
        if self.state is not State.SPLITTER_CHANGING:  # else the main sleeve's plan is carried out
            self.shift.plan = self.shift.release_us = None
        if self.state is State.SYNCHRONISING:
            self.shift.pulses = max(0, self.shift.pulses - 1)
        if self.state is State.DISENGAGING:
            self.shift.pulls = max(0, self.shift.pulls - 1)
        if self.shift.blocks >= self.settings.limits.blocks:
            if row == SLIP_ROW and (self.state, Trigger.TOO_SLOW) in TRANSITIONS:
                self.shift.blocks = 0
                self._go(too_slow(self, snapshot), snapshot)
                return
            fault = FAULT_OF_ROW.get(row, FaultCode.GUARD_BLOCKED)
            if self.state is State.SPLITTER_CHANGING and has_not_moved(self, snapshot):
                fault = FaultCode.SPLITTER_FAILED
            self._go(self.give_up(snapshot, fault), snapshot)
        elif self.state is State.ENGAGING:
            # One that should have touched by now was an attempt: its sleeve may not move at all.
            is_early = plan is not None and snapshot.now_us < plan.contact_us
            taken_back = is_early and self.shift.calls < CALLS
            self._go(recall(self) if taken_back else Trigger.BLOCKED, snapshot)

    def request(self, number: int, snapshot: StepSnapshot) -> str | None:
        """A drive gear is requested. Returns a line for the log if the request is refused."""
        if self.state not in (State.IN_GEAR, State.NEUTRAL) or self._rests(snapshot):
            return None
        current = snapshot.view.gear_number
        if number == current:
            return None
        record = ShiftRecord(
            current,
            number if number in DRIVE_GEARS else -1,
            DRIVE_GEARS.get(number, DRIVE_GEARS[1]),
            snapshot.now_us,
            self.settings.strategy,
        )
        refusal = self._impossible(snapshot, number)
        if refusal is not None:
            record.result, (record.fault, reason) = ShiftResult.REFUSED, refusal
            record.end_us = snapshot.now_us
            self.finished, self.fault = record, record.fault
            return f"request for gear {number} refused: {reason}"
        record.engagement = engagement(self.sheet, snapshot.view, record.target)
        if record.engagement is Engagement.SPLITTER:
            record.strategy = Strategy.SPEED_WINDOW
        self.shift, self.fault = record, FaultCode.NONE
        set_goal(self, record.target, snapshot)
        self.catches_engine, self.engine_rad_s = False, None
        self._go(Trigger.REQUESTED, snapshot)
        return None

    def _rests(self, snapshot: StepSnapshot) -> bool:
        """Whether the last shift ended less than the clutch's way out and back ago. TC1 carries no
        protection: requests that flood the bus are heeded no more often."""
        if self.ended_us is None:
            return False
        rest_s = self.sheet.clutch.open_delay_s + self.sheet.clutch.close_delay_s
        return 0 <= snapshot.now_us - self.ended_us < rest_s * SECOND_US

    def _impossible(self, snapshot: StepSnapshot, number: int) -> tuple[FaultCode, str] | None:
        """Fault and reason if a shift to this gear cannot begin; else None."""
        if number not in DRIVE_GEARS:
            return FaultCode.REQUEST_IMPOSSIBLE, "gears are 1 to 14"
        if not self.armed:
            return FaultCode.GUARD_BLOCKED, "the outputs are not armed (--arm)"
        if not snapshot.is_self_tested:  # the sensors' clock is another: it begins anew
            return FaultCode.GUARD_BLOCKED, "the guard's self-test is not passed again yet"
        if snapshot.lost is not FaultCode.NONE:
            return snapshot.lost, f"{snapshot.lost.name.lower()} before it began"
        if snapshot.view.main_gear is None:
            return FaultCode.REQUEST_IMPOSSIBLE, "a main sleeve stands between two gears"
        if snapshot.supply_pa < self.settings.limits.supply_low_pa:
            return FaultCode.LOW_SUPPLY, f"supply at {snapshot.supply_pa / 1e5:.1f} bar"
        if self._is_adrift(snapshot.view):
            return FaultCode.SPLITTER_FAILED, "the splitter stands in no step, nothing turns it"
        propeller = self._propeller(snapshot)
        top = self.sheet.limits.input_max_rad_s
        if propeller is not None:
            goal = DRIVE_GEARS[number]
            legs = (goal, next_leg(self.sheet, snapshot.view, goal))
            input_rad_s = propeller * max(map(self.sheet.overall_ratio, legs))
            if input_rad_s * (RAISE_ROOM if self._may_be_raised(goal, snapshot) else 1.0) > top:
                rpm = input_rad_s * 30.0 / math.pi
                return FaultCode.INPUT_OVERSPEED, f"the input shaft would turn at {rpm:.0f} rpm"
        return None

    def _is_adrift(self, view: GearboxView) -> bool:
        """Whether neither the main box nor a splitter with dog teeth holds the layshaft."""
        neutral = view.main_gear is MainGear.NEUTRAL
        return self.sheet.has_dog_splitter and neutral and view.split is None

    def _may_be_raised(self, goal: DriveGear, snapshot: StepSnapshot) -> bool:
        """Whether the engine may have to raise the layshaft for this gear: in neutral it slows
        down. Crawl gears have the highest numbers."""
        before = DRIVE_GEARS.get(snapshot.view.gear_number)
        ratio = self.sheet.overall_ratio
        return before is None or ratio(goal) > ratio(before)

    def _propeller(self, snapshot: StepSnapshot) -> float | None:
        """Propeller shaft speed (rad/s); with its sensor silent, that of the main shaft through the
        range that is in."""
        speeds, range_ = snapshot.speeds, snapshot.view.range_
        if speeds.propeller is not None or speeds.main is None or range_ is None:
            return speeds.propeller
        return speeds.main * self.sheet.range_mesh(range_).ratio


def _shows_a_gear(view: GearboxView) -> bool:
    return view.main_gear is not None and view.main_gear is not MainGear.NEUTRAL
