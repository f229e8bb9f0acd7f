"""From the firing on: contact, in mesh, or back to neutral and another attempt."""

from __future__ import annotations

from typing import Final

from meshpoint.controller.planning.gear_predictor import GearPredictor
from meshpoint.controller.planning.strategies.base import BUS_US
from meshpoint.controller.sensing.gearbox_view import ENGAGED_SHORT_M, ENTERED_M
from meshpoint.controller.settings import MS_IN_US
from meshpoint.controller.shift.brake_measurement import brake_holds
from meshpoint.controller.shift.context import DRIVEN_LATE_US, FALL_US, ShiftContext
from meshpoint.controller.shift.disengage import pull_out
from meshpoint.controller.shift.step_snapshot import StepSnapshot
from meshpoint.controller.shift.synchronise import shift_aims
from meshpoint.controller.shift.table import Trigger
from meshpoint.controller.valve_name import OPPOSITE, SLEEVE_VALVE
from meshpoint.dbc.messages import ClutchAction, FaultCode, ShiftDecision, ShiftResult
from meshpoint.gearbox import MainGear
from meshpoint.gearbox.gears import SLEEVE_OF_MAIN
from meshpoint.units import SECOND_US

LET_GO_US: Final = 120 * MS_IN_US
"""If the sleeve is not back in neutral this long after its valve went off, it is pulled back."""

STRAIGHT_SHARE: Final = 1.3
"""A sleeve that enters a gap at first contact takes no longer than this by the sheet's speed."""

CALLS: Final = 6
"""This often a sleeve may be recalled in one shift: each costs a gap's time."""
AGAIN_US: Final = 20 * MS_IN_US
"""A sleeve that is recalled can be fired anew so much later: the step in which it is seen to
have stayed, and the next."""

SEEN_US: Final = 28 * MS_IN_US
"""Longest delay from a gear being in mesh to the measured position showing it."""


def engage(context: ShiftContext, snapshot: StepSnapshot) -> Trigger | None:
    """Waits until the gear is in mesh, or the sleeve has rested on a tooth for too long."""
    shift = context.running
    gear = shift.target.main
    predictor = context.predictor(gear, snapshot)
    if predictor is not None:
        context.free_predictor, context.free_us = predictor, snapshot.now_us
        if _is_to_go_back(context, predictor, snapshot):
            return recall(context)
    if _is_refused(context, snapshot):
        return recall(context)
    if shift.measured_contact_us is None:
        _measure_contact(context, snapshot)
    if snapshot.view.main_gear is gear:
        side = SLEEVE_OF_MAIN[gear]
        seen_us = snapshot.view.engaged_us(side.sleeve, side.direction)
        straight = _went_straight(context, seen_us)
        struck_us = context.free_us if straight else snapshot.now_us - SEEN_US
        context.references.locked(gear, _flank_slip_rad_s(context, struck_us), straight)
        context.end(snapshot, ShiftResult.ENGAGED, FaultCode.NONE, seen_us)
        return Trigger.ENGAGED
    # The plates meet some hundredths of a second after the clutch sets off: it does so as soon as
    # the overlap holds the sleeve. A gear whose phase is not known yet is left to show its flank.
    holds = _entered_m(context, snapshot) > context.sheet.dog.most_overlap_m
    holds = holds and context.reference_known(gear)
    context.clutch = ClutchAction.CLOSE if holds else ClutchAction.OPEN
    if _is_tooth_on_tooth(context, snapshot) or context.late(
        snapshot, context.settings.limits.engage_ms
    ):
        context.board.off(SLEEVE_VALVE[gear])
        return Trigger.BLOCKED
    return None


def _is_to_go_back(context: ShiftContext, predictor: GearPredictor, snapshot: StepSnapshot) -> bool:
    """Whether a sleeve that is not on its way yet is better fired anew. A valve that is off again
    before its delay is over has moved nothing."""
    shift, plan = context.running, context.running.plan
    if plan is None or shift.calls >= CALLS or not shift_aims(context):
        return False
    moves_us = plan.fire_us + context.sheet.sleeve.valve_delay_s * SECOND_US
    if snapshot.now_us + BUS_US > moves_us:
        return False
    if brake_holds(context.sheet, predictor, snapshot.view.brake_gauge_pa):
        return True
    acting = context.strategist.acting(reference_known=True)
    earliest_us = snapshot.earliest_us + AGAIN_US
    return acting.is_to_go_back(predictor, snapshot.now_us, plan.contact_us, earliest_us)


def _is_refused(context: ShiftContext, snapshot: StepSnapshot) -> bool:
    """Whether the valve side has not taken the firing: it refuses what it hears too late. Nothing
    has moved then, and nothing will."""
    shift, plan = context.running, context.running.plan
    if plan is None or shift.calls >= CALLS or shift.measured_contact_us is not None:
        return False
    driven = snapshot.driven[SLEEVE_VALVE[shift.target.main]]
    return not driven and snapshot.now_us - plan.fire_us > DRIVEN_LATE_US


def recall(context: ShiftContext) -> Trigger:
    """The firing is withdrawn, and does not count as an attempt: nothing has touched."""
    shift = context.running
    shift.attempts -= 1
    shift.calls += 1
    context.board.off(SLEEVE_VALVE[shift.target.main])
    return Trigger.BLOCKED


def _measure_contact(context: ShiftContext, snapshot: StepSnapshot) -> None:
    shift = context.running
    side = SLEEVE_OF_MAIN[shift.target.main]
    crossing = snapshot.view.contact_us(side.sleeve, side.direction)
    if crossing is None:
        return
    shift.measured_contact_us = round(crossing)
    fired, free = context.firing_predictor, context.free_predictor
    if shift.aimed and fired is not None and free is not None:
        context.drifts.learn(fired, free, crossing)
    if free is not None and context.reference_known(shift.target.main):
        shift.estimated_phase_rad = context.strategist.plan_at(
            free, round(crossing), ShiftDecision.NONE
        ).phase_rad


def _is_tooth_on_tooth(context: ShiftContext, snapshot: StepSnapshot) -> bool:
    """Whether the sleeve has not entered its gear within `limits.face_ms` after contact."""
    shift = context.running
    if shift.measured_contact_us is None:
        return False
    rested_us = snapshot.now_us - shift.measured_contact_us
    entered = _entered_m(context, snapshot) > 2.0 * ENTERED_M
    return not entered and rested_us > context.settings.limits.face_ms * MS_IN_US


def _went_straight(context: ShiftContext, seen_us: int | None) -> bool:
    """Whether a sleeve that was measured in mesh at a time has not rested on a tooth before."""
    contact_us, sleeve = context.running.measured_contact_us, context.sheet.sleeve
    if contact_us is None or seen_us is None:
        return False
    way_m = sleeve.stroke_m - ENGAGED_SHORT_M - sleeve.to_contact_m
    return seen_us - contact_us < STRAIGHT_SHARE * way_m / sleeve.speed_m_s * SECOND_US


def _entered_m(context: ShiftContext, snapshot: StepSnapshot) -> float:
    """How far the sleeve is past the faces of its gear's teeth (m)."""
    side = SLEEVE_OF_MAIN[context.running.target.main]
    way_m = snapshot.view.position_m(side.sleeve) * side.direction
    return way_m - context.sheet.sleeve.to_contact_m


def _flank_slip_rad_s(context: ShiftContext, struck_us: int) -> float:
    """The slip (rad/s) that carried the tooth to its flank; 0 if its sign is not certain.

    Slip falls while the layshaft is free. A positive slip too small to cross the whole gap before
    it reverses may have left the tooth on either flank."""
    predictor = context.free_predictor
    if predictor is None:
        return 0.0
    slip = predictor.slip_rad_s(struck_us)
    later = predictor.slip_rad_s(struck_us + FALL_US)
    if slip <= 0.0:
        return later
    fall_rad_s2 = (slip - later) / (FALL_US * 1e-6)
    crosses = slip * slip > 2.0 * context.sheet.dog.backlash_rad * fall_rad_s2
    return slip if crosses else 0.0


def retract(context: ShiftContext, snapshot: StepSnapshot) -> Trigger | None:
    """Brings the sleeve back to neutral, pulling if needed; then the next attempt, if one is
    left."""
    shift, gear = context.running, snapshot.view.main_gear
    context.board.off(SLEEVE_VALVE[shift.target.main])
    context.clutch = ClutchAction.OPEN
    shift.plan = None
    # Not in the step that takes the valve off: the coil has to go off before it is fired again.
    if gear is MainGear.NEUTRAL and snapshot.now_us > context.since_us:
        context.board.off(OPPOSITE[shift.target.main])
        if shift.attempts >= context.settings.limits.attempts:
            return context.give_up(snapshot, FaultCode.ENGAGE_FAILED)
        return Trigger.RETRACTED
    if context.late(snapshot, context.settings.limits.disengage_ms):
        return context.give_up(snapshot, FaultCode.ENGAGE_FAILED)
    if snapshot.now_us - context.since_us > LET_GO_US:
        pull_out(context, snapshot, shift.target.main, drive=True)
    return None
