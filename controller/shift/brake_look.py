"""Whether the brake does as it is told."""

from __future__ import annotations

import math
from typing import Final

from meshpoint.controller.planning.gear_predictor import GearPredictor
from meshpoint.gearbox import GearboxSheet
from meshpoint.units import US

HELD_SHARE: Final = 0.3
"""Of the supply's pressure: so much more than the slowest law of the data sheet leaves is held."""


def brake_holds(sheet: GearboxSheet, predictor: GearPredictor) -> bool:
    """Whether the brake still has the pressure of which it should be rid: a valve that is stuck. No
    gear may be engaged then, and no prediction holds that lets the pressure fall."""
    brake, state = sheet.brake, predictor.layshaft
    switches = predictor.brake.arrays()
    if switches.shape[1] == 0 or switches[1, -1] > 0.0:
        return False
    since_s = (state.time_us - float(switches[0, -1])) * US
    slowest_s = brake.time_constant_s * (1.0 + brake.time_constant_tolerance)
    left = math.exp(-max(0.0, since_s) / slowest_s)
    return state.pressure_pa > (left + HELD_SHARE) * sheet.air.supply_gauge_pa
