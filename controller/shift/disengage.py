"""The old gear comes out: clutch open, then the sleeve to neutral (thesis 2.2)."""

from __future__ import annotations

from typing import Final

from meshpoint.controller.settings import MS_IN_US
from meshpoint.controller.shift.brake_ahead import brake_ahead
from meshpoint.controller.shift.context import OPPOSITE, ShiftContext
from meshpoint.controller.shift.step_snapshot import StepSnapshot
from meshpoint.controller.shift.table import Trigger
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
    unloaded_us = context.unloaded_us(snapshot)
    if unloaded_us is not None and unloaded_us < snapshot.earliest_us + context.tick_us:
        return Trigger.CLUTCH_OPEN
    if snapshot.now_us - shift.clutch_us > context.settings.limits.clutch_ms * MS_IN_US:
        return context.give_up(snapshot, FaultCode.CLUTCH_STUCK)
    return None


def disengage(context: ShiftContext, snapshot: StepSnapshot) -> Trigger | None:
    """Pulls the old gear out, in a limited number of attempts; not if only the splitter changes."""
    shift, gear = context.running, snapshot.view.main_gear
    if gear is shift.target.main and snapshot.view.range_ is shift.target.range_:
        return Trigger.MAIN_BOX_STAYS
    if gear is MainGear.NEUTRAL:
        for valve in OPPOSITE.values():
            context.board.off(valve)
        changes_range = snapshot.view.range_ is not shift.target.range_
        # The range waits for a sleeve that runs through neutral to stand there.
        return None if changes_range and not snapshot.view.main_rests else Trigger.MAIN_BOX_NEUTRAL
    limits = context.settings.limits
    # An attempt is disengage_ms with the valve on, then PULL_PAUSE_US with the valve off.
    share_us = limits.disengage_ms * MS_IN_US + PULL_PAUSE_US
    tried, within_us = divmod(snapshot.now_us - context.since_us, share_us)
    if tried >= limits.attempts:
        return context.give_up(snapshot, FaultCode.DISENGAGE_FAILED)
    pull_out(context, snapshot, gear, within_us < limits.disengage_ms * MS_IN_US)
    brake_ahead(context, snapshot)
    return None


def pull_out(
    context: ShiftContext, snapshot: StepSnapshot, gear: MainGear | None, drive: bool
) -> None:
    """Switches the valve that pulls this gear out on as the plates part, or off; nothing if no gear
    is in mesh. A time that can still be moved follows the clutch, and a clutch that stops or comes
    back takes the command back."""
    if gear is None or gear is MainGear.NEUTRAL:
        return  # the sleeve has left its gear already
    valve, unloaded_us = OPPOSITE[gear], context.unloaded_us(snapshot)
    command = context.board.command(valve)
    if not drive or unloaded_us is None:
        context.board.off(valve)
    elif not command.on:
        context.board.schedule(valve, True, unloaded_us, snapshot.now_us)
        context.references.released()
    elif command.time_us > snapshot.earliest_us:
        context.board.schedule(valve, True, unloaded_us, snapshot.now_us)
