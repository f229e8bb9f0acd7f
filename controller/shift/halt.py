"""A sleeve on its way that would meet a tooth: stopped short of the teeth, fired again from there.

The valve towards the gear goes off and the opposite one on in one instant, for some 10 ms. The
sleeve then stands before the teeth, vented, held by friction. It is fired again from where it
stands if that brings a good gap soon enough, and else goes back to neutral (`engage.retract`).
"""

from __future__ import annotations

from meshpoint.controller.plan.gear_predictor import GearPredictor
from meshpoint.controller.settings.settings import MS_IN_US
from meshpoint.controller.settings.valve_name import OPPOSITE, SLEEVE_VALVE, ValveName
from meshpoint.controller.shift.brake_measurement import brake_holds
from meshpoint.controller.shift.context import ShiftContext
from meshpoint.controller.shift.in_mesh import in_mesh
from meshpoint.controller.shift.refire import STANDS_US, fires_again_us
from meshpoint.controller.shift.step_snapshot import StepSnapshot
from meshpoint.controller.shift.synchronise import fire_if_due, plan_firing, shift_aims
from meshpoint.controller.shift.table import Trigger
from meshpoint.controller.sleeve.answers import Halt
from meshpoint.gearbox.gears import SLEEVE_OF_MAIN


def better_halted(
    context: ShiftContext, predictor: GearPredictor, snapshot: StepSnapshot
) -> Halt | None:
    """How to stop the sleeve, where it can still be stopped and would meet its gear out of the
    guard's slip window, or the contact that it is on its way to is expected to cost more than
    another one."""
    shift, plan = context.running, context.running.plan
    if plan is None or _has_spent_its_time(context, snapshot):
        return None
    gear, at_us = shift.target.main, snapshot.at_once_us
    sleeves, next_us = context.sleeves, at_us + context.more_known_in_us(snapshot)
    # Until the last step in which it can be stopped, waiting costs nothing and more is known.
    if sleeves.stops(gear, plan.fire_us, next_us) or not sleeves.stops(gear, plan.fire_us, at_us):
        return None
    halt = context.sleeves.abort(gear, at_us)
    slip, window = predictor.slip_rad_s(plan.contact_us), context.settings.guard
    is_in_window = window.slip_low_rad_s <= slip <= window.slip_high_rad_s
    if not is_in_window or brake_holds(context.sheet, predictor, snapshot.view.brake_gauge_pa):
        return halt
    if not shift_aims(context):
        return None
    next_us = max(halt.off_us, snapshot.earliest_us + context.tick_us)
    earliest_us = fires_again_us(context, predictor, snapshot, next_us)
    if earliest_us is None:
        return None
    again = context.with_stroke(
        predictor, context.sleeves.stroke_after(gear, halt, earliest_us), earliest_us
    )
    acting = context.strategist.acting(reference_known=True)
    is_better = acting.is_to_go_back(again, snapshot.now_us, plan.contact_us, earliest_us)
    return halt if is_better else None


def abort(context: ShiftContext, halt: Halt, snapshot: StepSnapshot) -> Trigger:
    """Stops the sleeve. The firing does not count as an attempt: nothing has touched."""
    shift = context.running
    gear = shift.target.main
    shift.attempts -= 1
    shift.aborts += 1
    shift.plan = None
    context.board.off(SLEEVE_VALVE[gear])
    if context.board.driven(ValveName.BRAKE, halt.at_us):
        # A sleeve that is not stopped in time must not meet a gear that is being braked.
        context.brake_off(snapshot.now_us)
        shift.release_us = snapshot.now_us
    if halt.off_us > halt.at_us:
        context.board.pulse(OPPOSITE[gear], halt.at_us, halt.off_us, snapshot.now_us)
    return Trigger.ABORTED


def stand(context: ShiftContext, snapshot: StepSnapshot) -> Trigger | None:
    """Before the teeth: waits for a gap within reach, and fires again."""
    shift = context.running
    gear = shift.target.main
    if snapshot.view.main_gear is gear:
        return in_mesh(context, snapshot)  # it was not stopped, and went in
    place = context.sleeves.place(SLEEVE_OF_MAIN[gear].sleeve, snapshot.now_us)
    shift.halt_m = place.m
    braking = context.board.command(OPPOSITE[gear])
    stopped_us = braking.until_us if braking.on else context.since_us
    if snapshot.now_us == context.since_us or (braking.on and snapshot.now_us < braking.time_us):
        # The valve towards the gear has to go off before it is fired again, and as far as the bus
        # knows the braking one stays on.
        return None
    if snapshot.now_us > context.since_us + STANDS_US:
        return Trigger.BLOCKED
    predictor = context.predictor(gear, snapshot)
    if predictor is None or not shift_aims(context):
        return Trigger.BLOCKED
    fired = fire_if_due(context, predictor, snapshot)
    if fired is not None:
        return fired
    if predictor.steady_slip_rad_s(snapshot.now_us) < context.settings.window.least_rad_s:
        return Trigger.BLOCKED
    next_us = max(snapshot.earliest_us, stopped_us)
    earliest_us = fires_again_us(context, predictor, snapshot, next_us)
    if earliest_us is None:
        return Trigger.BLOCKED
    plan_firing(context, predictor, snapshot, earliest_us)
    is_far = shift.plan is not None and shift.plan.fire_us > context.since_us + STANDS_US
    return Trigger.BLOCKED if is_far else None


def _has_spent_its_time(context: ShiftContext, snapshot: StepSnapshot) -> bool:
    """Whether aborts have taken as long as a shift may take to synchronise."""
    first_us = context.running.first_fire_us
    limit_us = context.settings.limits.synchronise_ms * MS_IN_US
    return first_us is not None and snapshot.now_us - first_us > limit_us
