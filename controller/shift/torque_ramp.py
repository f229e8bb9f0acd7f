"""The engine's torque is taken away before the clutch opens, so that the driveline does not ring.

TSC1 asks for no torque; the engine follows in its own time, and says how far it is (EEC1). The
clutch sets off so early that its plates part when no more than `engine.torque_left_percent` of the
engine's reference torque is left.
"""

from __future__ import annotations

from meshpoint.controller.settings import MS_IN_US
from meshpoint.controller.shift.context import ShiftContext
from meshpoint.controller.shift.step_snapshot import StepSnapshot


def ramp_down(context: ShiftContext, snapshot: StepSnapshot) -> bool:
    """Asks the engine for no torque; returns whether the clutch may set off: little enough will be
    left when its plates part, or the ramp has taken as long as it may."""
    limits = context.settings.engine
    if limits.ramp_ms == 0 or not context.engine_carries(snapshot):
        return True
    clutch = context.sheet.clutch
    parting_s = clutch.open_delay_s * (1.0 - context.kiss.share)
    left = context.torque.left_in(parting_s)
    if left is None:
        return True  # an engine that does not say how far it is cannot be waited for
    context.engine_share = 0.0
    if abs(left) <= limits.torque_left_share:
        return True
    return snapshot.now_us - context.since_us >= limits.ramp_ms * MS_IN_US
