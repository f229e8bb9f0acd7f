"""Before and after a shift: find the gear, stay in it, close the clutch, or stand faulted."""

from __future__ import annotations

from meshpoint.controller.shift.desk import CLUTCH_CLOSED_SHARE, ShiftDesk
from meshpoint.controller.shift.moment import Moment
from meshpoint.controller.shift.table import Trigger
from meshpoint.dbc.messages import ClutchAction, FaultCode
from meshpoint.dbc.messages import ControllerState as State
from meshpoint.gearbox import MainGear
from meshpoint.gearbox.gears import DRIVE_GEARS


def find_gear(desk: ShiftDesk, moment: Moment) -> Trigger | None:
    """Power-up: wait for all that a shift needs, then see what is in."""
    return None if moment.lost is not FaultCode.NONE else stay(desk, moment)


def stay(desk: ShiftDesk, moment: Moment) -> Trigger | None:
    """In a gear or in neutral, clutch closed, watching which."""
    desk.clutch = ClutchAction.CLOSE
    gear = moment.view.main_gear if moment.view.complete else None
    if gear is None:
        return None
    if gear is MainGear.NEUTRAL:
        return Trigger.FOUND_IN_NEUTRAL if desk.state is not State.NEUTRAL else None
    return Trigger.FOUND_IN_GEAR if desk.state is not State.IN_GEAR else None


def close_clutch(desk: ShiftDesk, moment: Moment) -> Trigger | None:
    """After a shift: the engine meets the gear's speed and the clutch closes. A sleeve between
    neutral and a gear keeps it open."""
    limit_ms = desk.settings.limits.clutch_ms
    if moment.view.main_gear is None:
        desk.clutch = ClutchAction.OPEN
        return Trigger.GEAR_UNKNOWN if desk.late(moment, limit_ms) else None
    desk.clutch = ClutchAction.CLOSE
    gear = DRIVE_GEARS.get(moment.view.gear_number)
    if gear is not None:
        desk.ask_engine(gear, 0.0, moment)
    late = desk.late(moment, limit_ms)
    if late and desk.fault is FaultCode.NONE:
        desk.fault = FaultCode.CLUTCH_STUCK
    if late or (moment.view.clutch_closed or 0.0) >= CLUTCH_CLOSED_SHARE:
        desk.engine_rad_s = None
        return stay(desk, moment)
    return None


def stand_faulted(desk: ShiftDesk, moment: Moment) -> Trigger | None:
    """Nobody knows what is in mesh: all valves off hold the sleeves, the clutch stays open. Ends
    when the positions tell a gear or neutral again."""
    desk.clutch = ClutchAction.OPEN
    if moment.lost is FaultCode.POSITION_STALE or moment.view.main_gear is None:
        return None
    if moment.view.main_gear is MainGear.NEUTRAL:
        return Trigger.FOUND_IN_NEUTRAL
    return Trigger.FOUND_IN_GEAR
