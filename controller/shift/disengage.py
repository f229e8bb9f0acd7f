"""The old gear comes out: clutch open, then the sleeve to neutral (thesis 2.2)."""

from __future__ import annotations

from typing import Final

from meshpoint.controller.settings.settings import MS_IN_US
from meshpoint.controller.settings.valve_name import OPPOSITE
from meshpoint.controller.shift.brake_ahead import brake_ahead
from meshpoint.controller.shift.context import ShiftContext
from meshpoint.controller.shift.speed_up import raise_ahead
from meshpoint.controller.shift.step_snapshot import StepSnapshot
from meshpoint.controller.shift.table import Trigger
from meshpoint.controller.shift.to_neutral import (
    bring_to_neutral,
    comes_to_rest,
    ends_in_time,
    is_under_way,
    stand,
)
from meshpoint.controller.shift.torque_ramp import ramp_down
from meshpoint.dbc.messages import ClutchAction, FaultCode
from meshpoint.gearbox import MainGear

PULL_PAUSE_US: Final = 60 * MS_IN_US
"""The valve is off for this long between two attempts: torque on the teeth may reverse
meanwhile."""


def open_clutch(context: ShiftContext, snapshot: StepSnapshot) -> Trigger | None:
    """Takes the engine's torque away, opens the clutch, and waits until it is time to command the
    valve that moves a sleeve as the plates part."""
    shift = context.running
    if not ramp_down(context, snapshot) and shift.clutch_us is None:
        return None
    context.clutch = ClutchAction.OPEN
    if shift.clutch_us is None:
        shift.clutch_us = snapshot.now_us
        # What the first plan asks for is worked out here: its step has enough to do.
        context.sleeves.abort_after_us(shift.target.main)
    gear = snapshot.view.main_gear
    pulls = None if gear is None else OPPOSITE.get(gear)
    unloaded_us = context.unloaded_us(snapshot, pulls)
    if unloaded_us is not None and unloaded_us < snapshot.earliest_us + context.tick_us:
        return Trigger.CLUTCH_OPEN
    if snapshot.now_us - shift.clutch_us > context.settings.limits.clutch_ms * MS_IN_US:
        return context.give_up(snapshot, FaultCode.CLUTCH_STUCK)
    return None


def disengage(context: ShiftContext, snapshot: StepSnapshot) -> Trigger | None:
    """Pulls the old gear out, in a limited number of attempts; not if only the splitter changes."""
    shift, gear, limits = context.running, snapshot.view.main_gear, context.settings.limits
    if gear is shift.target.main and snapshot.view.range_ is shift.target.range_:
        return Trigger.MAIN_BOX_STAYS
    if gear is MainGear.NEUTRAL and comes_to_rest(context, snapshot):
        # The range waits for a sleeve that runs through neutral to stand there, and the brake for
        # one that was pushed back: the guard takes it to be on its way to a gear until then.
        is_pushed = shift.pushed_us is not None and not shift.is_braked
        waits = is_pushed or snapshot.view.range_ is not shift.target.range_
        if not waits or stand(context, snapshot):
            return Trigger.MAIN_BOX_NEUTRAL
        return None
    if gear is not None and gear is not MainGear.NEUTRAL:
        if _stays_in(context, snapshot):
            return context.give_up(snapshot, FaultCode.DISENGAGE_FAILED)
        pull_out(context, snapshot, gear)
    elif shift.returns > limits.attempts or context.late(
        snapshot, limits.attempts * limits.disengage_ms
    ):
        return context.give_up(snapshot, FaultCode.DISENGAGE_FAILED)
    else:
        bring_to_neutral(context, snapshot, stands=False)
    brake_ahead(context, snapshot)
    if gear is None or gear is MainGear.NEUTRAL:
        raise_ahead(context, snapshot)
    return None


def pull_out(context: ShiftContext, snapshot: StepSnapshot, gear: MainGear) -> None:
    """Sends the pulse that pulls this gear out as the plates part. A time that can still be moved
    follows the clutch, and a clutch that stops or comes back takes the command back."""
    valve = OPPOSITE[gear]
    unloaded_us = context.unloaded_us(snapshot, valve)
    shift, now_us, command = context.running, snapshot.now_us, context.board.command(valve)
    if unloaded_us is None:
        context.board.off(valve)
        return
    if command.on and command.time_us <= snapshot.earliest_us < command.until_us:
        return  # under way
    is_ahead = command.on and command.time_us > snapshot.earliest_us
    if is_ahead or _may_pull(context, snapshot, gear):
        pulse = context.sleeves.pull_out(gear, unloaded_us, max(0, shift.pulls - 1))
        pulse = ends_in_time(context, snapshot, pulse)
        if is_ahead and unloaded_us <= command.time_us <= pulse.on_us:
            return  # each step would put it off once more
        context.board.pulse(valve, pulse.on_us, pulse.off_us, now_us)
        shift.pull_again_us = pulse.off_us + PULL_PAUSE_US


def _stays_in(context: ShiftContext, snapshot: StepSnapshot) -> bool:
    """Whether the gear has been pulled often enough and for `limits.disengage_ms` in vain, or could
    not be pulled for as long as all attempts may take: a clutch that does not part."""
    shift, limits = context.running, context.settings.limits
    is_tried = shift.pulls >= limits.attempts and context.late(snapshot, limits.disengage_ms)
    is_late = context.late(snapshot, limits.attempts * limits.disengage_ms)
    return (is_tried or is_late) and _rests_after_pull(context, snapshot)


def _rests_after_pull(context: ShiftContext, snapshot: StepSnapshot) -> bool:
    is_over = snapshot.now_us >= context.running.pull_again_us
    return is_over and not is_under_way(context, snapshot)


def _may_pull(context: ShiftContext, snapshot: StepSnapshot, gear: MainGear) -> bool:
    """Whether the gear is to be pulled, or pulled once more: torque on the teeth may have reversed
    since."""
    if not (_rests_after_pull(context, snapshot) and context.sleeves.rests(gear)):
        return False
    context.running.pulls += 1
    context.references.released()
    return True
