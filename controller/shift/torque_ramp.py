"""The engine's torque is taken away before the clutch opens, so that the driveline does not ring.

TSC1 asks for no torque; the engine follows in its own time, and says how far it is (EEC1). The
clutch sets off so early that its plates part when no more than `engine.torque_left_percent` of the
engine's reference torque is left.

On a driveline that has been seen to ring the torque is asked for step by step as a plan says that
leaves shafts, wheels and tyres at rest as the plates part (`unloading`).
"""

from __future__ import annotations

import math
from typing import Final

from meshpoint.controller.models.twist import Twist
from meshpoint.controller.shift.context import ShiftContext
from meshpoint.controller.shift.step_snapshot import StepSnapshot
from meshpoint.controller.shift.unloading import unload
from meshpoint.units import SECOND_US, US

KNOWN_MS: Final = 400
"""What the shafts carry is waited for no longer: a gear is followed for `LEAST_S` before the
controller says it, and teeth may be lost meanwhile."""
BESIDE_SHARE: Final = 0.005
"""The guard allows for a step of the torque, a per cent, and rounding; half of a step is taken by
`owed_share`."""


def ramp_down(context: ShiftContext, snapshot: StepSnapshot) -> bool:
    """Asks the engine for less torque; returns whether the clutch may set off: little enough will
    be left when its plates part, or the torque has taken as long as it may."""
    limits = context.settings.engine
    if limits.ramp_ms == 0 or not context.engine_carries(snapshot):
        return True
    if _is_soon_known(context, snapshot):
        return False
    clutch = context.sheet.clutch
    parting_s = clutch.open_delay_s * (1.0 - clutch.kiss_share)
    left = context.torque.left_in(parting_s)
    if left is None:
        return True  # an engine that does not say how far it is cannot be waited for
    if context.rings.twists and limits.swing_ramp_ms > 0 and snapshot.loaded is not None:
        twist = snapshot.loaded.twist(snapshot.now_us)
        is_over = None if twist is None else _unload(context, snapshot, twist, parting_s)
        if is_over is not None:
            return is_over or context.late(snapshot, limits.swing_ramp_ms)
    context.engine_share = 0.0
    if abs(left) <= limits.torque_left_share:
        return True
    return context.late(snapshot, limits.ramp_ms)


def _is_soon_known(context: ShiftContext, snapshot: StepSnapshot) -> bool:
    """Whether what the shafts of a driveline that rings carry will be known in a moment. Soon after
    a gear was engaged they swing the most, also where the engine gives no torque."""
    shift, limits, loaded = context.running, context.settings.engine, snapshot.loaded
    is_planned = context.rings.twists and limits.swing_ramp_ms > 0 and shift.own_nm is None
    if not is_planned or loaded is None or shift.clutch_us is not None:
        return False
    return loaded.is_early and not context.late(snapshot, KNOWN_MS)


def _unload(
    context: ShiftContext, snapshot: StepSnapshot, twist: Twist, parting_s: float
) -> bool | None:
    """Asks for what the plan says; returns whether the clutch may set off, None without a plan."""
    shift, step_s = context.running, context.settings.timing.measured_us * US
    if shift.own_nm is None:
        shift.own_nm = (context.torque.share or 0.0) * context.sheet.engine.reference_nm
    if shift.clutch_us is not None:
        parting_s -= (snapshot.now_us - shift.clutch_us) / SECOND_US
    least = max(1, math.floor(parting_s / step_s))
    plan = unload(twist, shift.own_nm, step_s, least, shift.unloads_in)
    if plan is None:
        return None
    shift.unloads_in = plan.steps
    _ask(context, plan.torque_nm, shift.own_nm)
    return plan.steps <= least


def _ask(context: ShiftContext, torque_nm: float, own_nm: float) -> None:
    """Asks for a torque. own_nm: the engine's own, before any was taken away. Beyond none only as
    far as the engine needs to change its speed: more would load the clutch anew, and row 14 of the
    guard forbids it.

    TSC1 says it in the steps in which EEC1 does: what rounding leaves out is asked for with the
    next frames."""
    engine, shift, step = context.sheet.engine, context.running, context.torque.step
    turning_nm = engine.inertia_kgm2 * context.torque.engine_rad_s2
    beside_nm = BESIDE_SHARE * engine.reference_nm
    low_nm, high_nm = min(own_nm, 0.0, turning_nm), max(own_nm, 0.0, turning_nm)
    wanted_nm = min(max(torque_nm, low_nm - beside_nm), high_nm + beside_nm)
    owed = wanted_nm / engine.reference_nm + shift.owed_share
    context.engine_share = step * round(owed / step)
    shift.owed_share = owed - context.engine_share
