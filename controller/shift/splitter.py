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

from meshpoint.controller.estimate.loaded_driveline import HeldLayshaft
from meshpoint.controller.measure.gearbox_view import VIEW_NEUTRAL_M
from meshpoint.controller.settings.settings import MS_IN_US, SPEEDS_RAD_S, splitter_ms
from meshpoint.controller.settings.valve_name import DOG_VALVE
from meshpoint.controller.shift.context import ShiftContext
from meshpoint.controller.shift.disengage import CLEAR_M, bring_to_neutral, pull_out, stays_in
from meshpoint.controller.shift.engine import CARRIED_RAD_S, SHORT_RAD_S
from meshpoint.controller.shift.legs import leg_done
from meshpoint.controller.shift.step_snapshot import StepSnapshot
from meshpoint.controller.shift.table import Trigger
from meshpoint.dbc.messages import ClutchAction, FaultCode
from meshpoint.gearbox import Sleeve
from meshpoint.gearbox.gears import SIDE_OF, SLEEVE_OF_MAIN, SPLIT_GEAR, SplitGear
from meshpoint.units import RPM, US

MINE: Final = (Sleeve.SPLITTER,)
FALL_US: Final = 100 * MS_IN_US
"""How fast the input shaft falls is taken over so long."""
LEAST_FALL_US: Final = 30 * MS_IN_US
SWING_US: Final = 400 * MS_IN_US
"""In so long a driveline has swung to both its ends: with a gear in the layshaft swings with it."""
SWINGS_SHARE: Final = 0.7
"""So far as it has swung it will swing again."""
PREDICTED_RAD_S: Final = 30.0 * RPM
"""The slip that is predicted for contact is so exact."""
SEEN_LATE_US: Final = 15 * MS_IN_US
"""A measured speed is so old on the average."""
SLACK_RAD_S: Final = 15.0 * RPM
"""The slip at contact may be so much less than wanted: what a drive by the engine comes out at."""
MOST_FRICTION: Final = 0.16
"""Of tooth on tooth, in oil: 0.06 to 0.16 are published."""


class Meeting(NamedTuple):
    """Input shaft and new step, rad/s: how much faster the sleeve turns than the gear."""

    slip: float
    """On the gear's mean speed."""
    swing: float
    """By so much the gear swings about that."""
    step_rad_s: float
    """The gear's speed, as a mean."""
    falls_rad_s2: float | None
    """How fast the input shaft falls by itself; None while that is not known."""
    now: float
    """The slip now."""
    met: float
    """The slip as a sleeve that is fired now comes to the gear."""


def change_by_dog_teeth(context: ShiftContext, snapshot: StepSnapshot) -> Trigger | None:
    """Out of the old step, the shafts to one speed, into the new step."""
    shift, split, view = context.running, context.running.target.split, snapshot.view
    change, gear = shift.splitter, SPLIT_GEAR[split]
    if view.split is split and snapshot.speeds.split_turns_together(split):
        return leg_done(context, snapshot)
    if _is_over(context, snapshot):
        return context.give_up(snapshot, FaultCode.SPLITTER_FAILED)
    meeting = _meeting(context, snapshot, gear)
    if view.split is not None and view.split is not split:
        if stays_in(context, snapshot):
            return context.give_up(snapshot, FaultCode.SPLITTER_FAILED)
        pull_out(context, snapshot, SPLIT_GEAR[view.split])
        return None
    if change.fire_us is not None:
        _watch_contact(context, snapshot, gear)
        return None
    is_out = abs(view.position_m(Sleeve.SPLITTER)) < context.sheet.sleeve.to_contact_m - CLEAR_M
    is_moving = bring_to_neutral(context, snapshot, stands=False, sleeves=MINE)
    if meeting is None:
        return None
    if not is_out and view.clutch_parted and change.attempts == 0:
        # The engine sets off while the sleeve comes out.
        _ask_engine(context, _driven_rad_s(context, gear, meeting, 0.0))
        return None
    if is_out and _is_driven(context, snapshot, gear, meeting):
        return None
    context.clutch = ClutchAction.OPEN
    if context.engine_rad_s is not None:
        # It goes on at that speed until the step is in: it would take the shaft along.
        _ask_engine(context, meeting.step_rad_s + _wanted_slip(context))
    is_neutral = abs(view.position_m(Sleeve.SPLITTER)) < VIEW_NEUTRAL_M
    if is_neutral and not is_moving and view.clutch_parted:
        _fire_when_due(context, snapshot, gear, meeting)
    return None


def is_between(context: ShiftContext, snapshot: StepSnapshot) -> bool:
    """Whether the sleeve of a splitter with dog teeth is neither in a step nor in neutral."""
    view = snapshot.view
    out = abs(view.position_m(Sleeve.SPLITTER)) >= VIEW_NEUTRAL_M
    return context.sheet.has_dog_splitter and view.split is None and out


def has_not_moved(context: ShiftContext, snapshot: StepSnapshot) -> bool:
    """Whether its sleeve was fired before and has not come in, or stands between a step and
    neutral: what the guard then forbids comes of it."""
    change = context.running.splitter
    earlier = change.attempts - (change.fire_us is not None)
    return earlier > 0 or is_between(context, snapshot)


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
    falls, ratio = _falls_rad_s2(change.inputs), context.sheet.dog_mesh(gear).ratio
    turning = [speed for _, speed in change.layshafts]
    swing = 0.5 * ratio * (max(turning) - min(turning))
    contact_us = context.sleeves.stroke(gear, snapshot.earliest_us).contact_us
    now, then = (_held(context, snapshot, at_us, turning) for at_us in (now_us, contact_us))
    fallen = (falls or 0.0) * (contact_us - now_us + SEEN_LATE_US) * US
    step, input_ = ratio * then.steady_rad_s, speeds.input_
    slips = input_ - ratio * now.omega_rad_s, input_ - fallen - ratio * then.omega_rad_s
    return Meeting(input_ - step, swing, step, falls, *slips)


def _held(
    context: ShiftContext, snapshot: StepSnapshot, time_us: int, turning: list[float]
) -> HeldLayshaft:
    """The layshaft at a time to come, by the driveline that turns it; where that is not known, as
    the main shaft's speed changes now, about the mean of its own of late."""
    loaded, main = snapshot.loaded, snapshot.main
    held = None if loaded is None else loaded.layshaft(time_us)
    if held is not None:
        return held
    gear = snapshot.view.main_gear
    omega = turning[-1]
    if main is not None and gear in SLEEVE_OF_MAIN:
        omega = main.omega_at(time_us) / context.sheet.main_mesh(gear).ratio
    return HeldLayshaft(omega, math.fsum(turning) / len(turning))


def _falls_rad_s2(inputs: list[tuple[int, float]]) -> float | None:
    """How fast the input shaft falls, by its speeds since it has turned alone."""
    while inputs and inputs[-1][0] - inputs[0][0] > FALL_US:
        del inputs[0]
    if not inputs or inputs[-1][0] - inputs[0][0] < LEAST_FALL_US:
        return None
    (first_us, first), (last_us, last) = inputs[0], inputs[-1]
    return max(0.0, (first - last) / ((last_us - first_us) * US))


def _wanted_slip(context: ShiftContext) -> float:
    """The slip wanted at contact: a tooth that meets a tooth passes its whole face before friction
    there has brought the input shaft to the gear's speed, dw^2 = 2 (mu F r / J_IS) (p - b)."""
    sheet, dog = context.sheet, context.sheet.teeth_of(Sleeve.SPLITTER)
    force_n = sheet.air.supply_gauge_pa * sheet.sleeve.bore_m2
    slowed_rad_s2 = MOST_FRICTION * force_n * dog.radius_m / sheet.shafts.input_inertia_kgm2
    passes = math.sqrt(2.0 * slowed_rad_s2 * (dog.pitch_rad - dog.backlash_rad))
    return max(context.settings.window.fire_slip_rad_s, passes)


def _slip_range(context: ShiftContext) -> tuple[float, float]:
    """The slips predicted for contact with which the sleeve is fired."""
    most = context.settings.guard.slip_high_rad_s - SPEEDS_RAD_S - PREDICTED_RAD_S
    return min(_wanted_slip(context), most) - SLACK_RAD_S, most


def _is_driven(
    context: ShiftContext, snapshot: StepSnapshot, gear: SplitGear, meeting: Meeting
) -> bool:
    """Whether the engine brings the input shaft to the new step's speed, and closes or opens the
    clutch for it: a shaft that is so slow that no swing of the gear's brings it the slip that is
    wanted, or that drag would take too long to slow down."""
    change, limits = context.running.splitter, context.settings.limits
    if not change.is_driven:
        falls = meeting.falls_rad_s2
        if falls is None or change.drives >= limits.raises:
            return False
        over = meeting.slip - falls * (context.sheet.sleeve.delay_s + SEEN_LATE_US * US)
        coasted, swings = falls * limits.coast_ms * MS_IN_US * US, SWINGS_SHARE * meeting.swing
        least, most = _slip_range(context)
        if least - swings <= over <= most + max(coasted, swings):
            return False
        change.is_driven, change.falls_rad_s2 = True, falls
        change.drives += 1
    wanted_rad_s = _driven_rad_s(context, gear, meeting, change.falls_rad_s2)
    if _arrives(context, snapshot, wanted_rad_s):
        change.is_driven = False
        return False
    context.clutch = ClutchAction.CLOSE
    _ask_engine(context, wanted_rad_s)
    return True


def _driven_rad_s(
    context: ShiftContext, gear: SplitGear, meeting: Meeting, falls_rad_s2: float
) -> float:
    """To this speed the engine brings the input shaft. A gear that swings far is met where it turns
    round, at its slowest: it changes least there."""
    wanted = _wanted_slip(context) + falls_rad_s2 * _lost_s(context) + SHORT_RAD_S
    wanted -= max(0.0, SWINGS_SHARE * meeting.swing - SLACK_RAD_S)
    low, high = _guarded_slips(context, gear)
    return meeting.step_rad_s + max(low, min(wanted, high))


def _ask_engine(context: ShiftContext, speed: float) -> None:
    """Asks the engine for a speed (rad/s), where it is one that it may have."""
    usable = context.settings.engine.least_rad_s <= speed <= context.sheet.limits.input_max_rad_s
    context.engine_rad_s = speed if usable else None


def _lost_s(context: ShiftContext) -> float:
    """From the clutch's setting off until a sleeve fired as the plates part comes to its gear."""
    clutch = context.sheet.clutch
    return clutch.open_delay_s * (1.0 - clutch.kiss_share) + context.sheet.sleeve.delay_s


def _guarded_slips(context: ShiftContext, gear: SplitGear) -> tuple[float, float]:
    """Of the speed that the engine is asked for over the new step's the guard lets pass no less and
    no more."""
    sheet, guard = context.sheet, context.settings.guard
    through = sheet.dog_mesh(gear).ratio / sheet.main_mesh(context.running.target.main).ratio
    low, high = through * guard.slip_low_rad_s, through * guard.slip_high_rad_s
    return low + SPEEDS_RAD_S, high - SPEEDS_RAD_S


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
    """Fires where the slip at contact is predicted to be one that is wanted, and the guard will see
    that it is: until shortly before it judges by the slip that it has measured."""
    change, (least, most) = context.running.splitter, _slip_range(context)
    is_seen = 0.5 * least <= meeting.now <= most
    if meeting.falls_rad_s2 is None or not (is_seen and least <= meeting.met <= most):
        return
    change.fire_us = change.fired_us = snapshot.earliest_us
    change.attempts += 1
    change.drives = 0
    context.board.schedule(DOG_VALVE[gear], True, change.fire_us, snapshot.now_us)


def _watch_contact(context: ShiftContext, snapshot: StepSnapshot, gear: SplitGear) -> None:
    """Until the step is in; a sleeve that stands on a tooth for too long goes back."""
    change, limits, side = context.running.splitter, context.settings.limits, SIDE_OF[gear]
    fire_us = change.fire_us or 0
    contact_us = context.sleeves.contact_us(gear, fire_us)
    if contact_us is None and not context.board.command(DOG_VALVE[gear]).on:
        # The guard has forbidden it before anything has touched.
        change.fire_us = None
        change.attempts -= 1
        return
    way_m = snapshot.view.position_m(Sleeve.SPLITTER) * side.direction
    is_at_face = way_m < context.sheet.sleeve.to_contact_m + CLEAR_M
    rests = contact_us is not None and snapshot.now_us - contact_us > limits.face_ms * MS_IN_US
    late = snapshot.now_us - fire_us > limits.engage_ms * MS_IN_US
    if (rests and is_at_face) or late:
        context.board.off(DOG_VALVE[gear])
        change.fire_us = None
        change.inputs.clear()
