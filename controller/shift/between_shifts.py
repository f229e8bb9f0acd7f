"""The states between shifts: starting, in gear, in neutral, clutch closing, faulted."""

from __future__ import annotations

from meshpoint.controller.shift.context import SEQUENCE_CLUTCH_CLOSED_SHARE, ShiftContext
from meshpoint.controller.shift.step_snapshot import MISSING, StepSnapshot
from meshpoint.controller.shift.table import Trigger
from meshpoint.dbc.messages import ClutchAction, FaultCode
from meshpoint.dbc.messages import ControllerState as State
from meshpoint.gearbox import MainGear
from meshpoint.gearbox.gears import DRIVE_GEARS


def find_gear(context: ShiftContext, snapshot: StepSnapshot) -> Trigger | None:
    """After power-up: waits until everything a shift needs is there, then finds the gear."""
    return None if snapshot.lost in MISSING else watch_gear(context, snapshot)


def watch_gear(context: ShiftContext, snapshot: StepSnapshot) -> Trigger | None:
    """In gear or in neutral with the clutch closed; follows the gear that the positions show."""
    context.clutch = ClutchAction.CLOSE
    gear = snapshot.view.main_gear if snapshot.view.complete else None
    if gear is None:
        return None
    if gear is MainGear.NEUTRAL:
        return Trigger.FOUND_IN_NEUTRAL if context.state is not State.NEUTRAL else None
    return Trigger.FOUND_IN_GEAR if context.state is not State.IN_GEAR else None


def close_clutch(context: ShiftContext, snapshot: StepSnapshot) -> Trigger | None:
    """After a shift: the engine is asked for the gear's speed and the clutch closes.

    The clutch stays open while a sleeve is between neutral and a gear."""
    limit_ms = context.settings.limits.clutch_ms
    if snapshot.view.main_gear is None:
        context.clutch = ClutchAction.OPEN
        return Trigger.GEAR_UNKNOWN if context.late(snapshot, limit_ms) else None
    context.clutch = ClutchAction.CLOSE
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
    """Faulted: it is unknown which gear is in mesh. All valves are off, the clutch stays open,
    until the position sensors show a gear or neutral again."""
    context.clutch = ClutchAction.OPEN
    if snapshot.lost is FaultCode.POSITION_STALE or snapshot.view.main_gear is None:
        return None
    if snapshot.view.main_gear is MainGear.NEUTRAL:
        return Trigger.FOUND_IN_NEUTRAL
    return Trigger.FOUND_IN_GEAR
