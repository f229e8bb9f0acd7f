"""From the firing on: contact, in mesh, or back to neutral and another attempt.

A sleeve on its way that would meet a tooth is stopped short of the teeth and fired again from
there. The valve towards the gear goes off and the opposite one on in one instant, for some 10 ms.
The sleeve then stands before the teeth, vented, held by friction. It is fired again from where it
stands if that brings a good gap soon enough, and else goes back to neutral.

Such a sleeve may meet its gear as its valve opens, so the guard judges the firing at once as if it
were the last call: the slip has to stay in its window though the layshaft fall on as it has. The
speeds that show how it falls are older than the brake's release may be.

A gear in mesh ends the shift; its way in says what is known of the phase.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from meshpoint.controller.estimate.reference import MeshChange
from meshpoint.controller.measure.gearbox_view import ENGAGED_SHORT_M, ENTERED_M
from meshpoint.controller.plan.gear_predictor import GearPredictor
from meshpoint.controller.settings.settings import MS_IN_US
from meshpoint.controller.settings.valve_name import OPPOSITE, SLEEVE_VALVE, ValveName
from meshpoint.controller.shift.context import DRIVEN_LATE_US, FALL_US, ShiftContext
from meshpoint.controller.shift.disengage import bring_to_neutral
from meshpoint.controller.shift.legs import leg_done
from meshpoint.controller.shift.move_on import move_on
from meshpoint.controller.shift.step_snapshot import StepSnapshot
from meshpoint.controller.shift.synchronise import brake_holds, fire_if_due, plan_firing, shift_aims
from meshpoint.controller.shift.table import Trigger
from meshpoint.controller.sleeve.stroke import Halt
from meshpoint.dbc.messages import ClutchAction, FaultCode, ShiftDecision
from meshpoint.gearbox import MainGear
from meshpoint.gearbox.gears import SLEEVE_OF_MAIN
from meshpoint.units import SECOND_US

STANDS_US: Final = 150 * MS_IN_US
"""A sleeve stands before turning teeth for no longer: a gap further off is as soon reached from
neutral."""
FALL_AGE_US: Final = 25 * MS_IN_US
"""How old the fall is, on the average, that the newest speeds show."""
TOLERANCE_RAD_S: Final = 1.0
"""The slip may leave the guard's window by so much: its speeds have errors."""

STRAIGHT_SHARE: Final = 1.3
"""A sleeve that enters a gap at first contact takes no longer than this by the sheet's speed."""
SEEN_US: Final = 28 * MS_IN_US
"""Longest delay from a gear being in mesh to the measured position showing it."""

FLANK_STEP_US: Final = 2 * MS_IN_US
FLANK_STEPS: Final = 100
"""A tooth in the gap is looked for at its flank in such steps, no further ahead than 0.2 s."""
SURE: Final = 3.0
"""A tooth surely lies at its flank where it would be this many standard deviations beyond it: a
flank that the engine strikes takes 10 to 70 J."""

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
    holds = holds and context.reference_known(gear) and strikes_first(context, snapshot.now_us)
    holds = holds and shift.after is None
    context.clutch = ClutchAction.CLOSE if holds else ClutchAction.OPEN
    if shift.measured_contact_us is not None:
        move_on(context, snapshot, _entered_m(context, snapshot))
    if _is_tooth_on_tooth(context, snapshot) or context.late(
        snapshot, context.settings.limits.engage_ms
    ):
        context.board.off(SLEEVE_VALVE[gear])
        context.brake_off(snapshot.now_us)
        return Trigger.BLOCKED
    return None


def _is_refused(context: ShiftContext, snapshot: StepSnapshot) -> bool:
    """Whether the valve node refused the firing as late; the sleeve has not moved."""
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
        context.flank_us = round(_flank_us(context, free, crossing))


def _flank_us(context: ShiftContext, predictor: GearPredictor, contact_us: float) -> float:
    """When a tooth that met the gap has come to a flank, for all that its phase is not known to:
    one with little slip may turn back just before the first flank, and come to the other one by
    drag alone."""
    dog = context.sheet.dog
    phases = predictor.trajectory(contact_us, FLANK_STEP_US, FLANK_STEPS).phase_rad
    off = phases - dog.pitch_rad * round(float(phases[0]) / dog.pitch_rad)
    known_rad = SURE * predictor.phase_sd_rad(contact_us)
    is_past = np.abs(off) > dog.backlash_rad / 2.0 + known_rad
    return contact_us + FLANK_STEP_US * (is_past.argmax() if is_past.any() else FLANK_STEPS)


def strikes_first(context: ShiftContext, now_us: int) -> bool:
    """Whether the tooth lies at its flank before the plates meet, of a clutch that sets off now.
    Else the engine would strike the flank with all of its inertia."""
    clutch = context.sheet.clutch
    meeting_s = clutch.surely_open_share * clutch.close_delay_s
    return now_us + meeting_s * SECOND_US >= context.flank_us


def _is_tooth_on_tooth(context: ShiftContext, snapshot: StepSnapshot) -> bool:
    """Whether the sleeve has not entered its gear within `limits.face_ms` after contact, or since
    the tooth was last moved on."""
    shift = context.running
    if shift.measured_contact_us is None:
        return False
    rested_us = snapshot.now_us - max(shift.measured_contact_us, shift.moved_us)
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
        context.notify_actuators(snapshot.now_us)
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
    # As many pushes as may bring an old gear's sleeve to neutral.
    limits = context.settings.limits
    if context.late(snapshot, limits.attempts * limits.disengage_ms):
        return context.give_up(snapshot, FaultCode.ENGAGE_FAILED)
    bring_to_neutral(context, snapshot, stands=True)
    return None


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


def hold(context: ShiftContext, snapshot: StepSnapshot) -> Trigger | None:
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


def fires_again_us(
    context: ShiftContext, predictor: GearPredictor, snapshot: StepSnapshot, earliest_us: int
) -> int | None:
    """The first firing, no sooner than `earliest_us`, that the guard lets pass; None where there is
    none while the sleeve may stand."""
    sleeve = context.sheet.sleeve
    low_rad_s = context.settings.guard.slip_low_rad_s - TOLERANCE_RAD_S
    # By the data sheet's latest contact, and from the newest speed on.
    falls_s = sleeve.delay_s + sleeve.delay_limit_s + context.tick_us / SECOND_US
    for fire_us in range(earliest_us, snapshot.now_us + STANDS_US, context.tick_us):
        fallen = _falls_rad_s2(context, predictor, fire_us - FALL_AGE_US) * falls_s
        if predictor.slip_rad_s(fire_us) - fallen >= low_rad_s:
            return fire_us
    return None


def _falls_rad_s2(context: ShiftContext, predictor: GearPredictor, time_us: int) -> float:
    """How fast the brake lets the slip fall at a time: by its pressure as measured, or as predicted
    from the newest estimate on."""
    sheet, target = context.sheet, context.running.target
    measured = [pa for at_us, pa in context.brake_gauges if at_us <= time_us]
    if measured and time_us <= context.brake_gauges[-1][0]:
        gauge_pa = measured[-1]
    else:
        at_us = max(float(time_us), predictor.layshaft.time_us)
        gauge_pa = predictor.layshaft_at(at_us, None).pressure_pa
    ratio, inertia = sheet.main_mesh(target.main).ratio, sheet.inertia_kgm2(target.split)
    return ratio * sheet.brake_nm_per_pa * max(0.0, gauge_pa) / inertia


def in_mesh(context: ShiftContext, snapshot: StepSnapshot) -> Trigger:
    """The gear asked for is in mesh: its phase is learned, and the shift ends."""
    gear = context.running.target.main
    side = SLEEVE_OF_MAIN[gear]
    seen_us = snapshot.view.engaged_us(side.sleeve, side.direction)
    straight = _went_straight(context, seen_us)
    struck_us = context.free_us if straight else snapshot.now_us - SEEN_US
    context.mesh_changes.append(MeshChange(gear, _flank_slip_rad_s(context, struck_us)))
    return leg_done(context, snapshot, seen_us)


def _went_straight(context: ShiftContext, seen_us: int | None) -> bool:
    """Whether a sleeve that was measured in mesh at a time has not rested on a tooth before."""
    contact_us, sleeve = context.running.measured_contact_us, context.sheet.sleeve
    if contact_us is None or seen_us is None:
        return False
    way_m = sleeve.stroke_m - ENGAGED_SHORT_M - sleeve.to_contact_m
    return seen_us - contact_us < STRAIGHT_SHARE * way_m / sleeve.speed_m_s * SECOND_US


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
