"""Downshifts: the engine brings the layshaft above the new gear's speed (thesis 2.2).

The clutch closes, the engine gets a TSC1 speed request, the clutch opens again; from there the slip
falls as in an upshift. The same is done when a gear has become too slow before it was engaged.
"""

from __future__ import annotations

import math
from typing import Final

from meshpoint.controller.settings.settings import MS_IN_US
from meshpoint.controller.settings.valve_name import ValveName
from meshpoint.controller.shift.context import (
    FALL_US as SEEN_LATE_US,
)
from meshpoint.controller.shift.context import (
    SEQUENCE_CLUTCH_CLOSED_SHARE,
    ShiftContext,
)
from meshpoint.controller.shift.step_snapshot import StepSnapshot
from meshpoint.controller.shift.table import Trigger
from meshpoint.dbc.messages import ClutchAction, FaultCode
from meshpoint.units import US

SHORT_RAD_S: Final = 1.0
"""The slip may be this much less than asked for (10 rpm)."""
OVER_RAD_S: Final = 3.0
"""The slip may be this much more than asked for (30 rpm): the brake removes the surplus."""
CARRIED_RAD_S: Final = 1.5
"""Plates carry the layshaft with the engine where the gear's slip by its own speed and by the
engine's differ by less (15 rpm): both are some hundredths of a second old."""
BEYOND_US: Final = 300 * MS_IN_US
"""For this long the speed that a gear needs may be above the input shaft's limit: a main shaft that
swings comes back, a vehicle that rolls downhill does not."""


def too_slow(context: ShiftContext, snapshot: StepSnapshot) -> Trigger:
    """The gear is slower than its sleeve: asks for the engine, a limited number of times a
    shift. The gear then comes down from above anew, and may be braked as often as at first."""
    shift = context.running
    if shift.raises >= context.settings.limits.raises:
        return context.give_up(snapshot, FaultCode.SYNCHRONISE_FAILED)
    shift.raises += 1
    shift.pulses = 0
    shift.plan = shift.release_us = None
    context.all_off(snapshot.now_us)
    return Trigger.TOO_SLOW


def raise_speed(context: ShiftContext, snapshot: StepSnapshot) -> Trigger | None:
    """Closes the clutch and asks the engine for speed, until the gear has the slip wanted."""
    shift = context.running
    context.clutch = ClutchAction.CLOSE
    wanted, carried = _raised_slip(context, snapshot), _carried_slip(context, snapshot)
    context.ask_engine(shift.target, wanted, snapshot)
    if carried is not None and _comes_to(context, carried, wanted, snapshot):
        return Trigger.RAISED
    if _stays_beyond(context, wanted, snapshot):
        return context.give_up(snapshot, FaultCode.INPUT_OVERSPEED)
    if context.late(snapshot, context.settings.limits.raise_ms):
        closed = (snapshot.view.clutch_closed or 0.0) >= SEQUENCE_CLUTCH_CLOSED_SHARE
        return context.give_up(
            snapshot, FaultCode.ENGINE_FAILED if closed else FaultCode.CLUTCH_STUCK
        )
    return None


def _carried_slip(context: ShiftContext, snapshot: StepSnapshot) -> float | None:
    """The gear's slip (rad/s) by the engine's speed, where the plates carry the layshaft with it;
    None where they do not, or a speed is not known."""
    slip = snapshot.speeds.slip_rad_s(context.running.target.main)
    main, engine = snapshot.speeds.main, snapshot.engine_rad_s
    if slip is None or main is None or engine is None:
        return None
    by_engine = _gear_over_engine(context) * engine - main
    return by_engine if abs(slip - by_engine) < CARRIED_RAD_S else None


def _comes_to(
    context: ShiftContext, slip_rad_s: float, wanted_rad_s: float, snapshot: StepSnapshot
) -> bool:
    """Whether the engine brings the gear from its slip to the one wanted by the time that the
    plates part, if the clutch is opened now. It changes the slower the nearer it is to what it was
    asked for."""
    clutch, lag_s = context.sheet.clutch, context.sheet.engine.lag_s
    meeting = max(0.0, (snapshot.view.clutch_closed or 0.0) - clutch.kiss_share)
    parting_s = meeting * clutch.open_delay_s + context.tick_us * US
    rate_rad_s2 = _gear_over_engine(context) * context.torque.engine_rad_s2
    comes = rate_rad_s2 * lag_s * (1.0 - math.exp(-parting_s / lag_s))
    return -SHORT_RAD_S <= slip_rad_s + comes - wanted_rad_s <= OVER_RAD_S


def _gear_over_engine(context: ShiftContext) -> float:
    """Speed of the new gear over the engine's, the clutch closed."""
    gear, sheet = context.running.target, context.sheet
    return sheet.main_mesh(gear.main).ratio * sheet.split_mesh(gear.split).ratio


def raise_ahead(context: ShiftContext, snapshot: StepSnapshot) -> None:
    """The engine rises for a gear that is too slow from when the old one is out of its teeth, so
    that it has come to its speed when the plates meet. Not for a sleeve that has left neutral."""
    shift, window = context.running, context.settings.window
    slip = snapshot.speeds.slip_rad_s(shift.target.main)
    is_too_slow = slip is not None and slip < window.contact_low_rad_s
    context.engine_rad_s = None
    if is_too_slow and snapshot.view.clutch_parted and not shift.returns:
        context.ask_engine(shift.target, _raised_slip(context, snapshot), snapshot)


def _stays_beyond(context: ShiftContext, slip_rad_s: float, snapshot: StepSnapshot) -> bool:
    """Whether the gear has been too fast for the input shaft for as long as a swing may last."""
    shift = context.running
    speed = context.engine_speed(shift.target, slip_rad_s, snapshot)
    if speed is None or speed <= context.sheet.limits.input_max_rad_s:
        shift.beyond_us = None
        return False
    if shift.beyond_us is None:
        shift.beyond_us = snapshot.now_us
    return snapshot.now_us - shift.beyond_us >= BEYOND_US


def part_clutch(context: ShiftContext, snapshot: StepSnapshot) -> Trigger | None:
    """Opens the clutch; the engine holds its speed until the plates are apart."""
    context.clutch = ClutchAction.OPEN
    context.ask_engine(context.running.target, _raised_slip(context, snapshot), snapshot)
    if snapshot.view.clutch_parted:
        context.engine_rad_s = None
        context.board.off(ValveName.BRAKE)
        return Trigger.CLUTCH_OPEN
    if context.late(snapshot, context.settings.limits.clutch_ms):
        return context.give_up(snapshot, FaultCode.CLUTCH_STUCK)
    return None


def _raised_slip(context: ShiftContext, snapshot: StepSnapshot) -> float:
    """The slip (rad/s) to ask for: `aim_slip_rpm`, plus what drag takes from the earliest on that
    plates of the sheet's tolerance part until a sleeve that is fired once they are measured apart
    comes to its gear. The measurement comes up to a sensor read and a tick later."""
    sheet, target, window = context.sheet, context.running.target, context.settings.window
    ratio = sheet.main_mesh(target.main).ratio
    layshaft = snapshot.speeds.layshaft or 0.0
    drag_rad_s2 = snapshot.layshaft.drag_nm(layshaft) / sheet.inertia_kgm2(target.split)
    clutch, sleeve = sheet.clutch, sheet.sleeve
    earliest_share = clutch.kiss_share + clutch.kiss_tolerance
    parted_s = (earliest_share - clutch.surely_open_share) * clutch.open_delay_s
    fall_s = parted_s + SEEN_LATE_US * US
    ahead_us = snapshot.earliest_us - snapshot.now_us + context.tick_us
    stroke_s = ahead_us * US + sleeve.delay_s + sleeve.delay_limit_s
    return window.aim_slip_rad_s + ratio * drag_rad_s2 * (fall_s + stroke_s)
