"""From the firing on: contact, in mesh, or back to neutral and another attempt."""

from __future__ import annotations

from typing import Final

from meshpoint.controller.measure.gearbox_view import ENTERED_M
from meshpoint.controller.settings.settings import MS_IN_US
from meshpoint.controller.settings.valve_name import SLEEVE_VALVE
from meshpoint.controller.shift.context import DRIVEN_LATE_US, ShiftContext
from meshpoint.controller.shift.halt import abort, better_halted
from meshpoint.controller.shift.in_mesh import in_mesh
from meshpoint.controller.shift.step_snapshot import StepSnapshot
from meshpoint.controller.shift.table import Trigger
from meshpoint.controller.shift.to_neutral import bring_to_neutral
from meshpoint.dbc.messages import ClutchAction, FaultCode, ShiftDecision
from meshpoint.gearbox import MainGear
from meshpoint.gearbox.gears import SLEEVE_OF_MAIN

CALLS: Final = 6
"""This often a sleeve may be recalled in one shift: each costs a gap's time."""


def engage(context: ShiftContext, snapshot: StepSnapshot) -> Trigger | None:
    """Waits until the gear is in mesh, or the sleeve has rested on a tooth for too long."""
    shift = context.running
    gear = shift.target.main
    predictor = context.predictor(gear, snapshot)
    if predictor is not None:
        context.free_predictor, context.free_us = predictor, snapshot.now_us
        halt = better_halted(context, predictor, snapshot)
        if halt is not None:
            return abort(context, halt, snapshot)
    if _is_refused(context, snapshot):
        return recall(context)
    if shift.measured_contact_us is None:
        _measure_contact(context)
    if snapshot.view.main_gear is gear:
        return in_mesh(context, snapshot)
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


def _measure_contact(context: ShiftContext) -> None:
    shift = context.running
    fire_us = 0 if shift.plan is None else shift.plan.fire_us
    crossing = context.sleeves.contact_us(shift.target.main, fire_us)
    if crossing is None:
        return
    shift.measured_contact_us = round(crossing)
    free = context.free_predictor
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


def _entered_m(context: ShiftContext, snapshot: StepSnapshot) -> float:
    """How far the sleeve is past the faces of its gear's teeth (m)."""
    side = SLEEVE_OF_MAIN[context.running.target.main]
    way_m = snapshot.view.position_m(side.sleeve) * side.direction
    return way_m - context.sheet.sleeve.to_contact_m


def retract(context: ShiftContext, snapshot: StepSnapshot) -> Trigger | None:
    """Brings the sleeve back to neutral; then the next attempt, if one is left."""
    shift, gear = context.running, snapshot.view.main_gear
    if snapshot.now_us == context.since_us:
        context.board.off(SLEEVE_VALVE[shift.target.main])
        context.tell_sleeves(snapshot.now_us)
    context.clutch = ClutchAction.OPEN
    if gear is shift.target.main and context.main_valves_rest(snapshot.now_us):
        # A sleeve that stood on a tooth may go in while its pressure falls.
        return in_mesh(context, snapshot)
    # Not in the step that takes the valve off: the coil has to go off before it is fired again.
    if gear is MainGear.NEUTRAL and snapshot.now_us > context.since_us:
        if bring_to_neutral(context, snapshot, stands=True):
            return None
        if shift.attempts >= context.settings.limits.attempts:
            return context.give_up(snapshot, FaultCode.ENGAGE_FAILED)
        shift.plan = None
        return Trigger.RETRACTED
    if context.late(snapshot, context.settings.limits.disengage_ms):
        return context.give_up(snapshot, FaultCode.ENGAGE_FAILED)
    bring_to_neutral(context, snapshot, stands=True)
    return None
