"""Main sleeves come to rest in neutral, out of a gear or from before its teeth.

A sleeve is a mass between two chambers and does not stop by itself where it is wanted: it is pulled
by a pulse that ends before neutral, and comes to rest there in its detent.
"""

from __future__ import annotations

from typing import Final

from meshpoint.controller.measure.gearbox_view import VIEW_NEUTRAL_M
from meshpoint.controller.settings.settings import MS_IN_US
from meshpoint.controller.settings.valve_name import OPPOSITE, SLEEVE_VALVE
from meshpoint.controller.shift.context import ShiftContext
from meshpoint.controller.shift.step_snapshot import StepSnapshot
from meshpoint.controller.sleeve.stroke import Pulse
from meshpoint.gearbox.gears import MAIN_GEARS, MAIN_SLEEVES, SLEEVE_OF_MAIN, Sleeve

CLEAR_M: Final = 1.0e-3
"""A sleeve this far before a gear's teeth has none between them."""
PRESSED_PA: Final = 0.8e5
"""With more than this, gauge, the brake presses: the guard lets no gear be pulled out then."""
BRAKES_US: Final = 20 * MS_IN_US
"""So soon after the end of a push a pulse against it brakes."""
_OTHER: Final = {SLEEVE_VALVE[gear]: OPPOSITE[gear] for gear in MAIN_GEARS}
EARLY_US: Final = MS_IN_US // 2
"""A step may come by so much sooner than a tick of the sensor clock after the one before: clocks
differ, and that one may have been late."""
RESTS_US: Final = 60 * MS_IN_US
"""A sleeve whose valves are off comes to rest within this time."""


def has_left_neutral(snapshot: StepSnapshot) -> bool:
    """Whether a main sleeve is measured out of neutral."""
    return any(not snapshot.view.in_neutral(sleeve) for sleeve in MAIN_SLEEVES)


def comes_to_rest(context: ShiftContext, snapshot: StepSnapshot) -> bool:
    """Whether both main sleeves come to rest in neutral as commanded, none driven any more, and
    none that is to be braked."""
    if not context.main_valves_rest(snapshot.now_us):
        return False
    sleeves, at_us = context.sleeves, snapshot.now_us + RESTS_US
    return all(
        abs(sleeves.place(one, at_us).m) < VIEW_NEUTRAL_M
        and sleeves.brake(one, snapshot.at_once_us) is None
        for one in MAIN_SLEEVES
    )


def stand(context: ShiftContext, snapshot: StepSnapshot) -> bool:
    """Whether both main sleeves are seen to stand since a valve last pushed one of them."""
    return context.is_shut(snapshot.now_us) and not is_under_way(context, snapshot)


def bring_to_neutral(context: ShiftContext, snapshot: StepSnapshot, *, stands: bool) -> bool:
    """Brings the main sleeves that do not come to rest in neutral by themselves there, one after
    the other. Whether that is still under way.

    stands: only a sleeve that stands is moved; else one that flies past is braked, too."""
    _withdraw_push(context, snapshot)
    if not context.main_valves_rest(snapshot.now_us) or (stands and _moves(context, snapshot)):
        return True
    for sleeve in MAIN_SLEEVES:
        if _may_be_in_mesh(context, snapshot, sleeve):
            return True
        pulse = context.sleeves.to_neutral(sleeve, snapshot.at_once_us)
        if pulse is not None:
            if not _brakes(context, pulse):
                pulse = ends_in_time(context, snapshot, pulse)
            context.board.pulse(pulse.valve, pulse.on_us, pulse.off_us, snapshot.now_us)
            if context.shift is not None:
                context.shift.pushed_us = pulse.off_us
                context.shift.is_braked = _brakes(context, pulse)
            return True
    return _moves(context, snapshot)


def _withdraw_push(context: ShiftContext, snapshot: StepSnapshot) -> None:
    """A push is withdrawn where the sleeve goes by itself before the valve can have moved it: its
    detent may win over friction once the chambers are empty."""
    for gear in MAIN_GEARS:
        valve, sleeve = SLEEVE_VALVE[gear], SLEEVE_OF_MAIN[gear].sleeve
        is_pushed = not context.board.command(valve).rests(snapshot.now_us)
        if is_pushed and context.sleeves.rests(gear) and not snapshot.view.rests(sleeve):
            context.board.off(valve)


def ends_in_time(context: ShiftContext, snapshot: StepSnapshot, pulse: Pulse) -> Pulse:
    """The same pulse, a little later where it is too short: its end is sent by the first step that
    surely comes after its beginning, and none is shorter than what that takes. A step that comes a
    little before would say the beginning once more, and the end would come a whole step late."""
    lead_us = snapshot.earliest_us - snapshot.now_us
    long_us = max(pulse.off_us - pulse.on_us, EARLY_US + lead_us)
    sent_us = EARLY_US + (snapshot.now_us - EARLY_US - pulse.on_us) % context.tick_us
    on_us = pulse.on_us + max(0, sent_us + lead_us - long_us)
    return pulse._replace(on_us=on_us, off_us=on_us + long_us)


def _brakes(context: ShiftContext, pulse: Pulse) -> bool:
    """Whether the guard takes this pulse to brake what the sleeve's other valve has set going, and
    not to send it to a gear."""
    before = context.board.command(_OTHER[pulse.valve])
    return before.on and 0 <= pulse.on_us - before.until_us <= BRAKES_US


def _may_be_in_mesh(context: ShiftContext, snapshot: StepSnapshot, sleeve: Sleeve) -> bool:
    """Whether the sleeve is at a gear's teeth while the brake presses: no pull is allowed then."""
    at_teeth = abs(snapshot.view.position_m(sleeve)) > context.sheet.sleeve.to_contact_m - CLEAR_M
    return at_teeth and snapshot.view.brake_gauge_pa > PRESSED_PA


def _moves(context: ShiftContext, snapshot: StepSnapshot) -> bool:
    """Whether a main sleeve moves, or has stood for so short a time that it may."""
    places = [context.sleeves.place(sleeve, snapshot.earliest_us) for sleeve in MAIN_SLEEVES]
    return any(place.is_moving for place in places) or not snapshot.view.main_rests


def is_under_way(context: ShiftContext, snapshot: StepSnapshot) -> bool:
    """Whether a main valve is driven or will be, or a main sleeve still moves."""
    if not context.main_valves_rest(snapshot.now_us):
        return True
    return _moves(context, snapshot)
