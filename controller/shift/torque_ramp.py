"""The engine's torque is taken away before the clutch opens, so that the driveline does not ring.

TSC1 asks for no torque; the engine follows in its own time, and says how far it is (EEC1). The
clutch sets off so early that its plates part when no more than `engine.torque_left_percent` of the
engine's reference torque is left.

On a driveline that has been seen to ring the torque is taken away in steps that leave the shafts
between engine and vehicle at rest, down to the one with which the clutch carries nothing
(`unloading`).
"""

from __future__ import annotations

from typing import Final

from meshpoint.controller.settings import MS_IN_US
from meshpoint.controller.shift.context import ShiftContext
from meshpoint.controller.shift.step_snapshot import StepSnapshot
from meshpoint.controller.shift.unloading import (
    Loaded,
    Unloading,
    geared_bodies,
    unloading,
)
from meshpoint.gearbox.gears import DRIVE_GEARS
from meshpoint.units import SECOND_US

BESIDE_SHARE: Final = 0.005
"""The guard allows for a step of the torque, a per cent, and rounding; half of a step is taken by
`owed_share`."""
BEFORE: Final = 1.0
"""This many periods of the shafts' swing before the ramp are looked at with it."""
LEAST_BEFORE_US: Final = 400 * MS_IN_US
"""At least so long before the ramp is looked at with it."""
MOST_LATE: Final = 1.5
"""A step is put off for no more than this many half periods after the last."""


def ramp_down(context: ShiftContext, snapshot: StepSnapshot) -> bool:
    """Asks the engine for less and less torque; returns whether the clutch may set off: the ramp
    will have ended and little enough will be left when its plates part, or the torque has taken as
    long as it may."""
    limits = context.settings.engine
    if limits.ramp_ms == 0 or not context.engine_carries(snapshot):
        return True
    clutch = context.sheet.clutch
    parting_s = clutch.open_delay_s * (1.0 - context.kiss.share)
    left = context.torque.left_in(parting_s)
    if left is None:
        return True  # an engine that does not say how far it is cannot be waited for
    ramp = _begun(context, snapshot)
    if ramp is None:
        context.engine_share, over_us, kept = 0.0, float(context.since_us), 0.0
    else:
        left, kept = context.torque.share or 0.0, _ask(context, ramp, snapshot)
        over_us = ramp.over_us - parting_s * SECOND_US
    if snapshot.now_us < over_us:
        return False
    if abs(left - kept) <= limits.torque_left_share:
        return True
    return snapshot.now_us - over_us >= limits.ramp_ms * MS_IN_US


def _begun(context: ShiftContext, snapshot: StepSnapshot) -> Unloading | None:
    """The ramp of this shift; None on a driveline that does not twist."""
    shift, seen, limits = context.running, context.driveline, context.settings.engine
    if shift.unloading is not None or context.clutch_opens:
        return shift.unloading
    gear, most_us = DRIVE_GEARS.get(shift.from_number), limits.swing_ramp_ms * MS_IN_US
    if not seen.twists or gear is None or most_us == 0:
        return None
    seen.loaded()
    layshaft = snapshot.speeds.layshaft
    drag_nm = 0.0 if layshaft is None else snapshot.layshaft.drag_nm(layshaft)
    bodies = geared_bodies(context.sheet, gear, seen.known, drag_nm)
    period_us = 2.0 * bodies.half_period_us
    own = seen.mean_share(period_us)
    fitted = seen.fit(bodies, snapshot.now_us - max(BEFORE * period_us, LEAST_BEFORE_US))
    if own is None or fitted is None:
        return None
    found, torque_nm = fitted
    begun = Loaded(
        own * context.sheet.engine.reference_nm,
        bodies.shafts_nm(torque_nm, found.acceleration_rad_s2),
        bodies.coasting_rad_s2(torque_nm, found.acceleration_rad_s2),
        seen.torque_sd_nm(bodies.ratio * found.acceleration_rad_s2),
    )
    seen.press(begun.pulled_nm, bodies.ratio * begun.doubt_nm, bodies.harmless_nm)
    ramps = unloading(context.sheet, bodies, begun, snapshot.now_us)
    short = [ramp for ramp in ramps if ramp.over_us - snapshot.now_us <= most_us]
    shift.unloading = (short or ramps[:1])[-1]
    return shift.unloading


def _ask(context: ShiftContext, ramp: Unloading, snapshot: StepSnapshot) -> float:
    """Asks for the ramp's torque at this time; returns it, as a share of the reference torque.

    TSC1 says it in the steps in which EEC1 does: what rounding leaves out is asked for with the
    next frames."""
    engine, shift, step = context.sheet.engine, context.running, context.driveline.torque_step
    if snapshot.now_us >= ramp.next_us:
        shift.unloading = ramp = _stepped(context, ramp, snapshot.now_us)
    wanted = _no_further(context, ramp.torque_nm / engine.reference_nm)
    owed = wanted + shift.owed_share
    context.engine_share = step * round(owed / step)
    shift.owed_share = owed - context.engine_share
    context.driveline.ask(wanted)
    return wanted


def _stepped(context: ShiftContext, ramp: Unloading, now_us: int) -> Unloading:
    """The ramp with its next step taken, or put off where the swing since it began turns out to be
    slower."""
    seen = _refitted(context, ramp)
    if seen.next_us > now_us + 0.5 * context.tick_us and now_us < _latest_us(ramp):
        return seen
    return seen._replace(taken=ramp.taken + 1, step_us=float(now_us))


def _refitted(context: ShiftContext, ramp: Unloading) -> Unloading:
    """The ramp with period and torque to end at as they are found from what was seen until now;
    shafts and vehicle are learned from it."""
    driveline, before = context.driveline, ramp.bodies
    period_us = 2.0 * before.half_period_us
    fitted = driveline.fit(before, ramp.began_us - max(BEFORE * period_us, LEAST_BEFORE_US))
    if fitted is None:
        return ramp
    found, torque_nm = fitted
    bodies = before._replace(known=found.known)
    coasting = bodies.coasting_rad_s2(torque_nm, found.acceleration_rad_s2)
    left_nm = bodies.coasting_nm(coasting)
    driveline.learned = found.known
    return ramp._replace(bodies=bodies, left_nm=left_nm)


def _latest_us(ramp: Unloading) -> float:
    """A step is put off no further than this."""
    return ramp.step_us + MOST_LATE * ramp.bodies.half_period_us


def _no_further(context: ShiftContext, share: float) -> float:
    """Beyond none only as far as the engine needs to change its speed as it does: more would load
    the clutch anew, and row 14 of the guard forbids it."""
    engine, own = context.sheet.engine, context.torque.share or 0.0
    needed = engine.inertia_kgm2 * context.driveline.engine_rad_s2 / engine.reference_nm
    low, high = min(own, 0.0, needed) - BESIDE_SHARE, max(own, 0.0, needed) + BESIDE_SHARE
    return min(max(share, low), high)
