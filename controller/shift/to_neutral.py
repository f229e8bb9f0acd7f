"""A main sleeve comes to rest in neutral, out of its gear or from before the teeth.

A sleeve is a mass between two chambers and does not stop by itself where it is wanted: it is pulled
by a pulse that ends before neutral, and comes to rest there in its detent.
"""

from __future__ import annotations

from meshpoint.controller.shift.context import OPPOSITE, SLEEVE_VALVE, ShiftContext
from meshpoint.controller.shift.step_snapshot import StepSnapshot
from meshpoint.gearbox import MainGear
from meshpoint.gearbox.gears import SLEEVE_OF_MAIN


def bring_to_neutral(context: ShiftContext, snapshot: StepSnapshot, gear: MainGear) -> bool:
    """Pulls a sleeve that stands before this gear's teeth, or on them, to neutral; whether that is
    still under way."""
    sleeve = SLEEVE_OF_MAIN[gear].sleeve
    if is_under_way(context, snapshot, gear):
        return True
    if snapshot.view.in_neutral(sleeve):
        return False
    pulse = context.sleeves.to_neutral(sleeve, snapshot.earliest_us)
    if pulse is None:
        return False
    context.board.pulse(pulse.valve, pulse.on_us, pulse.off_us, snapshot.now_us)
    return True


def is_under_way(context: ShiftContext, snapshot: StepSnapshot, gear: MainGear) -> bool:
    """Whether a valve of this gear's sleeve is driven or will be, or the sleeve still moves."""
    now_us, board = snapshot.now_us, context.board
    valves = (OPPOSITE[gear], SLEEVE_VALVE[gear])
    if not all(board.command(valve).rests(now_us) for valve in valves):
        return True
    return context.sleeves.place(SLEEVE_OF_MAIN[gear].sleeve, snapshot.earliest_us).is_moving
