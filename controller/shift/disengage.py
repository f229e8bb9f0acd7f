"""The old gear comes out: clutch open, then the sleeve to neutral (thesis 2.2).

A sleeve is a mass between two chambers and does not stop by itself where it is wanted: it is pulled
by a pulse that ends before neutral, and comes to rest there in its detent, out of a gear or from
before its teeth.

The brake gets its air before that, as soon as the teeth are seen to be out and stay so. Sooner, the
guard could not prove that no teeth are loaded: once its valve is off, a sleeve that is still
between the teeth may stop there.
"""

from __future__ import annotations

import math
from typing import Final

from meshpoint.controller.estimate.reference import RELEASED
from meshpoint.controller.measure.gearbox_view import VIEW_NEUTRAL_M
from meshpoint.controller.settings.settings import MS_IN_US
from meshpoint.controller.settings.valve_name import (
    DOG_OPPOSITE,
    DOG_VALVE,
    OPPOSITE,
    SLEEVE_VALVE,
    ValveName,
)
from meshpoint.controller.shift.context import ShiftContext
from meshpoint.controller.shift.engine import raise_ahead, ramp_down
from meshpoint.controller.shift.step_snapshot import StepSnapshot
from meshpoint.controller.shift.synchronise import plan_release
from meshpoint.controller.shift.table import Trigger
from meshpoint.controller.sleeve.stroke import Pulse
from meshpoint.dbc.messages import ClutchAction, FaultCode
from meshpoint.gearbox import MainGear
from meshpoint.gearbox.gears import (
    MAIN_GEARS,
    MAIN_SLEEVES,
    SIDE_OF,
    SLEEVE_OF_MAIN,
    DogGear,
    Sleeve,
)
from meshpoint.units import SECOND_US

CLEAR_M: Final = 1.0e-3
"""A sleeve this far before a gear's teeth has none between them."""
PRESSED_PA: Final = 0.8e5
"""With more than this, gauge, the brake presses: no gear is pulled out then, and no tooth moved on
by another pulse. The guard draws the line a little higher."""
BRAKES_US: Final = 20 * MS_IN_US
"""So soon after the end of a push a pulse against it brakes."""
_OTHER: Final = {valve: DOG_OPPOSITE[gear] for gear, valve in DOG_VALVE.items()}
EARLY_US: Final = MS_IN_US // 2
"""A step may come by so much sooner than a tick of the sensor clock after the one before: clocks
differ, and that one may have been late."""
RESTS_US: Final = 60 * MS_IN_US
"""A sleeve whose valves are off comes to rest within this time."""

LEAVES_M_S: Final = 0.1
"""A sleeve faster than this is surely on its way."""

PULL_PAUSE_US: Final = 60 * MS_IN_US
"""The valve is off for this long between two attempts: torque on the teeth may reverse
meanwhile."""
SHOWS_US: Final = 140 * MS_IN_US
"""A pull that has taken a gear out has done so by so much later than its valve's current, what the
gear turns by then is read and acted on (50 ms), and the main shaft may swing along with it for half
a period (90 ms)."""
LEAST_DRAG_RAD_S2: Final = 5.0
"""No layshaft falls more slowly: bearings and oil."""


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
        if not waits or sleeves_stand(context, snapshot):
            return Trigger.MAIN_BOX_NEUTRAL
        return None
    if gear is not None and gear is not MainGear.NEUTRAL:
        if stays_in(context, snapshot):
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
        raise_ahead(context, snapshot, stays_out=_is_out(context, snapshot))
    else:
        context.clutch, context.engine_rad_s = ClutchAction.OPEN, None
    return None


def pull_out(context: ShiftContext, snapshot: StepSnapshot, gear: DogGear) -> None:
    """Sends the pulse that pulls this gear out as the plates part. A time that can still be moved
    follows the clutch, and a clutch that stops or comes back takes the command back."""
    valve = DOG_OPPOSITE[gear]
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
        shift.pull_again_us = pulse.off_us + max(PULL_PAUSE_US, _shows_us(context, snapshot, gear))
    elif command.rests(now_us) and context.board.command(DOG_VALVE[gear]).rests(now_us):
        # One that has begun early shows before its gear is measured out.
        sleeve = SIDE_OF[gear].sleeve
        brake = context.sleeves.brake(sleeve, snapshot.at_once_us)
        if brake is not None:
            _push(context, snapshot, sleeve, brake)


def _shows_us(context: ShiftContext, snapshot: StepSnapshot, gear: DogGear) -> int:
    """So long after a pull its shafts show a gear that has come out though its sleeve's sensor does
    not: drag has turned it by `free_rad`. Pulled sooner, the sleeve would go on to the opposite
    gear."""
    sheet, layshaft = context.sheet, snapshot.speeds.layshaft or 0.0
    split = snapshot.view.split or context.running.target.split
    drag_rad_s2 = snapshot.layshaft.drag_nm(layshaft) / sheet.inertia_kgm2(split)
    turned_rad = sheet.dog.free_rad / sheet.dog_mesh(gear).ratio
    turns_s = math.sqrt(2.0 * turned_rad / max(drag_rad_s2, LEAST_DRAG_RAD_S2))
    return SHOWS_US + round(turns_s * SECOND_US)


def stays_in(context: ShiftContext, snapshot: StepSnapshot) -> bool:
    """Whether the gear has been pulled often enough and for `limits.disengage_ms` in vain, or could
    not be pulled for as long as all attempts may take: a clutch that does not part."""
    shift, limits = context.running, context.settings.limits
    is_tried = shift.pulls >= limits.attempts and context.late(snapshot, limits.disengage_ms)
    is_late = context.late(snapshot, limits.attempts * limits.disengage_ms)
    return (is_tried or is_late) and _rests_after_pull(context, snapshot)


def _rests_after_pull(context: ShiftContext, snapshot: StepSnapshot) -> bool:
    is_over = snapshot.now_us >= context.running.pull_again_us
    return is_over and not is_under_way(context, snapshot)


def _may_pull(context: ShiftContext, snapshot: StepSnapshot, gear: DogGear) -> bool:
    """Whether the gear is to be pulled, or pulled once more: torque on the teeth may have reversed
    since."""
    if not (_rests_after_pull(context, snapshot) and context.sleeves.rests(gear)):
        return False
    context.running.pulls += 1
    if isinstance(gear, MainGear):
        context.mesh_changes.append(RELEASED)
    return True


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


def sleeves_stand(context: ShiftContext, snapshot: StepSnapshot) -> bool:
    """Whether both main sleeves are seen to stand since a valve last pushed one of them."""
    return context.is_shut(snapshot.now_us) and not is_under_way(context, snapshot)


def bring_to_neutral(
    context: ShiftContext,
    snapshot: StepSnapshot,
    *,
    stands: bool,
    sleeves: tuple[Sleeve, ...] = MAIN_SLEEVES,
) -> bool:
    """Brings the sleeves that do not come to rest in neutral by themselves there, one after the
    other. Whether that is still under way.

    stands: only a sleeve that stands is moved; else one that flies past is braked, too."""
    _withdraw_push(context, snapshot)
    is_driven = not context.valves_rest(snapshot.now_us, sleeves)
    if is_driven or (stands and _moves(context, snapshot, sleeves)):
        return True
    for sleeve in sleeves:
        if _may_be_in_mesh(context, snapshot, sleeve):
            return True
        pulse = context.sleeves.to_neutral(sleeve, snapshot.at_once_us)
        if pulse is not None:
            _push(context, snapshot, sleeve, pulse)
            return True
    return _moves(context, snapshot, sleeves)


def _push(context: ShiftContext, snapshot: StepSnapshot, sleeve: Sleeve, pulse: Pulse) -> None:
    """Sends a sleeve on to neutral, or brakes it on its way."""
    if not _brakes(context, pulse):
        pulse = ends_in_time(context, snapshot, pulse)
    context.board.pulse(pulse.valve, pulse.on_us, pulse.off_us, snapshot.now_us)
    if context.shift is not None:
        context.shift.pushed_us = pulse.off_us
        context.shift.is_braked = _brakes(context, pulse)
        context.shift.flies = context.shift.is_braked or not snapshot.view.rests(sleeve)


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
    little before would say the beginning once more, and the end would come a whole step late.

    Its end takes no more lead after a refusal: every pulse would be as much longer, where one that
    is refused ends with the next step."""
    lead_us = snapshot.earliest_us - snapshot.now_us - snapshot.more_lead_us
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


def _moves(
    context: ShiftContext, snapshot: StepSnapshot, sleeves: tuple[Sleeve, ...] = MAIN_SLEEVES
) -> bool:
    """Whether a sleeve moves, or has stood for so short a time that it may."""
    places = [context.sleeves.place(sleeve, snapshot.earliest_us) for sleeve in sleeves]
    return any(place.is_moving for place in places) or not all(map(snapshot.view.rests, sleeves))


def is_under_way(context: ShiftContext, snapshot: StepSnapshot) -> bool:
    """Whether a main valve is driven or will be, or a main sleeve still moves."""
    if not context.main_valves_rest(snapshot.now_us):
        return True
    return _moves(context, snapshot)


def brake_ahead(context: ShiftContext, snapshot: StepSnapshot) -> None:
    """Brakes while the old gear's sleeve is out of its teeth and not in neutral yet, and plans the
    release; only for a gear that is too fast, and where no other sleeve has to change before."""
    shift, command = context.running, context.board.command(ValveName.BRAKE)
    acts = command.on or context.board.driven(ValveName.BRAKE, snapshot.earliest_us)
    is_out = _is_out(context, snapshot)
    if acts and not is_out:
        context.brake_off(snapshot.now_us)
        shift.pulses, shift.release_us = shift.pulses - 1, None
    elif acts:
        predictor = context.predictor(shift.target.main, snapshot)
        if predictor is not None:
            # No sleeve can be fired yet: so much slip is left that drag may go on till it can be.
            plan_release(context, predictor, snapshot, context.strategist.acting(False))
    elif is_out and shift.release_us is None and _is_wanted(context, snapshot):
        shift.pulses += 1
        context.switch_brake(True, snapshot.earliest_us, snapshot)


def _is_wanted(context: ShiftContext, snapshot: StepSnapshot) -> bool:
    """Whether the new gear is so fast that drag alone would take longer than `limits.coast_ms`, and
    the guard has blocked nothing in this shift. Nor for a sleeve that has left neutral by itself:
    it is brought back first."""
    shift, view, sheet = context.running, snapshot.view, context.sheet
    target = shift.target
    if shift.blocks or shift.returns:
        return False
    slip, layshaft = snapshot.speeds.slip_rad_s(target.main), snapshot.speeds.layshaft
    if (view.split, view.range_) != (target.split, target.range_):
        return False
    if slip is None or layshaft is None or shift.pulses >= context.settings.limits.pulses:
        return False
    drag_rad_s2 = snapshot.layshaft.drag_nm(layshaft) / sheet.inertia_kgm2(target.split)
    coast_s = context.settings.limits.coast_ms * MS_IN_US / SECOND_US
    fall = sheet.main_mesh(target.main).ratio * drag_rad_s2 * coast_s
    return slip - context.settings.window.fire_slip_rad_s > fall


def _is_out(context: ShiftContext, snapshot: StepSnapshot) -> bool:
    """Whether the main sleeves are seen clear of all teeth, stay so by their commands, and do not
    move towards them, nor are being braked, which may bring one back. Neutral is not waited for:
    one that falls short takes far longer to it."""
    if context.running.flies and not context.main_valves_rest(snapshot.now_us):
        return False
    clear_m = context.sheet.sleeve.to_contact_m - CLEAR_M
    for sleeve in MAIN_SLEEVES:
        track = snapshot.view.tracks[sleeve]
        newest_m = abs(track.position_m)
        comes_back = track.outward_m_s > LEAVES_M_S and newest_m > VIEW_NEUTRAL_M
        if newest_m > clear_m or comes_back:
            return False
    at_us = snapshot.now_us + RESTS_US
    return all(abs(context.sleeves.place(one, at_us).m) <= clear_m for one in MAIN_SLEEVES)
