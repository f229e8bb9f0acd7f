"""When a sleeve that was stopped before its gear's teeth may be fired again.

Such a sleeve may meet its gear as its valve opens, so the guard judges the firing at once as if
it were the last call: the slip has to stay in its window though the layshaft fall on as it has. The
speeds that show how it falls are older than the brake's release may be.
"""

from __future__ import annotations

from typing import Final

from meshpoint.controller.plan.gear_predictor import GearPredictor
from meshpoint.controller.settings.settings import MS_IN_US
from meshpoint.controller.shift.context import ShiftContext
from meshpoint.controller.shift.step_snapshot import StepSnapshot
from meshpoint.units import SECOND_US

STANDS_US: Final = 150 * MS_IN_US
"""A sleeve stands before turning teeth for no longer: a gap further off is as soon reached from
neutral."""
SEEN_US: Final = 25 * MS_IN_US
"""How old the fall is, on the average, that the newest speeds show."""

TOLERANCE_RAD_S: Final = 1.0
"""The slip may leave the guard's window by so much: its speeds have errors."""


def fires_again_us(
    context: ShiftContext, predictor: GearPredictor, snapshot: StepSnapshot, earliest_us: int
) -> int | None:
    """The first firing, no sooner than `earliest_us`, that the guard lets pass; None where there is
    none while the sleeve may stand."""
    sleeve = context.sheet.sleeve
    low_rad_s = context.settings.guard.slip_low_rad_s - TOLERANCE_RAD_S
    # By the data sheet's latest contact, and from the newest speed on.
    falls_s = sleeve.delay_s + sleeve.delay_limit_s + context.tick_us / SECOND_US
    for fire_us in range(earliest_us, snapshot.now_us + STANDS_US, context.tick_us):
        fallen = _falls_rad_s2(context, predictor, fire_us - SEEN_US) * falls_s
        if predictor.slip_rad_s(fire_us) - fallen >= low_rad_s:
            return fire_us
    return None


def _falls_rad_s2(context: ShiftContext, predictor: GearPredictor, time_us: int) -> float:
    """How fast the brake lets the slip fall at a time: by its pressure as measured, or as predicted
    from the newest estimate on."""
    sheet, target = context.sheet, context.running.target
    measured = [pa for at_us, pa in context.brake_gauges if at_us <= time_us]
    if measured and time_us <= context.brake_gauges[-1][0]:
        gauge_pa = measured[-1]
    else:
        at_us = max(float(time_us), predictor.layshaft.time_us)
        gauge_pa = predictor.layshaft_at(at_us, None).pressure_pa
    ratio, inertia = sheet.main_mesh(target.main).ratio, sheet.inertia_kgm2(target.split)
    return ratio * sheet.brake_nm_per_pa * max(0.0, gauge_pa) / inertia
