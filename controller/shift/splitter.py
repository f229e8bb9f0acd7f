"""A splitter with dog teeth: its sleeve is fired at a slip that is wanted (`window.fire_slip_rpm`).

The main box stays in its gear meanwhile, so that the layshaft turns with the vehicle. The clutch is
open, and once its sleeve is out the input shaft turns alone and is slowed down by drag, which is
little. So the engine brings it through the clutch to a speed above the new step's first, up or
down, and opens the clutch again. The sleeve comes from above: it turns faster than the gear, the
other way round than in the main box.

It is not aimed: nothing predicts the input shaft's angle. Tooth meets gap by chance; the slip is
large enough for a gap to come by before friction on the faces has brought the light input shaft to
the gear's speed, where it would stick.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from meshpoint.controller.measure.gearbox_view import VIEW_NEUTRAL_M
from meshpoint.controller.settings.settings import MS_IN_US, SPEEDS_RAD_S, splitter_ms
from meshpoint.controller.settings.valve_name import DOG_VALVE
from meshpoint.controller.shift.context import ShiftContext
from meshpoint.controller.shift.disengage import CLEAR_M, bring_to_neutral, pull_out
from meshpoint.controller.shift.engine import CARRIED_RAD_S, SHORT_RAD_S
from meshpoint.controller.shift.legs import leg_done
from meshpoint.controller.shift.step_snapshot import StepSnapshot
from meshpoint.controller.shift.table import Trigger
from meshpoint.dbc.messages import ClutchAction, FaultCode, Strategy
from meshpoint.gearbox import Sleeve
from meshpoint.gearbox.gears import SIDE_OF, SPLIT_GEAR, SplitGear
from meshpoint.units import RPM, SECOND_US, US

MINE: Final = (Sleeve.SPLITTER,)
FALL_US: Final = 100 * MS_IN_US
"""How fast the input shaft falls is taken over so long."""
LEAST_FALL_US: Final = 30 * MS_IN_US
SWING_US: Final = 180 * MS_IN_US
"""In so long a driveline has swung to both its ends: with a gear in the layshaft swings with it."""
SEEN_LATE_US: Final = 15 * MS_IN_US
"""A measured speed is so old on the average."""
LEAST_SLIP_RAD_S: Final = 20.0 * RPM
"""With less slip a sleeve is not fired: a tooth that meets a tooth would stick on it at once."""
SLACK_RAD_S: Final = 15.0 * RPM
"""The slip at contact may be so much less than wanted: what a drive by the engine comes out at."""
MOST_FRICTION: Final = 0.16
"""Of tooth on tooth, in oil: 0.06 to 0.16 are published."""


class Meeting(NamedTuple):
    """Input shaft and new step, rad/s: how much faster the sleeve turns than the gear."""

    slip: float
    """By the layshaft's mean speed over a swing of the driveline."""
    swing: float
    """By so much the gear swings about that."""
    step_rad_s: float
    """The gear's speed, as a mean."""
    falls_rad_s2: float | None
    """How fast the input shaft falls by itself; None while that is not known."""


def change_by_dog_teeth(context: ShiftContext, snapshot: StepSnapshot) -> Trigger | None:
    """Out of the old step, the shafts to one speed, into the new step."""
    shift, split, view = context.running, context.running.target.split, snapshot.view
    change, gear = shift.splitter, SPLIT_GEAR[split]
    if view.split is split and snapshot.speeds.split_turns_together(split):
        if shift.attempts == 0:  # so far this is the whole shift
            shift.attempts, shift.first_fire_us = change.attempts, change.fire_us
            shift.strategy = Strategy.SPEED_WINDOW
        return leg_done(context, snapshot)
    if _is_over(context, snapshot):
        return context.give_up(snapshot, FaultCode.SPLITTER_FAILED)
    meeting = _meeting(context, snapshot, gear)
    if view.split is not None and view.split is not split:
        pull_out(context, snapshot, SPLIT_GEAR[view.split])
        return None
    if change.fire_us is not None:
        _watch_contact(context, snapshot, gear)
        return None
    is_out = abs(view.position_m(Sleeve.SPLITTER)) < context.sheet.sleeve.to_contact_m - CLEAR_M
    is_moving = bring_to_neutral(context, snapshot, stands=False, sleeves=MINE)
    if meeting is None or (is_out and _is_driven(context, snapshot, gear, meeting)):
        return None
    context.clutch = ClutchAction.OPEN
    if context.engine_rad_s is not None:
        # It goes on at that speed until the step is in: it would take the shaft along.
        _ask_engine(context, meeting.step_rad_s + _wanted_slip(context, meeting))
    is_neutral = abs(view.position_m(Sleeve.SPLITTER)) < VIEW_NEUTRAL_M
    if is_neutral and not is_moving and view.clutch_parted:
        _fire_when_due(context, snapshot, gear, meeting)
    return None


def is_between(context: ShiftContext, snapshot: StepSnapshot) -> bool:
    """Whether the sleeve of a splitter with dog teeth is neither in a step nor in neutral."""
    view = snapshot.view
    out = abs(view.position_m(Sleeve.SPLITTER)) >= VIEW_NEUTRAL_M
    return context.sheet.has_dog_splitter and view.split is None and out


def _is_over(context: ShiftContext, snapshot: StepSnapshot) -> bool:
    """Whether it was fired as often as it may be, or takes too long; a sleeve is not left at the
    teeth."""
    limits, change = context.settings.limits, context.running.splitter
    is_tried = change.attempts >= limits.attempts and change.fire_us is None
    is_tried = is_tried and not is_between(context, snapshot)
    return is_tried or context.late(snapshot, splitter_ms(context.settings))


def _meeting(context: ShiftContext, snapshot: StepSnapshot, gear: SplitGear) -> Meeting | None:
    """How the two meet, from this step's speeds and those before; None where one is not known."""
    speeds, change, now_us = snapshot.speeds, context.running.splitter, snapshot.now_us
    if speeds.input_ is None or speeds.layshaft is None:
        return None
    change.layshafts.append((now_us, speeds.layshaft))
    while now_us - change.layshafts[0][0] > SWING_US:
        del change.layshafts[0]
    if snapshot.view.clutch_parted:
        change.inputs.append((now_us, speeds.input_))
    else:
        change.inputs.clear()
    ratio = context.sheet.dog_mesh(gear).ratio
    turning = [speed for _, speed in change.layshafts]
    mean, swing = math.fsum(turning) / len(turning), 0.5 * (max(turning) - min(turning))
    falls = _falls_rad_s2(change.inputs)
    return Meeting(speeds.input_ - ratio * mean, ratio * swing, ratio * mean, falls)


def _falls_rad_s2(inputs: list[tuple[int, float]]) -> float | None:
    """How fast the input shaft falls, by its speeds since it has turned alone."""
    while inputs and inputs[-1][0] - inputs[0][0] > FALL_US:
        del inputs[0]
    if not inputs or inputs[-1][0] - inputs[0][0] < LEAST_FALL_US:
        return None
    (first_us, first), (last_us, last) = inputs[0], inputs[-1]
    return max(0.0, (first - last) / ((last_us - first_us) * US))


def _wanted_slip(context: ShiftContext, meeting: Meeting) -> float:
    """The slip wanted at contact: a tooth that meets a tooth passes its whole face before friction
    there has brought the input shaft to the gear's speed, dw^2 = 2 (mu F r / J_IS) (p - b), also as
    the driveline swings; and no more than the guard lets pass."""
    sheet, dog = context.sheet, context.sheet.teeth_of(Sleeve.SPLITTER)
    force_n = sheet.air.supply_gauge_pa * sheet.sleeve.bore_m2
    slowed_rad_s2 = MOST_FRICTION * force_n * dog.radius_m / sheet.shafts.input_inertia_kgm2
    passes = math.sqrt(2.0 * slowed_rad_s2 * (dog.pitch_rad - dog.backlash_rad))
    least = max(context.settings.window.fire_slip_rad_s, passes + meeting.swing)
    return min(least, _highest_slip(context, meeting))


def _highest_slip(context: ShiftContext, meeting: Meeting) -> float:
    """The guard surely lets a sleeve go on at no more."""
    return context.settings.guard.slip_high_rad_s - SPEEDS_RAD_S - meeting.swing


def _is_driven(
    context: ShiftContext, snapshot: StepSnapshot, gear: SplitGear, meeting: Meeting
) -> bool:
    """Whether the engine brings the input shaft to the new step's speed, and closes or opens the
    clutch for it: a shaft that is too slow, or that drag would take too long to slow down."""
    change, limits = context.running.splitter, context.settings.limits
    wanted = _wanted_slip(context, meeting)
    if not change.is_driven:
        falls = meeting.falls_rad_s2
        if falls is None or change.drives >= limits.raises:
            return False
        over = meeting.slip - falls * (context.sheet.sleeve.delay_s + SEEN_LATE_US * US)
        coasted = falls * limits.coast_ms * MS_IN_US * US
        if wanted - SLACK_RAD_S <= over <= max(wanted + coasted, _highest_slip(context, meeting)):
            return False
        change.is_driven, change.falls_rad_s2 = True, falls
        change.drives += 1
    wanted += change.falls_rad_s2 * _lost_s(context) + SHORT_RAD_S
    wanted = min(wanted, _most_slip(context, gear))
    if _arrives(context, snapshot, meeting.step_rad_s + wanted):
        change.is_driven = False
        return False
    context.clutch = ClutchAction.CLOSE
    _ask_engine(context, meeting.step_rad_s + wanted)
    return True


def _ask_engine(context: ShiftContext, speed: float) -> None:
    """Asks the engine for a speed (rad/s), where it is one that it may have."""
    usable = context.settings.engine.least_rad_s <= speed <= context.sheet.limits.input_max_rad_s
    context.engine_rad_s = speed if usable else None


def _lost_s(context: ShiftContext) -> float:
    """From the clutch's setting off until a sleeve fired as the plates part comes to its gear."""
    clutch = context.sheet.clutch
    return clutch.open_delay_s * (1.0 - clutch.kiss_share) + context.sheet.sleeve.delay_s


def _most_slip(context: ShiftContext, gear: SplitGear) -> float:
    """Above the new step's speed the guard lets the engine be asked for no more."""
    sheet = context.sheet
    through = sheet.dog_mesh(gear).ratio / sheet.main_mesh(context.running.target.main).ratio
    return through * context.settings.guard.slip_high_rad_s - SPEEDS_RAD_S


def _arrives(context: ShiftContext, snapshot: StepSnapshot, wanted_rad_s: float) -> bool:
    """Whether the plates carry the input shaft, and the engine brings it to that speed by the time
    that they part, if the clutch is opened now."""
    sheet, speed, engine = context.sheet, snapshot.speeds.input_, snapshot.engine_rad_s
    if speed is None or engine is None or abs(speed - engine) > CARRIED_RAD_S:
        return False
    meeting = max(0.0, (snapshot.view.clutch_closed or 0.0) - sheet.clutch.kiss_share)
    parting_s = meeting * sheet.clutch.open_delay_s + context.tick_us * US
    lag_s = sheet.engine.lag_s
    comes = context.torque.engine_rad_s2 * lag_s * (1.0 - math.exp(-parting_s / lag_s))
    return abs(engine + comes - wanted_rad_s) <= SHORT_RAD_S


def _fire_when_due(
    context: ShiftContext, snapshot: StepSnapshot, gear: SplitGear, meeting: Meeting
) -> None:
    """Fires so that the slip at contact is the one wanted, or what is left of it."""
    shift, falls = context.running, meeting.falls_rad_s2
    if falls is None or meeting.slip < LEAST_SLIP_RAD_S:
        return
    fire_us = snapshot.earliest_us
    contact_us = context.sleeves.stroke(gear, fire_us).contact_us
    ahead_s = (contact_us - snapshot.now_us + SEEN_LATE_US) * US
    met, wanted = meeting.slip - falls * ahead_s, _wanted_slip(context, meeting)
    wait_us = SECOND_US * (met - wanted) / falls if falls > 0.0 else math.inf
    is_soon = wait_us <= context.settings.limits.coast_ms * MS_IN_US
    if met > wanted and (is_soon or met > _highest_slip(context, meeting)):
        # Where the plates hold the shaft up, some slip more costs less than the wait.
        if wait_us > context.tick_us:
            return
        fire_us += round(wait_us)
    shift.splitter.fire_us = fire_us
    shift.splitter.attempts += 1
    shift.splitter.drives = 0
    context.board.schedule(DOG_VALVE[gear], True, fire_us, snapshot.now_us)


def _watch_contact(context: ShiftContext, snapshot: StepSnapshot, gear: SplitGear) -> None:
    """Until the step is in; a sleeve that stands on a tooth for too long goes back."""
    change, limits, side = context.running.splitter, context.settings.limits, SIDE_OF[gear]
    fire_us = change.fire_us or 0
    contact_us = context.sleeves.contact_us(gear, fire_us)
    way_m = snapshot.view.position_m(Sleeve.SPLITTER) * side.direction
    is_at_face = way_m < context.sheet.sleeve.to_contact_m + CLEAR_M
    rests = contact_us is not None and snapshot.now_us - contact_us > limits.face_ms * MS_IN_US
    late = snapshot.now_us - fire_us > limits.engage_ms * MS_IN_US
    if (rests and is_at_face) or late:
        context.board.off(DOG_VALVE[gear])
        change.fire_us = None
        change.inputs.clear()
