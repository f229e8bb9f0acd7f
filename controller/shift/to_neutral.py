"""Main sleeves come to rest in neutral, out of a gear or from before its teeth.

A sleeve is a mass between two chambers and does not stop by itself where it is wanted: it is pulled
by a pulse that ends before neutral, and comes to rest there in its detent.
"""

from __future__ import annotations

from typing import Final

from meshpoint.controller.planning.strategies.base import BUS_US
from meshpoint.controller.sensing.gearbox_view import VIEW_NEUTRAL_M
from meshpoint.controller.settings import MS_IN_US
from meshpoint.controller.shift.context import ShiftContext
from meshpoint.controller.shift.step_snapshot import StepSnapshot
from meshpoint.gearbox.gears import MAIN_SLEEVES

RESTS_US: Final = 60 * MS_IN_US
"""A sleeve whose valves are off comes to rest within this time."""


def has_left_neutral(snapshot: StepSnapshot) -> bool:
    """Whether a main sleeve is measured out of neutral."""
    return any(not snapshot.view.in_neutral(sleeve) for sleeve in MAIN_SLEEVES)


def comes_to_rest(context: ShiftContext, snapshot: StepSnapshot) -> bool:
    """Whether both main sleeves come to rest in neutral as commanded, none driven any more."""
    if not context.main_valves_rest(snapshot.now_us):
        return False
    at_us = snapshot.now_us + RESTS_US
    places = [context.sleeves.place(sleeve, at_us) for sleeve in MAIN_SLEEVES]
    return all(abs(place.m) < VIEW_NEUTRAL_M for place in places)


def bring_to_neutral(context: ShiftContext, snapshot: StepSnapshot) -> bool:
    """Brings the main sleeves that do not come to rest in neutral by themselves there, one after
    the other: pulls one that falls short, brakes one that flies past. Whether that is still under
    way."""
    if not context.main_valves_rest(snapshot.now_us):
        return True
    for sleeve in MAIN_SLEEVES:
        pulse = context.sleeves.to_neutral(sleeve, snapshot.now_us + BUS_US)
        if pulse is not None:
            context.board.pulse(pulse.valve, pulse.on_us, pulse.off_us, snapshot.now_us)
            return True
    return is_under_way(context, snapshot)


def is_under_way(context: ShiftContext, snapshot: StepSnapshot) -> bool:
    """Whether a main valve is driven or will be, or a main sleeve still moves."""
    if not context.main_valves_rest(snapshot.now_us):
        return True
    places = [context.sleeves.place(sleeve, snapshot.earliest_us) for sleeve in MAIN_SLEEVES]
    return any(place.is_moving for place in places)
