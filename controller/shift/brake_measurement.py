"""Whether the brake does as it is commanded."""

from __future__ import annotations

import math
from typing import Final

from meshpoint.controller.plan.gear_predictor import GearPredictor
from meshpoint.gearbox import GearboxSheet
from meshpoint.units import US

HELD_SHARE: Final = 0.3
"""Of the supply's pressure: so much more than the slowest law of the data sheet leaves is held."""


SETTLED: Final = 5.0
"""This many time constants after a release nothing is left, and the sensor has seen it fall."""


def brake_holds(sheet: GearboxSheet, predictor: GearPredictor, measured_pa: float) -> bool:
    """Whether the brake still has the pressure of which it should be rid: a valve that is stuck. No
    gear may be engaged then, and no prediction holds that lets the pressure fall.

    measured_pa: the newest sample, gauge. An estimate that has just begun with a free layshaft does
    not know it yet."""
    brake, state = sheet.brake, predictor.layshaft
    switches = predictor.brake.arrays()
    is_known = switches.shape[1] > 0
    if is_known and switches[1, -1] > 0.0:
        return False
    since_s = (state.time_us - float(switches[0, -1])) * US if is_known else math.inf
    slowest_s = brake.time_constant_s * (1.0 + brake.time_constant_tolerance)
    if since_s > SETTLED * slowest_s and measured_pa > HELD_SHARE * sheet.air.supply_gauge_pa:
        return True
    left = math.exp(-max(0.0, since_s) / slowest_s)
    return state.pressure_pa > (left + HELD_SHARE) * sheet.air.supply_gauge_pa
