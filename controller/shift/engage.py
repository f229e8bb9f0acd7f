"""The sleeve on its way: contact, in mesh, or back and once more."""

from __future__ import annotations

from typing import Final

from meshpoint.controller.sensing.gearbox_view import ENTERED_M
from meshpoint.controller.shift.desk import FALL_US, MS, OPPOSITE, SLEEVE_VALVE, ShiftDesk
from meshpoint.controller.shift.disengage import pull_out
from meshpoint.controller.shift.moment import Moment
from meshpoint.controller.shift.table import Trigger
from meshpoint.dbc.messages import FaultCode, ShiftDecision, ShiftResult, Strategy
from meshpoint.gearbox import MainGear
from meshpoint.gearbox.gears import SLEEVE_OF_MAIN

LET_GO_US: Final = 120 * MS
"""A sleeve that has not come back by itself so long after its valve went off is pulled."""

STRAIGHT_US: Final = 32 * MS
"""A sleeve that goes straight into a gap is seen in mesh so long after contact."""

SEEN_US: Final = 28 * MS
"""A gear is in so long before it is seen to be, at most."""


def engage(desk: ShiftDesk, moment: Moment) -> Trigger | None:
    """Until the gear is in, or rests on a tooth for too long."""
    shift = desk.running
    gear = shift.target.main
    outlook = desk.outlook(gear, moment)
    if outlook is not None:
        desk.free_outlook, desk.free_us = outlook, moment.now_us
    if shift.measured_contact_us is None:
        _look_for_contact(desk, moment)
    if moment.view.main_gear is gear:
        contact_us = shift.measured_contact_us
        straight = contact_us is not None and moment.now_us - contact_us < STRAIGHT_US
        struck_us = desk.free_us if straight else moment.now_us - SEEN_US
        desk.references.locked(gear, _flank_slip_rad_s(desk, struck_us), straight)
        desk.end(moment, ShiftResult.ENGAGED, FaultCode.NONE)
        return Trigger.ENGAGED
    if _rests_on_a_tooth(desk, moment) or desk.late(moment, desk.settings.limits.engage_ms):
        desk.board.off(SLEEVE_VALVE[gear])
        return Trigger.BLOCKED
    return None


def _look_for_contact(desk: ShiftDesk, moment: Moment) -> None:
    shift = desk.running
    side = SLEEVE_OF_MAIN[shift.target.main]
    crossing = moment.view.contact_us(side.sleeve, side.direction)
    if crossing is None:
        return
    shift.measured_contact_us = round(crossing)
    if shift.plan is not None:
        desk.delays.learn(shift.target.main, crossing - shift.plan.fire_us)
    fired, free = desk.fired_outlook, desk.free_outlook
    aimed = shift.strategy is Strategy.TARGET_PHASE
    if aimed and fired is not None and free is not None:
        desk.drifts.learn(fired, free, crossing)
    if free is not None and desk.reference_known(shift.target.main):
        shift.estimated_phase_rad = desk.strategist.plan_at(
            free, round(crossing), ShiftDecision.NONE
        ).phase_rad


def _rests_on_a_tooth(desk: ShiftDesk, moment: Moment) -> bool:
    """Contact was long ago, and the sleeve has not entered."""
    shift = desk.running
    if shift.measured_contact_us is None:
        return False
    side = SLEEVE_OF_MAIN[shift.target.main]
    way_m = moment.view.position_m(side.sleeve) * side.direction
    rested_us = moment.now_us - shift.measured_contact_us
    entered = way_m > desk.sheet.sleeve.to_contact_m + 2.0 * ENTERED_M
    return not entered and rested_us > desk.settings.limits.face_ms * MS


def _flank_slip_rad_s(desk: ShiftDesk, struck_us: int) -> float:
    """The slip that carried the tooth to its flank; 0 where its sign cannot be told.

    Slip falls while the layshaft is free. A positive one that is too small to cross the whole
    gap before it reverses may have left the tooth on either flank."""
    outlook = desk.free_outlook
    if outlook is None:
        return 0.0
    slip = outlook.slip_rad_s(struck_us)
    later = outlook.slip_rad_s(struck_us + FALL_US)
    if slip <= 0.0:
        return later
    fall_rad_s2 = (slip - later) / (FALL_US * 1e-6)
    crosses = slip * slip > 2.0 * desk.sheet.dog.backlash_rad * fall_rad_s2
    return slip if crosses else 0.0


def retract(desk: ShiftDesk, moment: Moment) -> Trigger | None:
    """Back to neutral: by itself, or pulled; then once more, a bounded number of times."""
    shift, gear = desk.running, moment.view.main_gear
    desk.board.off(SLEEVE_VALVE[shift.target.main])
    shift.plan = None
    if gear is MainGear.NEUTRAL:
        desk.board.off(OPPOSITE[shift.target.main])
        if shift.attempts >= desk.settings.limits.attempts:
            return desk.give_up(moment, FaultCode.ENGAGE_FAILED)
        return Trigger.RETRACTED
    if desk.late(moment, desk.settings.limits.disengage_ms):
        return desk.give_up(moment, FaultCode.ENGAGE_FAILED)
    if moment.now_us - desk.since_us > LET_GO_US:
        pull_out(desk, moment, shift.target.main, drive=True)
    return None
