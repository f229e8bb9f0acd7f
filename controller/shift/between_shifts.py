"""The states between shifts: starting, in gear, in neutral, clutch closing, faulted."""

from __future__ import annotations

from typing import Final

from meshpoint.controller.settings.settings import MS_IN_US
from meshpoint.controller.shift.context import SEQUENCE_CLUTCH_CLOSED_SHARE, ShiftContext
from meshpoint.controller.shift.step_snapshot import MISSING, StepSnapshot
from meshpoint.controller.shift.table import Trigger
from meshpoint.controller.shift.to_neutral import bring_to_neutral
from meshpoint.dbc.messages import ClutchAction, FaultCode
from meshpoint.dbc.messages import ControllerState as State
from meshpoint.gearbox import MainGear
from meshpoint.gearbox.gears import DRIVE_GEARS

FREE_AGAIN_US: Final = 300 * MS_IN_US
"""A sleeve that has not come to neutral is tried again after so long."""


def find_gear(context: ShiftContext, snapshot: StepSnapshot) -> Trigger | None:
    """After power-up: waits until everything a shift needs is there and the guard lets valves be
    driven, then finds the gear: who reads that a gear is in may ask for another. A sleeve that
    stands between neutral and a gear is brought to neutral first."""
    if snapshot.lost in MISSING:
        return None
    if snapshot.view.complete and snapshot.view.main_gear is None:
        _free_sleeves(context, snapshot)
        return None
    found = watch_gear(context, snapshot)
    return found if snapshot.is_self_tested else None


def watch_gear(context: ShiftContext, snapshot: StepSnapshot) -> Trigger | None:
    """In gear or in neutral with the clutch closed; follows the gear that the positions show."""
    context.clutch = ClutchAction.CLOSE
    _catch_engine(context, snapshot)
    gear = snapshot.view.main_gear if snapshot.view.complete else None
    if gear is None:
        return None
    if gear is MainGear.NEUTRAL:
        return Trigger.FOUND_IN_NEUTRAL if context.state is not State.NEUTRAL else None
    return Trigger.FOUND_IN_GEAR if context.state is not State.IN_GEAR else None


def _catch_engine(context: ShiftContext, snapshot: StepSnapshot) -> None:
    """Where the guard lets no clutch close because the engine turns too differently, it is asked
    for the gear's speed until the clutch has closed: a controller that starts, or comes back, while
    the truck rolls and the engine idles."""
    gear = DRIVE_GEARS.get(snapshot.view.gear_number) if snapshot.view.complete else None
    is_closed = (snapshot.view.clutch_closed or 0.0) >= SEQUENCE_CLUTCH_CLOSED_SHARE
    context.catches_engine |= context.closing_blocked
    if not context.catches_engine:
        return
    if gear is None or is_closed:
        context.catches_engine, context.engine_rad_s = False, None
    else:
        context.ask_engine(gear, 0.0, snapshot)


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
    """Faulted: it is unknown which gear is in mesh. The clutch stays open until the position
    sensors show a gear or neutral again; a sleeve that they show in between is brought to
    neutral."""
    context.clutch = ClutchAction.OPEN
    if snapshot.lost is FaultCode.POSITION_STALE:
        return None
    if snapshot.view.main_gear is None:
        # The shift that has just ended has tried.
        if snapshot.now_us - context.since_us > FREE_AGAIN_US:
            _free_sleeves(context, snapshot)
        return None
    if snapshot.view.main_gear is MainGear.NEUTRAL:
        return Trigger.FOUND_IN_NEUTRAL
    return Trigger.FOUND_IN_GEAR


def _free_sleeves(context: ShiftContext, snapshot: StepSnapshot) -> None:
    """Brings sleeves that stand between neutral and a gear to neutral, the clutch open; one that
    has not come is tried again after a while, so that it does not take all the air."""
    context.clutch = ClutchAction.OPEN
    is_ready = snapshot.is_self_tested and context.armed and snapshot.view.clutch_parted
    # Another time where the sensors' clock has gone back since.
    if is_ready and not 0 <= snapshot.now_us - context.freed_us <= FREE_AGAIN_US:
        context.freed_us = snapshot.now_us
        bring_to_neutral(context, snapshot, stands=True)
