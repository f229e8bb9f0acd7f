"""A main sleeve comes to rest in neutral: out of its gear, or from before the teeth.

A sleeve is a mass between two chambers and does not stop by itself where it is wanted: the valve
that pulls it goes off before neutral, and the other one brakes it.
"""

from __future__ import annotations

from meshpoint.controller.planning.strategies.base import BUS_US
from meshpoint.controller.shift.context import OPPOSITE, SLEEVE_VALVE, ShiftContext
from meshpoint.controller.shift.step_snapshot import StepSnapshot
from meshpoint.gearbox import MainGear
from meshpoint.gearbox.gears import SLEEVE_OF_MAIN


def bring_to_neutral(context: ShiftContext, snapshot: StepSnapshot, gear: MainGear) -> bool:
    """Pulls the sleeve of this gear to neutral; whether that is still under way."""
    board, now_us = context.board, snapshot.now_us
    if not board.command(OPPOSITE[gear]).rests(now_us):
        stop_in_neutral(context, snapshot, gear)
        return True
    if not board.command(SLEEVE_VALVE[gear]).rests(now_us):
        return True
    sleeve = SLEEVE_OF_MAIN[gear].sleeve
    place = context.sleeves.place(sleeve, snapshot.earliest_us)
    if place.is_moving:
        return True
    if snapshot.view.in_neutral(sleeve):
        return False
    # The sleeve may stand on either side of neutral.
    away = place.position_m * SLEEVE_OF_MAIN[gear].direction < 0.0
    valve = SLEEVE_VALVE[gear] if away else OPPOSITE[gear]
    board.schedule(valve, True, snapshot.earliest_us, now_us)
    stop_in_neutral(context, snapshot, gear)
    return True


def stop_in_neutral(context: ShiftContext, snapshot: StepSnapshot, gear: MainGear) -> None:
    """Ends the pull so that the sleeve comes to rest in neutral, once the end has come so near
    that it can be commanded."""
    board, now_us = context.board, snapshot.now_us
    pulls, brakes = OPPOSITE[gear], SLEEVE_VALVE[gear]
    command = board.command(pulls)
    stop = context.sleeves.stop_in_neutral(gear, now_us + BUS_US)
    if not command.on or stop is None or stop.off_us > snapshot.earliest_us + context.tick_us:
        return
    board.pulse(pulls, command.time_us, stop.off_us, now_us)
    if stop.brake_until_us > stop.off_us:
        board.pulse(brakes, stop.off_us, stop.brake_until_us, now_us)
