"""In which order main box and splitter change where both have dog teeth.

One after the other, by way of the gear between them: into the high step before the main box's
change, into the low one after it. With the high step in, the input shaft turns slower than in the
gear before or as fast as in the one asked for: in no leg faster than in one of these two.
"""

from __future__ import annotations

from meshpoint.controller.measure.gearbox_view import GearboxView
from meshpoint.controller.shift.context import ShiftContext
from meshpoint.controller.shift.step_snapshot import StepSnapshot
from meshpoint.controller.shift.table import Trigger
from meshpoint.dbc.messages import ClutchAction, Engagement, FaultCode, ShiftResult
from meshpoint.gearbox import DriveGear, GearboxSheet, MainGear, Split
from meshpoint.gearbox.gears import DRIVE_GEAR_WITH


def next_leg(sheet: GearboxSheet, view: GearboxView, goal: DriveGear) -> DriveGear:
    """The gear to go to next on the way to the one asked for: that one itself, unless splitter and
    main box both have to change. Out of neutral the main box's change comes first, in the step that
    is in: nothing else turns the layshaft."""
    main, split, range_ = view.main_gear, view.split, view.range_
    stays = engagement(sheet, view, goal) is Engagement.SPLITTER
    if stays or not sheet.has_dog_splitter or split is goal.split:
        return goal
    wanted = (goal.main, split, goal.range_)
    if main is not MainGear.NEUTRAL and split is not Split.HIGH:
        wanted = (main, Split.HIGH, range_)  # type: ignore[assignment]
    return DRIVE_GEAR_WITH.get(wanted, goal)


def engagement(sheet: GearboxSheet, view: GearboxView, goal: DriveGear) -> Engagement:
    """Whose dog teeth meet on the way to a gear: the main gear's, unless its own are in already."""
    stays = (view.main_gear, view.range_) == (goal.main, goal.range_)
    return Engagement.SPLITTER if sheet.has_dog_splitter and stays else Engagement.MAIN_GEAR


def set_goal(context: ShiftContext, goal: DriveGear, snapshot: StepSnapshot) -> None:
    """The running shift goes to this gear, if need be by way of another one."""
    shift = context.running
    shift.target = next_leg(context.sheet, snapshot.view, goal)
    shift.after = None if shift.target == goal else goal


def leg_done(context: ShiftContext, snapshot: StepSnapshot, ended_us: int | None = None) -> Trigger:
    """The target is in: the shift ends, or goes on to the gear that is asked for. ended_us: when a
    sensor showed it, if not now."""
    shift = context.running
    if shift.after is None:
        context.end(snapshot, ShiftResult.ENGAGED, FaultCode.NONE, ended_us)
        return Trigger.ENGAGED
    set_goal(context, shift.after, snapshot)
    shift.pulls = shift.pull_again_us = shift.returns = 0
    shift.pushed_us, shift.is_braked, shift.flies = None, False, False
    context.engine_rad_s, context.clutch = None, ClutchAction.OPEN
    context.all_off(snapshot.now_us)
    return Trigger.LEG_DONE
