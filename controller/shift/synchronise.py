"""From neutral to the firing: brake, coast, and choose when to fire (thesis 2.2, 5.4)."""

from __future__ import annotations

import math
from typing import Final

from meshpoint.controller.plan.gear_predictor import GearPredictor
from meshpoint.controller.plan.strategist import Plan
from meshpoint.controller.plan.strategy import EngagementStrategy
from meshpoint.controller.settings.settings import MS_IN_US
from meshpoint.controller.settings.valve_name import SLEEVE_VALVE, ValveName
from meshpoint.controller.shift.context import DRIVEN_LATE_US, FALL_US, ShiftContext
from meshpoint.controller.shift.engine import too_slow
from meshpoint.controller.shift.step_snapshot import StepSnapshot
from meshpoint.controller.shift.table import Trigger
from meshpoint.dbc.messages import ClutchAction, FaultCode, ShiftDecision
from meshpoint.gearbox import GearboxSheet, MainGear
from meshpoint.gearbox.gears import MAIN_SLEEVES, SLEEVE_OF_MAIN
from meshpoint.units import SECOND_US, US

HELD_SHARE: Final = 0.3
"""Of the supply's pressure: so much more than the slowest law of the data sheet leaves is held."""
SETTLED: Final = 5.0
"""This many time constants after a release nothing is left, and the sensor has seen it fall."""

KEEP_US: Final = 6 * MS_IN_US
"""A firing this close to the earliest possible activation is not planned again: the new time could
come out slightly too early to be sent, and the sleeve would have to wait for the next gap. And the
next step comes soon enough after it to call the sleeve back (`engage`)."""
WITHDRAW_US: Final = 4 * MS_IN_US
"""A firing nearer than this is not withdrawn: its valve could have opened before."""
CONTACT_SHARES: Final = (-1.0, -0.5, 0.0, 0.5, 1.0)
"""Contacts earlier and later than planned, in shares of what the data sheet says of the delay."""
MOST_OUTSIDE: Final = 0.05
"""A sleeve is fired where the slip at its contact is below the guard's window with no more than
this probability: a main shaft that is about to meet a flank of its driveline's backlash may be far
faster by then than is most probable."""
RELEASE_HORIZON_US: Final = 90 * MS_IN_US
"""A release further ahead than this is not sent yet: the valve side accepts at most 100 ms."""


def synchronise(context: ShiftContext, snapshot: StepSnapshot) -> Trigger | None:
    """Brakes the layshaft for a gear that is too fast, and plans the brake's release and the
    firing.

    A gear that is too slow needs the engine (TOO_SLOW); one that is close enough needs no brake."""
    shift, now = context.running, snapshot.now_us
    gear = shift.target.main
    if context.clutch is ClutchAction.CLOSE:
        return too_slow(context, snapshot)  # it is being raised already (`raise_ahead`)
    # What was asked for while the old gear came out is asked for again if need be.
    context.engine_rad_s = None
    if context.late(snapshot, context.settings.limits.synchronise_ms):
        return context.give_up(snapshot, FaultCode.SYNCHRONISE_FAILED)
    predictor = context.predictor(gear, snapshot)
    if predictor is None:
        return None
    fired = fire_if_due(context, predictor, snapshot)
    if fired is not None:
        return fired
    if shift.release_us is not None and snapshot.earliest_us >= shift.release_us:
        # The release can no longer be changed. From here on only the firing is planned, while the
        # brake's pressure falls.
        return Trigger.BRAKE_RELEASED
    command = context.board.command(ValveName.BRAKE)
    if not command.on and not command.before:
        if predictor.steady_slip_rad_s(now) < context.settings.window.contact_low_rad_s:
            return too_slow(context, snapshot)
        helps = _brake_helps(context, predictor, snapshot)
        if not (helps or _brakes_for_phase(context, predictor, snapshot)):
            shift.release_us = now
            return Trigger.BRAKE_RELEASED
        shift.pulses += 1
    _keep_braking(context, snapshot)
    plan_release(context, predictor, snapshot, _acting(context, gear))
    if shift.release_us is not None and _acting(context, gear).aims:
        # The firing may come before the release: the sleeve takes longer than the brake to fade.
        plan_firing(context, predictor, snapshot, snapshot.earliest_us)
    return None


def coast(context: ShiftContext, snapshot: StepSnapshot) -> Trigger | None:
    """The layshaft slows by drag alone; the sleeve is fired at the time the strategy has chosen."""
    shift = context.running
    if context.late(snapshot, context.settings.limits.synchronise_ms):
        return context.give_up(snapshot, FaultCode.SYNCHRONISE_FAILED)
    predictor = context.predictor(shift.target.main, snapshot)
    if predictor is None:
        return None
    fired = fire_if_due(context, predictor, snapshot)
    if fired is not None:
        return fired
    if predictor.steady_slip_rad_s(snapshot.now_us) < context.settings.window.least_rad_s:
        return too_slow(context, snapshot)
    if not _braked_lately(context, snapshot) and _brake_helps(context, predictor, snapshot):
        shift.plan = shift.release_us = None
        context.all_off(snapshot.now_us)
        return Trigger.TOO_FAST
    plan_firing(context, predictor, snapshot, snapshot.earliest_us)
    return None


def fire_if_due(
    context: ShiftContext, predictor: GearPredictor, snapshot: StepSnapshot
) -> Trigger | None:
    """Enters the firing as done once the activation that was sent can no longer be changed."""
    shift, plan = context.running, context.running.plan
    if plan is None or plan.fire_us >= snapshot.earliest_us + KEEP_US:
        return None
    if _better_withdrawn(context, predictor, plan, snapshot):
        context.board.off(SLEEVE_VALVE[shift.target.main])
        shift.plan = None
        return None
    shift.attempts += 1
    shift.first_fire_us = shift.first_fire_us or plan.fire_us
    shift.measured_contact_us = None
    context.free_predictor = None
    context.decision = plan._replace(decision=ShiftDecision.COMMITTED)
    return Trigger.FIRED


def _better_withdrawn(
    context: ShiftContext, predictor: GearPredictor, plan: Plan, snapshot: StepSnapshot
) -> bool:
    """Whether a firing that was planned for the gap is now predicted to meet a tooth, and there is
    still time to take it back: a command that switches off needs no lead but the bus's."""
    if not shift_aims(context) or plan.misses:
        return False
    if plan.fire_us < snapshot.now_us + WITHDRAW_US:
        return False
    return context.strategist.plan_at(predictor, plan.contact_us, plan.decision).misses


def shift_aims(context: ShiftContext) -> bool:
    """Whether the running shift's strategy aims, and knows where."""
    shift = context.running
    return shift.aimed and context.reference_known(shift.target.main)


def _brake_helps(context: ShiftContext, predictor: GearPredictor, snapshot: StepSnapshot) -> bool:
    """Whether drag alone would take longer than `limits.coast_ms` to bring the slip down to the
    strategy's `fire_slip_rad_s`, and the brake may still be used in this shift."""
    limits = context.settings.limits
    if context.running.pulses >= limits.pulses:
        return False
    wanted = _acting(context, predictor.gear).fire_slip_rad_s
    slip = predictor.steady_slip_rad_s(snapshot.now_us)
    fall = slip - predictor.steady_slip_rad_s(snapshot.now_us + FALL_US)
    return slip - wanted > fall * (limits.coast_ms * MS_IN_US / FALL_US)


def _brakes_for_phase(
    context: ShiftContext, predictor: GearPredictor, snapshot: StepSnapshot
) -> bool:
    """Whether a gear that drag alone would slow down is braked all the same, once: its release
    chooses the phase at contact, drag does not. Only where the first contact that can be made
    would come with more slip than is aimed for, and where drag does not take a pitch for each
    sleeve delay by itself: the brake would take far too much then."""
    shift = context.running
    if shift.pulses > 0 or shift.changes_range or not _acting(context, predictor.gear).aims:
        return False
    first_us = snapshot.earliest_us + predictor.delay_us
    slip = predictor.steady_slip_rad_s(first_us)
    fall = predictor.steady_slip_rad_s(snapshot.earliest_us) - slip
    is_slow = fall * context.sheet.sleeve.delay_s < context.sheet.dog.pitch_rad
    return is_slow and slip > context.settings.window.aim_slip_rad_s


def _braked_lately(context: ShiftContext, snapshot: StepSnapshot) -> bool:
    """Whether the brake was released so recently that its pressure may still act."""
    release_us, brake = context.running.release_us, context.sheet.brake
    settle_s = brake.valve_delay_s + 4.0 * brake.time_constant_s
    return release_us is not None and snapshot.now_us < release_us + settle_s * 1e6


def _keep_braking(context: ShiftContext, snapshot: StepSnapshot) -> None:
    command = context.board.command(ValveName.BRAKE)
    refused = command.on and not snapshot.driven[ValveName.BRAKE]
    if not command.on and not command.before:
        context.switch_brake(True, snapshot.earliest_us, snapshot)
    elif refused and snapshot.now_us - command.time_us > DRIVEN_LATE_US:
        context.brake.schedule(snapshot.now_us, False, snapshot.now_us)
        context.switch_brake(True, snapshot.earliest_us, snapshot)


def plan_release(
    context: ShiftContext,
    predictor: GearPredictor,
    snapshot: StepSnapshot,
    acting: EngagementStrategy,
) -> None:
    """Plans the brake's release anew by a strategy, and sends it once it is near enough."""
    shift = context.running
    command = context.board.command(ValveName.BRAKE)
    on_us = command.time_us if command.on else snapshot.now_us
    earliest_us = max(snapshot.earliest_us, on_us)
    release_us, contact_us = acting.release(predictor, snapshot.now_us, earliest_us)
    horizon_us = snapshot.now_us + RELEASE_HORIZON_US
    if shift.release_us is not None:
        # A release that was sent may be moved but not withdrawn: its slot holds the newest time.
        release_us = min(release_us, horizon_us)
    decision = ShiftDecision.BRAKE
    if release_us <= horizon_us and snapshot.now_us >= on_us:
        shift.release_us = release_us
        context.switch_brake(False, release_us, snapshot)
        decision = ShiftDecision.RELEASE
    slip = predictor.slip_rad_s(contact_us, release_us)
    context.decision = Plan(decision, 0, contact_us, 0.0, 0.0, slip)


def _acting(context: ShiftContext, gear: MainGear) -> EngagementStrategy:
    return context.strategist.acting(context.reference_known(gear))


def _stays_in_window(context: ShiftContext, predictor: GearPredictor, plan: Plan) -> bool:
    """Whether the guard will let the sleeve go on to its gear: at each contact of a gearbox within
    its data sheet the slip is inside the guard's window, however the main shaft swings, and also if
    the layshaft falls no more once the sleeve is fired."""
    window, spread_us = context.settings.guard, context.sheet.sleeve.delay_limit_s * SECOND_US
    if predictor.least_slip_rad_s(plan.contact_us, MOST_OUTSIDE) < window.slip_low_rad_s:
        return False
    fired = predictor.steady_slip_rad_s(plan.fire_us)
    for share in CONTACT_SHARES:
        contact_us = plan.contact_us + share * spread_us
        held = fired + predictor.swing_rad_s(contact_us)
        met = predictor.slip_rad_s(contact_us)
        if met < window.slip_low_rad_s or held > window.slip_high_rad_s:
            return False
    return True


def plan_firing(
    context: ShiftContext, predictor: GearPredictor, snapshot: StepSnapshot, earliest_us: int
) -> None:
    """Plans the firing anew, for an activation at `earliest_us` or later, and sends it."""
    shift, strategist = context.running, context.strategist
    valve = SLEEVE_VALVE[shift.target.main]
    if shift.attempts == 0:
        shift.reference_known = context.reference_known(shift.target.main)
        shift.reference_source = context.references.source(shift.target.main)
    acting = _acting(context, shift.target.main)
    shift.strategy, shift.aimed = strategist.wire(acting), acting.aims
    contact_us, plan = acting.contact(predictor, snapshot.now_us, earliest_us), None
    if contact_us is not None:
        plan = strategist.plan_at(predictor, contact_us, ShiftDecision.FIRE)
    if plan is not None and plan.slip_rad_s < context.settings.window.least_rad_s:
        plan = None  # the gear would be too slow by then: it is, or will be, the engine's turn
    if plan is not None and not _stays_in_window(context, predictor, plan):
        plan = None
    if plan is not None and plan.fire_us > snapshot.now_us + RELEASE_HORIZON_US:
        plan = None  # too far ahead: the valve side would refuse it
    if brake_holds(context.sheet, predictor, snapshot.view.brake_gauge_pa):
        plan = None
    mine = SLEEVE_OF_MAIN[shift.target.main].sleeve
    others_rest = all(map(snapshot.view.rests, set(MAIN_SLEEVES) - {mine}))
    if not (others_rest and context.is_shut(snapshot.now_us)):
        plan = None  # the guard lets no sleeve go while the other one may move
    if plan is None:
        context.board.off(valve)
        waiting = ShiftDecision.WAIT_FOR_GAP if acting.aims else ShiftDecision.WAIT_FOR_SLIP
        context.decision = strategist.plan_at(predictor, earliest_us, waiting)._replace(
            fire_us=0, contact_us=0
        )
    else:
        context.board.schedule(valve, True, plan.fire_us, snapshot.now_us)
        context.decision = plan
    shift.plan = plan


def brake_holds(sheet: GearboxSheet, predictor: GearPredictor, measured_pa: float) -> bool:
    """Whether the brake still has the pressure of which it should be rid: a valve that is stuck. No
    gear may be engaged then, and no prediction holds that lets the pressure fall.

    measured_pa: the newest sample, gauge. An estimate that has just begun with a free layshaft does
    not know it yet."""
    brake, state = sheet.brake, predictor.layshaft
    switches = predictor.brake.arrays()
    is_known = switches.shape[1] > 0
    if is_known and switches[1, -1] > 0.0:
        return False
    since_s = (state.time_us - float(switches[0, -1])) * US if is_known else math.inf
    slowest_s = brake.time_constant_s * (1.0 + brake.time_constant_tolerance)
    if since_s > SETTLED * slowest_s and measured_pa > HELD_SHARE * sheet.air.supply_gauge_pa:
        return True
    left = math.exp(-max(0.0, since_s) / slowest_s)
    return state.pressure_pa > (left + HELD_SHARE) * sheet.air.supply_gauge_pa
