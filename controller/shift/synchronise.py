"""From neutral to the firing: brake, coast, and choose when to fire (thesis 2.2, 5.4)."""

from __future__ import annotations

from typing import Final

from meshpoint.controller.planning.outlook import Outlook
from meshpoint.controller.planning.strategist import Plan
from meshpoint.controller.shift.desk import FALL_US, MS, SLEEVE_VALVE, ShiftDesk
from meshpoint.controller.shift.moment import Moment
from meshpoint.controller.shift.speed_up import too_slow
from meshpoint.controller.shift.table import Trigger
from meshpoint.controller.shift.valve_board import Valve
from meshpoint.dbc.messages import FaultCode, ShiftDecision, Strategy
from meshpoint.gearbox import MainGear

DRIVEN_LATE_US: Final = 40 * MS
"""A valve not reported driven this long after its activation was refused: try again."""
KEEP_US: Final = 3 * MS
"""A firing this near to the earliest possible one stands: planned anew, it could by a hair come out
too early to be sent, and the gap would be lost for one that comes a pitch later."""
RELEASE_HORIZON_US: Final = 90 * MS
"""A release further ahead is not sent yet: the valve side takes at most 100 ms."""


def synchronise(desk: ShiftDesk, moment: Moment) -> Trigger | None:
    """Brakes a gear that is fast; one that is slow goes to the engine, one near needs neither."""
    shift, now = desk.running, moment.now_us
    gear = shift.target.main
    if desk.late(moment, desk.settings.limits.synchronise_ms):
        return desk.give_up(moment, FaultCode.SYNCHRONISE_FAILED)
    outlook = desk.outlook(gear, moment)
    if outlook is None:
        return None
    fired = _fire_if_due(desk, outlook, moment)
    if fired is not None:
        return fired
    if shift.release_us is not None and moment.earliest_us >= shift.release_us:
        # It can no longer be moved: from here on the firing is chosen, the brake still dying away.
        return Trigger.BRAKE_RELEASED
    command = desk.board.command(Valve.BRAKE)
    if not command.on and not command.before:
        if outlook.slip_rad_s(now) < desk.settings.window.contact_low_rad_s:
            return too_slow(desk, moment)
        if not _brake_helps(desk, outlook, moment):
            shift.release_us = now
            return Trigger.BRAKE_RELEASED
        shift.pulses += 1
    _keep_braking(desk, moment)
    _plan_release(desk, outlook, moment)
    if shift.release_us is not None and _strategy(desk, gear) is Strategy.TARGET_PHASE:
        # Planned with the release, a firing may come before it: the sleeve is on its way longer.
        _plan_firing(desk, outlook, moment)
    return None


def coast(desk: ShiftDesk, moment: Moment) -> Trigger | None:
    """The gear falls by drag; fires when the strategy says so."""
    shift = desk.running
    if desk.late(moment, desk.settings.limits.synchronise_ms):
        return desk.give_up(moment, FaultCode.SYNCHRONISE_FAILED)
    outlook = desk.outlook(shift.target.main, moment)
    if outlook is None:
        return None
    fired = _fire_if_due(desk, outlook, moment)
    if fired is not None:
        return fired
    if outlook.slip_rad_s(moment.now_us) < desk.settings.window.least_rad_s:
        return too_slow(desk, moment)
    if not _braked_lately(desk, moment) and _brake_helps(desk, outlook, moment):
        shift.plan = shift.release_us = None
        desk.all_off(moment.now_us)
        return Trigger.TOO_FAST
    _plan_firing(desk, outlook, moment)
    return None


def _fire_if_due(desk: ShiftDesk, outlook: Outlook, moment: Moment) -> Trigger | None:
    """The sleeve goes, where the firing that was sent can no longer be moved."""
    shift, plan = desk.running, desk.running.plan
    if plan is None or plan.fire_us >= moment.earliest_us + KEEP_US:
        return None
    shift.attempts += 1
    shift.measured_contact_us = None
    desk.free_outlook, desk.fired_outlook = None, outlook
    desk.decision = plan._replace(decision=ShiftDecision.COMMITTED)
    return Trigger.FIRED


def _brake_helps(desk: ShiftDesk, outlook: Outlook, moment: Moment) -> bool:
    """Whether drag alone would take too long to bring the slip to where it is fired."""
    limits, window = desk.settings.limits, desk.settings.window
    if desk.running.pulses >= limits.pulses:
        return False
    wanted = {
        Strategy.SPEED_WINDOW: window.fire_slip_rad_s,
        Strategy.SPEED_WINDOW_ANTICIPATING: window.anticipate_slip_rad_s,
        Strategy.TARGET_PHASE: window.contact_high_rad_s,
    }[_strategy(desk, outlook.gear)]
    slip = outlook.slip_rad_s(moment.now_us)
    fall = slip - outlook.slip_rad_s(moment.now_us + FALL_US)
    return slip - wanted > fall * (limits.coast_ms * MS / FALL_US)


def _braked_lately(desk: ShiftDesk, moment: Moment) -> bool:
    """Whether the brake's pressure may still act."""
    release_us, brake = desk.running.release_us, desk.sheet.brake
    settle_s = brake.valve_delay_s + 4.0 * brake.time_constant_s
    return release_us is not None and moment.now_us < release_us + settle_s * 1e6


def _keep_braking(desk: ShiftDesk, moment: Moment) -> None:
    command = desk.board.command(Valve.BRAKE)
    refused = command.on and not moment.brake_driven
    if not command.on and not command.before:
        desk.switch_brake(True, moment.earliest_us, moment)
    elif refused and moment.now_us - command.time_us > DRIVEN_LATE_US:
        desk.brake.schedule(moment.now_us, False, moment.now_us)
        desk.switch_brake(True, moment.earliest_us, moment)


def _plan_release(desk: ShiftDesk, outlook: Outlook, moment: Moment) -> None:
    shift = desk.running
    command = desk.board.command(Valve.BRAKE)
    on_us = command.time_us if command.on else moment.now_us
    earliest_us = max(moment.earliest_us, on_us)
    strategy = _strategy(desk, shift.target.main)
    release_us, contact_us = desk.strategist.release(outlook, moment.now_us, earliest_us, strategy)
    horizon_us = moment.now_us + RELEASE_HORIZON_US
    if shift.release_us is not None:
        # A release once sent is moved, never taken back: its slot holds the newest time.
        release_us = min(release_us, horizon_us)
    decision = ShiftDecision.BRAKE
    if release_us <= horizon_us and moment.now_us >= on_us:
        shift.release_us = release_us
        desk.switch_brake(False, release_us, moment)
        decision = ShiftDecision.RELEASE
    slip = outlook.slip_rad_s(contact_us, release_us)
    desk.decision = Plan(decision, 0, contact_us, 0.0, 0.0, slip)


def _strategy(desk: ShiftDesk, gear: MainGear) -> Strategy:
    """The one asked for; without a phase reference there is nothing to aim at."""
    asked = desk.settings.strategy
    if asked is Strategy.TARGET_PHASE and not desk.reference_known(gear):
        return Strategy.SPEED_WINDOW
    return asked


def _plan(desk: ShiftDesk, outlook: Outlook, moment: Moment, strategy: Strategy) -> Plan | None:
    strategist = desk.strategist
    if strategy is Strategy.TARGET_PHASE:
        return strategist.target_phase(outlook, moment.now_us, moment.earliest_us)
    if strategy is Strategy.SPEED_WINDOW_ANTICIPATING:
        return strategist.anticipating(outlook, moment.earliest_us)
    return strategist.speed_window(outlook, moment.now_us, moment.earliest_us)


def _plan_firing(desk: ShiftDesk, outlook: Outlook, moment: Moment) -> None:
    shift, strategist = desk.running, desk.strategist
    valve = SLEEVE_VALVE[shift.target.main]
    if shift.attempts == 0:
        shift.reference_known = desk.reference_known(shift.target.main)
        shift.reference_source = desk.references.source(shift.target.main)
    shift.strategy = _strategy(desk, shift.target.main)
    aimed = shift.strategy is Strategy.TARGET_PHASE
    plan = _plan(desk, outlook, moment, shift.strategy)
    if plan is not None and plan.fire_us > moment.now_us + RELEASE_HORIZON_US:
        plan = None  # not sent yet, like a release: the valve side would refuse it
    if plan is None:
        desk.board.off(valve)
        waiting = ShiftDecision.WAIT_FOR_GAP if aimed else ShiftDecision.WAIT_FOR_SLIP
        desk.decision = strategist.plan_at(outlook, moment.earliest_us, waiting)._replace(
            fire_us=0, contact_us=0
        )
    else:
        desk.board.schedule(valve, True, plan.fire_us, moment.now_us)
        desk.decision = plan
    shift.plan = plan
