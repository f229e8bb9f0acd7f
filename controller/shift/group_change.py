"""Splitter and range: changed through synchronisers with the clutch open; the range with the main
box in neutral.

During a change neither the layshaft's model (thesis 4.13) nor constant speed of the main shaft
(4.16) holds, so nothing is predicted until the shafts turn together again. The phase references
stay valid: the layshaft is in constant mesh with the main gears, and both wheels' teeth are counted
throughout.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from meshpoint.controller.measure.gearbox_view import GearboxView
from meshpoint.controller.settings.settings import MS_IN_US
from meshpoint.controller.settings.valve_name import ValveName
from meshpoint.controller.shift.context import ShiftContext
from meshpoint.controller.shift.splitter import change_by_dog_teeth
from meshpoint.controller.shift.step_snapshot import StepSnapshot
from meshpoint.controller.shift.table import Trigger
from meshpoint.dbc.messages import FaultCode, ShiftResult
from meshpoint.gearbox import MainGear, Range, Split

PUSH_US: Final = 400 * MS_IN_US
"""If a valve has been on for this long without moving its sleeve, it is switched off and on
again."""
SPLIT_VALVE: Final = {Split.LOW: ValveName.SPLIT_LOW, Split.HIGH: ValveName.SPLIT_HIGH}
RANGE_VALVE: Final = {Range.LOW: ValveName.RANGE_LOW, Range.HIGH: ValveName.RANGE_HIGH}


class GroupChange(NamedTuple):
    """A change of splitter or range: the valve for it, how far it is, and the fault if it fails."""

    valve: ValveName
    in_mesh: bool
    together: bool
    fault: FaultCode

    @property
    def done(self) -> bool:
        """In mesh and synchronised."""
        return self.in_mesh and self.together


def change_splitter(context: ShiftContext, snapshot: StepSnapshot) -> Trigger | None:
    """A shift by the splitter alone; the main box stays in its gear."""
    if context.sheet.has_dog_splitter:
        return change_by_dog_teeth(context, snapshot)
    missing = _unfinished(_push_steps(context, snapshot))
    if missing is None:
        context.end(snapshot, ShiftResult.ENGAGED, FaultCode.NONE)
        return Trigger.ENGAGED
    if context.late(snapshot, context.settings.limits.steps_ms):
        return context.give_up(snapshot, missing)
    return None


def change_steps(context: ShiftContext, snapshot: StepSnapshot) -> Trigger | None:
    """Changes splitter and range to those of the new gear while the main box is in neutral."""
    steps = _push_steps(context, snapshot)
    missing = _unfinished(steps)
    # Without a change nothing has disturbed the estimates, but a brake that acts makes them lag.
    if missing is None and (not steps or _tracked(snapshot)):
        return Trigger.STEPS_IN
    if context.late(snapshot, context.settings.limits.steps_ms):
        return context.give_up(snapshot, missing or FaultCode.SPEED_STALE)
    return None


def _push_steps(context: ShiftContext, snapshot: StepSnapshot) -> list[GroupChange]:
    """Drives the valves of changes that are not in mesh yet; returns all changes."""
    steps = _steps(context, snapshot)
    for step in steps:
        if step.in_mesh:
            context.board.off(step.valve)
        else:
            _push(context, step.valve, snapshot)
    return steps


def _unfinished(steps: list[GroupChange]) -> FaultCode | None:
    """The fault to declare for the first change that is not finished; None if all are."""
    return next((step.fault for step in steps if not step.done), None)


def _tracked(snapshot: StepSnapshot) -> bool:
    """Whether the estimated speeds agree with the measured ones after the synchronisers have
    acted."""
    layshaft, main = snapshot.layshaft.at(snapshot.now_us), snapshot.main
    if layshaft is None or main is None:
        return False
    for estimate, seen in (
        (layshaft.omega_rad_s, snapshot.speeds.layshaft),
        (main.omega_rad_s, snapshot.speeds.main),
    ):
        if seen is None or abs(estimate - seen) > 0.05 * seen:
            return False
    return True


def _steps(context: ShiftContext, snapshot: StepSnapshot) -> list[GroupChange]:
    """The changes that this shift needs: splitter and range where they differed from the new gear
    when the shift began. The range is left out unless the main box is in neutral."""
    target, view, speeds = context.running.target, snapshot.view, snapshot.speeds
    from_ = _stood(view, context)
    steps = []
    # One with dog teeth changes in a leg of its own.
    if from_[0] is not target.split and not context.sheet.has_dog_splitter:
        rests = from_[0] is None and _layshaft_rests(snapshot)
        split = Split.HIGH if rests else target.split
        steps.append(
            GroupChange(
                SPLIT_VALVE[split],
                view.split is split,
                speeds.split_turns_together(split),
                FaultCode.SPLITTER_FAILED,
            )
        )
    if from_[1] is not target.range_ and view.main_gear is MainGear.NEUTRAL:
        steps.append(
            GroupChange(
                RANGE_VALVE[target.range_],
                view.range_ is target.range_,
                speeds.range_turns_together(target.range_),
                FaultCode.RANGE_FAILED,
            )
        )
    return steps


def _layshaft_rests(snapshot: StepSnapshot) -> bool:
    """Whether the layshaft was left to itself by a splitter between its steps, until its speed was
    unknown. The guard (row 9) forbids the low step then; by the high one it turns again."""
    return snapshot.view.split is None and snapshot.speeds.layshaft is None


def _stood(view: GearboxView, context: ShiftContext) -> tuple[Split | None, Range | None]:
    """Where splitter and range stood when the shift began."""
    shift = context.running
    if shift.steps_before is None:
        shift.steps_before = (view.split, view.range_)
    return shift.steps_before


def _push(context: ShiftContext, valve: ValveName, snapshot: StepSnapshot) -> None:
    command, unloaded_us = context.board.command(valve), context.unloaded_us(snapshot, valve)
    if unloaded_us is None:
        context.board.off(valve)
    elif not command.on or command.time_us > snapshot.earliest_us:
        context.board.schedule(valve, True, unloaded_us, snapshot.now_us)
    elif snapshot.now_us - command.time_us > PUSH_US:
        context.board.off(valve)
